# pyright: strict
"""The impact rig on a bench: its command port and the stream of its acquisition module.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `PEAK deg_s` | `OK`: strikes give this rate from now on; `PEAK?` → deg/s |
| `ARM` | `OK duration_s`: the slider is cocked and the timer reset; ARMED after that time |
| `FIRE` | `OK duration_s`: the slider strikes within 10 ms; the table is at rest again after that time |
| `FIRE t_s` | the same at a programmed instant of the module's clock, from 20 ms to 10 s ahead |
| `SAFE` | `OK`: the slider is let down without a strike |
| `COUNT?` | triggers that the timer has seen since the rig was switched on |
| `STAT?` | `state,shots,triggered`; state SAFE COCKING ARMED MOVING FAULT; times fired; 0 or 1 |
| `LIM?` | `peak_low,peak_high,least_spacing_s`: deg/s, and s between strikes at the present setting |
| `CAL?` | ISO date until which the rig's calibration holds |
| `STRE ON` `STRE OFF` | `OK`; a record (`protocol.impact_rig`) for each frame of the unit |

Errors: 1 unknown, 2 arguments, 10 busy, 11 not armed, 12 limit, 14 door open. Faults: `door_open` (nothing
can be armed or fired), `no_trigger` (the contact is dirty: it strikes, the timer does not start),
`slider_stuck` (nothing strikes), `none`.

The unit's serial line goes through the module, so it sees the frames whether or not somebody reads them.
"""

from typing import ClassVar

from dut_emulator.stands.command_port import CommandPort, Commands, number, ok
from dut_emulator.stands.impact_rig.live_rig import LiveImpactRig
from dut_emulator.stands.impact_rig.rig import PEAK_RATE_DEG_S


class ImpactRigPort(CommandPort):
    """The rig behind its command port."""

    STAND = "an impact rig"
    FAULTS = ("none", "door_open", "no_trigger", "slider_stuck")
    COMMANDS: ClassVar[Commands] = {
        "PEAK": (1,),
        "PEAK?": (0,),
        "ARM": (0,),
        "FIRE": (0, 1),
        "SAFE": (0,),
        "COUNT?": (0,),
        "STAT?": (0,),
        "LIM?": (0,),
    }

    def __init__(self, rig: LiveImpactRig, identity: str, calibration_due: str) -> None:
        super().__init__(f"Testloom,IR1,{identity},1.0", calibration_due, rig.stream)
        self._rig = rig

    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        rig = self._rig
        match word:
            case "PEAK":
                rig.set_peak(number(arguments[0]))
                return "OK"
            case "PEAK?":
                return f"{rig.peak_deg_s:g}"
            case "ARM":
                return ok(rig.arm(now_s))
            case "FIRE":
                return ok(rig.fire(number(arguments[0]) if arguments else None, now_s))
            case "SAFE":
                rig.safe(now_s)
                return "OK"
            case "COUNT?":
                return str(rig.triggers(now_s))
            case "STAT?":
                return rig.status(now_s)
            case _:
                low, high = PEAK_RATE_DEG_S
                return f"{low:g},{high:g},{rig.least_spacing_s():.3f}"

    def _inject(self, fault: str, now_s: float) -> None:
        del now_s
        self._rig.inject(fault)

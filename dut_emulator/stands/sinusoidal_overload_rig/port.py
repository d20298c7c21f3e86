# pyright: strict
"""The command port of the overload rig, its trigger line and its sample stream. One command a line.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `RUN g` | `OK start_up_s`; `ERR 12` beyond a limit, `ERR 10` while it moves |
| `STOP` | `OK duration_s` |
| `AXIS n` | `OK`: body axis 1, 2 or 3 along the stroke; at rest only |
| `ARM` | `OK wait_s`: the next edge of the trigger line comes in so many s; `ERR 14` not at speed |
| `HALF?` | `force,T_s,V_m_s,S_m2_s3` of the last half-cycle, force 1 or -1; `ERR 14` before there is one |
| `STAT?` | `state,overload_g,speed_rad_s,angle_deg,position_m,temperature_c` |
| `LIM?` | `least_g,most_g,radius_m,speed_rad_s,motor_W` |
| `CAL?` | ISO date until which the rig's calibration holds |
| `STRE ON,rate_hz` `STRE OFF` | `OK`; samples on the stream link, up to 2000 Hz |

States: READY STARTING RUNNING STOPPING FAULT NOREF. Errors are `ERR code text`: 1 unknown command,
2 arguments, 10 moving, 11 zero mark lost, 12 beyond a limit, 13 door open, 14 not at speed. Faults:
`door_open`, `lost_reference` (the grating's zero mark), `speed_not_reached` (from the next `RUN` on), `none`.

The edges of the trigger line are the passes over the grating's zero mark, where the force along the stroke
changes its sign.

Stream sample: as a turntable's, with the crank's angle and speed as the inner ones and the grating's position
in the reserved place.
"""

import math
from typing import ClassVar

from dut_emulator.stands.command_port import (
    ERR_ARGUMENTS,
    CommandPort,
    Commands,
    Refused,
    SampleStream,
    accepted,
    number,
    ok,
)
from dut_emulator.stands.sinusoidal_overload_rig.live_rig import (
    ERR_NOT_RUNNING,
    FAULTS,
    RADIUS_M,
    LiveOverloadRig,
)
from protocol.stand_stream import STAND_SAMPLE_COLUMNS

MAX_STREAM_RATE_HZ = 2000.0


class OverloadPort(CommandPort):
    """One rig behind its command port; it is the trigger line too (`TriggerLine`)."""

    STAND = "an overload rig"
    FAULTS = FAULTS
    COMMANDS: ClassVar[Commands] = {
        "RUN": (1,),
        "STOP": (0,),
        "AXIS": (1,),
        "ARM": (0,),
        "HALF?": (0,),
        "STAT?": (0,),
        "LIM?": (0,),
    }

    def __init__(self, rig: LiveOverloadRig, identification: str) -> None:
        stream = SampleStream(rig.stream_rows, STAND_SAMPLE_COLUMNS, MAX_STREAM_RATE_HZ)
        super().__init__(identification, rig.rig.identity.calibration_due, stream)
        self.rig = rig

    def next_edge_s(self, after_s: float) -> float | None:
        """The trigger line's next edge; see `TriggerLine`."""
        return self.rig.next_mark_s(after_s)

    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        rig = self.rig
        match word:
            case "RUN":
                return ok(rig.start(number(arguments[0]), now_s))
            case "STOP":
                return ok(rig.stop(now_s))
            case "AXIS":
                if arguments[0] not in ("1", "2", "3"):
                    raise Refused(ERR_ARGUMENTS, "AXIS takes 1, 2 or 3")
                accepted(rig.mount(int(arguments[0]), now_s))
                return "OK"
            case "ARM":
                return ok(self._wait_s(now_s))
            case "HALF?":
                half = accepted(rig.half_cycle(now_s))
                figures = (half.duration_s, half.speed_change_m_s, half.squared_m2_s3)
                return ",".join([str(half.force), *(f"{figure:.9g}" for figure in figures)])
            case "STAT?":
                return self._status(now_s)
            case _:
                limits, drive = rig.rig.limits, rig.rig.drive
                figures = (limits.least_g, limits.most_g, RADIUS_M, limits.speed_rad_s, drive.motor_power_w)
                return ",".join(f"{figure:g}" for figure in figures)

    def _inject(self, fault: str, now_s: float) -> None:
        self.rig.inject(fault, now_s)

    def _status(self, now_s: float) -> str:
        status = self.rig.status(now_s)
        seen = (
            *(status.overload_g, status.speed_rad_s, math.degrees(status.angle_rad)),
            *(status.position_m, status.temperature_c),
        )
        return ",".join([status.state, *(f"{figure:.7f}" for figure in seen)])

    def _wait_s(self, now_s: float) -> float:
        """Time until the next edge of the trigger line."""
        state = self.rig.state(now_s)
        edge_s = self.rig.next_mark_s(now_s) if state == "RUNNING" else None
        if edge_s is None:
            raise Refused(ERR_NOT_RUNNING, f"not at speed: {state.lower()}")
        return edge_s - now_s

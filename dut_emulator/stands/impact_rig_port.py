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

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.impact_profile import Impacts, since_trigger_s
from dut_emulator.stands import impact_rig as rig_model
from protocol.bench_description import Site
from protocol.impact_rig import make_records, stamp_of

FloatArray = NDArray[np.float64]

ERR_UNKNOWN, ERR_ARGUMENTS = 1, 2
ERR_BUSY, ERR_NOT_ARMED, ERR_LIMIT, ERR_DOOR_OPEN = 10, 11, 12, 14
FAULTS: Final = ("none", "door_open", "no_trigger", "slider_stuck")

COCKING_S = 0.5
PROGRAMMED_AHEAD_S = (0.02, 10.0)
DEFAULT_PEAK_DEG_S = 40.0
SENDING_PERIOD_S = 0.05
"""Records leave the module at the latest so long after those before."""
MAX_KEPT = 256
"""Strikes, triggers and armings that are remembered: nobody asks about frames so long past."""

_COMMANDS = ("PEAK", "ARM", "FIRE", "SAFE", "STRE")
_QUERIES = ("*IDN?", "PEAK?", "COUNT?", "STAT?", "LIM?", "CAL?")


class Refused(Exception):
    """The rig does not do it: code and text."""


class LiveImpactRig:
    """The rig over bench time. See `Surroundings` and `TakesFrames`; commands get the bench time."""

    def __init__(self, seed: int, site: Site) -> None:
        self._character = rig_model.draw_character(seed)
        self._table = rig_model.TableSurroundings(site)
        self._rng = rig_model.live_generator(seed)
        self._impacts = Impacts(np.empty(0), np.empty(0), self._character.response)
        self._triggers_s = np.empty(0)
        self._armed_s = np.empty(0)
        self._forgotten_triggers = 0
        self._cocked_from_s = math.inf
        self._rest_from_s = -math.inf
        self._stream_from_s = math.inf
        self._pending: list[bytes] = []
        self.peak_deg_s = DEFAULT_PEAK_DEG_S
        self.shots = 0
        self.fault = "none"

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """How the unit is mounted."""
        return rig_model.rig_effects(self._character)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit."""
        return self._table.stimulus(self._impacts, times_s)

    def take_frames(self, frames: NDArray[np.uint8], received_s: FloatArray) -> None:
        """Stamp the unit's frames; they leave on the stream from when somebody has switched it on."""
        wanted = received_s >= self._stream_from_s
        if wanted.any():
            since = since_trigger_s(received_s[wanted], self._armed_s, self._triggers_s)
            self._pending.append(make_records(frames[wanted], stamp_of(since), received_s[wanted]))

    def stream(self, on: bool, now_s: float) -> None:
        """Switch the stream on or off."""
        self._stream_from_s = now_s if on else math.inf

    @property
    def streaming(self) -> bool:
        """Whether the stream is on."""
        return math.isfinite(self._stream_from_s)

    def records(self) -> bytes:
        """What has been stamped since the last call."""
        records = b"".join(self._pending)
        self._pending.clear()
        return records

    def set_peak(self, peak_deg_s: float) -> None:
        """How hard the next strikes are."""
        low, high = rig_model.PEAK_RATE_DEG_S
        if not low <= peak_deg_s <= high:
            raise Refused(ERR_LIMIT, f"the slider gives {low:g} to {high:g} deg/s")
        self.peak_deg_s = peak_deg_s

    def arm(self, now_s: float) -> float:
        """Cock the slider, reset the timer: how long it takes."""
        self._check_free(now_s)
        self._cocked_from_s = now_s + COCKING_S
        self._armed_s = np.append(self._armed_s, now_s)[-MAX_KEPT:]
        return COCKING_S

    def safe(self, now_s: float) -> None:
        """Let the slider down."""
        self._check_free(now_s)
        self._cocked_from_s = math.inf

    def fire(self, at_s: float | None, now_s: float) -> float:
        """Strike at a programmed instant, or when the slider comes: time from now until the table rests."""
        self._check_free(now_s)
        if now_s < self._cocked_from_s:
            raise Refused(ERR_NOT_ARMED, "the slider is not cocked")
        if at_s is None:
            error_s = float(rig_model.scattered_release_s(1, self._rng)[0])
        else:
            low, high = PROGRAMMED_AHEAD_S
            if not low <= at_s - now_s <= high:
                raise Refused(ERR_LIMIT, f"give an instant {low:g} to {high:g} s ahead")
            error_s = float(rig_model.programmed_error_s(1, self._rng)[0])
        impact_s = (now_s if at_s is None else at_s) + error_s
        jumps, jitter_s = rig_model.strike(self.peak_deg_s, 1, self._rng)
        self._cocked_from_s = math.inf
        if self.fault == "slider_stuck":
            self._rest_from_s = impact_s
            return impact_s - now_s
        self.shots += 1
        self._impacts = self._impacts.with_impact(impact_s, float(jumps[0]), MAX_KEPT)
        if self.fault != "no_trigger":
            trigger_s = impact_s + self._character.trigger_latency_s + float(jitter_s[0])
            self._forgotten_triggers += len(self._triggers_s) == MAX_KEPT
            self._triggers_s = np.append(self._triggers_s, trigger_s)[-MAX_KEPT:]
        self._rest_from_s = impact_s + self._character.response.stop_s(float(jumps[0]))
        return self._rest_from_s - now_s

    def triggers(self, now_s: float) -> int:
        """How many the timer has seen."""
        return self._forgotten_triggers + int(np.searchsorted(self._triggers_s, now_s, side="right"))

    def least_spacing_s(self) -> float:
        """Between strikes at the present setting."""
        return rig_model.least_spacing_s(self._character.response, self.peak_deg_s)

    def status(self, now_s: float) -> str:
        """What `STAT?` says."""
        if self.fault == "door_open":
            state = "FAULT"
        elif now_s < self._rest_from_s:
            state = "MOVING"
        elif math.isinf(self._cocked_from_s):
            state = "SAFE"
        else:
            state = "ARMED" if now_s >= self._cocked_from_s else "COCKING"
        since = since_trigger_s(np.array([now_s]), self._armed_s, self._triggers_s)
        return f"{state},{self.shots},{int(not np.isnan(since[0]))}"

    def inject(self, fault: str) -> None:
        """An open door lets the slider down; what already moves, moves on."""
        self.fault = fault
        if fault == "door_open":
            self._cocked_from_s = math.inf

    def _check_free(self, now_s: float) -> None:
        if self.fault == "door_open":
            raise Refused(ERR_DOOR_OPEN, "the door is open")
        if now_s < self._rest_from_s:
            raise Refused(ERR_BUSY, "the table is not at rest, or a strike is due")


class ImpactRigPort:
    """The rig behind its command port. See `StandModel`."""

    def __init__(self, rig: LiveImpactRig, identity: str) -> None:
        self._rig = rig
        self._identification = f"Testloom,IR1,{identity},1.0"
        self._sent_s = -math.inf

    def command(self, line: str, now_s: float) -> str:
        """The answer to one line."""
        word, _, rest = line.strip().partition(" ")
        try:
            return self._dispatch(word.upper(), rest.strip(), now_s)
        except Refused as refusal:
            code, text = refusal.args
            return f"ERR {code} {text}"
        except ValueError as error:
            return f"ERR {ERR_ARGUMENTS} {error}"

    def advance(self, to_s: float) -> bytes:
        """Records of the frames that have come; they bring their own times."""
        self._sent_s = to_s
        return self._rig.records()

    def next_event_s(self) -> float | None:
        """When the module sends what it has got, while its stream is on."""
        return self._sent_s + SENDING_PERIOD_S if self._rig.streaming else None

    def inject(self, fault: str, now_s: float) -> None:
        """Raises BenchModelError for a fault that this stand cannot have."""
        del now_s
        if fault not in FAULTS:
            raise BenchModelError(
                f"an impact rig cannot have the fault '{fault}'; it can {', '.join(FAULTS)}"
            )
        self._rig.inject(fault)

    def _dispatch(self, word: str, argument: str, now_s: float) -> str:
        rig = self._rig
        match word, bool(argument):
            case "PEAK", True:
                rig.set_peak(_number(argument))
                return "OK"
            case "ARM", False:
                return f"OK {rig.arm(now_s):.9f}"
            case "FIRE", _:
                return f"OK {rig.fire(_number(argument) if argument else None, now_s):.9f}"
            case "SAFE", False:
                rig.safe(now_s)
                return "OK"
            case "STRE", True if argument.upper() in ("ON", "OFF"):
                rig.stream(argument.upper() == "ON", now_s)
                self._sent_s = now_s
                return "OK"
            case _, False if word in _QUERIES:
                return self._answer(word, now_s)
            case _ if word in (*_COMMANDS, *_QUERIES):
                raise ValueError(f"{word} does not take '{argument[:20]}'")
            case _:
                return f"ERR {ERR_UNKNOWN} unknown command {word[:20]}"

    def _answer(self, query: str, now_s: float) -> str:
        rig = self._rig
        low, high = rig_model.PEAK_RATE_DEG_S
        return {
            "*IDN?": self._identification,
            "PEAK?": f"{rig.peak_deg_s:g}",
            "COUNT?": str(rig.triggers(now_s)),
            "STAT?": rig.status(now_s),
            "LIM?": f"{low:g},{high:g},{rig.least_spacing_s():.3f}",
            "CAL?": rig_model.CALIBRATION_DUE,
        }[query]


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{text[:20]}' is not a number")
    return value

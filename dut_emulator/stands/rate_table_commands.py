# pyright: strict
"""The command port and the sample stream of a single-axis rate table. One command a line.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `HOME` | `OK duration_s`: one slow turn over the reference mark; needed once before anything moves |
| `RATE rate[,acceleration]` | `OK duration_s`: of the ramp, then the rate is held; `RATE 0` is `LOCK` |
| `LOCK` | `OK duration_s`: to rest, then locked |
| `TILT axis` | `OK duration_s`: body axis 1, 2 or 3 (x, y, z) up, along the table's axis; only when locked |
| `STOP` | `OK`: everything to rest at the greatest acceleration |
| `STAT?` | `state,rate,commanded,angle,axis,temperature_c` (deg/s, deg/s, deg); axis 0: between two |
| `LIM?` | `least_rate,greatest_rate,greatest_acceleration` (deg/s, deg/s, deg/s²) |
| `CAL?` | ISO date until which its calibration holds |
| `STRE ON,rate_hz` `STRE OFF` | `OK`; samples on the stream link, as a turntable's |

States: NOREF LOCKED RAMPING HOLDING SHORT TILTING SEEKING FAULT. SHORT: the drive holds less than it was
told. Errors are `ERR code text`: 1 unknown command, 2 arguments, 10 busy, 11 no reference, 12 limit, 13 door
open, 14 no mark, 15 argument, 16 not locked. Faults: door_open, lost_reference, rate_not_reached, none.
"""

import math

import numpy as np

from dut_emulator.interfaces import BenchModelError, StandRefusal
from dut_emulator.stands.rate_table_model import (
    FAULTS,
    MAX_ACCELERATION_DEG_S2,
    MAX_RATE_DEG_S,
    MIN_RATE_DEG_S,
    RateTableModel,
)

ERR_UNKNOWN, ERR_ARGUMENTS = 1, 2
MAX_STREAM_RATE_HZ = 2000.0
ARGUMENTS: dict[str, tuple[int, ...]] = {
    "*IDN?": (0,),
    "HOME": (0,),
    "RATE": (1, 2),
    "LOCK": (0,),
    "TILT": (1,),
    "STOP": (0,),
    "STAT?": (0,),
    "LIM?": (0,),
    "CAL?": (0,),
    "STRE": (1, 2),
}
"""Command → how many arguments it takes."""
_INSTANT_TOLERANCE_S = 1e-9


class RateTablePort:
    """One table behind its command port. See `StandModel`."""

    def __init__(self, table: RateTableModel, identification: str, calibration_due: str) -> None:
        self._table = table
        self._identification = identification
        self._calibration_due = calibration_due
        self._rate_hz = 0.0
        self._started_s = 0.0
        self._taken = 0
        self._pending: list[bytes] = []

    def command(self, line: str, now_s: float) -> str:
        """The answer to one line."""
        self._sample_to(now_s)
        word, _, rest = line.strip().partition(" ")
        word = word.upper()
        arguments = [part.strip() for part in rest.split(",")] if rest.strip() else []
        if word not in ARGUMENTS:
            return f"ERR {ERR_UNKNOWN} unknown command {word[:20]}"
        if len(arguments) not in ARGUMENTS[word]:
            return f"ERR {ERR_ARGUMENTS} {word} does not take {len(arguments)} arguments"
        try:
            return self._dispatch(word, arguments, now_s)
        except ValueError as error:
            return f"ERR {ERR_ARGUMENTS} {error}"

    def advance(self, to_s: float) -> bytes:
        """Stream samples of (last advance, to_s]."""
        self._sample_to(to_s)
        samples = b"".join(self._pending)
        self._pending.clear()
        return samples

    def next_event_s(self) -> float | None:
        """When the next sample is due."""
        return self._started_s + self._taken / self._rate_hz if self._rate_hz else None

    def inject(self, fault: str, now_s: float) -> None:
        """Raises BenchModelError for a fault that a rate table cannot have."""
        if fault not in FAULTS:
            raise BenchModelError(f"a rate table cannot have the fault '{fault}'; it can {', '.join(FAULTS)}")
        self._sample_to(now_s)
        self._table.inject(fault, now_s)

    def _dispatch(self, word: str, arguments: list[str], now_s: float) -> str:
        match word:
            case "*IDN?":
                return self._identification
            case "HOME":
                return _done(self._table.home(now_s))
            case "RATE":
                rate, acceleration = [*map(_number, arguments), None][:2]
                assert rate is not None
                return _done(self._table.set_rate(rate, acceleration, now_s))
            case "LOCK":
                return _done(self._table.set_rate(0.0, None, now_s))
            case "TILT":
                axis = _number(arguments[0])
                return _done(self._table.tilt(int(axis) if axis.is_integer() else 0, now_s))
            case "STOP":
                self._table.stop(now_s)
                return "OK"
            case "STAT?":
                now = self._table.status(now_s)
                figures = f"{now.rate_deg_s:.6f},{now.commanded_deg_s:.6f},{now.angle_deg:.6f}"
                return f"{now.state},{figures},{now.axis},{now.temperature_c:.6f}"
            case "LIM?":
                return f"{MIN_RATE_DEG_S:g},{MAX_RATE_DEG_S:g},{MAX_ACCELERATION_DEG_S2:g}"
            case "CAL?":
                return self._calibration_due
            case _:
                return self._stream(arguments, now_s)

    def _stream(self, arguments: list[str], now_s: float) -> str:
        match [arguments[0].upper(), *arguments[1:]]:
            case ["OFF"]:
                self._rate_hz = 0.0
            case ["ON", text]:
                rate_hz = _number(text)
                if not 0 < rate_hz <= MAX_STREAM_RATE_HZ:
                    raise ValueError(f"the stream's rate must lie between 0 and {MAX_STREAM_RATE_HZ:g} Hz")
                self._rate_hz, self._started_s, self._taken = rate_hz, now_s, 0
            case _:
                raise ValueError("STRE takes OFF, or ON and a rate")
        return "OK"

    def _sample_to(self, now_s: float) -> None:
        if not self._rate_hz:
            return
        ripe = math.floor((now_s - self._started_s + _INSTANT_TOLERANCE_S) * self._rate_hz) + 1
        if ripe > self._taken:
            times_s = self._started_s + np.arange(self._taken, ripe) / self._rate_hz
            self._pending.append(self._table.encoder_samples(times_s).astype("<f8").tobytes())
            self._taken = ripe


def _done(answer: float | StandRefusal) -> str:
    return f"ERR {answer.code} {answer.text}" if isinstance(answer, StandRefusal) else f"OK {answer:.9f}"


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{text[:20]}' is not a number")
    return value

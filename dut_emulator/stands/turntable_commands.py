# pyright: strict
"""The command port and the sample stream of turntables, as docs/bench.md has them.

    *IDN?                              identification
    CAL?                               ISO date until which the stand's own calibration holds
    HOME                               OK, or ERR code text
    MOVE outer,middle,inner            OK duration_s
    ROT axis,angle,duration_s,ramp_s   OK duration_s
    SWING axis,amplitude,rate,cycles   OK duration_s: sine of this amplitude and peak rate, whole periods
                                       between the present angle and two amplitudes further
    STOP                               OK
    STAT?                              state, three angles, three rates, temperature of the probe
    LIM?                               three rates, three accelerations; 0: this axis has no drive
    STRE ON,rate_hz   STRE OFF         OK
    TEMP target,ramp                   OK duration_s: °C, °C/min; chambers only
    TEMP?                              air at the probe, set point; chambers only

All turntables have three angles; an axis without a drive stays at its home, and asking it to turn is ERR 15.
The faults 'door_open' (ERR 13), 'lost_reference' (ERR 11 until HOME) and 'rate_not_reached' can be injected:
under the last a ROT is answered as ever, but runs at nine tenths of its rate and ends short of its angle.

Angles are in degrees on the command port and in radians in the stream. An error is `ERR code text`; codes
from 10 up are the stand's own. Sample k of a stream is taken k / rate after `STRE ON`; samples of the past
are taken before a command changes the motion.

Omitted: continuous rate mode, sweeps, the axes' zero settings.
"""

import math
from typing import Final, Protocol

import numpy as np

from dut_emulator.interfaces import BenchModelError, EmulatedStand, StandRefusal
from protocol.stand_stream import STAND_SAMPLE_DTYPE

ERR_UNKNOWN, ERR_ARGUMENTS = 1, 2
MAX_STREAM_RATE_HZ = 2000.0
STAND_FAULTS: Final = ("none", "door_open", "lost_reference", "rate_not_reached")
_INSTANT_TOLERANCE_S = 1e-9


class Turntable(EmulatedStand, Protocol):
    """What the port asks of a stand."""

    def swing(
        self, axis: str, amplitude_deg: float, peak_rate_deg_s: float, cycles: float, now_s: float
    ) -> float | StandRefusal:
        """Whole periods of a sine on one axis."""
        ...


class Chamber(Protocol):
    """What the port asks of a stand with a chamber."""

    def set_temperature(self, target_c: float, ramp_c_per_min: float, now_s: float) -> float | StandRefusal:
        """Begin a ramp of the air; the time that it takes in s."""
        ...

    def temperatures_c(self, now_s: float) -> tuple[float, float]:
        """Of the air at the probe, and the set point."""
        ...


class TurntablePort:
    """One turntable behind its command port. See `StandModel`.

    `calibration_due`: None answers no `CAL?`. `chamber`: None answers no `TEMP`.
    """

    def __init__(
        self,
        stand: Turntable,
        identification: str,
        calibration_due: str | None = None,
        chamber: Chamber | None = None,
    ) -> None:
        self._stand = stand
        self._identification = identification
        self._calibration_due, self._chamber = calibration_due, chamber
        self._rate_hz = 0.0
        self._started_s = 0.0
        self._taken = 0
        self._pending: list[bytes] = []

    def command(self, line: str, now_s: float) -> str:
        """The answer to one line."""
        self._sample_to(now_s)
        word, _, rest = line.strip().partition(" ")
        arguments = [part.strip() for part in rest.split(",")] if rest.strip() else []
        try:
            return self._dispatch(word.upper(), arguments, now_s)
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
        """Raises BenchModelError for a fault that a stand cannot have."""
        if fault not in STAND_FAULTS:
            raise BenchModelError(
                f"a stand cannot have the fault '{fault}'; it can {', '.join(STAND_FAULTS)}"
            )
        self._sample_to(now_s)
        self._stand.inject(fault, now_s)

    def _dispatch(self, word: str, arguments: list[str], now_s: float) -> str:
        match word, len(arguments):
            case "HOME" | "MOVE" | "ROT" | "SWING" | "STOP", _:
                return self._motion(word, arguments, now_s)
            case "*IDN?", 0:
                return self._identification
            case "STAT?", 0:
                status = self._stand.status(now_s)
                figures = (*status.angles_deg, *status.rates_deg_s, status.temperature_c)
                return ",".join([status.state, *(f"{figure:.6f}" for figure in figures)])
            case "LIM?", 0:
                return ",".join(f"{limit:g}" for limit in self._stand.limits())
            case "STRE", 1 | 2:
                return self._stream(arguments, now_s)
            case "CAL?", 0 if self._calibration_due is not None:
                return self._calibration_due
            case "TEMP" | "TEMP?", _ if self._chamber is not None:
                return self._temperature(self._chamber, word, arguments, now_s)
            case (("*IDN?" | "STAT?" | "LIM?" | "STRE"), count):
                raise ValueError(f"{word} does not take {count} arguments")
            case _:
                return f"ERR {ERR_UNKNOWN} unknown command {word[:20]}"

    def _motion(self, word: str, arguments: list[str], now_s: float) -> str:
        match word, len(arguments):
            case "HOME", 0:
                answer = self._stand.home(now_s)
                return _refused(answer) if isinstance(answer, StandRefusal) else "OK"
            case "MOVE", 3:
                outer, middle, inner = (_number(text) for text in arguments)
                return _done(self._stand.move((outer, middle, inner), now_s))
            case "ROT", 4:
                angle_deg, duration_s, ramp_s = (_number(text) for text in arguments[1:])
                return _done(self._stand.rotate(arguments[0].lower(), angle_deg, duration_s, ramp_s, now_s))
            case "SWING", 4:
                amplitude_deg, rate_deg_s, cycles = (_number(text) for text in arguments[1:])
                axis = arguments[0].lower()
                return _done(self._stand.swing(axis, amplitude_deg, rate_deg_s, cycles, now_s))
            case "STOP", 0:
                self._stand.stop(now_s)
                return "OK"
            case _, count:
                raise ValueError(f"{word} does not take {count} arguments")

    def _temperature(self, chamber: Chamber, word: str, arguments: list[str], now_s: float) -> str:
        match word, len(arguments):
            case "TEMP?", 0:
                air_c, target_c = chamber.temperatures_c(now_s)
                return f"{air_c:.2f},{target_c:g}"
            case "TEMP", 2:
                target_c, ramp_c_per_min = (_number(text) for text in arguments)
                return _done(chamber.set_temperature(target_c, ramp_c_per_min, now_s))
            case _, count:
                raise ValueError(f"{word} does not take {count} arguments")

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
            rows = self._stand.encoder_samples(times_s).astype("<f8")
            assert rows.shape[1] * 8 == STAND_SAMPLE_DTYPE.itemsize
            self._pending.append(rows.tobytes())
            self._taken = ripe


def _done(answer: float | StandRefusal) -> str:
    return _refused(answer) if isinstance(answer, StandRefusal) else f"OK {answer:.9f}"


def _refused(refusal: StandRefusal) -> str:
    return f"ERR {refusal.code} {refusal.text}"


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{text[:20]}' is not a number")
    return value

# pyright: strict
"""The command port of a satellite simulator: a line for a command, a line for an answer.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `SCEN profile[,parameter=value …]` | `OK duration_s`: loads `satellite_static` or `satellite_trajectory` |
| `STAR` | `OK duration_s`: plays it from its beginning |
| `STOP` | `OK`: no signals |
| `SATS n` | `OK`: signals of so many satellites, 0 to 16 |
| `POW dbm` `POW satellite,dbm` | `OK`: of all signals, or of one (from 1) |
| `POW? satellite` | dBm that is set |
| `REF?` | `LOCKED` or `UNLOCKED`: the time's reference |
| `PPS?` | seconds until the next pulse, by its own time; pulses come on whole seconds of a scenario |
| `STAT?` | `state,satellites,elapsed_s,east,north,up,speed` (m, m/s); state READY PLAYING NOREF FAULT |
| `LIM?` | `least_power,greatest_power,satellites,speed,acceleration` (dBm, dBm, 1, m/s, m/s²) |
| `CAL?` | ISO date until which its calibration holds |
| `STRE ON,rate_hz` `STRE OFF` | `OK`; samples on the stream link, up to 100 Hz |

Errors are `ERR code text`: 1 unknown command, 2 arguments, 10 playing, 11 reference not locked, 12 beyond a
limit, 13 RF output dead, 15 no such profile or value, 16 no scenario, or none playing. Faults: no_signal
(FAULT), reference_unlocked (NOREF: what plays goes on with a time that runs away, nothing new starts), none.

Stream sample (little endian, 8 × f64, no framing): time_s, position east north up (m), velocity east north up
(m/s), satellites. At rest in the origin without satellites while nothing plays.
"""

import math
from typing import Final

import numpy as np

from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.satellite_profiles import MAX_SATELLITES
from dut_emulator.stands.satellite_simulator import (
    ACCELERATION_LIMIT_M_S2,
    CALIBRATION_DUE,
    POWER_LIMITS_DBM,
    SPEED_LIMIT_M_S,
    LiveSatelliteSimulator,
    check_power,
    track_rows,
)
from protocol.errors import TestloomError

ERR_UNKNOWN, ERR_ARGUMENTS = 1, 2
ERR_PLAYING, ERR_NO_REFERENCE, ERR_LIMIT, ERR_DEAD, ERR_ARGUMENT, ERR_NOTHING = 10, 11, 12, 13, 15, 16
STAND_FAULTS: Final = ("none", "no_signal", "reference_unlocked")
MAX_STREAM_RATE_HZ = 100.0
_INSTANT_TOLERANCE_S = 1e-9
_COUNTS: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("*IDN?", "STAR", "STOP", "REF?", "PPS?", "STAT?", "LIM?", "CAL?"), (0,)),
    **{"SCEN": tuple(range(1, 20)), "SATS": (1,), "POW": (1, 2), "POW?": (1,), "STRE": (1, 2)},
}


class _Refused(Exception):
    """A code and a text: why a command is not carried out."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f"ERR {code} {text}")


class SatelliteSimulatorPort:
    """See `StandModel`."""

    def __init__(self, model: LiveSatelliteSimulator, identification: str) -> None:
        self._model, self._identification = model, identification
        self._rate_hz = self._started_s = 0.0
        self._taken = 0
        self._pending: list[bytes] = []

    def command(self, line: str, now_s: float) -> str:
        """The answer to one line."""
        self._sample_to(now_s)
        word, _, rest = line.strip().partition(" ")
        word = word.upper()
        arguments = [part.strip() for part in rest.split(",")] if rest.strip() else []
        try:
            if word not in _COUNTS:
                raise _Refused(ERR_UNKNOWN, f"unknown command {word[:20]}")
            if len(arguments) not in _COUNTS[word]:
                raise _Refused(ERR_ARGUMENTS, f"{word} does not take {len(arguments)} arguments")
            if word in ("SCEN", "STAR", "STOP", "SATS", "POW", "STRE"):
                return self._ordered(word, arguments, now_s)
            return self._asked(word, arguments, now_s)
        except _Refused as refusal:
            return str(refusal)

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
        """Raises BenchModelError for a fault that this stand cannot have."""
        if fault not in STAND_FAULTS:
            raise BenchModelError(
                f"a satellite simulator cannot have the fault '{fault}'; it can {', '.join(STAND_FAULTS)}"
            )
        self._sample_to(now_s)
        self._model.inject(fault, now_s)

    def _ordered(self, word: str, arguments: list[str], now_s: float) -> str:
        model = self._model
        match word:
            case "SCEN":
                return self._load(arguments, now_s)
            case "STAR":
                return self._start(now_s)
            case "STOP":
                model.stop(now_s)
            case "SATS":
                count = _number(arguments[0])
                if count not in range(MAX_SATELLITES + 1):
                    raise _Refused(ERR_LIMIT, f"0 to {MAX_SATELLITES} satellites")
                model.count = int(count)
                model.changed(now_s)
            case "POW":
                chosen = slice(None) if len(arguments) == 1 else _satellite(arguments[0])
                power_dbm = _number(arguments[-1])
                try:
                    check_power(power_dbm)
                except TestloomError as error:
                    raise _Refused(ERR_LIMIT, error.what.rstrip(".")) from None
                model.power_dbm[chosen] = power_dbm
                model.changed(now_s)
            case _:
                self._stream(arguments, now_s)
        return "OK"

    def _asked(self, word: str, arguments: list[str], now_s: float) -> str:
        model = self._model
        match word:
            case "*IDN?":
                return self._identification
            case "CAL?":
                return CALIBRATION_DUE
            case "LIM?":
                limits = (*POWER_LIMITS_DBM, MAX_SATELLITES, SPEED_LIMIT_M_S, ACCELERATION_LIMIT_M_S2)
                return ",".join(f"{limit:g}" for limit in limits)
            case "POW?":
                return f"{model.power_dbm[_satellite(arguments[0])]:.2f}"
            case "REF?":
                return "LOCKED" if model.is_locked else "UNLOCKED"
            case "PPS?":
                elapsed_s = model.elapsed_s(now_s)
                if elapsed_s is None:
                    raise _Refused(ERR_NOTHING, "no scenario plays")
                return f"{math.floor(elapsed_s) + 1 - elapsed_s:.9f}"
            case _:
                row = self._row(now_s)
                figures = (model.elapsed_s(now_s) or 0.0, *row[1:4], math.hypot(row[4], row[5], row[6]))
                return ",".join(
                    [self._state(now_s), f"{row[7]:.0f}", *(f"{figure:.6f}" for figure in figures)]
                )

    def _state(self, now_s: float) -> str:
        if not self._model.has_signal:
            return "FAULT"
        if not self._model.is_locked:
            return "NOREF"
        return "READY" if self._model.elapsed_s(now_s) is None else "PLAYING"

    def _load(self, arguments: list[str], now_s: float) -> str:
        if self._model.elapsed_s(now_s) is not None:
            raise _Refused(ERR_PLAYING, "playing: STOP first")
        values: dict[str, float] = {}
        for argument in arguments[1:]:
            name, equals, value = argument.partition("=")
            if not equals:
                raise _Refused(ERR_ARGUMENTS, f"'{argument[:40]}' is no parameter=value")
            values[name.strip()] = _number(value)
        try:
            scenario = self._model.load(arguments[0].lower(), values)
        except TestloomError as error:
            code = ERR_LIMIT if error.where.startswith("stand ") else ERR_ARGUMENT
            raise _Refused(code, error.what.rstrip(".")) from None
        return f"OK {scenario.duration_s:.9f}"

    def _start(self, now_s: float) -> str:
        model, state = self._model, self._state(now_s)
        if state == "FAULT":
            raise _Refused(ERR_DEAD, "RF output dead")
        if state == "NOREF":
            raise _Refused(ERR_NO_REFERENCE, "reference not locked")
        if state == "PLAYING":
            raise _Refused(ERR_PLAYING, "playing: STOP first")
        if model.scenario is None:
            raise _Refused(ERR_NOTHING, "no scenario: SCEN first")
        model.start(now_s)
        return f"OK {model.scenario.duration_s:.9f}"

    def _stream(self, arguments: list[str], now_s: float) -> None:
        match [arguments[0].upper(), *arguments[1:]]:
            case ["OFF"]:
                self._rate_hz = 0.0
            case ["ON", text]:
                rate_hz = _number(text)
                if not 0 < rate_hz <= MAX_STREAM_RATE_HZ:
                    raise _Refused(
                        ERR_ARGUMENTS, f"the rate must be above 0 and up to {MAX_STREAM_RATE_HZ:g} Hz"
                    )
                self._rate_hz, self._started_s, self._taken = rate_hz, now_s, 0
            case _:
                raise _Refused(ERR_ARGUMENTS, "STRE takes OFF, or ON and a rate")

    def _row(self, time_s: float) -> list[float]:
        elapsed_s = self._model.elapsed_s(time_s)
        if elapsed_s is None or self._model.scenario is None:
            return [time_s, *[0.0] * 7]
        moved = track_rows(self._model.scenario.track, np.array([elapsed_s]))[0]
        return [time_s, *moved.tolist(), float(self._model.count if self._model.has_signal else 0)]

    def _sample_to(self, now_s: float) -> None:
        if not self._rate_hz:
            return
        ripe = math.floor((now_s - self._started_s + _INSTANT_TOLERANCE_S) * self._rate_hz) + 1
        for number in range(self._taken, ripe):
            row = self._row(self._started_s + number / self._rate_hz)
            self._pending.append(np.array(row, dtype="<f8").tobytes())
        self._taken = max(ripe, self._taken)


def _satellite(text: str) -> int:
    number = _number(text)
    if number not in range(1, MAX_SATELLITES + 1):
        raise _Refused(ERR_LIMIT, f"satellites are 1 to {MAX_SATELLITES}")
    return int(number) - 1


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _Refused(ERR_ARGUMENTS, f"'{text[:20]}' is not a number")
    return value

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
limit, 13 RF output dead, 15 no such profile or value, 16 no scenario, or none playing. Faults: `no_signal`
(FAULT), `reference_unlocked` (NOREF: what plays goes on with a time that runs away, nothing new starts),
`none`.

Stream sample (little endian, 8 × f64, no framing): time_s, position east north up (m), velocity east north up
(m/s), satellites. At rest in the origin without satellites while nothing plays.
"""

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from dut_emulator.motion.satellite_profiles import MAX_SATELLITES
from dut_emulator.stands.command_port import (
    CommandPort,
    Commands,
    Refused,
    SampleStream,
    named_numbers,
    number,
)
from dut_emulator.stands.satellite_simulator.simulator import (
    ACCELERATION_LIMIT_M_S2,
    POWER_LIMITS_DBM,
    SPEED_LIMIT_M_S,
    LiveSatelliteSimulator,
    check_power,
    track_rows,
)
from protocol.errors import TestloomError

ERR_PLAYING, ERR_NO_REFERENCE, ERR_LIMIT, ERR_DEAD, ERR_ARGUMENT, ERR_NOTHING = 10, 11, 12, 13, 15, 16
MAX_STREAM_RATE_HZ = 100.0
STREAM_COLUMNS = 8
MAX_ARGUMENTS = 20


class SatelliteSimulatorPort(CommandPort):
    """One simulator behind its command port."""

    STAND = "a satellite simulator"
    FAULTS = ("none", "no_signal", "reference_unlocked")
    COMMANDS: ClassVar[Commands] = {
        "SCEN": range(1, MAX_ARGUMENTS + 1),
        "STAR": (0,),
        "STOP": (0,),
        "SATS": (1,),
        "POW": (1, 2),
        "POW?": (1,),
        "REF?": (0,),
        "PPS?": (0,),
        "STAT?": (0,),
        "LIM?": (0,),
    }

    def __init__(self, model: LiveSatelliteSimulator, identification: str, calibration_due: str) -> None:
        stream = SampleStream(self._rows, STREAM_COLUMNS, MAX_STREAM_RATE_HZ)
        super().__init__(identification, calibration_due, stream)
        self._model = model

    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        return (self._asked if word.endswith("?") else self._ordered)(word, arguments, now_s)

    def _inject(self, fault: str, now_s: float) -> None:
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
                count = number(arguments[0])
                if count not in range(MAX_SATELLITES + 1):
                    raise Refused(ERR_LIMIT, f"0 to {MAX_SATELLITES} satellites")
                model.count = int(count)
                model.changed(now_s)
            case _:
                chosen = slice(None) if len(arguments) == 1 else _satellite(arguments[0])
                power_dbm = number(arguments[-1])
                try:
                    check_power(power_dbm)
                except TestloomError as error:
                    raise Refused(ERR_LIMIT, error.what.rstrip(".")) from None
                model.power_dbm[chosen] = power_dbm
                model.changed(now_s)
        return "OK"

    def _asked(self, word: str, arguments: list[str], now_s: float) -> str:
        model = self._model
        match word:
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
                    raise Refused(ERR_NOTHING, "no scenario plays")
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
            raise Refused(ERR_PLAYING, "playing: STOP first")
        values = named_numbers(arguments[1:])
        try:
            scenario = self._model.load(arguments[0].lower(), values)
        except TestloomError as error:
            code = ERR_LIMIT if error.where.startswith("stand ") else ERR_ARGUMENT
            raise Refused(code, error.what.rstrip(".")) from None
        return f"OK {scenario.duration_s:.9f}"

    def _start(self, now_s: float) -> str:
        model, state = self._model, self._state(now_s)
        if state == "FAULT":
            raise Refused(ERR_DEAD, "RF output dead")
        if state == "NOREF":
            raise Refused(ERR_NO_REFERENCE, "reference not locked")
        if state == "PLAYING":
            raise Refused(ERR_PLAYING, "playing: STOP first")
        if model.scenario is None:
            raise Refused(ERR_NOTHING, "no scenario: SCEN first")
        model.start(now_s)
        return f"OK {model.scenario.duration_s:.9f}"

    def _rows(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([self._row(float(time_s)) for time_s in times_s])

    def _row(self, time_s: float) -> list[float]:
        elapsed_s = self._model.elapsed_s(time_s)
        if elapsed_s is None or self._model.scenario is None:
            return [time_s, *[0.0] * 7]
        moved = track_rows(self._model.scenario.track, np.array([elapsed_s]))[0]
        return [time_s, *moved.tolist(), float(self._model.count if self._model.has_signal else 0)]


def _satellite(text: str) -> int:
    satellite = number(text)
    if satellite not in range(1, MAX_SATELLITES + 1):
        raise Refused(ERR_LIMIT, f"satellites are 1 to {MAX_SATELLITES}")
    return int(satellite) - 1

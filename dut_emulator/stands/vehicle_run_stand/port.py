# pyright: strict
"""The command port of a vehicle with a reference on board: a line for a command, a line for an answer.

| command | answer |
|---|---|
| `*IDN?` | identification |
| `START profile[,parameter=value …]` | `OK duration_s`: `vehicle_run` or `flight`, from rest to rest |
| `STOP` | `OK duration_s`: braked to rest; `ERR 16` in the air |
| `STAT?` | `state,phase,roll,pitch,yaw,speed,height,temperature_c`; state READY MOVING NOREF FAULT |
| `PHAS?` | `name=begin_s,…` of the present or last run, in seconds from its start |
| `LIM?` | `road_speed,road_cornering,road_radius,flight_speed,bank,load_factor` (m/s, m/s², m, m/s, deg, g) |
| `CAL?` | date until which the reference's calibration holds |
| `STRE ON,rate_hz` `STRE OFF` | `OK`; samples on the stream link, up to 500 Hz |

Errors: 1 unknown command, 2 arguments, 10 already on the way, 11 the reference is lost, 12 beyond a limit,
13 door open, 15 no such profile or value, 16 in the air. Faults: `door_open` (FAULT: will not start; a car
on the road brakes, an aircraft flies on), `reference_lost` (NOREF: will not start; its samples are not
numbers). Angles are in deg, speed in m/s, height in m.

Stream sample (little endian, 17 × f64, no framing): time_s, then the reference's reading as in recordings:
rate_x … acc_x … roll pitch yaw, position and velocity east north up, temp (deg/s, g, deg, m, m/s, degC).

Omitted: the way back. Each run begins at the start again, headed as `Site.heading_deg`.
"""

import dataclasses
import math
from collections import deque
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.course import Course
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.stands.command_port import CommandPort, Commands, Refused, SampleStream, named_numbers
from dut_emulator.stands.vehicle_run_stand.stand import (
    COURSES,
    LIMITS,
    READING_UNITS,
    Reference,
    VehicleRunStand,
    parked,
)
from protocol.bench_description import Site
from protocol.errors import TestloomError

FloatArray = NDArray[np.float64]

ERR_BUSY, ERR_NO_REFERENCE, ERR_LIMIT, ERR_DOOR_OPEN, ERR_ARGUMENT, ERR_IN_THE_AIR = 10, 11, 12, 13, 15, 16
MAX_STREAM_RATE_HZ = 500.0
MAX_ARGUMENTS = 20
MAX_RUNS = 8
"""Older ones are forgotten: nobody asks about times so long past."""
_CHANNELS = (
    "time_s",
    "temperature_c",
    "rate_rad_s",
    "specific_force_m_s2",
    "field_t",
    "earth_rate_rad_s",
    "position_m",
    "dcm_local_from_body",
)
_ON_THE_GROUND_M = 0.01
_INSTANT_TOLERANCE_S = 1e-9


@dataclasses.dataclass(frozen=True)
class _Begun:
    at_s: float
    course: Course


class VehiclePort(CommandPort):
    """The port, and what acts on the unit on the plate (`Surroundings`)."""

    STAND = "a vehicle"
    FAULTS = ("none", "door_open", "reference_lost")
    COMMANDS: ClassVar[Commands] = {
        "START": range(1, MAX_ARGUMENTS + 1),
        "STOP": (0,),
        "STAT?": (0,),
        "PHAS?": (0,),
        "LIM?": (0,),
    }

    def __init__(self, stand: VehicleRunStand, site: Site, identity: str) -> None:
        stream = SampleStream(self._rows, 1 + len(READING_UNITS), MAX_STREAM_RATE_HZ)
        super().__init__(f"Testloom,VRS,{identity},1.0", stand.identity.calibration_due, stream)
        self._stand = stand
        self._reference = Reference(stand.seed)
        self._runs = deque([_Begun(-math.inf, parked(site, stand.seed))], maxlen=MAX_RUNS)
        self._fault = "none"

    # --- what acts on the unit

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """The plate's."""
        return self._stand.effects

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """See `Surroundings.stimulus`."""
        parts = [
            dataclasses.replace(begun.course.stimulus(own_s), time_s=part_s)
            for begun, part_s, own_s in self._by_run(times_s)
        ]
        if len(parts) == 1:
            return parts[0]
        joined: dict[str, Any] = {
            name: np.concatenate([part.channel(name) for part in parts]) for name in _CHANNELS
        }
        return dataclasses.replace(parts[0], **joined)

    # --- the port

    def _answer(self, word: str, arguments: list[str], now_s: float) -> str:
        match word:
            case "START":
                return f"OK {self._start(arguments, now_s):.9f}"
            case "STOP":
                return f"OK {self._stop(now_s):.9f}"
            case "STAT?":
                return self._status(now_s)
            case "PHAS?":
                phases = self._run_at(now_s).course.phases
                return ",".join(f"{phase.name}={phase.begin_s:.6f}" for phase in phases)
            case _:
                return ",".join(f"{limit:g}" for limit in dataclasses.astuple(LIMITS))

    def _inject(self, fault: str, now_s: float) -> None:
        self._fault = fault
        if fault == "door_open" and self._moving(now_s) and not self._in_the_air(now_s):
            self._stop(now_s)

    def _start(self, arguments: list[str], now_s: float) -> float:
        if self._fault == "door_open":
            raise Refused(ERR_DOOR_OPEN, "door open")
        if self._moving(now_s):
            raise Refused(ERR_BUSY, "on the way")
        if self._fault == "reference_lost":
            raise Refused(ERR_NO_REFERENCE, "no reference: its solution is lost")
        profile = arguments[0].lower()
        if profile not in COURSES:
            raise Refused(ERR_ARGUMENT, f"no profile {profile[:20]}: {' or '.join(COURSES)}")
        try:
            values = profile_named(profile).values(named_numbers(arguments[1:]))
        except TestloomError as error:
            raise Refused(ERR_ARGUMENT, f"{error.what} {error.remedy}") from error
        try:
            course = self._stand.run(profile, values).course
        except TestloomError as error:
            raise Refused(ERR_LIMIT, f"{error.what} {error.remedy}") from error
        self._runs.append(_Begun(now_s, course))
        return course.duration_s

    def _stop(self, now_s: float) -> float:
        if not self._moving(now_s):
            return 0.0
        if self._in_the_air(now_s):
            raise Refused(ERR_IN_THE_AIR, "in the air: it can stop on the ground only")
        begun = self._runs[-1]
        course = begun.course.ended(now_s - begun.at_s)
        self._runs[-1] = _Begun(begun.at_s, course)
        return begun.at_s + course.duration_s - now_s

    def _status(self, now_s: float) -> str:
        begun = self._run_at(now_s)
        own_s = self._own_s(begun, np.array([now_s]))
        motion = begun.course.path.motion(own_s)
        passed = [phase.name for phase in begun.course.phases if phase.begin_s <= own_s[0]]
        figures = (
            *np.degrees(motion.euler_rad[0]),
            float(np.sqrt(np.sum(motion.velocity_local_m_s**2))),
            motion.position_local_m[0, 2],
            begun.course.temperature_c(motion.position_local_m)[0],
        )
        return ",".join([self._state(now_s), passed[-1], *(f"{figure:.6f}" for figure in figures)])

    def _state(self, now_s: float) -> str:
        if self._fault == "door_open":
            return "FAULT"
        if self._fault == "reference_lost":
            return "NOREF"
        return "MOVING" if self._moving(now_s) else "READY"

    def _moving(self, now_s: float) -> bool:
        last = self._runs[-1]
        return now_s < last.at_s + last.course.duration_s - _INSTANT_TOLERANCE_S

    def _in_the_air(self, now_s: float) -> bool:
        begun = self._runs[-1]
        own_s = now_s - begun.at_s
        path = begun.course.path
        height_m = float(path.position_local_m(np.array([own_s]))[0, 2])
        flies = path.suspension is None
        return flies and (abs(height_m) > _ON_THE_GROUND_M or path.climb.level_after(own_s) != 0.0)

    def _run_at(self, now_s: float) -> _Begun:
        return next(begun for begun in reversed(self._runs) if begun.at_s <= now_s or begun is self._runs[0])

    @staticmethod
    def _own_s(begun: _Begun, times_s: FloatArray) -> FloatArray:
        return np.maximum(times_s - begun.at_s, 0.0) if math.isfinite(begun.at_s) else times_s

    def _by_run(self, times_s: FloatArray) -> list[tuple[_Begun, FloatArray, FloatArray]]:
        """The times of each run that they fall into, on the bench's clock and on the run's own."""
        cuts = np.searchsorted(times_s, [begun.at_s for begun in self._runs], side="left")
        edges = [0, *(int(cut) for cut in cuts[1:]), len(times_s)]
        return [
            (begun, times_s[low:high], self._own_s(begun, times_s[low:high]))
            for begun, low, high in zip(self._runs, edges[:-1], edges[1:], strict=True)
            if low < high or len(times_s) == 0
        ]

    def _rows(self, times_s: FloatArray) -> FloatArray:
        """Samples of the stream (n, 17)."""
        rows = np.full((len(times_s), 1 + len(READING_UNITS)), np.nan)
        rows[:, 0] = times_s
        if self._fault != "reference_lost":
            read = [self._reference.rows(begun.course, own) for begun, _, own in self._by_run(times_s)]
            rows[:, 1:] = np.concatenate(read)
        return rows

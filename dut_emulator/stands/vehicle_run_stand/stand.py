# pyright: strict
"""A vehicle or an aircraft with a reference on board: an inertial and satellite navigation system.

The unit sits on a plate beside the reference. The stand's errors are the plate's: the unit's place and
direction on it are known to some millimetres and a milliradian. The reference reads the centre's motion with
slow errors of its own, as after post-processing (of the class of an iMAR or Applanix system): roll and pitch
0.01°, heading 0.03°, position 0.05 m, velocity 0.01 m/s (rms), rates 1e-3 °/s and force 0.01 mg in
resolution. Rates it reports are relative to the Earth. Vibration is smoothed out of its force, but the unit
feels it: in what a reference leaves over of accelerometers it stands as tones, not as their noise.

Out of scope: outages of the satellites, wheel slip, wind (speed is over ground), the flexing of the airframe.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import SensorName, Stimulus
from dut_emulator.effects.stand import LeverArm, RemountMisalignment
from dut_emulator.motion.course import PHASES, Course, Phase
from dut_emulator.motion.flight import flight
from dut_emulator.motion.path import Steps, euler_angles_rad
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.run import EventStream
from dut_emulator.motion.vehicle_run import drive
from dut_emulator.stands.recording_stand import StandIdentity, beyond_limit
from dut_emulator.stands.stand_draws import StandDraws, calibration_due
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

FloatArray = NDArray[np.float64]

KIND = "vehicle_run_stand"
READING_RATE_HZ = 100.0
COURSES: dict[str, Callable[[Mapping[str, float], Site, int], Course]] = {
    "vehicle_run": drive,
    "flight": flight,
}
READING_UNITS: dict[str, str] = {
    **{f"rate_{axis}": "deg/s" for axis in "xyz"},
    **{f"acc_{axis}": "g" for axis in "xyz"},
    **dict.fromkeys(("roll", "pitch", "yaw"), "deg"),
    **{f"position_{axis}": "m" for axis in ("east", "north", "up")},
    **{f"velocity_{axis}": "m/s" for axis in ("east", "north", "up")},
    "temp": "degC",
}
_ATTITUDE_ERROR_RAD = np.radians([0.01, 0.01, 0.03])
_POSITION_ERROR_M, _VELOCITY_ERROR_M_S = 0.05, 0.01
_QUANTA = (1e-3, 1e-5, 1e-4, 1e-4, 1e-4, 0.01)
"""Of rates (deg/s), force (g), angles (deg), position (m), velocity (m/s), temperature (degC)."""
_WANDER_PERIODS_S = (37.0, 61.0, 113.0, 197.0, 331.0, 613.0)
_LOAD_CHECK_S = 0.1
_PLATE_ANGLE_RAD, _PLATE_PLACE_M = 1e-3, 3e-3


@dataclass(frozen=True)
class VehicleLimits:
    """What may be asked of car and aircraft. Load factor: the largest specific force over gravity."""

    road_speed_m_s: float = 40.0
    road_cornering_m_s2: float = 6.0
    road_radius_m: float = 5.0
    flight_speed_m_s: float = 90.0
    bank_deg: float = 60.0
    load_factor: float = 1.9


LIMITS = VehicleLimits()


class Wander:
    """Slow errors of rms 1 for each of k channels: sums of sines with drawn phases. A function of time."""

    def __init__(self, channels: int, rng: np.random.Generator) -> None:
        self._phases = rng.uniform(0.0, 2.0 * np.pi, (len(_WANDER_PERIODS_S), channels))

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n, k)."""
        total = np.zeros((len(times_s), self._phases.shape[1]))
        for period_s, phase in zip(_WANDER_PERIODS_S, self._phases, strict=True):
            total += np.sin(2.0 * np.pi / period_s * times_s[:, np.newaxis] + phase)
        return total * math.sqrt(2.0 / len(_WANDER_PERIODS_S))


class Reference:
    """The reference on board. `seed`: of its errors."""

    def __init__(self, seed: int) -> None:
        self._wander = Wander(9, StandDraws(KIND, seed).generator("reference"))

    def rows(self, course: Course, times_s: FloatArray) -> FloatArray:
        """(n, 16): what it says, in the order and the units of `READING_UNITS`."""
        motion = course.path.motion(times_s)
        error = self._wander.at(times_s)
        euler = euler_angles_rad(motion.dcm_local_from_body) + error[:, :3] * _ATTITUDE_ERROR_RAD
        quantities = (
            np.degrees(motion.rate_rad_s),
            motion.specific_force_m_s2 / STANDARD_GRAVITY_M_S2,
            np.degrees((euler + np.pi) % (2.0 * np.pi) - np.pi),
            motion.position_local_m + error[:, 3:6] * _POSITION_ERROR_M,
            motion.velocity_local_m_s + error[:, 6:9] * _VELOCITY_ERROR_M_S,
            course.temperature_c(motion.position_local_m)[:, np.newaxis],
        )
        rounded = [
            np.rint(values / quantum) * quantum for values, quantum in zip(quantities, _QUANTA, strict=True)
        ]
        return np.concatenate(rounded, axis=1)


@dataclass(frozen=True)
class VehicleRun:
    """One drive or flight. See `Run`."""

    course: Course
    reference: Reference

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.course.duration_s

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit."""
        return self.course.stimulus(times_s)

    @property
    def reading_units(self) -> Mapping[str, str]:
        """Of the reference."""
        return READING_UNITS

    @property
    def reading_rate_hz(self) -> float:
        """Of the reference."""
        return READING_RATE_HZ

    def reading(self, times_s: FloatArray) -> Mapping[str, NDArray[Any]]:
        """What the reference says."""
        rows = self.reference.rows(self.course, times_s)
        return {name: rows[:, index] for index, name in enumerate(READING_UNITS)}

    def events(self) -> tuple[EventStream, ...]:
        """The phases' beginnings: `phase` is the place in `motion.course.PHASES`."""
        phases = self.course.phases
        columns: dict[str, NDArray[Any]] = {
            "t": np.array([phase.begin_s for phase in phases]),
            "phase": np.array([PHASES.index(phase.name) for phase in phases], dtype=np.uint8),
        }
        return (EventStream("phases", {"t": "s", "phase": "1"}, columns),)

    @property
    def trigger_times_s(self) -> FloatArray:
        """The start."""
        return np.zeros(1)


class VehicleRunStand:
    """See `RecordingStand`. Its errors are drawn by `seed`."""

    def __init__(self, seed: int, site: Site) -> None:
        self.seed, self._site = seed, site
        self.identity = StandIdentity(KIND, f"VR-{seed:04d}", calibration_due(KIND, seed))

    @cached_property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """The plate's: the same small rotation for every triad, and the place of the accelerometers."""
        draws = StandDraws(KIND, self.seed)
        turned, moved = draws.triple("remount", _PLATE_ANGLE_RAD), draws.triple("lever arm", _PLATE_PLACE_M)
        triads: tuple[SensorName, ...] = ("gyro", "acc", "mag")
        return (*(RemountMisalignment(triad, turned) for triad in triads), LeverArm("acc", moved))

    def run(self, profile: str, values: Mapping[str, float]) -> VehicleRun:
        """See `RecordingStand.run`."""
        return VehicleRun(
            checked_course(profile, values, self._site, self.seed, self.identity), Reference(self.seed)
        )


def parked(site: Site, seed: int) -> Course:
    """At rest at the start, for good."""
    values = profile_named("vehicle_run").values({})
    course = drive(values, site, seed)
    resting = dataclasses.replace(course.path, speed=Steps(), climb=Steps(), turn=Steps())
    return dataclasses.replace(course, path=resting, phases=(Phase("rest", -math.inf),), duration_s=0.0)


def checked_course(
    profile: str, values: Mapping[str, float], site: Site, seed: int, identity: StandIdentity
) -> Course:
    """The course of a profile, inside all limits.

    Raises:
        TestloomError: not a drive or a flight, or beyond a limit.
    """
    if profile not in COURSES:
        raise TestloomError(
            f"The profile '{profile}' is neither a drive nor a flight.",
            where=f"stand {identity.stand_id}",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(COURSES)}; or another kind of stand.",
        )
    speed, fastest = values["speed_m_s"], LIMITS.road_speed_m_s
    if profile == "flight":
        fastest = LIMITS.flight_speed_m_s
        _refuse(identity, "bank", values["bank_deg"], LIMITS.bank_deg, "deg", "a flatter turn (bank_deg)")
    else:
        cornering, remedy = values["cornering_m_s2"], "gentler curves (cornering_m_s2)"
        _refuse(identity, "cornering", cornering, LIMITS.road_cornering_m_s2, "m/s^2", remedy)
        least_m = LIMITS.road_radius_m
        radius_m = speed**2 / (2.0 * cornering)  # of the circle that is driven at half the speed
        if radius_m < least_m:
            text = f"The circle's radius of {radius_m:.3g} m is below the car's least, {least_m:g} m."
            raise beyond_limit(
                identity.stand_id, text, "ask for a higher speed_m_s or a lower cornering_m_s2."
            )
    _refuse(identity, "speed", speed, fastest, "m/s", "a slower run (speed_m_s)")
    course = COURSES[profile](values, site, seed)
    force = course.path.motion(np.arange(0.0, course.duration_s, _LOAD_CHECK_S)).specific_force_m_s2
    load_factor = float(np.sqrt(np.max(np.sum(force**2, axis=1)))) / site.gravity_m_s2
    _refuse(identity, "load factor", load_factor, LIMITS.load_factor, "g", "a flatter turn, at a load factor")
    return course


def _refuse(identity: StandIdentity, what: str, value: float, limit: float, unit: str, remedy: str) -> None:
    if value > limit:
        text = f"The {what} of {value:.4g} {unit} is above the limit of {limit:g} {unit}."
        raise beyond_limit(identity.stand_id, text, f"ask for {remedy} of at most {limit:g} {unit}.")

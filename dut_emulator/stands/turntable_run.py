# pyright: strict
"""Turntables that run profiles: limits looked at first, then one exact run.

What is in a run's stimulus: the motion, the field and the temperature as the stand commands and reports
them, exactly, and the Earth's rate. What is not: whatever the stand does beside its report (wobble, ripple,
lever arm, the chamber's lag …), which are its `effects`. The reading is the report: the commanded angles and
rates in the encoders' quanta, relative to the laboratory.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.motion import chamber_profiles, turntable_profiles
from dut_emulator.motion.chamber import ROOM_C, AirPath
from dut_emulator.motion.laboratory import Laboratory, rounded
from dut_emulator.motion.run import EventStream
from dut_emulator.motion.schedule import Drives, Schedule
from dut_emulator.motion.turntable_schedules import schedule_of
from dut_emulator.stands.recording_stand import StandIdentity, beyond_limit
from dut_emulator.stands.stand_draws import calibration_due
from dut_emulator.stands.turntable_errors import ARC_SECOND_RAD, TurntableSpec, drawn_effects
from protocol.bench_description import Site
from protocol.units_of_measure import factor_to_si

RESTING_RATE_HZ, CHAMBER_RATE_HZ = 10.0, 50.0
"""Of the report when no axis turns, and when one does now and then during hours in a chamber."""
ANGLE_QUANTUM_RAD = 0.1 * ARC_SECOND_RAD
RATE_QUANTUM_DEG_S = 1e-5
PROBE_QUANTUM_C = 0.01

_AXIS_NAMES = ("outer", "middle", "inner")
_COLUMNS = (
    ("rate", "deg/s", "xyz"),
    ("acc", "g", "xyz"),
    ("mag", "uT", "xyz"),
    ("angle", "deg", _AXIS_NAMES),
)
READING_UNITS: Mapping[str, str] = {
    **{f"{name}_{part}": unit for name, unit, parts in _COLUMNS for part in parts},
    "temp": "degC",
}


@dataclass(frozen=True)
class ChamberLimits:
    """What a chamber can do."""

    low_c: float = -60.0
    high_c: float = 100.0
    ramp_c_per_min: float = 5.0


@dataclass(frozen=True)
class TurntableKind:
    """A kind of turntable as a recording asks of it.

    Attributes:
        name: as in the catalogue of stands.
        prefix: of a stand's identity, such as 'tt3'.
        drives: limits, home.
        spec: of its own errors.
        chamber: None: it stands in a room.
        moving_rate_hz: how often it reports while a profile turns an axis.
        mounts: drives by what the profile's parameter 'mount' says, for stands on which that matters.
    """

    name: str
    prefix: str
    drives: Drives
    spec: TurntableSpec
    chamber: ChamberLimits | None = None
    moving_rate_hz: float = 500.0
    mounts: Mapping[int, Drives] = field(default_factory=dict[int, Drives])


class TurntableRun:
    """A schedule carried out at a site. See `Run`, and the module."""

    reading_units: Mapping[str, str] = READING_UNITS

    def __init__(self, site: Site, schedule: Schedule, air: AirPath, reading_rate_hz: float) -> None:
        self._laboratory = Laboratory(site)
        self._schedule, self._air = schedule, air
        self.reading_rate_hz = reading_rate_hz

    @property
    def duration_s(self) -> float:
        """From start to end."""
        return self._schedule.duration_s

    @property
    def trigger_times_s(self) -> FloatArray:
        """(1,): the start."""
        return np.zeros(1)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit (n,); see `Run`."""
        angles_deg, rates_deg_s, _ = self._schedule.at(times_s)
        return self._laboratory.acting(
            times_s, np.radians(angles_deg), np.radians(rates_deg_s), self._air.at(times_s)
        )

    def reading(self, times_s: FloatArray) -> Mapping[str, NDArray[Any]]:
        """What the encoders and the chamber's probe say, (n,) each."""
        angles_deg, rates_deg_s, _ = self._schedule.at(times_s)
        angles_rad = rounded(np.radians(angles_deg), ANGLE_QUANTUM_RAD)
        rates_rad_s = np.radians(rounded(rates_deg_s, RATE_QUANTUM_DEG_S))
        report = self._laboratory.reported(angles_rad, rates_rad_s)
        parts = (report.rate_rad_s, report.specific_force_m_s2, report.field_t, report.angles_rad)
        columns: dict[str, NDArray[Any]] = {}
        for (name, unit, names), values in zip(_COLUMNS, parts, strict=True):
            in_unit = values / factor_to_si(unit) + 0.0  # a zero has no sign
            columns |= {f"{name}_{part}": in_unit[:, index] for index, part in enumerate(names)}
        return columns | {"temp": rounded(self._air.at(times_s), PROBE_QUANTUM_C)}

    def events(self) -> tuple[EventStream, ...]:
        """None."""
        return ()


class RecordingTurntable:
    """A turntable of a kind, with errors of its own. See `RecordingStand`."""

    def __init__(self, kind: TurntableKind, seed: int, site: Site) -> None:
        self._kind, self._seed, self._site = kind, seed, site
        self._identity = StandIdentity(kind.name, f"{kind.prefix}-{seed}", calibration_due(kind.name, seed))
        self._effects = drawn_effects(kind.name, seed, kind.spec, kind.drives)

    @property
    def identity(self) -> StandIdentity:
        """Which stand it is."""
        return self._identity

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """Its own errors."""
        return self._effects

    def effects_of(self, values: Mapping[str, float]) -> tuple[CatalogueEffect, ...]:
        """Its own errors with a unit mounted as the values say: they follow the axis that turns then."""
        drives = self._drives_of(values)
        if drives is self._kind.drives:
            return self._effects
        return drawn_effects(self._kind.name, self._seed, self._kind.spec, drives)

    def run(self, profile: str, values: Mapping[str, float]) -> TurntableRun:
        """One run of a profile. Raises as `RecordingStand`."""
        schedule, air, drives = self._planned(profile, values)
        excess = schedule.excess(drives)
        if excess is not None:
            remedy = turntable_profiles.what_fits(profile, values, excess, drives)
            raise beyond_limit(self._identity.stand_id, str(excess), remedy)
        moving_hz = CHAMBER_RATE_HZ if air.fastest_ramp_c_per_min else self._kind.moving_rate_hz
        rate_hz = moving_hz if schedule.moves else RESTING_RATE_HZ
        return TurntableRun(self._site, schedule, air, rate_hz)

    def _planned(self, profile: str, values: Mapping[str, float]) -> tuple[Schedule, AirPath, Drives]:
        drives = self._drives_of(values)
        if profile in {kind.name for kind in turntable_profiles.KINDS}:
            return schedule_of(profile, values, drives), AirPath.steady(ROOM_C), drives
        if profile not in {kind.name for kind in chamber_profiles.KINDS}:
            raise self._cannot(f"A {self._kind.name} cannot do the profile '{profile}'.")
        if self._kind.chamber is None:
            raise self._cannot("The stand has no chamber.")
        axis = next(index for index in range(3) if drives.turns(index))
        schedule, air = chamber_profiles.chamber_schedule(profile, values, drives, axis)
        self._check_air(air, self._kind.chamber)
        return schedule, air, drives

    def _drives_of(self, values: Mapping[str, float]) -> Drives:
        return self._kind.mounts.get(round(values.get("mount", 1.0)), self._kind.drives)

    def _check_air(self, air: AirPath, limits: ChamberLimits) -> None:
        low_c, high_c = air.range_c
        stand = self._identity.stand_id
        if low_c < limits.low_c:
            what = f"{low_c:g} °C lies {limits.low_c - low_c:g} °C below what the chamber can do."
            raise beyond_limit(stand, what, f"give at least {limits.low_c:g} °C.")
        if high_c > limits.high_c:
            what = f"{high_c:g} °C lies {high_c - limits.high_c:g} °C above what the chamber can do."
            raise beyond_limit(stand, what, f"give at most {limits.high_c:g} °C.")
        ramp = air.fastest_ramp_c_per_min
        if ramp > limits.ramp_c_per_min * (1 + 1e-6):
            over = ramp - limits.ramp_c_per_min
            what = f"A ramp of {ramp:.4g} °C/min is {over:.3g} °C/min faster than the chamber can do."
            raise beyond_limit(stand, what, f"give at most {limits.ramp_c_per_min:g} °C/min.")

    def _cannot(self, what: str) -> Exception:
        return beyond_limit(self._identity.stand_id, what, "choose another stand or another profile.")

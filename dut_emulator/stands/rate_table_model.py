# pyright: strict
"""A single-axis rate table with a tilting fixture: limits, errors, and a state machine over bench time.

The table's axis is vertical and is the 'outer' one of `gimbal_geometry`; the fixture's two tilts are
'middle' and 'inner', so that the stand's effects of the catalogue hold. The table keeps a rate of 5 to
1450 °/s either way; below that it is locked, and locked it is exactly at rest (paper 4: LX-10G).

States: NOREF until `home` has found the mark, LOCKED, RAMPING, HOLDING, SHORT (it holds less than it was
told), TILTING, SEEKING (the mark), FAULT while the door is open. Every motion is known in closed form.

The own errors act as effects: a rate scale factor (accuracy 0.01 %, of the mean over a turn), a ripple of
the drive, a wobble, and how the fixture sits and tilts. Omitted: the servo's overshoot and lag, wind of a
fast table on the unit, and force from a unit that sits off the axis.
"""

import math
from dataclasses import dataclass

import numpy as np

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray, SensorName, Stimulus
from dut_emulator.effects.stand import (
    NonOrthogonality,
    RateRipple,
    RateScaleFactor,
    RemountMisalignment,
    Wobble,
)
from dut_emulator.interfaces import StandRefusal
from dut_emulator.motion.axis_motion import AxisMotion, Trapezoid
from dut_emulator.motion.rate_table_profile import POSE_DEG, RateAxis, pose_rad, tilt
from dut_emulator.stands.level_board import ROOM_TEMPERATURE_C
from dut_emulator.stands.stand_draws import StandDraws
from protocol.bench_description import Site
from protocol.units_of_measure import factor_to_si

DEG = factor_to_si("deg")
ARC_SECOND = factor_to_si("arcsec")

KIND = "rate_table"
MIN_RATE_DEG_S, MAX_RATE_DEG_S = 5.0, 1450.0
RATE_ACCURACY = 1e-4
"""Relative; bounds of a uniform distribution (paper 4)."""
MAX_ACCELERATION_DEG_S2, WORKING_ACCELERATION_DEG_S2 = 200.0, 50.0
ANGLE_QUANTUM_DEG, RATE_QUANTUM_DEG_S = 1e-4, 1e-4
"""Resolution of the encoder's readings."""
SEEKING_RATE_DEG_S = 30.0
SHORT_SHARE = 0.9
"""Of the rate it was told that a table with a weak drive still reaches."""
LIVE_HISTORY_PIECES = 512

ERR_BUSY, ERR_NO_REFERENCE, ERR_LIMIT, ERR_DOOR_OPEN, ERR_NO_MARK, ERR_ARGUMENT, ERR_NOT_LOCKED = range(
    10, 17
)
FAULTS = ("none", "door_open", "lost_reference", "rate_not_reached")

_REST_TOLERANCE_S = 1e-9
_TRIADS: tuple[SensorName, ...] = ("gyro", "acc", "mag")


def drawn_errors(seed: int) -> tuple[CatalogueEffect, ...]:
    """The table's own errors: the same seed is the same table."""
    draws = StandDraws(KIND, seed)
    share = float(draws.generator("rate").uniform(-RATE_ACCURACY, RATE_ACCURACY))
    ripple = draws.normal("ripple cosine", 2e-5), draws.normal("ripple sine", 2e-5)
    cosine = draws.triple("wobble cosine", 2.0 * ARC_SECOND)
    sine = draws.triple("wobble sine", 2.0 * ARC_SECOND)
    tilts = draws.normal("outer middle", 20.0 * ARC_SECOND), draws.normal("middle inner", 20.0 * ARC_SECOND)
    mounted = draws.triple("remount", 3e-4)
    of_rate = (RateScaleFactor("gyro", share), RateRipple("gyro", *ripple, axis="outer"))
    of_axes = (
        (
            Wobble(sensor, cosine, sine, axis="outer"),
            NonOrthogonality(sensor, *tilts),
            RemountMisalignment(sensor, mounted),
        )
        for sensor in _TRIADS
    )
    return (*of_rate, *(effect for effects in of_axes for effect in effects))


class TablePlace:
    """What the place of a table does to a unit on it: Earth rate, gravity, field, room temperature."""

    def __init__(self, site: Site, temperature_c: float = ROOM_TEMPERATURE_C) -> None:
        self.temperature_c = temperature_c
        self._earth_rate = geometry.earth_rate_lab_rad_s(site)
        self._gravity = geometry.specific_force_lab_m_s2(site)
        self._field = geometry.field_lab_t(site)

    def stimulus(self, times_s: FloatArray, angles_rad: FloatArray, rates_rad_s: FloatArray) -> Stimulus:
        """(n,) times, (n, 3) gimbal angles and rates → what acts at the table's centre, in body axes."""
        earth_rate = geometry.into_body(self._earth_rate, angles_rad)
        return Stimulus(
            time_s=times_s,
            temperature_c=np.full(len(times_s), self.temperature_c),
            sample_period_s=math.nan,
            rate_rad_s=geometry.body_rate_rad_s(angles_rad, rates_rad_s) + earth_rate,
            specific_force_m_s2=geometry.into_body(self._gravity, angles_rad),
            field_t=geometry.into_body(self._field, angles_rad),
            angles_rad=angles_rad,
            earth_rate_rad_s=earth_rate,
        )

    def reading(self, angles_rad: FloatArray, rates_rad_s: FloatArray) -> tuple[FloatArray, ...]:
        """As the encoders give it, (n, 3) each: body rate (Earth rate is not in it), force, angles, rates."""
        angles = _rounded(angles_rad, ANGLE_QUANTUM_DEG * DEG)
        rates = _rounded(rates_rad_s, RATE_QUANTUM_DEG_S * DEG)
        return (
            geometry.body_rate_rad_s(angles, rates),
            geometry.into_body(self._gravity, angles),
            angles,
            rates,
        )


@dataclass(frozen=True)
class RateTableStatus:
    """What `STAT?` says. `axis`: the body axis along the table's, 0 between two of them."""

    state: str
    rate_deg_s: float
    commanded_deg_s: float
    angle_deg: float
    axis: int
    temperature_c: float


class RateTableModel:
    """A table on a bench. Every command gets the bench time; a refusal has changed nothing."""

    def __init__(self, site: Site, seed: int) -> None:
        self._place = TablePlace(site)
        self._effects = drawn_errors(seed)
        self._table = RateAxis(LIVE_HISTORY_PIECES)
        self._middle, self._inner = (AxisMotion(angle) for angle in POSE_DEG[3])
        self._commanded_deg_s = 0.0
        self._acceleration_deg_s2 = WORKING_ACCELERATION_DEG_S2
        self._ramp_ends_s = self._tilt_ends_s = self._search_ends_s = -math.inf
        self._referenced = False
        self._fault = "none"

    # --- commands

    def home(self, now_s: float) -> float | StandRefusal:
        """One slow turn over the reference mark."""
        refusal = self._refusal(now_s, needs_reference=False) or self._refusal_unless_at_rest(now_s)
        if refusal is not None:
            return refusal
        if self._fault == "lost_reference":
            return StandRefusal(ERR_NO_MARK, "reference mark not found")
        turn = Trapezoid.fastest(360.0, SEEKING_RATE_DEG_S, WORKING_ACCELERATION_DEG_S2)
        self._table.turn(turn, now_s)
        self._search_ends_s = now_s + turn.duration_s
        self._referenced = True
        return turn.duration_s

    def set_rate(
        self, rate_deg_s: float, acceleration_deg_s2: float | None, now_s: float
    ) -> float | StandRefusal:
        """Turn at a rate from now on; 0 locks the table. The time of the ramp."""
        refusal = self._refusal(now_s) or self._beyond(rate_deg_s, acceleration_deg_s2)
        if refusal is not None:
            return refusal
        self._commanded_deg_s = rate_deg_s
        self._acceleration_deg_s2 = acceleration_deg_s2 or WORKING_ACCELERATION_DEG_S2
        return self._drive(self._acceleration_deg_s2, now_s)

    def tilt(self, axis: int, now_s: float) -> float | StandRefusal:
        """Bring a body axis (1, 2, 3) along the table's; only while the table is locked."""
        refusal = self._refusal(now_s) or self._refusal_unless_at_rest(now_s)
        if refusal is not None:
            return refusal
        if axis not in POSE_DEG:
            return StandRefusal(ERR_ARGUMENT, "axis must be 1, 2 or 3")
        duration_s = tilt(self._middle, self._inner, axis, now_s)
        self._tilt_ends_s = now_s + duration_s
        return duration_s

    def stop(self, now_s: float) -> float:
        """Everything to rest at the greatest acceleration; a search is given up."""
        if now_s < self._search_ends_s:
            self._referenced = False
        if now_s < self._tilt_ends_s:
            for motion in (self._middle, self._inner):
                motion.brake(MAX_ACCELERATION_DEG_S2, now_s)
        self._search_ends_s = self._tilt_ends_s = -math.inf
        self._commanded_deg_s = 0.0
        return self._drive(MAX_ACCELERATION_DEG_S2, now_s)

    def inject(self, fault: str, now_s: float) -> None:
        """An open door or a lost reference brakes; a weak drive sags to a share of its rate, and recovers."""
        self._fault = fault
        if fault in ("door_open", "lost_reference"):
            self.stop(now_s)
        elif self._commanded_deg_s:
            self._drive(self._acceleration_deg_s2, now_s)
        if fault == "lost_reference":
            self._referenced = False

    # --- what is seen

    def status(self, now_s: float) -> RateTableStatus:
        """The state now; rate and angle as the encoder reads them."""
        angle_deg, rate_deg_s = self._table.now(now_s)
        pose = tuple(float(motion.at(np.array([now_s]))[0][0]) for motion in (self._middle, self._inner))
        axis = next((number for number, angles in POSE_DEG.items() if angles == pose), 0)
        return RateTableStatus(
            self._state(now_s),
            round(rate_deg_s / RATE_QUANTUM_DEG_S) * RATE_QUANTUM_DEG_S,
            self._commanded_deg_s,
            round(angle_deg / ANGLE_QUANTUM_DEG) * ANGLE_QUANTUM_DEG % 360.0,
            axis,
            self._place.temperature_c,
        )

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """The table's own errors."""
        return self._effects

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit; see `Surroundings`."""
        return self._place.stimulus(times_s, *self._pose_rad(times_s))

    def encoder_samples(self, times_s: FloatArray) -> FloatArray:
        """(n, 15): the columns of `protocol.stand_stream`."""
        rate, force, angles, rates = self._place.reading(*self._pose_rad(times_s))
        rows = np.zeros((len(times_s), 15))
        rows[:, 0] = times_s
        rows[:, 1:4], rows[:, 4:7], rows[:, 7:10], rows[:, 10:13] = rate, force, angles, rates
        rows[:, 13] = self._place.temperature_c
        return rows

    # --- inside

    def _pose_rad(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return pose_rad((self._table, self._middle, self._inner), times_s)

    def _drive(self, acceleration_deg_s2: float, now_s: float) -> float:
        share = SHORT_SHARE if self._fault == "rate_not_reached" else 1.0
        ramp_s = self._table.to_rate(share * self._commanded_deg_s, acceleration_deg_s2, now_s)
        self._ramp_ends_s = now_s + ramp_s
        return ramp_s

    def _state(self, now_s: float) -> str:
        if self._fault == "door_open":
            return "FAULT"
        for state, ends_s in (
            ("SEEKING", self._search_ends_s),
            ("TILTING", self._tilt_ends_s),
            ("RAMPING", self._ramp_ends_s),
        ):
            if now_s < ends_s - _REST_TOLERANCE_S:
                return state
        if not self._referenced:
            return "NOREF"
        if self._commanded_deg_s == 0.0:
            return "LOCKED"
        return "SHORT" if self._fault == "rate_not_reached" else "HOLDING"

    def _refusal(self, now_s: float, *, needs_reference: bool = True) -> StandRefusal | None:
        state = self._state(now_s)
        if state == "FAULT":
            return StandRefusal(ERR_DOOR_OPEN, "door open")
        if state in ("SEEKING", "TILTING"):
            return StandRefusal(ERR_BUSY, f"busy: {state.lower()}")
        if needs_reference and not self._referenced:
            return StandRefusal(ERR_NO_REFERENCE, "no reference: HOME first")
        return None

    def _refusal_unless_at_rest(self, now_s: float) -> StandRefusal | None:
        if self._state(now_s) in ("LOCKED", "NOREF"):
            return None
        return StandRefusal(ERR_NOT_LOCKED, "the table turns: LOCK first")

    def _beyond(self, rate_deg_s: float, acceleration_deg_s2: float | None) -> StandRefusal | None:
        asked = WORKING_ACCELERATION_DEG_S2 if acceleration_deg_s2 is None else acceleration_deg_s2
        text = beyond_rate(rate_deg_s) or beyond_acceleration(asked)
        return StandRefusal(ERR_LIMIT, text) if text else None


def beyond_rate(rate_deg_s: float) -> str:
    """Why a table cannot hold a rate; empty if it can."""
    if rate_deg_s and abs(rate_deg_s) < MIN_RATE_DEG_S:
        return f"{rate_deg_s:g} deg/s is below the least rate of {MIN_RATE_DEG_S:g} deg/s; 0 locks the table"
    if not abs(rate_deg_s) <= MAX_RATE_DEG_S:
        return f"{rate_deg_s:g} deg/s is above the limit of {MAX_RATE_DEG_S:g} deg/s"
    return ""


def beyond_acceleration(acceleration_deg_s2: float) -> str:
    """Why a table cannot accelerate so; empty if it can."""
    if 0 < acceleration_deg_s2 <= MAX_ACCELERATION_DEG_S2:
        return ""
    return f"acceleration {acceleration_deg_s2:g} deg/s2 is not between 0 and {MAX_ACCELERATION_DEG_S2:g}"


def _rounded(values: FloatArray, quantum: float) -> FloatArray:
    return np.rint(values / quantum) * quantum

# pyright: strict
"""A turntable of one to three axes as a state machine over bench time.

Its states: NOREF until `home` has found the reference marks, MOVING while any axis turns or
the marks are sought, READY at rest, FAULT while the door is open. It takes a command only when READY
(`home` also in NOREF), checks it against rate and acceleration limits before anything moves, and then
knows its pose at every moment in closed form. A door that opens in mid-motion brakes all axes.

The motion is exact; the *reading* has the encoders' resolution and a small wobble. What the table does
beside its report are its `effects`, which the unit's chains apply. A drive that does not reach its rate
(fault 'rate_not_reached') runs at nine tenths of what `rotate` asks, and so ends short of the angle. Out of
scope: servo lag.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.interfaces import StandRefusal, StandStatus
from dut_emulator.motion.axis_motion import AxisMotion, Trapezoid
from dut_emulator.motion.laboratory import Laboratory, rounded
from dut_emulator.motion.schedule import AXES, Drives, Triple
from dut_emulator.stands.level_board import ROOM_TEMPERATURE_C
from protocol.bench_description import Site

FloatArray = NDArray[np.float64]
ARC_SECOND_RAD = math.radians(1 / 3600)

ERR_BUSY, ERR_NO_REFERENCE, ERR_LIMIT, ERR_DOOR_OPEN, ERR_NO_MARK, ERR_ARGUMENT = 10, 11, 12, 13, 14, 15
REFERENCE_SEARCH_S = 3.0
"""The creep over the reference marks after the way to zero."""
REST_TOLERANCE_S = 1e-9
MAX_CYCLES = 100_000
REACHED_SHARE = 0.9
"""Of the rate that is asked, under the fault 'rate_not_reached'."""


@dataclass(frozen=True)
class EncoderErrors:
    """Of the reading: resolution, and a wobble of once and twice a turn with phases by `seed`.

    The reading is right at zero angle, where the reference marks are.
    """

    angle_quantum_rad: float = 0.1 * ARC_SECOND_RAD
    rate_quantum_rad_s: float = math.radians(1e-5)
    wobble_rad: tuple[float, float] = (0.5 * ARC_SECOND_RAD, 0.2 * ARC_SECOND_RAD)
    seed: int = 0


class TurntableModel:
    """See `EmulatedStand`. `lever_arm_m`: of the unit's sensors from the centre, in body axes."""

    def __init__(
        self,
        site: Site,
        limits: Drives,
        encoders: EncoderErrors | None = None,
        lever_arm_m: Triple = (0.0, 0.0, 0.0),
        temperature_c: float = ROOM_TEMPERATURE_C,
        effects: tuple[CatalogueEffect, ...] = (),
    ) -> None:
        self._limits = limits
        self._effects = effects
        self._encoders = encoders or EncoderErrors()
        self._lever_arm_m = np.array(lever_arm_m)
        self._temperature_c = temperature_c
        self._laboratory = Laboratory(site)
        self._axes = tuple(AxisMotion(angle) for angle in limits.home_deg)  # degrees: commands end round
        self._busy_until_s = -math.inf
        self._referenced = False
        self._seeking_mark = False
        self._fault = "none"
        rng = np.random.Generator(np.random.PCG64([self._encoders.seed, 3]))
        self._wobble_phase = rng.uniform(0.0, 2 * np.pi, size=(2, 3))

    # --- commands

    def home(self, now_s: float) -> float | StandRefusal:
        """Find the reference marks and go to the home pose: zero angles, unless the drives say another."""
        refusal = self._refusal(now_s, needs_reference=False)
        if refusal is not None:
            return refusal
        if self._fault == "lost_reference":
            return StandRefusal(ERR_NO_MARK, "reference mark not found")
        duration_s = self._go(self._limits.home_deg, now_s) + REFERENCE_SEARCH_S
        self._referenced = self._seeking_mark = True
        self._busy_until_s = now_s + duration_s
        return duration_s

    def move(self, angles_deg: Triple, now_s: float) -> float | StandRefusal:
        """Go to absolute angles (whole turns count) at the positioning rate, all axes at once."""
        refusal = self._refusal(now_s)
        if refusal is not None:
            return refusal
        if not all(math.isfinite(angle) for angle in angles_deg):
            return StandRefusal(ERR_ARGUMENT, "an angle is not a number")
        for axis, (angle, home) in enumerate(zip(angles_deg, self._limits.home_deg, strict=True)):
            if angle != home and not self._limits.turns(axis):
                return StandRefusal(
                    ERR_ARGUMENT, f"the {AXES[axis]} axis has no drive and stays at {home:g} deg"
                )
        duration_s = self._go(angles_deg, now_s)
        self._seeking_mark = False
        self._busy_until_s = now_s + duration_s
        return duration_s

    def rotate(
        self, axis: str, angle_deg: float, duration_s: float, ramp_s: float, now_s: float
    ) -> float | StandRefusal:
        """Turn one axis on a trapezoid of rate with equal ramps."""
        refusal = self._refusal(now_s) or self._check_turn(axis, angle_deg, duration_s, ramp_s)
        if refusal is not None:
            return refusal
        reached_deg = angle_deg * (REACHED_SHARE if self._fault == "rate_not_reached" else 1.0)
        self._axes[AXES.index(axis)].turn(Trapezoid(reached_deg, duration_s, ramp_s), now_s)
        self._seeking_mark = False
        self._busy_until_s = now_s + duration_s
        return duration_s

    def swing(
        self, axis: str, amplitude_deg: float, peak_rate_deg_s: float, cycles: float, now_s: float
    ) -> float | StandRefusal:
        """Whole periods of a sine on one axis, from here as a turning point to 2 amplitudes further."""
        refusal = self._refusal(now_s) or self._check_swing(axis, amplitude_deg, peak_rate_deg_s, cycles)
        if refusal is not None:
            return refusal
        reached_deg = amplitude_deg * (REACHED_SHARE if self._fault == "rate_not_reached" else 1.0)
        omega = peak_rate_deg_s / abs(amplitude_deg)
        duration_s = self._axes[AXES.index(axis)].swing(reached_deg, omega, round(cycles), now_s)
        self._seeking_mark = False
        self._busy_until_s = now_s + duration_s
        return duration_s

    def stop(self, now_s: float) -> float:
        """To rest at the acceleration limit; while the marks are sought, that search is given up."""
        if now_s >= self._busy_until_s:
            return 0.0
        self._referenced &= not self._seeking_mark
        _, rates, _ = self._pose_deg(np.array([now_s]))
        accelerations = self._limits.acceleration_deg_s2
        for motion, acceleration in zip(self._axes, accelerations, strict=True):
            if acceleration:
                motion.brake(acceleration, now_s)
        duration_s = max(
            abs(rate) / limit for rate, limit in zip(rates[0], accelerations, strict=True) if limit
        )
        self._busy_until_s = now_s + duration_s
        return duration_s

    def inject(self, fault: str, now_s: float) -> None:
        """'door_open' and 'lost_reference' brake whatever moves; 'none' clears, but finds no reference.

        'rate_not_reached' holds for what is asked from then on.
        """
        if fault in ("door_open", "lost_reference"):
            self.stop(now_s)
        if fault == "lost_reference":
            self._referenced = False
        self._fault = fault

    # --- what is seen

    def status(self, now_s: float) -> StandStatus:
        """The state now."""
        angles, rates, _ = self._pose_deg(np.array([now_s]))
        temperature_c = float(self.temperature_c(np.array([now_s]))[0])
        return StandStatus(self._state(now_s), _triple(angles[0]), _triple(rates[0]), temperature_c)

    def limits(self) -> tuple[float, float, float, float, float, float]:
        """Rates (deg/s) and accelerations (deg/s²) of outer, middle, inner."""
        return (*self._limits.rate_deg_s, *self._limits.acceleration_deg_s2)

    def pose(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """True gimbal angles (rad), rates (rad/s) and accelerations (rad/s²), each (n, 3)."""
        angles, rates, accelerations = self._pose_deg(times_s)
        return np.radians(angles), np.radians(rates), np.radians(accelerations)

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """What the table does beside its report."""
        return self._effects

    def temperature_c(self, times_s: FloatArray) -> FloatArray:
        """(n,) at the probe: the room's, or the chamber's."""
        return np.full(len(times_s), self._temperature_c)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit: Earth rate and the table's, gravity and lever arm, field, temperature."""
        angles, rates, accelerations = self.pose(times_s)
        acting = self._laboratory.acting(times_s, angles, rates, self.temperature_c(times_s))
        if not self._lever_arm_m.any():
            return acting
        turning = geometry.body_rate_rad_s(angles, rates)
        angular = geometry.body_acceleration_rad_s2(angles, rates, accelerations)
        force = acting.channel("specific_force_m_s2")
        force = force + geometry.lever_arm_force_m_s2(turning, angular, self._lever_arm_m)
        return dataclasses.replace(acting, specific_force_m_s2=force)

    def encoder_samples(self, times_s: FloatArray) -> FloatArray:
        """The stand's own reading, (n, 15): see `protocol.stand_stream`. Earth rate is not in it."""
        angles, rates, _ = self.pose(times_s)
        errors = self._encoders
        wobble, slope = np.zeros_like(angles), np.zeros_like(angles)
        for harmonic, amplitude in enumerate(errors.wobble_rad, start=1):
            at_zero = self._wobble_phase[harmonic - 1]
            phase = harmonic * angles + at_zero
            wobble += amplitude * (np.sin(phase) - np.sin(at_zero))
            slope += amplitude * harmonic * np.cos(phase)
        read_angles = rounded(angles + wobble, errors.angle_quantum_rad)
        read_rates = rounded(rates * (1 + slope), errors.rate_quantum_rad_s)
        report = self._laboratory.reported(read_angles, read_rates)
        rows = np.zeros((len(times_s), 15))
        rows[:, 0] = times_s
        rows[:, 1:4], rows[:, 4:7] = report.rate_rad_s, report.specific_force_m_s2
        rows[:, 7:10], rows[:, 10:13] = read_angles, read_rates
        rows[:, 13] = self.temperature_c(times_s)
        return rows

    # --- inside

    def _state(self, now_s: float) -> str:
        if self._fault == "door_open":
            return "FAULT"
        if now_s < self._busy_until_s - REST_TOLERANCE_S:
            return "MOVING"
        return "READY" if self._referenced else "NOREF"

    def _refusal(self, now_s: float, *, needs_reference: bool = True) -> StandRefusal | None:
        state = self._state(now_s)
        if state == "FAULT":
            return StandRefusal(ERR_DOOR_OPEN, "door open")
        if state == "MOVING":
            return StandRefusal(ERR_BUSY, "moving")
        if state == "NOREF" and needs_reference:
            return StandRefusal(ERR_NO_REFERENCE, "no reference: HOME first")
        return None

    def _check_turn(
        self, axis: str, angle_deg: float, duration_s: float, ramp_s: float
    ) -> StandRefusal | None:
        if axis not in AXES or not all(map(math.isfinite, (angle_deg, duration_s, ramp_s))):
            return StandRefusal(ERR_ARGUMENT, "axis unknown, or not a number")
        if not 0.0 < ramp_s <= duration_s / 2:
            return StandRefusal(ERR_ARGUMENT, "ramp must be above 0 and at most half the duration")
        turn = Trapezoid(angle_deg, duration_s, ramp_s)
        return self._beyond(axis, abs(turn.peak_rate), abs(turn.acceleration))

    def _check_swing(
        self, axis: str, amplitude_deg: float, peak_rate_deg_s: float, cycles: float
    ) -> StandRefusal | None:
        if axis not in AXES or not all(map(math.isfinite, (amplitude_deg, peak_rate_deg_s, cycles))):
            return StandRefusal(ERR_ARGUMENT, "axis unknown, or not a number")
        if (
            amplitude_deg == 0
            or peak_rate_deg_s <= 0
            or cycles != round(cycles)
            or not 0 < cycles <= MAX_CYCLES
        ):
            text = f"needs an amplitude, a rate above 0 and a whole number of cycles up to {MAX_CYCLES}"
            return StandRefusal(ERR_ARGUMENT, text)
        return self._beyond(axis, peak_rate_deg_s, peak_rate_deg_s**2 / abs(amplitude_deg))

    def _beyond(self, axis: str, peak_deg_s: float, peak_deg_s2: float) -> StandRefusal | None:
        number = AXES.index(axis)
        if not self._limits.turns(number):
            return StandRefusal(ERR_ARGUMENT, f"the {axis} axis has no drive")
        rate, acceleration = self._limits.rate_deg_s[number], self._limits.acceleration_deg_s2[number]
        if peak_deg_s > rate:
            text = f"peak rate {peak_deg_s:.1f} deg/s above the limit of {rate:g} deg/s"
            return StandRefusal(ERR_LIMIT, text)
        if peak_deg_s2 > acceleration:
            text = f"acceleration {peak_deg_s2:.1f} deg/s2 above the limit of {acceleration:g} deg/s2"
            return StandRefusal(ERR_LIMIT, text)
        return None

    def _go(self, angles_deg: Triple, now_s: float) -> float:
        present = self._pose_deg(np.array([now_s]))[0][0]
        longest_s = 0.0
        for motion, angle, target in zip(self._axes, present, angles_deg, strict=True):
            way = target - float(angle)
            if way:
                turn = Trapezoid.fastest(
                    way, self._limits.positioning_rate_deg_s, self._limits.positioning_acceleration_deg_s2
                )
                motion.turn(turn, now_s)
                longest_s = max(longest_s, turn.duration_s)
        return longest_s

    def _pose_deg(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        poses = [motion.at(times_s) for motion in self._axes]
        angles, rates, accelerations = (np.stack(parts, axis=1) for parts in zip(*poses, strict=True))
        return angles, rates, accelerations


def _triple(values: FloatArray) -> Triple:
    outer, middle, inner = (float(value) for value in values)
    return outer, middle, inner

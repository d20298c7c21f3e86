# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""What a stand does to the input that it says it gives: its axes, its encoders, its place on a turning Earth.

The stimulus holds what the stand reports. A stand that is turned by a small rotation φ (body axes) against
its report makes u − φ × u of an input, and adds φ̇ to a rate. Its effects follow the stand's angles, are
common to all units and survive a re-mount. Axes are those of `dut_emulator.motion.gimbal_geometry`: body x is
the inner one.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect, add_contribution
from dut_emulator.effects.couplings import lever_arm_force, lever_arm_patterns
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, Triple, parameter
from dut_emulator.effects.recursions import cross, rate_of_change

AxisName = Literal["outer", "middle", "inner"]
AXIS_NAMES: tuple[AxisName, ...] = ("outer", "middle", "inner")
INERTIAL: tuple[SensorName, ...] = ("gyro", "acc")
TRIADS: tuple[SensorName, ...] = ("gyro", "acc", "mag")


def axis_angle(stimulus: Stimulus, axis: AxisName) -> FloatArray:
    """(n, 1) angle of one gimbal."""
    index = AXIS_NAMES.index(axis)
    return stimulus.channel("angles_rad")[:, index : index + 1]


def axis_direction(stimulus: Stimulus, axis: AxisName) -> FloatArray:
    """(n, 3) unit vector of one gimbal's axis, in body axes."""
    (_, sine_m, sine_i), (_, cosine_m, cosine_i) = stimulus.gimbal_waves
    zero = np.zeros_like(sine_i)
    if axis == "inner":
        return _side_by_side(zero + 1.0, zero, zero)
    if axis == "middle":
        return _side_by_side(zero, cosine_i, -sine_i)
    return _side_by_side(-sine_m, sine_i * cosine_m, cosine_i * cosine_m)


def _side_by_side(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Three columns (n,) as (n, 3), each in one piece."""
    return np.stack([x, y, z]).T


def turned(
    sensor: SensorName,
    samples: FloatArray,
    rotation: FloatArray,
    stimulus: Stimulus,
    state: EffectState,
    key: str,
) -> FloatArray:
    """(n, 3) what a small rotation φ (n, 3) of the body adds: −φ × u, and φ̇ to a rate."""
    change = cross(samples, rotation)
    if sensor == "gyro":
        change += rate_of_change(rotation, stimulus, state, key)
    return change


@dataclass(frozen=True)
class SmallRotation(LinearEffect):
    """The base of what turns the body by a small φ that is linear in its parameters: y = u − φ × u (+ φ̇)."""

    def rotations(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """Parameter → its φ per unit, as `LinearEffect.regressors`: (n, 1), (n, 3) or (3, n, 3)."""
        raise NotImplementedError

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        patterns: dict[str, FloatArray] = {}
        for name, rotation in self.rotations(stimulus).items():
            if rotation.ndim == 2 and rotation.shape[1] == 3:
                patterns[name] = turned(self.sensor, samples, rotation, stimulus, state, name)
            else:
                components = rotation if rotation.ndim == 3 else [rotation * unit for unit in np.eye(3)]
                columns = [
                    turned(self.sensor, samples, component, stimulus, state, f"{name} {index}")
                    for index, component in enumerate(components)
                ]
                patterns[name] = np.stack(columns)
        return patterns

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3): one turn by the whole φ."""
        if self.is_neutral:
            return samples
        rotation = np.zeros(samples.shape, order="F")
        for name, pattern in self.rotations(stimulus).items():
            add_contribution(rotation, np.asarray(getattr(self, name), dtype=np.float64), pattern)
        return samples + turned(self.sensor, samples, rotation, stimulus, state, "rotation")


@dataclass(frozen=True)
class Wobble(SmallRotation):
    """An axis nods as it turns: φ = c cos nθ + s sin nθ, a rotation in body axes; 1 to 30″ (n = 1 or 2).

    Gyros see φ̇ − φ × ω, accelerometers −φ × f.
    """

    cosine_rad: Triple = parameter(ZERO, "rad", (-0.01, 0.01), "rotation that goes with the cosine")
    sine_rad: Triple = parameter(ZERO, "rad", (-0.01, 0.01), "rotation that goes with the sine")
    harmonic: float = parameter(1.0, "1", (1.0, 1000.0), "periods in a turn of the axis", held=True)
    axis: AxisName = "inner"
    word: ClassVar[str] = "wobble"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Small angles; one harmonic of one axis."
    sensors: ClassVar[tuple[SensorName, ...]] = TRIADS

    def rotations(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """See `SmallRotation.rotations`."""
        phase = self.harmonic * axis_angle(stimulus, self.axis)
        return {"cosine_rad": np.cos(phase), "sine_rad": np.sin(phase)}


@dataclass(frozen=True)
class RateRipple(LinearEffect):
    """The drive does not turn evenly: the rate of one axis is θ̇ (1 + c cos nθ + s sin nθ); 0.001 to 0.1 %.

    n is a number of pole pairs or gear teeth. The stand's reported rate is the mean one.
    """

    cosine: float = parameter(0.0, "1", (-0.1, 0.1), "relative ripple with the cosine")
    sine: float = parameter(0.0, "1", (-0.1, 0.1), "relative ripple with the sine")
    harmonic: float = parameter(12.0, "1", (1.0, 1000.0), "periods in a turn of the axis", held=True)
    axis: AxisName = "inner"
    word: ClassVar[str] = "rate_ripple"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "The angle error that the ripple leads to is left out: below 1e-3 / n rad."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        angle = axis_angle(stimulus, self.axis)
        rate = rate_of_change(angle, stimulus, state, "angle") * axis_direction(stimulus, self.axis)
        return {"cosine": rate * np.cos(self.harmonic * angle), "sine": rate * np.sin(self.harmonic * angle)}


@dataclass(frozen=True)
class EncoderEccentricity(SmallRotation):
    """The graduation is not centred: the encoder reads θ + c cos θ + s sin θ; 1 to 20″.

    The true angle is smaller by that, so the body is turned by −(c cos θ + s sin θ) about the axis, and gyros
    see the rate of it.
    """

    cosine_rad: float = parameter(0.0, "rad", (-0.01, 0.01), "error that goes with the cosine")
    sine_rad: float = parameter(0.0, "rad", (-0.01, 0.01), "error that goes with the sine")
    axis: AxisName = "inner"
    word: ClassVar[str] = "encoder_eccentricity"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Small errors; one reading head."
    sensors: ClassVar[tuple[SensorName, ...]] = TRIADS

    def rotations(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """See `SmallRotation.rotations`."""
        direction, index = axis_direction(stimulus, self.axis), AXIS_NAMES.index(self.axis)
        sine, cosine = (waves[index][:, np.newaxis] for waves in stimulus.gimbal_waves)
        return {"cosine_rad": -cosine * direction, "sine_rad": -sine * direction}


@dataclass(frozen=True)
class RemountMisalignment(LinearEffect):
    """The unit sits a little turned after a re-mount: y = u − φ × u; 0.1 to 2 mrad.

    The same φ for all triads of the unit, another one at the next mount.
    """

    rotation_rad: Triple = parameter(ZERO, "rad", (-0.1, 0.1), "small rotation of the unit, body axes")
    word: ClassVar[str] = "remount_misalignment"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Small angles: 2 mrad leave 2e-6."
    sensors: ClassVar[tuple[SensorName, ...]] = TRIADS

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"rotation_rad": np.stack([cross(samples, unit) for unit in np.eye(3)])}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return samples if self.is_neutral else samples + cross(samples, np.asarray(self.rotation_rad))


@dataclass(frozen=True)
class EarthRate(LinearEffect):
    """The stand's rates are relative to the laboratory, the gyro's to inertial space: y = ω + k Ω, k = 1.

    15.04 °/h (WGS 84: 7.292115e-5 rad/s). Only where the reported rates leave it out.
    """

    share: float = parameter(0.0, "1", (-2.0, 2.0), "share of the Earth rate that the report lacks")
    word: ClassVar[str] = "earth_rate"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Any motion whose attitude is known."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"share": stimulus.channel("earth_rate_rad_s")}


@dataclass(frozen=True)
class LeverArm(LinearEffect):
    """The accelerometers sit off the stand's centre: y = f + ω̇ × r + ω × (ω × r); 1 to 10 mm.

    Paper 2 gives the two terms' magnitudes; as vectors they are these.
    """

    arm_m: Triple = parameter(ZERO, "m", (-5.0, 5.0), "from the centre to the unit, body axes")
    word: ClassVar[str] = "lever_arm"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Rates sampled fast enough for their difference."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"arm_m": lever_arm_patterns(stimulus, state)}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        force = lever_arm_force(stimulus, state, np.tile(self.arm_m, (3, 1)))
        return samples + force


@dataclass(frozen=True)
class MotorField(LinearEffect):
    """A stand's motor turns its field with its axis: y = B + c cos nθ + s sin nθ; 0.1 to 20 µT."""

    cosine_t: Triple = parameter(ZERO, "T", (-1e-3, 1e-3), "field that goes with the cosine")
    sine_t: Triple = parameter(ZERO, "T", (-1e-3, 1e-3), "field that goes with the sine")
    harmonic: float = parameter(1.0, "1", (1.0, 1000.0), "periods in a turn of the axis", held=True)
    axis: AxisName = "inner"
    word: ClassVar[str] = "motor_field"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "A current that does not change with the load."
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        phase = self.harmonic * axis_angle(stimulus, self.axis)
        return {"cosine_t": np.cos(phase), "sine_t": np.sin(phase)}


@dataclass(frozen=True)
class ChamberGradient(LinearEffect):
    """The chamber is warmer at its probe than at the unit: T_i = T + g_i (T − T_room); 1 to 5 °C at its ends.

    Acts on what temperature sensors say, one for each axis.
    """

    share: Triple = parameter(ZERO, "1", (-0.5, 0.5), "difference as a share of the distance to room")
    room_c: float = parameter(25.0, "degC", (-40.0, 85.0), "temperature outside the chamber", held=True)
    word: ClassVar[str] = "chamber_gradient"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "A chamber in equilibrium with its walls."
    sensors: ClassVar[tuple[SensorName, ...]] = ("temperature",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"share": samples - self.room_c}


@dataclass(frozen=True)
class LevelDrift(SmallRotation):
    """The stand's base tilts slowly: φ = ψ (t − t_on) about laboratory axes; y = u − φ × u.

    A gyro sees φ̇ too. From the floor's warming, some µrad per minute.
    """

    tilt_rate_rad_s: Triple = parameter(ZERO, "rad/s", (-1e-3, 1e-3), "ψ about laboratory x, y, z")
    word: ClassVar[str] = "level_drift"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Small angles; a steady tilt from power-on."
    sensors: ClassVar[tuple[SensorName, ...]] = INERTIAL

    def rotations(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """See `SmallRotation.rotations`."""
        since = stimulus.time_s - stimulus.power_on_s
        (so, sm, si), (co, cm, ci) = stimulus.gimbal_waves
        # the columns of C_body_from_lab, see `gimbal_geometry`
        x = _side_by_side(co * cm, co * sm * si - so * ci, co * sm * ci + so * si)
        y = _side_by_side(so * cm, so * sm * si + co * ci, so * sm * ci - co * si)
        z = _side_by_side(-sm, cm * si, cm * ci)
        return {"tilt_rate_rad_s": np.stack([x.T * since, y.T * since, z.T * since]).swapaxes(1, 2)}


@dataclass(frozen=True)
class NonOrthogonality(SmallRotation):
    """Neighbouring axes of the stand are not square: φ = ε_om n_om + ε_mi n_mi, n normal to the two axes.

    n_om = middle × outer is carried by the outer gimbal, n_mi = inner × middle by the middle one; ε > 0 turns
    what the second axis of the pair carries by +ε about n.
    """

    outer_middle_rad: float = parameter(0.0, "rad", (-0.1, 0.1), "ε_om")
    middle_inner_rad: float = parameter(0.0, "rad", (-0.1, 0.1), "ε_mi")
    word: ClassVar[str] = "non_orthogonality"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Small angles."
    sensors: ClassVar[tuple[SensorName, ...]] = TRIADS

    def rotations(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """See `SmallRotation.rotations`."""
        (_, lean, sine), (_, upright, cosine) = stimulus.gimbal_waves
        return {
            "outer_middle_rad": _side_by_side(upright, sine * lean, cosine * lean),
            "middle_inner_rad": _side_by_side(np.zeros_like(sine), sine, cosine),
        }


@dataclass(frozen=True)
class RateScaleFactor(LinearEffect):
    """The stand turns faster than it says by a share: y = ω (1 + s); 0.01 % for the rate table of paper 4.

    Common to all axes and units; a unit's own scale factor error looks the same until another stand is used.
    """

    share: float = parameter(0.0, "1", (-0.1, 0.1), "relative error of the stand's rate")
    word: ClassVar[str] = "rate_scale_factor"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Earth rate is far below the stand's."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"share": samples}


@dataclass(frozen=True)
class CrankGeometry(LinearEffect):
    """A slider-crank is no sinusoid: y = f − λ r θ̇² cos 2θ along the stroke, λ = r / b (first order in λ).

    x = r cos θ + r λ / 4 · cos 2θ: with λ = 0.2, the half-cycle integrals of a² are far from equal (paper 5).
    θ is the inner angle; a scotch yoke has λ = 0.
    """

    ratio: float = parameter(0.0, "1", (0.0, 0.5), "λ = r / b, crank radius over rod length")
    radius_m: float = parameter(0.15, "m", (0.0, 10.0), "crank radius r", held=True)
    stroke: Triple = parameter((1.0, 0.0, 0.0), "1", (-1.0, 1.0), "unit vector, body axes", held=True)
    word: ClassVar[str] = "crank_geometry"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = (
        "A steady speed of the flywheel; terms of λ³ (2 % of the correction at λ = 0.2) are left out."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        angle = axis_angle(stimulus, "inner")
        rate = rate_of_change(angle, stimulus, state, "angle")
        return {"ratio": -self.radius_m * rate**2 * np.cos(2.0 * angle) * np.asarray(self.stroke)}

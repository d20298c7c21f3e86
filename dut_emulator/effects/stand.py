# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""What a stand does to the input that it says it gives: its axes, its encoders, where it carries the unit.

The stimulus holds what the stand reports. A stand that is turned by a small rotation φ (body axes) against
its report makes u − φ × u of an input, and adds φ̇ to a rate. Its effects follow the stand's angles, are
common to all units and survive a re-mount. Axes are those of `dut_emulator.gimbal_geometry`: body x is
the inner one.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
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
    return stimulus.triad("angles_rad")[:, index : index + 1]


def axis_waves(stimulus: Stimulus, axis: AxisName, harmonic: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine of nθ of one gimbal, (n, 1) each."""
    sine, cosine = stimulus.angle_waves(AXIS_NAMES.index(axis), harmonic)
    return sine[:, np.newaxis], cosine[:, np.newaxis]


def about_axis(stimulus: Stimulus, axis: AxisName, amount: FloatArray) -> FloatArray:
    """(n, 3) `amount` (n,) along the axis of one gimbal, in body axes."""
    along = np.zeros((len(amount), 3), order="F")
    if axis == "inner":
        along[:, 0] = amount
        return along
    sine_i, cosine_i = stimulus.angle_waves(2)
    if axis == "middle":
        along[:, 1], along[:, 2] = cosine_i * amount, -sine_i * amount
        return along
    sine_m, cosine_m = stimulus.angle_waves(1)
    upright = cosine_m * amount
    along[:, 0], along[:, 1], along[:, 2] = -sine_m * amount, sine_i * upright, cosine_i * upright
    return along


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

    def rotation(self, stimulus: Stimulus) -> FloatArray:
        """(n, 3) the whole φ."""
        return self.added_up(self.rotations(stimulus))

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
        rotation = self.rotation(stimulus)
        change = turned(self.sensor, samples, rotation, stimulus, state, "rotation")
        change += samples
        return change


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
        sine, cosine = axis_waves(stimulus, self.axis, self.harmonic)
        return {"cosine_rad": cosine, "sine_rad": sine}


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
        rate = rate_of_change(axis_angle(stimulus, self.axis), stimulus, state, "angle")[:, 0]
        sine, cosine = stimulus.angle_waves(AXIS_NAMES.index(self.axis), self.harmonic)
        return {
            "cosine": about_axis(stimulus, self.axis, rate * cosine),
            "sine": about_axis(stimulus, self.axis, rate * sine),
        }


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
        sine, cosine = stimulus.angle_waves(AXIS_NAMES.index(self.axis))
        return {
            "cosine_rad": about_axis(stimulus, self.axis, -cosine),
            "sine_rad": about_axis(stimulus, self.axis, -sine),
        }


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
        if self.is_neutral:
            return samples
        change = cross(samples, np.asarray(self.rotation_rad))
        change += samples
        return change


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
        force += samples
        return force


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
        (so, co), (sm, cm), (si, ci) = (stimulus.angle_waves(axis) for axis in range(3))
        # the columns of C_body_from_lab, see `gimbal_geometry`
        x = _side_by_side(co * cm, co * sm * si - so * ci, co * sm * ci + so * si)
        y = _side_by_side(so * cm, so * sm * si + co * ci, so * sm * ci - co * si)
        z = _side_by_side(-sm, cm * si, cm * ci)
        return {"tilt_rate_rad_s": np.stack([x.T * since, y.T * since, z.T * since]).swapaxes(1, 2)}

    def rotation(self, stimulus: Stimulus) -> FloatArray:
        """(n, 3) the tilt, turned by one gimbal after the other."""
        since = stimulus.time_s - stimulus.power_on_s
        (so, co), (sm, cm), (si, ci) = (stimulus.angle_waves(axis) for axis in range(3))
        x, y, z = self.tilt_rate_rad_s
        along, across = (co * x + so * y) * since, (co * y - so * x) * since
        z_t = z * since
        up = sm * along + cm * z_t
        return _side_by_side(cm * along - sm * z_t, si * up + ci * across, ci * up - si * across)


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
        (lean, upright), (sine, cosine) = stimulus.angle_waves(1), stimulus.angle_waves(2)
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

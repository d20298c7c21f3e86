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

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.couplings import lever_arm_patterns
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, Triple, parameter
from dut_emulator.effects.recursions import rate_of_change
from dut_emulator.motion.gimbal_geometry import dcm_body_from_lab

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
    _, middle, inner = stimulus.channel("angles_rad").T
    zero = np.zeros_like(inner)
    if axis == "inner":
        return np.stack([zero + 1.0, zero, zero], axis=1)
    if axis == "middle":
        return np.stack([zero, np.cos(inner), -np.sin(inner)], axis=1)
    cosine = np.cos(middle)
    return np.stack([-np.sin(middle), np.sin(inner) * cosine, np.cos(inner) * cosine], axis=1)


def turned(
    sensor: SensorName,
    samples: FloatArray,
    rotation: FloatArray,
    stimulus: Stimulus,
    state: EffectState,
    key: str,
) -> FloatArray:
    """(n, 3) what a small rotation φ (n, 3) of the body adds: −φ × u, and φ̇ to a rate."""
    change = np.cross(samples, rotation)
    if sensor == "gyro":
        change = change + rate_of_change(rotation, stimulus, state, key)
    return change


@dataclass(frozen=True)
class Wobble(LinearEffect):
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

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        phase = self.harmonic * axis_angle(stimulus, self.axis)
        waves = {"cosine_rad": np.cos(phase), "sine_rad": np.sin(phase)}
        return {
            name: np.stack(
                [
                    turned(self.sensor, samples, wave * unit, stimulus, state, f"{name} {index}")
                    for index, unit in enumerate(np.eye(3))
                ]
            )
            for name, wave in waves.items()
        }


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
class EncoderEccentricity(LinearEffect):
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

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        angle, direction = axis_angle(stimulus, self.axis), axis_direction(stimulus, self.axis)
        waves = {"cosine_rad": np.cos(angle), "sine_rad": np.sin(angle)}
        return {
            name: turned(self.sensor, samples, -wave * direction, stimulus, state, name)
            for name, wave in waves.items()
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
        return {"rotation_rad": np.stack([np.cross(samples, unit) for unit in np.eye(3)])}


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
class LevelDrift(LinearEffect):
    """The stand's base tilts slowly: φ = ψ (t − t_on) about laboratory axes; y = u − φ × u.

    A gyro sees φ̇ too. From the floor's warming, some µrad per minute.
    """

    tilt_rate_rad_s: Triple = parameter(ZERO, "rad/s", (-1e-3, 1e-3), "ψ about laboratory x, y, z")
    word: ClassVar[str] = "level_drift"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "Small angles; a steady tilt from power-on."
    sensors: ClassVar[tuple[SensorName, ...]] = INERTIAL

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        since = (stimulus.time_s - stimulus.power_on_s)[:, np.newaxis]
        laboratory = np.moveaxis(dcm_body_from_lab(stimulus.channel("angles_rad")), 2, 0)
        return {
            "tilt_rate_rad_s": np.stack(
                [
                    turned(self.sensor, samples, since * laboratory[axis], stimulus, state, f"tilt {axis}")
                    for axis in range(3)
                ]
            )
        }


@dataclass(frozen=True)
class NonOrthogonality(LinearEffect):
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

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        _, middle, inner = stimulus.channel("angles_rad").T
        across = np.stack(
            [np.cos(middle), np.sin(inner) * np.sin(middle), np.cos(inner) * np.sin(middle)], axis=1
        )
        normal = np.stack([np.zeros_like(inner), np.sin(inner), np.cos(inner)], axis=1)
        return {
            "outer_middle_rad": turned(self.sensor, samples, across, stimulus, state, "outer"),
            "middle_inner_rad": turned(self.sensor, samples, normal, stimulus, state, "middle"),
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

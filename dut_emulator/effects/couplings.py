# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""Where one quantity leaks into the reading of another: force into rate, supply, field, shock, size."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import AXES, ZERO, ZERO_MATRIX, Matrix, Triple, parameter
from dut_emulator.effects.recursions import cross, first_order_lag, rate_of_change


@dataclass(frozen=True)
class GSensitivity(LinearEffect):
    """A gyro feels specific force: y_i = u_i + Σ_j G_ij f_j (IEEE 528, acceleration-sensitive error).

    Paper 5 measures the three columns as D1, D2, D3; 0.001 to 0.02 °/s/g in MEMS. A tumble reveals it.
    """

    acc: Matrix = parameter(ZERO_MATRIX, "rad/s per m/s^2", (-0.01, 0.01), "sensor i for force along axis j")
    word: ClassVar[str] = "g_sensitivity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Force inside the band in which the coefficient was found; linear."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"acc": stimulus.triad("specific_force_m_s2")}


@dataclass(frozen=True)
class G2Sensitivity(LinearEffect):
    """A gyro feels the square of specific force: y_i = u_i + Σ_j G_ij f_j² (IEEE 952).

    Vibration is rectified into a bias of G times its mean square; 1e-4 to 1e-3 °/s/g² in MEMS.
    """

    acc_squared: Matrix = parameter(
        ZERO_MATRIX, "rad/s per m/s^2 per m/s^2", (-1e-3, 1e-3), "sensor i for force along axis j, squared"
    )
    word: ClassVar[str] = "g2_sensitivity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = (
        "Vibration inside the sampled band; what is beyond it has to be added to the force's square."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"acc_squared": stimulus.triad("specific_force_m_s2") ** 2}


@dataclass(frozen=True)
class SupplySensitivity(LinearEffect):
    """The bias follows the supply: y = u + s (V − V_nominal); 0.001 to 0.01 °/s/V in MEMS gyros.

    The nominal voltage is the module's 5 V rail of paper 1, table 3, unless it is given.
    """

    per_volt_si: Triple = parameter(ZERO, "{si} per V", (-0.01, 0.01), "bias per volt")
    nominal_v: float = parameter(5.0, "V", (0.0, 100.0), "supply without this error", held=True)
    word: ClassVar[str] = "supply_sensitivity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Supplies inside the product's limits."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc")

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"per_volt_si": (stimulus.channel("supply_v") - self.nominal_v)[:, np.newaxis]}


@dataclass(frozen=True)
class MagneticSensitivity(LinearEffect):
    """A gyro feels the magnetic field: y_i = u_i + Σ_j M_ij B_j (IEEE 952, magnetic sensitivity).

    In a fibre-optic gyro it is Faraday rotation in the coil; it turns with the table, unlike a bias.
    """

    field: Matrix = parameter(ZERO_MATRIX, "rad/s per T", (-100.0, 100.0), "sensor i for field along axis j")
    word: ClassVar[str] = "magnetic_sensitivity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Fields that do not saturate the shield."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"field": stimulus.triad("field_t")}


@dataclass(frozen=True)
class CrossAxisSensitivity(LinearEffect):
    """A sensor answers to force across its axis: y_i = f_i + Σ_j c_ij f_j (IEEE 1293).

    0.1 to 1 % in MEMS. In a linear model it is the misalignment of the sensor's input axis.
    """

    cross: Matrix = parameter(
        ZERO_MATRIX, "1", (-0.5, 0.5), "sensor i for force along axis j", off_diagonal=True
    )
    word: ClassVar[str] = "cross_axis_sensitivity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Linear; cross products f_i f_j are not part of it."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"cross": samples}


def lever_arm_patterns(stimulus: Stimulus, state: EffectState) -> FloatArray:
    """(3, n, 3): specific force per metre of a lever arm along x, y and z, ω̇ × e + ω × (ω × e).

    Paper 2's centripetal and tangential terms as vectors. ω̇ is the backward difference of the samples.
    """
    rate = stimulus.channel("rate_rad_s")
    angular_acceleration = rate_of_change(rate, stimulus, state, "rate")
    patterns = [cross(angular_acceleration, arm) + cross(rate, cross(rate, arm)) for arm in np.eye(3)]
    return np.stack(patterns)


def lever_arm_force(stimulus: Stimulus, state: EffectState, places_m: FloatArray) -> FloatArray:
    """(n, 3): what sensor i at `places_m[i]` feels along its own axis, ω̇ × r + (ω · r) ω − ω² r."""
    rate = stimulus.triad("rate_rad_s")
    (px, py, pz), (x, y, z) = rate_of_change(rate, stimulus, state, "rate").T, rate.T
    xy, xz, yz, x_2, y_2, z_2 = x * y, x * z, y * z, x * x, y * y, z * z
    (r_xx, r_xy, r_xz), (r_yx, r_yy, r_yz), (r_zx, r_zy, r_zz) = places_m
    result = np.empty(rate.shape, order="F")
    result[:, 0] = (py + xz) * r_xz - (pz - xy) * r_xy - (y_2 + z_2) * r_xx
    result[:, 1] = (pz + xy) * r_yx - (px - yz) * r_yz - (x_2 + z_2) * r_yy
    result[:, 2] = (px + yz) * r_zy - (py - xz) * r_zx - (x_2 + y_2) * r_zz
    return result


@dataclass(frozen=True)
class SizeEffect(LinearEffect):
    """The three accelerometers do not sit at one point: y_i = f_i + (ω̇ × r_i + ω × (ω × r_i))_i.

    r_i is the place of sensor i; 1 to 20 mm (Grewal, Andrews, Bartone, *Global Navigation Satellite Systems,
    Inertial Navigation, and Integration*).
    """

    place_x_m: Triple = parameter(ZERO, "m", (-1.0, 1.0), "place of sensor x")
    place_y_m: Triple = parameter(ZERO, "m", (-1.0, 1.0), "place of sensor y")
    place_z_m: Triple = parameter(ZERO, "m", (-1.0, 1.0), "place of sensor z")
    word: ClassVar[str] = "size_effect"
    stage: ClassVar[Stage] = Stage.MOUNTING
    valid: ClassVar[str] = (
        "Rates sampled fast enough for their difference; r_ii along the sensor's own axis is seen by ω² only."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """For each sensor the lever arm's patterns, on its own axis alone."""
        patterns = lever_arm_patterns(stimulus, state)
        return {f"place_{name}_m": patterns * np.eye(3)[axis] for axis, name in enumerate(AXES)}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        places_m = np.array([self.place_x_m, self.place_y_m, self.place_z_m])
        force = lever_arm_force(stimulus, state, places_m)
        force += samples
        return force


@dataclass(frozen=True)
class VibrationRectification(LinearEffect):
    """Vibration makes a bias: y = f + v ⟨(f − ⟨f⟩)²⟩, ⟨ ⟩ a first-order mean over τ (IEEE 1293, VRE).

    50 to 500 µg/g². Unlike the quadratic term it answers to vibration and not to steady force.
    """

    coefficient_per_si: Triple = parameter(ZERO, "1 per {si}", (-1.0, 1.0), "bias per mean square")
    averaging_time_s: float = parameter(1.0, "s", (1e-3, 1e3), "time constant of the means", held=True)
    remembers: ClassVar[bool] = True
    word: ClassVar[str] = "vibration_rectification"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Vibration inside the sampled band."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        period, time = stimulus.sample_period_s, self.averaging_time_s
        vibration = samples - first_order_lag(samples, period, time, state, "mean")
        return {"coefficient_per_si": first_order_lag(vibration**2, period, time, state, "mean square")}


@dataclass(frozen=True)
class ShockBiasShift(LinearEffect):
    """A shock leaves a bias behind: y = f + b once |f| of any axis has passed a threshold; 0.1 to 5 mg.

    It begins with the sample that passes it and stays until power-off.
    """

    shift_si: Triple = parameter(ZERO, "{si}", (-0.1, 0.1), "bias after the shock")
    threshold_si: float = parameter(500.0, "{si}", (0.0, 1000.0), "force that counts as a shock", held=True)
    remembers: ClassVar[bool] = True
    word: ClassVar[str] = "shock_bias_shift"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "One shift for the first shock; further ones add nothing."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)
    scanned: ClassVar[dict[str, tuple[float, ...]]] = {
        "threshold_si": tuple(float(f) for f in np.geomspace(10.0, 1500.0, 61))
    }

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        before = "shocked" in state.carried
        shocked = np.logical_or.accumulate((np.abs(samples) > self.threshold_si).any(axis=1)) | before
        if shocked.any():
            state.carried["shocked"] = np.ones(1)
        return {"shift_si": shocked.astype(np.float64)[:, np.newaxis]}

# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""What temperature, its rate, its history and the time since power-on do."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.deterministic import (
    REFERENCE_TEMPERATURE_C,
    VALID_TEMPERATURES_C,
    excess_c,
    polynomial,
    powers,
)
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, ZERO_MATRIX, Matrix, Triple, parameter
from dut_emulator.effects.recursions import play, rate_of_change


@dataclass(frozen=True)
class ScaleFactorTemperature(LinearEffect):
    """y = u (1 + Σ_k c_k (T − T_ref)^k): the scale factor follows the temperature (IEEE 952).

    50 to 300 ppm/°C in MEMS, 10 to 50 ppm/°C in fibre-optic gyros.
    """

    coefficients_per_c: tuple[Triple, ...] = parameter(
        (),
        "1 per degC",
        (-0.1, 0.1),
        "coefficient of the power k of T − T_ref, per degC to the k",
        powers=True,
    )
    reference_temperature_c: float = parameter(
        REFERENCE_TEMPERATURE_C, "degC", VALID_TEMPERATURES_C, "temperature without this error", held=True
    )
    word: ClassVar[str] = "scale_factor_temperature"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "−40 to 85 °C; outside it the polynomial is held at its edge."
    start: ClassVar[dict[str, Any]] = {"coefficients_per_c": (ZERO, ZERO)}

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        count = len(self.coefficients_per_c)
        return {"coefficients_per_c": samples * powers(stimulus, self.reference_temperature_c, count)}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        scaled = polynomial(stimulus, self.reference_temperature_c, self.coefficients_per_c)
        scaled += 1.0
        scaled *= samples
        return scaled


@dataclass(frozen=True)
class MisalignmentTemperature(LinearEffect):
    """The axes turn with temperature: y_i = u_i + (T − T_ref) Σ_j m_ij u_j (small angles).

    0.05 to 0.5° over the span in MEMS, from the stress of the package.
    """

    misalignment_rad_per_c: Matrix = parameter(
        ZERO_MATRIX, "rad per degC", (-0.01, 0.01), "turn of sensor i towards axis j", off_diagonal=True
    )
    reference_temperature_c: float = parameter(
        REFERENCE_TEMPERATURE_C, "degC", VALID_TEMPERATURES_C, "temperature without this error", held=True
    )
    word: ClassVar[str] = "misalignment_temperature"
    stage: ClassVar[Stage] = Stage.MOUNTING
    valid: ClassVar[str] = "Small angles; −40 to 85 °C, outside it held at the edge."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc")

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        excess = excess_c(stimulus, self.reference_temperature_c)
        return {"misalignment_rad_per_c": samples * excess[:, np.newaxis]}


@dataclass(frozen=True)
class TemperatureRate(LinearEffect):
    """A bias in proportion to the rate of the temperature: y = u + c Ṫ.

    In a fibre coil it is Shupe's effect (D. M. Shupe, *Thermally induced nonreciprocity in the fiber-optic
    interferometer*, Applied Optics 19, 1980); in MEMS a gradient across the die. Ṫ is the backward difference
    of the samples' temperatures and 0 at the first.
    """

    coefficient_rad_per_c: Triple = parameter(ZERO, "rad per degC", (-1.0, 1.0), "bias per rate")
    word: ClassVar[str] = "temperature_rate"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = (
        "Temperature changes slower than heat crosses the sensor; a noisy probe gives a noisy bias."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        rate = rate_of_change(stimulus.temperature_c[:, np.newaxis], stimulus, state, "temperature")
        return {"coefficient_rad_per_c": rate}


@dataclass(frozen=True)
class ThermalHysteresis(LinearEffect):
    """The bias depends on where the temperature came from: y = u + h p, p in [−1, 1] the place in the play.

    After w degrees of heating the bias is h above the middle, after as much cooling h below: a closed loop of
    temperature encloses an area (IEEE 1293, hysteresis). Model: stop operator (Visintin, 1994).
    """

    amplitude_si: Triple = parameter(ZERO, "{si}", (-0.01, 0.01), "half the distance of the two branches")
    half_width_c: float = parameter(
        10.0, "degC", (0.01, 100.0), "change of temperature from middle to branch", held=True
    )
    remembers: ClassVar[bool] = True
    word: ClassVar[str] = "thermal_hysteresis"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = (
        "Independent of how fast the temperature changes; begins in the middle of its play."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc")
    scanned: ClassVar[dict[str, tuple[float, ...]]] = {
        "half_width_c": tuple(float(w) for w in np.geomspace(0.5, 80.0, 33))
    }

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {
            "amplitude_si": play(
                stimulus.temperature_c[:, np.newaxis], self.half_width_c, state, "temperature"
            )
        }


@dataclass(frozen=True)
class WarmUp(LinearEffect):
    """After power-on the bias settles: y = u + A exp(−(t − t_on) / τ); nothing before power-on.

    0.01 to 0.1 °/s with τ of 60 to 600 s in MEMS gyros; cold starts show it (IEEE 952, warm-up time).
    """

    amplitude_si: Triple = parameter(ZERO, "{si}", (-0.1, 0.1), "bias at power-on above the settled one")
    time_constant_s: float = parameter(120.0, "s", (0.01, 1e5), "time constant τ", held=True)
    word: ClassVar[str] = "warm_up"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "One time constant; a unit that was off for long enough to be cold."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc")
    scanned: ClassVar[dict[str, tuple[float, ...]]] = {
        "time_constant_s": tuple(float(t) for t in np.geomspace(1.0, 3000.0, 33))
    }

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        since = stimulus.time_s - stimulus.power_on_s
        decay = np.exp(-np.maximum(since, 0.0) / self.time_constant_s)
        return {"amplitude_si": np.where(since >= 0, decay, 0.0)[:, np.newaxis]}

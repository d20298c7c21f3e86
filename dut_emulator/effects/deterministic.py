# pyright: strict
# ruff: noqa: ARG002  one signature for every effect: most need only a part of it
"""Effects that follow from the stimulus alone: matrix, bias, bias over temperature, range and quantum.

The model of a triad is y = M u + b (IEEE 528 words; rows of M are sensors), M = S (I + misalignment), with
the rest added or cut behind it. Source of the form: paper 1, eqs (1), (2), solved for the output.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus

Triple = tuple[float, float, float]
Matrix = tuple[Triple, Triple, Triple]

ZERO: Triple = (0.0, 0.0, 0.0)
NO_MISALIGNMENT: Matrix = (ZERO, ZERO, ZERO)


@dataclass(frozen=True)
class Misalignment:
    """Each sensor's axis leaves its nominal direction: y_i = u_i + Σ_j m_ij u_j (small angles, rad).

    The diagonal must be zero: what acts along the axis is scale factor error. Non-orthogonality is the
    symmetric part, rotation of the whole triad the antisymmetric one.
    """

    sensor: SensorName
    misalignment_rad: Matrix = NO_MISALIGNMENT
    word: ClassVar[str] = "misalignment"
    stage: ClassVar[Stage] = Stage.MOUNTING

    @property
    def is_neutral(self) -> bool:
        """No angle at all."""
        return not np.any(self.misalignment_rad)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        return samples + samples @ np.asarray(self.misalignment_rad, dtype=np.float64).T


@dataclass(frozen=True)
class ScaleFactorError:
    """y_i = (1 + s_i) u_i, s dimensionless; −1 is a dead sensor."""

    sensor: SensorName
    scale_factor_error: Triple = ZERO
    word: ClassVar[str] = "scale_factor_error"
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    @property
    def is_neutral(self) -> bool:
        """Nominal scale factors."""
        return not any(self.scale_factor_error)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        return samples * (1.0 + np.asarray(self.scale_factor_error))


@dataclass(frozen=True)
class Bias:
    """A constant output at zero input, in SI of the sensor."""

    sensor: SensorName
    bias_si: Triple = ZERO
    word: ClassVar[str] = "bias"
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    @property
    def is_neutral(self) -> bool:
        """No bias."""
        return not any(self.bias_si)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return samples if self.is_neutral else samples + np.asarray(self.bias_si)


@dataclass(frozen=True)
class BiasTemperature:
    """Bias that follows the sensor's temperature: a polynomial about the reference temperature.

    b_i(T) = Σ_k c_ki (T − T_ref)^k with k = 1, 2, …; so the bias at T_ref is `Bias` alone. Row k − 1 of
    `coefficients_si_per_c` belongs to power k. Valid from −40 to 85 °C; outside it is held at the edge.
    """

    sensor: SensorName
    coefficients_si_per_c: tuple[Triple, ...] = ()
    reference_temperature_c: float = 25.0
    word: ClassVar[str] = "bias_temperature"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid_from_c: ClassVar[float] = -40.0
    valid_to_c: ClassVar[float] = 85.0

    @property
    def is_neutral(self) -> bool:
        """No power has a coefficient."""
        return not np.any(self.coefficients_si_per_c)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        excess = np.clip(stimulus.temperature_c, self.valid_from_c, self.valid_to_c)
        excess = (excess - self.reference_temperature_c)[:, np.newaxis]
        bias = np.zeros_like(samples)
        for row in reversed(self.coefficients_si_per_c):  # Horner
            bias = (bias + np.asarray(row)) * excess
        return samples + bias


@dataclass(frozen=True)
class Saturation:
    """The output stays inside ± range, in SI of the sensor; infinite is none."""

    sensor: SensorName
    range_si: float = np.inf
    word: ClassVar[str] = "saturation"
    stage: ClassVar[Stage] = Stage.QUANTISER

    @property
    def is_neutral(self) -> bool:
        """No range."""
        return np.isinf(self.range_si)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return samples if self.is_neutral else np.clip(samples, -self.range_si, self.range_si)


@dataclass(frozen=True)
class Quantisation:
    """The output is a whole number of quanta (rounded to nearest, half to even); 0 is none.

    Error of a busy signal: uniform, standard deviation quantum / √12. Goes last in its stage, so that a
    saturated sample is the highest code.
    """

    sensor: SensorName
    quantum_si: float = 0.0
    word: ClassVar[str] = "quantization"
    stage: ClassVar[Stage] = Stage.QUANTISER

    @property
    def is_neutral(self) -> bool:
        """No quantum."""
        return self.quantum_si == 0

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return samples if self.is_neutral else np.rint(samples / self.quantum_si) * self.quantum_si

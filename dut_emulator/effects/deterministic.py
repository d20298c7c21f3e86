# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""Effects that follow from the stimulus alone: matrix, bias, bias over temperature, range and quantum.

The model of a triad is y = M u + b (IEEE 528 words; rows of M are sensors), M = S (I + misalignment), with
the rest added or cut behind it. Source of the form: paper 1, eqs (1), (2), solved for the output.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect, LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, ZERO_MATRIX, Matrix, Triple, parameter

NO_MISALIGNMENT = ZERO_MATRIX
VALID_TEMPERATURES_C = (-40.0, 85.0)
REFERENCE_TEMPERATURE_C = 25.0
LEAST_QUANTUM_SHARE = 1e-9
"""Outputs nearer to each other than this share of the largest differ by rounding only."""


def excess_c(stimulus: Stimulus, reference_c: float) -> FloatArray:
    """(n,) T − T_ref, T held at the edges of its validity."""
    return np.clip(stimulus.temperature_c, *VALID_TEMPERATURES_C) - reference_c


def powers(stimulus: Stimulus, reference_c: float, count: int) -> FloatArray:
    """(count, n, 1): (T − T_ref)^k for k = 1 … count, T held at the edges of its validity."""
    excess = excess_c(stimulus, reference_c)[:, np.newaxis]
    return np.stack([excess**power for power in range(1, count + 1)]) if count else np.zeros((0, 1, 1))


def polynomial(stimulus: Stimulus, reference_c: float, coefficients: tuple[Triple, ...]) -> FloatArray:
    """(n, 3): Σ_k c_k (T − T_ref)^k with c_k in row k − 1, by Horner's rule."""
    excess = excess_c(stimulus, reference_c)[:, np.newaxis]
    total = np.zeros((len(excess), 3), order="F")
    for row in reversed(coefficients):
        total += np.asarray(row)
        total *= excess
    return total


@dataclass(frozen=True)
class Misalignment(LinearEffect):
    """Each sensor's axis leaves its nominal direction: y_i = u_i + Σ_j m_ij u_j (small angles, rad).

    The diagonal must be zero: what acts along the axis is scale factor error. Non-orthogonality is the
    symmetric part, rotation of the whole triad the antisymmetric one.
    """

    misalignment_rad: Matrix = parameter(
        NO_MISALIGNMENT, "rad", (-0.5, 0.5), "angle of sensor i towards axis j", off_diagonal=True
    )
    word: ClassVar[str] = "misalignment"
    stage: ClassVar[Stage] = Stage.MOUNTING
    valid: ClassVar[str] = "Small angles: at 1° the neglected square is 1.5e-4."

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"misalignment_rad": samples}


@dataclass(frozen=True)
class ScaleFactorError(LinearEffect):
    """y_i = (1 + s_i) u_i, s dimensionless; −1 is a dead sensor."""

    scale_factor_error: Triple = parameter(ZERO, "1", (-1.0, 1.0), "relative error of the scale factor")
    word: ClassVar[str] = "scale_factor_error"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Any input; what depends on the input is non-linearity."

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"scale_factor_error": samples}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        return samples * (1.0 + np.asarray(self.scale_factor_error))


@dataclass(frozen=True)
class Bias(LinearEffect):
    """A constant output at zero input, in SI of the sensor."""

    bias_si: Triple = parameter(ZERO, "{si}", (-0.1, 0.1), "output at zero input")
    word: ClassVar[str] = "bias"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "One run; turn-on differences are another value in each run."

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"bias_si": np.ones((len(samples), 1))}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return samples if self.is_neutral else samples + np.asarray(self.bias_si)


@dataclass(frozen=True)
class BiasTemperature(LinearEffect):
    """Bias that follows the sensor's temperature: a polynomial about the reference temperature.

    b_i(T) = Σ_k c_ki (T − T_ref)^k with k = 1, 2, …; so the bias at T_ref is `Bias` alone. Row k − 1 of
    `coefficients_si_per_c` belongs to power k. Valid from −40 to 85 °C; outside it is held at the edge.
    """

    coefficients_si_per_c: tuple[Triple, ...] = parameter(
        (),
        "{si} per degC",
        (-1e-3, 1e-3),
        "coefficient of the power k of T − T_ref, per degC to the k",
        powers=True,
    )
    reference_temperature_c: float = parameter(
        REFERENCE_TEMPERATURE_C, "degC", VALID_TEMPERATURES_C, "temperature of the constant bias", held=True
    )
    word: ClassVar[str] = "bias_temperature"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "−40 to 85 °C; outside it the polynomial is held at its edge."
    start: ClassVar[dict[str, Any]] = {"coefficients_si_per_c": (ZERO, ZERO)}

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {
            "coefficients_si_per_c": powers(
                stimulus, self.reference_temperature_c, len(self.coefficients_si_per_c)
            )
        }

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        bias = polynomial(stimulus, self.reference_temperature_c, self.coefficients_si_per_c)
        bias += samples
        return bias


@dataclass(frozen=True)
class Saturation(CatalogueEffect):
    """The output stays inside ± range, in SI of the sensor; infinite is none."""

    range_si: float = parameter(np.inf, "{si}", (0.0, np.inf), "largest output")
    word: ClassVar[str] = "saturation"
    stage: ClassVar[Stage] = Stage.QUANTISER
    valid: ClassVar[str] = "A hard stop, the same on both sides and for the three sensors."

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """∂y/∂R is the sign of what is cut."""
        samples = stimulus.true_input(self.sensor)
        return {"range_si": np.where(np.abs(samples) > self.range_si, np.sign(samples), 0.0)}

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "Saturation":
        """The range is where the output stays while the input goes on."""
        samples = stimulus.true_input(self.sensor)
        cut = np.isfinite(residual) & (residual * np.sign(samples) < 0)
        if not cut.any():
            return dataclasses.replace(self, range_si=np.inf)
        return dataclasses.replace(self, range_si=float(np.median(np.abs((samples + residual)[cut]))))

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
class Quantisation(CatalogueEffect):
    """The output is a whole number of quanta (rounded to nearest, half to even); 0 is none.

    Error of a busy signal: uniform, standard deviation quantum / √12. Goes last in its stage, so that a
    saturated sample is the highest code.
    """

    quantum_si: float = parameter(0.0, "{si}", (0.0, 0.1), "step of the output")
    word: ClassVar[str] = "quantization"
    stage: ClassVar[Stage] = Stage.QUANTISER
    valid: ClassVar[str] = "Rounding converters; one that cuts off has a bias of half a quantum besides."

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """∂y/∂q is the code, wherever the code does not just change."""
        samples = stimulus.true_input(self.sensor)
        if self.is_neutral:
            return {"quantum_si": np.zeros_like(samples)}
        return {"quantum_si": np.rint(samples / self.quantum_si)}

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "Quantisation":
        """The least distance between two outputs, sharpened over all codes."""
        outputs = (stimulus.true_input(self.sensor) + residual)[np.isfinite(residual)]
        distances = np.diff(np.unique(outputs))
        largest = float(np.abs(outputs).max(initial=0.0))
        real = distances[distances > LEAST_QUANTUM_SHARE * largest]
        if len(real) == 0:
            return dataclasses.replace(self, quantum_si=0.0)
        codes = np.rint(outputs / float(real.min()))
        return dataclasses.replace(self, quantum_si=float(codes @ outputs / (codes @ codes)))

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return samples if self.is_neutral else np.rint(samples / self.quantum_si) * self.quantum_si

# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""What makes a scale factor depend on the input: asymmetry, powers, dead band, hysteresis of the rate."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import ZERO, Triple, parameter
from dut_emulator.effects.recursions import play


@dataclass(frozen=True)
class ScaleFactorAsymmetry(LinearEffect):
    """y = u + a |u|: the scale factor is 1 + a for positive and 1 − a for negative inputs.

    a = (K⁺ − K⁻) / (K⁺ + K⁻) is paper 5's Kax; IEEE 528 calls the whole difference, 2a, the asymmetry.
    """

    asymmetry: Triple = parameter(ZERO, "1", (-0.5, 0.5), "half the relative difference of scale factors")
    word: ClassVar[str] = "scale_factor_asymmetry"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = (
        "Any input inside the range; tells from even orders only when two rates of one sign are seen."
    )
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc")

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"asymmetry": np.abs(samples)}


@dataclass(frozen=True)
class ScaleFactorNonlinearity(LinearEffect):
    """y = u + k₃ u³: odd, the scale factor grows or falls with the size of the input (IEEE 952).

    1000 ppm at 400 °/s is k₃ = 2.1e-5 s²/rad².
    """

    cubic: Triple = parameter(ZERO, "1 per {si} per {si}", (-1.0, 1.0), "coefficient of the cube")
    word: ClassVar[str] = "scale_factor_nonlinearity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "|k₃| u² ≪ 1 over the range in use."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"cubic": samples * samples * samples}


@dataclass(frozen=True)
class EvenNonlinearity(LinearEffect):
    """y = u + k₂ u²: even, the same sign for both directions of turning (IEEE 952).

    Looks like asymmetry at one rate and like g-sensitivity on a table that turns off its centre.
    """

    square: Triple = parameter(ZERO, "1 per {si}", (-1.0, 1.0), "coefficient of the square")
    word: ClassVar[str] = "even_nonlinearity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "|k₂ u| ≪ 1 over the range in use."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"square": samples**2}


@dataclass(frozen=True)
class QuadraticNonlinearity(LinearEffect):
    """y = f + K₂ f²: the second-order coefficient of the accelerometer's model equation (IEEE 1293, K2).

    50 to 500 µg/g² in MEMS; it rectifies vibration into a bias of K₂ times the mean square.
    """

    square: Triple = parameter(ZERO, "1 per {si}", (-1.0, 1.0), "K2")
    word: ClassVar[str] = "quadratic_nonlinearity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "|K₂ f| ≪ 1 over the range in use."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"square": samples**2}


@dataclass(frozen=True)
class OddQuadraticNonlinearity(LinearEffect):
    """y = f + K_oq f |f|: second order, but of the sign of the input (IEEE 1293, Koq).

    It is the quadratic term that fits the text of paper 5, whose half-cycle sums would lose an even one.
    """

    odd_square: Triple = parameter(ZERO, "1 per {si}", (-1.0, 1.0), "Koq")
    word: ClassVar[str] = "odd_quadratic_nonlinearity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "|K_oq f| ≪ 1 over the range in use."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"odd_square": samples * np.abs(samples)}


@dataclass(frozen=True)
class CubicNonlinearity(LinearEffect):
    """y = f + K₃ f³: the third-order coefficient of the accelerometer's model equation (IEEE 1293, K3)."""

    cubic: Triple = parameter(ZERO, "1 per {si} per {si}", (-1.0, 1.0), "K3")
    word: ClassVar[str] = "cubic_nonlinearity"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "|K₃| f² ≪ 1 over the range in use."
    sensors: ClassVar[tuple[SensorName, ...]] = ("acc",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"cubic": samples * samples * samples}


@dataclass(frozen=True)
class DeadBand(LinearEffect):
    """Near zero the output stays at zero: y = (1 − d) u where |u| < w (IEEE 528, dead band).

    d = 1 is a band without any response; IEEE 528 speaks of a dead band from d = 0.9. Outside it the output
    is right, so it jumps by d w at the edge.
    """

    depth: Triple = parameter(ZERO, "1", (0.0, 1.0), "share of the response that is missing")
    half_width_si: float = parameter(1e-4, "{si}", (0.0, 0.01), "half width of the band", held=True)
    word: ClassVar[str] = "dead_band"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Rates that pass slowly through zero; noise of the size of the band hides it."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)
    scanned: ClassVar[dict[str, tuple[float, ...]]] = {
        "half_width_si": tuple(float(w) for w in np.geomspace(1e-5, 1.0, 101))
    }

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        inside = np.abs(samples) < self.half_width_si
        return {"depth": np.where(inside, -samples, 0.0)}


@dataclass(frozen=True)
class RateHysteresis(LinearEffect):
    """Up and down strokes differ: y = u + h p, p in [−1, 1] the place in the play; h < 0 lags.

    p moves by Δu / w and stops at ±1, so up and down strokes of a staircase differ by 2h; paper 4 finds them
    in its rate gyro. Where friction keeps the output back, up strokes read less. Model: stop operator
    (Visintin, *Differential Models of Hysteresis*, 1994).
    """

    amplitude_si: Triple = parameter(ZERO, "{si}", (-0.01, 0.01), "half the distance of the two branches")
    half_width_si: float = parameter(
        0.1, "{si}", (1e-6, 0.1), "change of rate from middle to branch", held=True
    )
    remembers: ClassVar[bool] = True
    word: ClassVar[str] = "rate_hysteresis"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Independent of how fast the rate changes; begins in the middle of its play."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)
    scanned: ClassVar[dict[str, tuple[float, ...]]] = {
        "half_width_si": tuple(float(w) for w in np.geomspace(1e-3, 10.0, 33))
    }

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        return {"amplitude_si": play(samples, self.half_width_si, state, "rate")}

# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""Noise: white (angle or velocity random walk) and slow (bias instability). IEEE 952, annex C.

Both are stationary from the first sample and do not depend on how a run is cut into chunks.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectState, FloatArray, Stage, Stimulus
from dut_emulator.effects.first_order import first_order
from dut_emulator.effects.parameters import ZERO, Triple, as_tuples, parameter

ALLAN_MAXIMUM_OF_GAUSS_MARKOV = 0.618
"""Largest Allan deviation of a first-order Gauss–Markov process in units of its standard deviation;
it lies at 1.89 correlation times (IEEE 952, eq. C.18: 0.437 q √T with q = σ √(2/T))."""

_SAME_STEP = 1e-6
"""A gap between chunks that differs from the sample period by less than this share of it is none."""

G = TypeVar("G", bound="BiasInstability")


@dataclass(frozen=True)
class StochasticEffect(CatalogueEffect):
    """An effect that draws. In place of a basis it has a statistic: its Allan deviation or its variance."""

    stochastic: ClassVar[bool] = True

    def allan_deviation(self, spans_s: FloatArray, sample_period_s: float) -> FloatArray:
        """(m,) averaging times → (m, 3) expected Allan deviation of the contribution."""
        raise NotImplementedError

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """None: a random contribution has no derivative."""
        return {}


def gauss_markov_allan_deviation(spans: FloatArray) -> FloatArray:
    """Of a first-order Gauss–Markov process of variance 1, spans in correlation times (IEEE 952, C.18)."""
    inner = 1.0 - (3.0 - 4.0 * np.exp(-spans) + np.exp(-2.0 * spans)) / (2.0 * spans)
    return np.sqrt(2.0 / spans * inner)


@dataclass(frozen=True)
class WhiteNoise(StochasticEffect):
    """White noise of constant density N: each sample has the standard deviation N / √period.

    `density_si_per_sqrt_hz`: of a gyro it is the angle random walk in rad/√s (= rad/s/√Hz), of an
    accelerometer the velocity random walk in m/s/√s. Allan deviation N / √τ. N is the output's: a chain
    adds it behind the filter.
    """

    density_si_per_sqrt_hz: Triple = parameter(ZERO, "{density}", (0.0, 0.1), "density N of the white noise")
    word: ClassVar[str] = "white_noise"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Noise that is white up to half the sampling rate."

    def allan_deviation(self, spans_s: FloatArray, sample_period_s: float) -> FloatArray:
        """N / √τ (IEEE 952, annex C), (m, 3)."""
        return np.asarray(self.density_si_per_sqrt_hz) / np.sqrt(spans_s)[:, np.newaxis]

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "WhiteNoise":
        """N = s √Δt."""
        found = np.nanstd(residual, axis=0) * np.sqrt(stimulus.sample_period_s)
        return dataclasses.replace(self, density_si_per_sqrt_hz=as_tuples(found))

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        deviation = np.asarray(self.density_si_per_sqrt_hz) / np.sqrt(stimulus.sample_period_s)
        noise = np.asfortranarray(rng.standard_normal(samples.shape))
        noise *= deviation
        noise += samples
        return noise


@dataclass(frozen=True)
class BiasInstability(StochasticEffect):
    """Slow noise: a first-order Gauss–Markov process of standard deviation σ and correlation time T.

    x_k = φ x_(k−1) + σ √(1 − φ²) w_k with φ = exp(−Δt / T), x_0 drawn from N(0, σ²): stationary at once,
    autocovariance σ² exp(−|τ| / T). The Allan deviation is flat about τ = 1.89 T at 0.618 σ. After a
    pause (no stream) the process has moved on by the pause.
    """

    standard_deviation_si: Triple = parameter(ZERO, "{si}", (0.0, 0.1), "standard deviation σ")
    correlation_time_s: float = parameter(300.0, "s", (1e-3, 1e6), "correlation time T", held=True)
    word: ClassVar[str] = "bias_instability"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "One correlation time; for a flat Allan curve over decades take the flicker form."
    excludes: ClassVar[tuple[str, ...]] = ("flicker_noise",)

    def allan_deviation(self, spans_s: FloatArray, sample_period_s: float) -> FloatArray:
        """IEEE 952, eq. (C.18) with q² = 2σ² / T, (m, 3)."""
        shape = gauss_markov_allan_deviation(spans_s / self.correlation_time_s)
        return shape[:, np.newaxis] * np.asarray(self.standard_deviation_si)

    def guess(self: G, residual: FloatArray, stimulus: Stimulus) -> G:
        """σ from the variance, T from the correlation of neighbours: φ = exp(−Δt / T)."""
        whole = np.isfinite(residual[1:]) & np.isfinite(residual[:-1])
        products = np.where(whole, residual[1:] * residual[:-1], 0.0).sum(axis=0)
        squares = np.where(whole, residual[:-1] ** 2, 0.0).sum(axis=0)
        seen = squares > 0
        phi = float(np.clip((products[seen] / squares[seen]).mean() if seen.any() else 0.0, 1e-9, 1 - 1e-12))
        deviation = np.sqrt(np.nanmean(residual**2, axis=0))
        time_s = -stimulus.sample_period_s / float(np.log(phi))
        return dataclasses.replace(
            self, standard_deviation_si=as_tuples(deviation), correlation_time_s=time_s
        )

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral or len(samples) == 0:
            return samples
        phi = float(np.exp(-stimulus.sample_period_s / self.correlation_time_s))
        drive = np.asfortranarray(rng.standard_normal(samples.shape))
        if state.last is None:
            drive[1:] *= np.sqrt(1.0 - phi * phi)
            memory = np.zeros(3)
        else:
            first = self._phi_over_gap(stimulus, state, phi)
            drive[1:] *= np.sqrt(1.0 - phi * phi)
            drive[0] *= np.sqrt(1.0 - first * first)
            memory = first * state.last
        process = first_order(drive, phi, memory)
        state.last = process[-1].copy()
        state.last_time_s = float(stimulus.time_s[-1])
        process *= np.asarray(self.standard_deviation_si)
        process += samples
        return process

    def _phi_over_gap(self, stimulus: Stimulus, state: EffectState, phi: float) -> float:
        """Correlation of the chunk's first sample with the last one before it."""
        period = stimulus.sample_period_s
        gap = float(stimulus.time_s[0]) - state.last_time_s
        if abs(gap - period) < _SAME_STEP * period:
            return phi  # exactly as inside a chunk, whatever the times' rounding
        return float(np.exp(-max(gap, 0.0) / self.correlation_time_s))

# pyright: strict
# ruff: noqa: ARG002  one signature for every effect: most need only a part of it
"""Noise: white (angle or velocity random walk) and slow (bias instability). IEEE 952, annex C.

Both are stationary from the first sample and do not depend on how a run is cut into chunks.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.deterministic import ZERO, Triple
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.first_order import first_order

ALLAN_MAXIMUM_OF_GAUSS_MARKOV = 0.618
"""Largest Allan deviation of a first-order Gauss–Markov process in units of its standard deviation;
it lies at 1.89 correlation times (IEEE 952, eq. C.18: 0.437 q √T with q = σ √(2/T))."""

_SAME_STEP = 1e-6
"""A gap between chunks that differs from the sample period by less than this share of it is none."""


@dataclass(frozen=True)
class WhiteNoise:
    """White noise of constant density N: each sample has the standard deviation N / √period.

    `density_si_per_sqrt_hz`: of a gyro it is the angle random walk in rad/√s (= rad/s/√Hz), of an
    accelerometer the velocity random walk in m/s/√s. Allan deviation N / √τ.
    """

    sensor: SensorName
    density_si_per_sqrt_hz: Triple = ZERO
    word: ClassVar[str] = "white_noise"
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    @property
    def is_neutral(self) -> bool:
        """No noise."""
        return not any(self.density_si_per_sqrt_hz)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        deviation = np.asarray(self.density_si_per_sqrt_hz) / np.sqrt(stimulus.sample_period_s)
        noise = rng.standard_normal(samples.shape)
        noise *= deviation
        noise += samples
        return noise


@dataclass(frozen=True)
class BiasInstability:
    """Slow noise: a first-order Gauss–Markov process of standard deviation σ and correlation time T.

    x_k = φ x_(k−1) + σ √(1 − φ²) w_k with φ = exp(−Δt / T), x_0 drawn from N(0, σ²): stationary at once,
    autocovariance σ² exp(−|τ| / T). The Allan deviation is flat about τ = 1.89 T at 0.618 σ. After a
    pause (no stream) the process has moved on by the pause.
    """

    sensor: SensorName
    standard_deviation_si: Triple = ZERO
    correlation_time_s: float = 300.0
    word: ClassVar[str] = "bias_instability"
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    @property
    def is_neutral(self) -> bool:
        """No slow noise."""
        return not any(self.standard_deviation_si)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral or len(samples) == 0:
            return samples
        phi = float(np.exp(-stimulus.sample_period_s / self.correlation_time_s))
        drive = rng.standard_normal(samples.shape)
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
        return samples + process * np.asarray(self.standard_deviation_si)

    def _phi_over_gap(self, stimulus: Stimulus, state: EffectState, phi: float) -> float:
        """Correlation of the chunk's first sample with the last one before it."""
        period = stimulus.sample_period_s
        gap = float(stimulus.time_s[0]) - state.last_time_s
        if abs(gap - period) < _SAME_STEP * period:
            return phi  # exactly as inside a chunk, whatever the times' rounding
        return float(np.exp(-max(gap, 0.0) / self.correlation_time_s))

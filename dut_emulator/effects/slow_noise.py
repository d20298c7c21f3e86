# pyright: strict
# ruff: noqa: ARG002, RUF009  one signature for every effect; `parameter` makes a field
"""Noise whose spectrum falls: flicker in the form of IEEE 952, random walk of the rate, multipath."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.first_order import first_order
from dut_emulator.effects.parameters import ZERO, Triple, as_tuples, parameter
from dut_emulator.effects.stochastic import BiasInstability, StochasticEffect, gauss_markov_allan_deviation

RATIO_OF_TIMES = 4.0
"""Of neighbouring Gauss–Markov terms of flicker noise; its spectrum then ripples by less than 1 %."""
DRAWN_AT_ONCE = 512
"""Samples: so much of the terms' noise is turned over inside a processor's cache."""
ALLAN_FLOOR_OF_FLICKER = 0.6643
"""√(2 ln 2 / π): the flat of the Allan deviation over B (IEEE 952, annex C)."""


@dataclass(frozen=True)
class FlickerNoise(StochasticEffect):
    """Bias instability in the form of IEEE 952: S(f) = B² / (2πf), a flat of the Allan deviation at 0.664 B.

    A sum of Gauss–Markov processes with correlation times four apart from the shortest to the longest one,
    each of variance B² ln 4 / π: between 1 / longest and 1 / shortest their (two-sided) spectra add up to
    B² / (2πf). Each begins in its stationary state.
    """

    coefficient_si: Triple = parameter(ZERO, "{si}", (0.0, 0.1), "coefficient B")
    shortest_time_s: float = parameter(0.1, "s", (1e-4, 1e6), "least correlation time", held=True)
    longest_time_s: float = parameter(6553.6, "s", (1e-4, 1e8), "greatest correlation time", held=True)
    word: ClassVar[str] = "flicker_noise"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = (
        "Flat to 1 % from 50 times the shortest to a fifteenth of the longest time; uninterrupted sampling."
    )
    excludes: ClassVar[tuple[str, ...]] = ("bias_instability",)

    def correlation_times_s(self) -> FloatArray:
        """Of the terms."""
        count = 1 + max(0, round(np.log(self.longest_time_s / self.shortest_time_s) / np.log(RATIO_OF_TIMES)))
        return np.asarray(self.shortest_time_s * RATIO_OF_TIMES ** np.arange(count), dtype=np.float64)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral or len(samples) == 0:
            return samples
        times = self.correlation_times_s()
        rows = np.empty((len(times) * 3, len(samples)))
        for begin in range(0, len(samples), DRAWN_AT_ONCE):  # in the order of the samples
            part = rows[:, begin : begin + DRAWN_AT_ONCE]
            part[:] = rng.standard_normal(part.shape[::-1]).T
        total = np.zeros_like(samples)
        for term, time in enumerate(times):
            phi = float(np.exp(-stimulus.sample_period_s / time))
            drive, last = rows[3 * term : 3 * term + 3].T, state.carried.get(f"term {term}")
            drive[0 if last is not None else 1 :] *= np.sqrt(1.0 - phi * phi)
            process = first_order(drive, phi, np.zeros(3) if last is None else phi * last)
            state.carried[f"term {term}"] = process[-1].copy()
            total += process
        deviation = np.sqrt(np.log(RATIO_OF_TIMES) / np.pi) * np.asarray(self.coefficient_si)
        total *= deviation
        total += samples
        return total

    def allan_deviation(self, spans_s: FloatArray, sample_period_s: float) -> FloatArray:
        """Of the sum of terms, (m, 3)."""
        terms = [gauss_markov_allan_deviation(spans_s / time) ** 2 for time in self.correlation_times_s()]
        shape = np.sqrt(np.log(RATIO_OF_TIMES) / np.pi * np.sum(terms, axis=0))
        return shape[:, np.newaxis] * np.asarray(self.coefficient_si)

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "FlickerNoise":
        """B from the Allan deviation at a few spans between the shortest and the longest time."""
        period = stimulus.sample_period_s
        longest = min(self.longest_time_s, len(residual) * period / LEAST_CLUSTERS)
        spans = np.geomspace(self.shortest_time_s, longest, SPANS_OF_A_GUESS)
        counts = np.maximum(np.round(spans / period).astype(int), 1)
        unit = dataclasses.replace(self, coefficient_si=(1.0, 1.0, 1.0))
        expected = unit.allan_deviation(counts * period, period)
        seen = np.stack([allan_deviation_of(residual, int(count)) for count in counts])
        return dataclasses.replace(self, coefficient_si=as_tuples(np.median(seen / expected, axis=0)))


LEAST_CLUSTERS = 30
SPANS_OF_A_GUESS = 7


def allan_deviation_of(values: FloatArray, count: int) -> FloatArray:
    """(3,) Allan deviation of neighbouring means of `count` samples."""
    whole = values[: len(values) // count * count]
    means = whole.reshape(-1, count, values.shape[1]).mean(axis=1)
    return np.sqrt(np.mean(np.diff(means, axis=0) ** 2, axis=0) / 2.0)


@dataclass(frozen=True)
class RateRandomWalk(StochasticEffect):
    """The bias itself walks: b_k = b_(k−1) + K √Δt w_k from 0 at power-on. Allan deviation K √(τ / 3).

    The bias at power-on belongs to `bias`. (IEEE 952, annex C.)
    """

    coefficient_si_per_sqrt_s: Triple = parameter(ZERO, "{si} per sqrt(s)", (0.0, 0.1), "coefficient K")
    word: ClassVar[str] = "rate_random_walk"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    valid: ClassVar[str] = "Runs in which the walk stays small; a pause does not move it on."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro",)

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral or len(samples) == 0:
            return samples
        steps = np.asfortranarray(rng.standard_normal(samples.shape))
        if state.last is None:
            steps[0] = 0.0
        else:
            steps[0] += state.last
        walk = np.cumsum(steps, axis=0)
        state.last = walk[-1].copy()
        scale = np.asarray(self.coefficient_si_per_sqrt_s) * np.sqrt(stimulus.sample_period_s)
        return samples + walk * scale

    def allan_deviation(self, spans_s: FloatArray, sample_period_s: float) -> FloatArray:
        """K √(τ / 3 · (1 + 1 / (2 m²))) for means of m samples, (m, 3); IEEE 952 gives the limit."""
        finite = 1.0 + (sample_period_s / spans_s) ** 2 / 2.0
        return np.sqrt(spans_s / 3.0 * finite)[:, np.newaxis] * np.asarray(self.coefficient_si_per_sqrt_s)

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "RateRandomWalk":
        """K from the steps."""
        steps = np.sqrt(np.nanmean(np.diff(residual, axis=0) ** 2, axis=0))
        found = as_tuples(steps / np.sqrt(stimulus.sample_period_s))
        return dataclasses.replace(self, coefficient_si_per_sqrt_s=found)


@dataclass(frozen=True)
class Multipath(BiasInstability):
    """Reflections move a fix slowly: a first-order Gauss–Markov process of 1 to 5 m over some minutes.

    (P. D. Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, multipath.)
    """

    standard_deviation_si: Triple = parameter(ZERO, "{si}", (0.0, 1e-4), "standard deviation σ")
    correlation_time_s: float = parameter(120.0, "s", (1e-3, 1e6), "correlation time T", held=True)
    word: ClassVar[str] = "multipath"
    origin: ClassVar[str] = "gnss"
    valid: ClassVar[str] = "A receiver at rest or slow; fast ones see it change within seconds."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gnss",)
    excludes: ClassVar[tuple[str, ...]] = ()
    start: ClassVar[dict[str, Any]] = {}

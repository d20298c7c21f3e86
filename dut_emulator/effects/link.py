# pyright: strict
# ruff: noqa: ARG002  one signature for every effect; `parameter` makes a field
"""What a link does to finished samples: jitter of their times, frames lost or sent twice, counters that wrap.

A lost frame is a row of values that are not a number: the hole stays a hole.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectState, FloatArray, Stage, Stimulus
from dut_emulator.effects.parameters import parameter
from dut_emulator.effects.recursions import rate_of_change
from dut_emulator.effects.stochastic import StochasticEffect

ROUNDING = 1e-12
"""Outputs that differ by less than this share are the same."""


@dataclass(frozen=True)
class TimestampJitter(StochasticEffect):
    """Samples are taken a little before or after their stamps: y = u + j u̇, j normal with deviation σ.

    One j for all three axes of a sample. It shows where the input moves, as noise of σ |u̇|.
    """

    deviation_s: float = parameter(0.0, "s", (0.0, 0.1), "standard deviation σ of the stamps")
    word: ClassVar[str] = "timestamp_jitter"
    stage: ClassVar[Stage] = Stage.TRANSPORT
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "σ below one sample period: first order in j."

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        moved = rate_of_change(samples, stimulus, state, "input")
        moved *= self.deviation_s * rng.standard_normal((len(samples), 1))
        moved += samples
        return moved

    def variance(self, stimulus: Stimulus) -> FloatArray:
        """(n, 3): σ² u̇²."""
        slope = rate_of_change(stimulus.true_input(self.sensor), stimulus, EffectState(), "input")
        return (self.deviation_s * slope) ** 2

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "TimestampJitter":
        """σ² = Σ r² / Σ u̇²."""
        expected = _sum_of(dataclasses.replace(self, deviation_s=1.0).variance(stimulus))
        found = float((_sum_of(residual**2) / expected) ** 0.5) if expected else 0.0
        return dataclasses.replace(self, deviation_s=found)


def _sum_of(values: FloatArray) -> float:
    """Sum of what is there."""
    return float(np.sum(values[np.isfinite(values)]))


@dataclass(frozen=True)
class FrameLoss(StochasticEffect):
    """Each frame is lost with probability p, independently of the others; its row has no values."""

    probability: float = parameter(0.0, "1", (0.0, 1.0), "probability p that a frame is lost")
    word: ClassVar[str] = "frame_loss"
    stage: ClassVar[Stage] = Stage.TRANSPORT
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "Single losses; bursts are several effects' work."

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        out = samples.copy(order="K")
        out[rng.random(len(samples)) < self.probability] = np.nan
        return out

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "FrameLoss":
        """The share of rows without values."""
        lost = float(np.isnan(residual[:, 0]).mean()) if len(residual) else 0.0
        return dataclasses.replace(self, probability=lost)


@dataclass(frozen=True)
class DuplicateFrames(StochasticEffect):
    """Each frame is, with probability p, a copy of the one before it; the sample it should bring is lost."""

    probability: float = parameter(0.0, "1", (0.0, 1.0), "probability p that a frame is a copy")
    word: ClassVar[str] = "duplicate_frames"
    stage: ClassVar[Stage] = Stage.TRANSPORT
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "Inputs that change from sample to sample, else a copy cannot be told."

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral or len(samples) == 0:
            return samples
        copied = np.flatnonzero(rng.random(len(samples)) < self.probability)
        out = samples.copy(order="K")
        begins = np.diff(copied, prepend=-2) != 1  # of copies of copies the first knows what they repeat
        sources = copied[begins][np.cumsum(begins) - 1] - 1
        first = samples[0] if state.last is None else state.last
        out[copied] = np.where(sources[:, np.newaxis] < 0, first, samples[sources])
        state.last = out[-1].copy()
        return out

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "DuplicateFrames":
        """The share of samples that repeat the one before although the input moved."""
        inputs = stimulus.true_input(self.sensor)
        outputs, moved = inputs + residual, (np.diff(inputs, axis=0) != 0).any(axis=1)
        same = np.abs(np.diff(outputs, axis=0)).max(axis=1) <= ROUNDING * np.abs(outputs[1:]).max(axis=1)
        found = float((same & moved).sum() / moved.sum()) if moved.any() else 0.0
        return dataclasses.replace(self, probability=found)


@dataclass(frozen=True)
class CounterWrap(CatalogueEffect):
    """A counter of too few bits wraps round: y = ((u + M) mod 2M) − M; M infinite is none.

    A 16-bit word of quanta q has M = 32768 q; values at M and beyond come out with the other sign.
    """

    half_span_si: float = parameter(np.inf, "{si}", (0.0, np.inf), "largest value M that the word holds")
    word: ClassVar[str] = "counter_wrap"
    stage: ClassVar[Stage] = Stage.TRANSPORT
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "Two's complement words."
    start: ClassVar[dict[str, Any]] = {"half_span_si": 1.0}

    @property
    def is_neutral(self) -> bool:
        """A word that holds everything."""
        return bool(np.isinf(self.half_span_si))

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral:
            return samples
        span = 2.0 * self.half_span_si
        return samples - span * np.floor((samples + self.half_span_si) / span)

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """∂y/∂M is −2 for each turn of the counter."""
        samples = stimulus.true_input(self.sensor)
        turns = np.floor((samples + self.half_span_si) / (2.0 * self.half_span_si))
        return {"half_span_si": np.zeros_like(samples) if self.is_neutral else -2.0 * turns}

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "CounterWrap":
        """The least step of the residual is one turn of the counter, 2M."""
        steps = np.abs(residual[np.isfinite(residual)])
        turned = steps[steps > LEAST_TURN_SHARE * steps.max(initial=0.0)]
        found = float(turned.min()) / 2.0 if len(turned) else np.inf
        return dataclasses.replace(self, half_span_si=found)


LEAST_TURN_SHARE = 1e-6
"""A step that is smaller than this share of the largest is rounding and no turn of a counter."""

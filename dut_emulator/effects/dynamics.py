# pyright: strict
# ruff: noqa: ARG002  one signature for every effect; `parameter` makes a field
"""What a sensor or a link does to the time of an input: bandwidth, delays, clocks."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.guessing import fitted, unexplained
from dut_emulator.effects.parameters import parameter
from dut_emulator.effects.recursions import (
    MAX_DELAY_S,
    first_order_lag,
    lag_coefficients,
    recursion,
    straddling,
)

MOMENTS_OF_A_SCAN = 32
"""A moment is looked for at so many places, then again between two of them."""


@dataclass(frozen=True)
class Bandwidth(CatalogueEffect):
    """The output follows with a first-order lag: τ ẏ = u − y; the −3 dB frequency is 1 / (2πτ) (IEEE 528).

    Settled on the first sample, exact for inputs that are linear between samples. τ of 1 to 10 ms in MEMS,
    below 1 ms in fibre-optic gyros; a sine sweep tells it from a delay by the fall of the amplitude.
    """

    time_constant_s: float = parameter(0.0, "s", (0.0, 1e4), "time constant τ")
    remembers: ClassVar[bool] = True
    word: ClassVar[str] = "bandwidth"
    stage: ClassVar[Stage] = Stage.FILTER
    valid: ClassVar[str] = "One pole; the same for the three sensors of a triad."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc")
    start: ClassVar[dict[str, Any]] = {"time_constant_s": 5e-3}

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        return first_order_lag(samples, stimulus.sample_period_s, self.time_constant_s, state, "lag")

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """∂y/∂τ: the recursion's own derivative, s_k = α s_(k−1) + α' y_(k−1) + b0' u_k + b1' u_(k−1)."""
        inputs, period = stimulus.true_input(self.sensor), stimulus.sample_period_s
        before = np.concatenate([inputs[:1], inputs[:-1]])
        tau = self.time_constant_s
        if tau <= 0:
            return {"time_constant_s": (before - inputs) / period}
        alpha, _, _ = lag_coefficients(period, tau)
        outputs = first_order_lag(inputs, period, tau, EffectState(), "lag")
        outputs_before = np.concatenate([inputs[:1], outputs[:-1]])
        # with x = Δt / τ: α' = x α / τ, b0' = −(1 − α − x α) / Δt, and the three add up to nothing
        alpha_slope = alpha * period / tau**2
        b0_slope = (alpha_slope * tau - (1.0 - alpha)) / period
        drive = alpha_slope * outputs_before + b0_slope * inputs - (alpha_slope + b0_slope) * before
        return {"time_constant_s": recursion(drive, (1.0, 0.0), alpha, np.zeros(3), EffectState(), "slope")}


@dataclass(frozen=True)
class ChamberLag(Bandwidth):
    """The unit's temperature follows the chamber's probe with a lag: τ Ṫ = T_probe − T.

    A unit of some 100 g in moving air has a τ of minutes. Acts on what a temperature sensor says.
    """

    word: ClassVar[str] = "chamber_lag"
    stage: ClassVar[Stage] = Stage.MOUNTING
    origin: ClassVar[str] = "stand"
    valid: ClassVar[str] = "One thermal mass; no power of its own."
    sensors: ClassVar[tuple[SensorName, ...]] = ("temperature",)
    start: ClassVar[dict[str, Any]] = {"time_constant_s": 1.0}


@dataclass(frozen=True)
class TimeShift(CatalogueEffect):
    """The base of everything that makes samples late: y(t) = u(t − d(t)), d = Σ_k p_k D_k(t).

    Linear between samples, held before the first one; d up to 2 s.
    """

    remembers: ClassVar[bool] = True
    stage: ClassVar[Stage] = Stage.TRANSPORT
    sensors: ClassVar[tuple[SensorName, ...]] = ("gyro", "acc", "mag")

    def delay_patterns(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """Free parameter → (n,): the delay per unit of it."""
        raise NotImplementedError

    def apply(
        self, samples: FloatArray, stimulus: Stimulus, rng: np.random.Generator, state: EffectState
    ) -> FloatArray:
        """(n, 3) → (n, 3)."""
        if self.is_neutral or len(samples) == 0:
            return samples
        known, left, share, _ = straddling(samples, stimulus, self._delay_s(stimulus), state)
        out = np.empty(samples.shape, order="F")
        for row, shifted in zip(known, out.T, strict=True):
            before = row.take(left)
            np.subtract(row[1:].take(left), before, out=shifted)
            shifted *= share
            shifted += before
        return out

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """−u̇(t − d) D_k."""
        samples = stimulus.true_input(self.sensor)
        delay_s = self._delay_s(stimulus)
        known, left, _, span = straddling(samples, stimulus, delay_s, EffectState())
        slope = np.where(delay_s < MAX_DELAY_S, np.diff(known)[:, left] / span, 0.0).T
        return {
            name: -slope * pattern[:, np.newaxis] for name, pattern in self.delay_patterns(stimulus).items()
        }

    def _delay_s(self, stimulus: Stimulus) -> FloatArray:
        total = np.zeros(len(stimulus.time_s))
        for name, pattern in self.delay_patterns(stimulus).items():
            total = total + float(getattr(self, name)) * pattern
        return total


@dataclass(frozen=True)
class FixedDelay(TimeShift):
    """Every sample is older than its time-stamp says, by the same delay; 0.1 to 20 ms on the links.

    The pure lag of paper 3 is one of 242 or 348 µs.
    """

    delay_s: float = parameter(0.0, "s", (0.0, MAX_DELAY_S), "delay")
    word: ClassVar[str] = "fixed_delay"
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "Up to 2 s; motion that is linear between samples."

    def delay_patterns(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """1 throughout."""
        return {"delay_s": np.ones(len(stimulus.time_s))}


@dataclass(frozen=True)
class ClockDrift(TimeShift):
    """The unit's clock runs fast by a share e: what it stamps t was taken at t − e (t − t_on).

    1 to 100 ppm for crystals. A slow clock (e < 0) is extrapolated along the last slope.
    """

    relative_rate: float = parameter(0.0, "1", (-0.01, 0.01), "how much faster the unit's clock runs")
    word: ClassVar[str] = "clock_drift"
    origin: ClassVar[str] = "link"
    valid: ClassVar[str] = "Until the clocks are 2 s apart; slow clocks only while e t is a few samples."

    def delay_patterns(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """Time since power-on."""
        return {"relative_rate": stimulus.time_s - stimulus.power_on_s}


@dataclass(frozen=True)
class GnssLatency(TimeShift):
    """A fix comes later than it was true, 20 to 200 ms, and is taken for the moment's: y(t) = u(t − L)."""

    latency_s: float = parameter(0.0, "s", (0.0, MAX_DELAY_S), "latency L")
    word: ClassVar[str] = "latency"
    origin: ClassVar[str] = "gnss"
    valid: ClassVar[str] = "Up to 2 s; motion that is linear between samples."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gnss",)

    def delay_patterns(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """1 throughout."""
        return {"latency_s": np.ones(len(stimulus.time_s))}


@dataclass(frozen=True)
class GnssClockStep(TimeShift):
    """From one moment on, fixes are older than their time says: the receiver's clock has jumped.

    Receivers steer their clock in steps of 1 ms; a leap second that is applied late makes 1 s.
    """

    step_s: float = parameter(0.0, "s", (-MAX_DELAY_S, MAX_DELAY_S), "how far the clock jumps ahead")
    at_s: float = parameter(0.0, "s", (-1e9, 1e9), "when, on the stimulus' clock", held=True)
    word: ClassVar[str] = "clock_step"
    origin: ClassVar[str] = "gnss"
    valid: ClassVar[str] = "One step, up to 2 s; a step back is extrapolated along the last slope."
    sensors: ClassVar[tuple[SensorName, ...]] = ("gnss",)

    def guess(self, residual: FloatArray, stimulus: Stimulus) -> "GnssClockStep":
        """The step at each of some moments, then at the samples between the best one's neighbours."""
        times, best = stimulus.time_s, self
        low, high = 0, len(times) - 1
        while high >= low:
            stride = max((high - low) // MOMENTS_OF_A_SCAN, 1)
            trials = [
                fitted(dataclasses.replace(self, at_s=float(times[index])), residual, stimulus)
                for index in range(low, high + 1, stride)
            ]
            best = min(trials, key=lambda trial: unexplained(trial, residual, stimulus))
            if stride == 1:
                break
            at = int(np.searchsorted(times, best.at_s))
            low, high = max(at - stride, 0), min(at + stride, len(times) - 1)
        return best

    def delay_patterns(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """0 before the step, 1 from it on."""
        return {"step_s": (stimulus.time_s >= self.at_s).astype(np.float64)}

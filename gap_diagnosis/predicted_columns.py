# pyright: strict
"""What candidates would add to a unit's outputs under one test, and how far apart that is in its noise."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.dynamics import Bandwidth, TimeShift
from dut_emulator.effects.effect import EffectState, FloatArray, Stimulus, name_of
from dut_emulator.effects.parameters import scalars, with_values
from dut_emulator.effects.stochastic import StochasticEffect, gauss_markov_allan_deviation
from gap_diagnosis.observation import Channel, SensorOutput
from gap_diagnosis.planned_tests import PlannedTest
from protocol.errors import TestloomError

COEFFICIENT_TO_DEVIATION = 0.664 / 0.618
"""Of a Gauss–Markov process whose Allan deviation has its maximum at 0.664 B (IEEE 952)."""
USUAL_CORRELATION_TIME_S = 300.0
NUISANCES = 4
"""1, and the three inputs of the triad: bias and a row of the matrix are recalibrated at every mount."""
BLOCKS = 1024
"""Slow noise is whitened between the means of so many stretches; inside one, noise is white."""
_OF_NO_STAND = ("earth_rate",)
_SHAPE_STEP = 0.02
_DEPENDENT = 1e-9
_SHORT = 1e-3
"""In correlation times: below it the closed form loses its digits."""


@dataclass(frozen=True)
class OutputNoise:
    """Noise of one channel. `range_si`: inputs beyond it are not measured."""

    white_si_per_sqrt_hz: float
    slow_deviation_si: float = 0.0
    slow_correlation_time_s: float = USUAL_CORRELATION_TIME_S
    range_si: float = math.inf

    @staticmethod
    def of(output: SensorOutput) -> "OutputNoise":
        """As an observation believes it; a slow level without a correlation time is IEEE 952's B."""
        belief = output.noise
        slow = belief.slow_deviation_si or COEFFICIENT_TO_DEVIATION * (belief.slow_coefficient_si or 0.0)
        return OutputNoise(
            belief.white_si_per_sqrt_hz or 0.0,
            slow,
            belief.slow_correlation_time_s or USUAL_CORRELATION_TIME_S,
            output.range_si,
        )

    def allan_variance(self, spans_s: FloatArray) -> FloatArray:
        """(m,) at averaging times."""
        spans = spans_s / self.slow_correlation_time_s
        markov = gauss_markov_allan_deviation(np.maximum(spans, _SHORT)) ** 2
        markov *= np.minimum(spans / _SHORT, 1.0)  # a random walk there: its variance grows with the span
        return self.white_si_per_sqrt_hz**2 / spans_s + self.slow_deviation_si**2 * markov


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects that may be the cause, with fitted parameters; none: no effect.

    `standard_uncertainties`: for each effect, scalar → standard uncertainty; a scalar without one is free.
    """

    effects: tuple[CatalogueEffect, ...]
    probability: float
    standard_uncertainties: tuple[Mapping[str, float], ...] = ()

    @property
    def name(self) -> str:
        """'gyro.g_sensitivity + stand.wobble'; '' for no effect."""
        return " + ".join(dict.fromkeys(name_of(effect) for effect in self.effects))

    def known(self) -> tuple[tuple[CatalogueEffect, Mapping[str, float]], ...]:
        """Each effect with the standard uncertainties of its scalars."""
        given = self.standard_uncertainties
        nothing: Mapping[str, float] = {}
        return tuple(
            (effect, given[index] if index < len(given) else nothing)
            for index, effect in enumerate(self.effects)
        )

    @property
    def acts_in_milliseconds(self) -> bool:
        """Whether it is told by what happens between two samples."""
        return any(isinstance(effect, Bandwidth | TimeShift) for effect in self.effects)


class PredictedColumns:
    """What effects add under one test, (n, 3) of one triad each, by number.

    Args:
        stimulus: what acts in the test, (n,) uniform.
        elsewhere: the test is on another kind of stand than the data were: its errors stay behind.
    """

    def __init__(self, stimulus: Stimulus, *, elsewhere: bool) -> None:
        self._stimulus, self._elsewhere = stimulus, elsewhere
        self._columns: list[tuple[str, FloatArray]] = []
        self._known: dict[tuple[CatalogueEffect, frozenset[str]], tuple[int | None, dict[str, int]]] = {}

    def __len__(self) -> int:
        return len(self._columns)

    def total(self, hypothesis: Hypothesis) -> list[int]:
        """The columns whose sum a hypothesis adds."""
        numbers = (self._of(effect, known)[0] for effect, known in hypothesis.known())
        return [number for number in numbers if number is not None]

    def tangents(self, hypothesis: Hypothesis) -> tuple[list[int], FloatArray]:
        """Columns that a rival may move along, and how precisely it is known how far (1/u², 0: free)."""
        places: list[int] = []
        precision: list[float] = []
        for effect, known in hypothesis.known():
            for name, number in self._of(effect, known)[1].items():
                places.append(number)
                precision.append(known[name] ** -2 if known.get(name, 0.0) > 0 else 0.0)
        return places, np.array(precision)

    def gram(self, channel: Channel, noise: OutputNoise) -> FloatArray:
        """(columns, columns) of one channel after whitening, without what a recalibration takes away."""
        mine = [number for number, (sensor, _) in enumerate(self._columns) if sensor == channel.sensor]
        gram = np.zeros((len(self), len(self)))
        if not mine:
            return gram
        inputs = self._stimulus.true_input(channel.sensor)
        both = np.column_stack(
            [np.ones(len(inputs)), inputs, *(self._columns[number][1][:, channel.axis] for number in mine)]
        )
        both[np.abs(inputs[:, channel.axis]) > noise.range_si] = 0.0
        gram[np.ix_(mine, mine)] = _eliminated(_whitened_gram(both, noise, self._stimulus.sample_period_s))
        return gram

    def _of(self, effect: CatalogueEffect, known: Mapping[str, float]) -> tuple[int | None, dict[str, int]]:
        key = effect, frozenset(known)
        if key not in self._known:
            self._known[key] = self._added(effect, key[1])
        return self._known[key]

    def _added(self, effect: CatalogueEffect, known: frozenset[str]) -> tuple[int | None, dict[str, int]]:
        stays_behind = self._elsewhere and effect.origin == "stand" and effect.word not in _OF_NO_STAND
        if effect.stochastic or stays_behind:
            return None, {}
        try:
            contribution = self._contribution(effect)
            tangents = self._tangents_of(effect, known, contribution)
        except TestloomError:  # this test has no such input: the effect is not excited
            return None, {}
        return self._kept(effect, contribution), {
            name: self._kept(effect, values) for name, values in tangents.items()
        }

    def _tangents_of(
        self, effect: CatalogueEffect, known: frozenset[str], contribution: FloatArray
    ) -> dict[str, FloatArray]:
        """Fitted scalar → its derivative; all free ones if none is fitted; shapes by a small step."""
        fitted = {scalar.name for scalar in scalars(effect, free_only=True) if scalar.value} | known
        columns = {
            name: values
            for name, values in effect.basis(self._stimulus).items()
            if name in fitted or not fitted
        }
        for scalar in scalars(effect):
            if scalar.name not in effect.scanned:
                continue
            step = _SHAPE_STEP * scalar.value
            if step and scalar.low <= scalar.value + step <= scalar.high:
                moved = with_values(effect, {scalar.name: scalar.value + step})
                columns[scalar.name] = (self._contribution(moved) - contribution) / step
        return columns

    def _contribution(self, effect: CatalogueEffect) -> FloatArray:
        inputs = self._stimulus.true_input(effect.sensor)
        idle = np.random.Generator(np.random.SFC64(0))  # nothing that is looked at here draws from it
        return effect.apply(inputs, self._stimulus, idle, EffectState()) - inputs

    def _kept(self, effect: CatalogueEffect, values: FloatArray) -> int:
        self._columns.append((effect.sensor, values))
        return len(self._columns) - 1


def noise_distance(
    test: PlannedTest, one: Hypothesis, other: Hypothesis, noise: Mapping[Channel, OutputNoise]
) -> float:
    """8 times the Bhattacharyya distance of two noises, from their Allan variances at octaves."""
    if not any(effect.stochastic for effect in (*one.effects, *other.effects)):
        return 0.0
    octaves = max(int(math.log2(test.duration_s / test.sample_period_s)), 1)
    spans_s: FloatArray = np.ldexp(test.sample_period_s, np.arange(octaves))
    independent = test.duration_s / (2.0 * spans_s)
    distance = 0.0
    for channel, of_channel in noise.items():
        first, second = (
            of_channel.allan_variance(spans_s)
            + _added_variance(hypothesis.effects, channel, spans_s, test.sample_period_s)
            for hypothesis in (one, other)
        )
        distance += float(independent @ np.log((first + second) / (2.0 * np.sqrt(first * second)))) / 2.0
    return 8.0 * distance


def _added_variance(
    effects: Sequence[CatalogueEffect], channel: Channel, spans_s: FloatArray, period_s: float
) -> FloatArray:
    added = np.zeros(len(spans_s))
    for effect in effects:
        if isinstance(effect, StochasticEffect) and effect.sensor == channel.sensor:
            try:
                added += effect.allan_deviation(spans_s, period_s)[:, channel.axis] ** 2
            except NotImplementedError:  # a noise that follows the motion: left out
                continue
    return added


def _whitened_gram(values: FloatArray, noise: OutputNoise, period_s: float) -> FloatArray:
    """(n, m) → (m, m): means of stretches by Kalman innovations, what differs from them as white noise."""
    length = -(-len(values) // BLOCKS)
    rest = len(values) % length
    whole = values[: len(values) - rest].reshape(-1, length, values.shape[1])
    means = whole.mean(axis=1)
    inside = (whole - means[:, np.newaxis, :]).reshape(-1, values.shape[1])
    white = _innovations(means, noise, length * period_s)
    return white.T @ white + (inside.T @ inside) * (period_s / noise.white_si_per_sqrt_hz**2)


def _innovations(values: FloatArray, noise: OutputNoise, row_s: float) -> FloatArray:
    """Kalman innovations over their standard deviations, begun in the slow noise's stationary state."""
    white = noise.white_si_per_sqrt_hz**2 / row_s
    slow = noise.slow_deviation_si**2
    if slow == 0.0:
        return values / math.sqrt(white)
    phi = math.exp(-row_s / noise.slow_correlation_time_s)
    out = np.empty_like(values)
    state, variance = np.zeros(values.shape[1]), slow
    for row, value in enumerate(values):
        total = variance + white
        innovation = value - state
        out[row] = innovation / math.sqrt(total)
        gain = variance / total
        state = phi * (state + gain * innovation)
        variance = phi * phi * variance * (1.0 - gain) + (1.0 - phi * phi) * slow
    return out


def _eliminated(gram: FloatArray) -> FloatArray:
    """The Gram matrix of the columns when the first ones, the nuisances, are projected out of them."""
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    scaled = gram / np.outer(size, size)
    cross = scaled[:NUISANCES, NUISANCES:]
    values, vectors = np.linalg.eigh(scaled[:NUISANCES, :NUISANCES])
    kept = values > _DEPENDENT
    along = (vectors[:, kept].T @ cross) / np.sqrt(values[kept])[:, np.newaxis]
    left = scaled[NUISANCES:, NUISANCES:] - along.T @ along
    gone = np.diag(left) < _DEPENDENT
    left[gone], left[:, gone] = 0.0, 0.0
    return left * np.outer(size[NUISANCES:], size[NUISANCES:])

# pyright: strict
"""The six sensors of one unit from power-on on, as running integrals of pulses.

Rates come from a chain of effects for each triad. What follows from the stimulus is taken at the nodes of
`PANELS` Simpson panels in each sample period; noise is drawn once a sample period and held over it, so that
its integral has the density of the catalogue's effect whatever the panels. A noise that passes a filter of
the twin is left unfiltered: its integral is the same beyond the filter's time constant.

A counter is the whole part of its integral: what is left of a pulse is carried, so the error of a total
stays below one pulse for ever. A rate about zero lets both counters of an axis tick.
"""

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import ChainState, EffectChain, FloatArray, Stimulus
from dut_emulator.products.pulse_imu.half_waves import half_wave_integrals
from dut_emulator.products.pulse_imu.scale import PULSES_PER_SI, TRIADS
from dut_emulator.seeds import child_seed

PANELS = 2
"""Of a sample period."""
NOMINAL_SUPPLY_V = 12.0
SELF_HEATING_C, SELF_HEATING_TIME_S = 4.0, 600.0
BLOCK = 4096
"""Sample periods that are worked on at once: the nodes of a triad stay in a processor's cache."""

Acting = Callable[[FloatArray], Stimulus]


@dataclasses.dataclass(frozen=True)
class SampleGrid:
    """Sample k is taken at started_s + k period_s."""

    started_s: float
    period_s: float
    power_on_s: float

    def node_times_s(self, first: int, last: int) -> FloatArray:
        """Nodes first … last; 2 PANELS of them make a period."""
        return self.started_s + np.arange(first, last + 1, dtype=np.float64) * (self.period_s / (2 * PANELS))

    def periods_until(self, now_s: float) -> int:
        """How many whole periods are over."""
        return math.floor((now_s - self.started_s) / self.period_s * (1 + 1e-15) + 1e-9)


class PulseSensors:
    """See the module. Calls go forward in time.

    Args:
        effects: triad → effects in the order in which they act.
        grid: when samples are taken.
        seed: of the noise.
    """

    supply_v = NOMINAL_SUPPLY_V

    def __init__(
        self,
        effects: Mapping[str, tuple[CatalogueEffect, ...]],
        grid: SampleGrid,
        seed: np.random.SeedSequence,
    ) -> None:
        self._grid = grid
        self._certain = {
            triad: EffectChain(effect for effect in effects[triad] if not effect.stochastic)
            for triad in TRIADS
        }
        self._random = {
            triad: EffectChain(effect for effect in effects[triad] if effect.stochastic) for triad in TRIADS
        }
        seeds = {triad: child_seed(seed, number) for number, triad in enumerate(TRIADS)}
        self._certain_memory = {triad: self._certain[triad].begin(seeds[triad]) for triad in TRIADS}
        self._random_memory = {triad: self._random[triad].begin(seeds[triad]) for triad in TRIADS}
        self._periods = 0
        self._integrals = np.zeros((6, 2))
        self._last_node: FloatArray | None = None
        self._noise_ahead: FloatArray | None = None

    def advance(self, acting: Acting, periods: int) -> FloatArray:
        """Run this many sample periods: uncut integrals at the end of each, (periods, 6, 2).

        Channels as in `scale.CHANNELS`; positive, then negative.
        """
        blocks = [
            self._block(acting, min(BLOCK, periods - done)) for done in range(0, max(periods, 0), BLOCK)
        ]
        return np.concatenate([np.zeros((0, 6, 2)), *blocks])

    def advance_to(self, acting: Acting, now_s: float) -> None:
        """Run all sample periods that are over at a moment."""
        over = self._grid.periods_until(now_s)
        while self._periods < over:
            self._block(acting, min(BLOCK, over - self._periods))

    def integrals(self, acting: Acting, now_s: float) -> FloatArray:
        """Uncut integrals at a moment in the present sample period or later, (6, 2)."""
        self.advance_to(acting, now_s)
        begin_s = self._grid.started_s + self._periods * self._grid.period_s
        part_s = now_s - begin_s
        if part_s <= 0:
            return self._integrals.copy()
        if self._last_node is None:
            self._last_node = self._rates(acting(np.array([begin_s])), part_s)[0]
        memory = {
            triad: ChainState(copy.deepcopy(state.states), state.generators)  # nothing draws in there
            for triad, state in self._certain_memory.items()
        }
        nodes = self._rates(acting(np.array([begin_s + 0.5 * part_s, now_s])), 0.5 * part_s, memory)
        if self._noise_ahead is None:
            self._noise_ahead = self._noise(1)
        first, middle, last = (node + self._noise_ahead[0] for node in (self._last_node, nodes[0], nodes[1]))
        positive, negative = half_wave_integrals(first, middle, last, part_s)
        return self._integrals + np.stack([positive, negative], axis=-1)

    def _block(self, acting: Acting, periods: int) -> FloatArray:
        steps, grid = 2 * PANELS, self._grid
        begin = self._periods * steps
        starts = 0 if self._last_node is None else 1
        stimulus = acting(grid.node_times_s(begin + starts, begin + periods * steps))
        rates = self._rates(stimulus, grid.period_s / steps)
        if self._last_node is not None:
            rates = np.concatenate([self._last_node[np.newaxis], rates])
        noise = self._noise(periods)
        added = np.zeros((periods, 6, 2))
        for panel in range(PANELS):  # one after the other: the sum rounds alike however it is cut
            nodes = [rates[2 * panel + node :: steps][:periods] + noise for node in range(3)]
            positive, negative = half_wave_integrals(*nodes, panel_s=grid.period_s / PANELS)
            added[..., 0] += positive
            added[..., 1] += negative
        integrals = np.cumsum(np.concatenate([self._integrals[np.newaxis], added]), axis=0)[1:]
        self._integrals, self._last_node = integrals[-1].copy(), rates[-1].copy()
        self._periods += periods
        return integrals

    def _rates(
        self, stimulus: Stimulus, step_s: float, memory: Mapping[str, ChainState] | None = None
    ) -> FloatArray:
        """(n, 6) pulses per second without noise."""
        heat = -SELF_HEATING_C * np.expm1(
            -np.maximum(stimulus.time_s - self._grid.power_on_s, 0.0) / SELF_HEATING_TIME_S
        )
        seen = dataclasses.replace(
            stimulus,
            temperature_c=stimulus.temperature_c + heat,
            sample_period_s=step_s,
            supply_v=np.full(len(stimulus.time_s), self.supply_v),
            power_on_s=self._grid.power_on_s,
        )
        states = memory or self._certain_memory
        return np.concatenate(
            [
                self._certain[triad].apply(stimulus.true_input(triad), seen, states[triad])
                * PULSES_PER_SI[triad]
                for triad in TRIADS
            ],
            axis=1,
        )

    def _noise(self, periods: int) -> FloatArray:
        """(periods, 6) pulses per second, held over each period; one that was drawn ahead comes first."""
        ahead, self._noise_ahead = self._noise_ahead, None
        drawn = np.zeros((0, 6)) if ahead is None else ahead
        begin, end = self._periods + len(drawn), self._periods + periods
        if begin == end:
            return drawn
        times_s = self._grid.started_s + np.arange(begin + 1, end + 1, dtype=np.float64) * self._grid.period_s
        nothing = np.zeros((end - begin, 3))
        when = Stimulus(times_s, nothing[:, 0], self._grid.period_s)  # noise asks for no temperature
        fresh = [
            self._random[triad].apply(nothing, when, self._random_memory[triad]) * PULSES_PER_SI[triad]
            for triad in TRIADS
        ]
        return np.concatenate([drawn, np.concatenate(fresh, axis=1)])


def whole_pulses(integrals: FloatArray) -> NDArray[np.int64]:
    """What counters show, same shape."""
    return np.floor(integrals).astype(np.int64)

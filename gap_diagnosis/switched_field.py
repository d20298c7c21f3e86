# pyright: strict
# ruff: noqa: ARG002, RUF009  an effect's one signature, and its declared parameters
"""A hard iron that is there for a part of a recording: a magnet brought near and taken away.

Its offset stays with the unit while the unit turns, from one instant to another. The instants are looked for
on a grid over means of a second, then between them; offset and share of the gap are the search's to fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import EffectState, FloatArray, SensorName, Stage, Stimulus
from dut_emulator.effects.parameters import Triple, parameter
from gap_diagnosis.candidates import Trial
from gap_diagnosis.observation import Observation

NAME = "mag.hard_iron"
MEAN_OVER_S = 1.0
MAX_EDGES = 90
FINER_S = 0.1
LEAST_BLOCKS = 30
LEAST_LOG_RATIO = 60.0
"""Of the best pair of instants: far beyond what the best of all pairs reaches on noise."""
LEAST_SHARE = 0.7
"""Of what bias and matrix leave: a field that changes with place makes steps too, beside much else."""
LONGEST_S = 1e9


@dataclass(frozen=True)
class SwitchedHardIron(LinearEffect):
    """y = B + h from `begins_s` to `ends_s` of the observation's time; outside y = B."""

    field_t: Triple = parameter((0.0, 0.0, 0.0), "T", (-1e-3, 1e-3), "field of the unit while it is there")
    begins_s: float = parameter(0.0, "s", (-LONGEST_S, LONGEST_S), "when it came", held=True)
    ends_s: float = parameter(0.0, "s", (-LONGEST_S, LONGEST_S), "when it went", held=True)
    word: ClassVar[str] = "hard_iron"
    stage: ClassVar[Stage] = Stage.TRANSDUCER
    sensors: ClassVar[tuple[SensorName, ...]] = ("mag",)

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        there = (stimulus.time_s >= self.begins_s) & (stimulus.time_s < self.ends_s)
        return {"field_t": there.astype(np.float64)[:, np.newaxis]}


def switched_trials(
    observations: Sequence[Observation], without: frozenset[str] = frozenset()
) -> list[Trial]:
    """The two instants that explain most of one recording's field, if they explain far more than chance."""
    found: list[Trial] = []
    if NAME not in without and len(observations) == 1 and "mag" in observations[0].outputs:
        instants = switched_between(observations[0])
        if instants is not None:
            effect = SwitchedHardIron("mag", begins_s=instants[0], ends_s=instants[1])
            found.append(Trial(NAME, (effect,)))
    return found


def switched_between(observation: Observation) -> tuple[float, float] | None:
    """The instants between which the field is another, on the observation's time; None: it is not."""
    means = _means(observation)
    if means is None:
        return None
    time_s, residual, nuisances = means
    if len(time_s) < LEAST_BLOCKS:
        return None
    places: FloatArray = np.linspace(float(time_s[0]), float(time_s[-1]), min(MAX_EDGES, len(time_s)))
    begins, ends = _pairs(places, np.append(places, time_s[-1] + MEAN_OVER_S))
    some = ends - begins > 3.0 * MEAN_OVER_S
    gain, total = _gains(time_s, residual, nuisances, begins[some], ends[some])
    best = int(np.argmax(gain))
    explained = float(gain[best] / total)
    ratio = -0.5 * residual.size * float(np.log1p(-min(explained, 1.0 - 1e-12)))
    if ratio < LEAST_LOG_RATIO or explained < LEAST_SHARE:
        return None
    near = np.arange(-2.0, 2.0 + FINER_S / 2, FINER_S) * float(places[1] - places[0])
    finer_begins, finer_ends = _pairs(begins[some][best] + near, ends[some][best] + near)
    gain, _ = _gains(time_s, residual, nuisances, finer_begins, finer_ends)
    chosen = int(np.argmax(gain))
    return float(finer_begins[chosen]), float(finer_ends[chosen])


def _pairs(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each of the one with each of the other."""
    return np.repeat(one, len(other)), np.tile(other, len(one))


def _means(observation: Observation) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """(b,) times, (b, 3) residual and (b, 4) nuisances, averaged inside blocks that have enough rows."""
    output = observation.outputs["mag"]
    stimulus = observation.stimulus
    if stimulus.field_t is None:
        return None
    use = observation.usable & np.isfinite(output.residual_si).all(axis=1)
    use &= np.isfinite(stimulus.field_t).all(axis=1)
    if not use.any():
        return None
    number = np.floor((stimulus.time_s[use] - stimulus.time_s[use][0]) / MEAN_OVER_S).astype(np.int64)
    count = np.bincount(number)
    full = count > 0.5 * count.max()

    def mean(values: FloatArray) -> FloatArray:
        return np.bincount(number, weights=values)[full] / count[full]

    residual = np.stack([mean(output.residual_si[use, axis]) for axis in range(3)], axis=1)
    field = [mean(stimulus.field_t[use, axis]) for axis in range(3)]
    return mean(stimulus.time_s[use]), residual, np.stack([np.ones(int(full.sum())), *field], axis=1)


def _gains(
    time_s: FloatArray, residual: FloatArray, nuisances: FloatArray, begins: FloatArray, ends: FloatArray
) -> tuple[FloatArray, float]:
    """(pairs,) sum of squares that a step explains beside bias and matrix, and what these leave."""
    basis, _ = np.linalg.qr(nuisances / np.abs(nuisances).max(axis=0))
    left = residual - basis @ (basis.T @ residual)
    steps = ((time_s[:, np.newaxis] >= begins) & (time_s[:, np.newaxis] < ends)).astype(np.float64)
    steps -= basis @ (basis.T @ steps)
    size = np.sum(steps**2, axis=0)
    gained = np.sum((left.T @ steps) ** 2, axis=0)
    seen = size > 0.5
    return np.where(seen, gained / np.where(seen, size, 1.0), 0.0), float(np.sum(left**2))

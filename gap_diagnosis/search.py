"""Which effects explain the residual: every single one, then pairs and triples on top of the best.

An effect has trials (its shapes) and a trial has blocks (its channels). Blocks take part or not, all
subsets alike; shapes are alike; so an effect's ln B is a mean over both. One effect, whichever, has prior
odds of 3 against none; each further one the prior 0.2 / effects; something that is not listed takes 0.03 of
either. A set is built by adding effects to the best smaller ones, whose own columns are then projected out:
each addition is a search for a single effect in what is left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.candidates import is_neighbour
from gap_diagnosis.design import NUISANCES, Block, Design
from gap_diagnosis.evidence import (
    STEPS_OF_DATA,
    STEPS_OF_NULLS,
    gains,
    log_bayes_factor,
    log_mean_exp,
    log_sum_exp,
)
from gap_diagnosis.observation import Channel
from gap_diagnosis.unlisted import UNLISTED
from gap_diagnosis.whitened import ChannelSystem

MAX_EFFECTS = 3
ODDS_OF_A_GAP = 3.0
"""Prior odds of some effect against none: who asks for a diagnosis has a reason."""
EXPECTED_EFFECTS = 0.2
"""Prior number of effects beyond the first."""
UNLISTED_SHARE = 0.03
"""Prior share of gaps, or of what is left of one, that follow a variable as no listed effect does."""
INEXACT = 5e-3
"""How far a regressor is off the truth (interpolation, second orders): what is left of a very clear effect
must not look like another one, so an addition has to gain more than this share squared of what is there."""
BEAM = 6
"""So many of the best sets of one size are added to."""
WORTH_ADDING = -4.0
"""A set whose ln B is by so much below that of the best smaller one is not grown."""
PROJECTION_RIDGE = 1e-9


@dataclass(frozen=True)
class SlowExcess:
    """Slow noise beyond the belief, as a cause: its levels take the place of the believed ones."""

    name: str
    channels: frozenset[Channel]
    shapes: tuple[int, ...]


@dataclass(frozen=True)
class Cause:
    """One effect in one shape on some channels.

    Attributes:
        name: in the catalogue.
        trial: index; −1 for noise.
        blocks: indices of those that take part; noise has none.
        channels: that it changes.
        shapes: of slow noise, where it is one.
    """

    name: str
    trial: int
    blocks: tuple[int, ...]
    channels: tuple[Channel, ...]
    shapes: tuple[int, ...] = ()


@dataclass(frozen=True)
class CauseSet:
    """Effects that act together.

    Attributes:
        causes: in the order in which they were added; none: no effect.
        log_bayes_factor: against no effect, all shapes and channels of the last one averaged.
    """

    causes: tuple[Cause, ...]
    log_bayes_factor: float

    @property
    def names(self) -> tuple[str, ...]:
        """Sorted."""
        return tuple(sorted(cause.name for cause in self.causes))


@dataclass(frozen=True)
class Scan:
    """Every effect alone, on some systems.

    Attributes:
        log_bayes_factor: name → (j,).
        of_trial: (trials, j), minus infinity without blocks.
        best: name → its best shape and channels for the data.
    """

    log_bayes_factor: Mapping[str, FloatArray]
    of_trial: FloatArray
    best: Mapping[str, Cause]


def scan(
    systems: Mapping[Channel, ChannelSystem],
    design: Design,
    *,
    data_only: bool,
    without: frozenset[str] = frozenset(),
) -> Scan:
    """ln B of every effect alone. `data_only`: column 0 and more steps; else all columns."""
    blocks = design.blocks
    chosen = [i for i, block in enumerate(blocks) if design.trials[block.trial].name not in without]
    columns, steps = (slice(0, 1), STEPS_OF_DATA) if data_only else (slice(None), STEPS_OF_NULLS)
    count = 1 if data_only else next(iter(systems.values())).cross.shape[-1]
    of_block = np.full((len(blocks), count), -np.inf)
    for group in gains(systems, blocks, chosen, columns, steps):
        of_block[list(group.blocks)] = log_bayes_factor(group.gain, group.amplitude.shape[-1])
    of_trial = np.full((len(design.trials), count), -np.inf)
    members: dict[int, list[int]] = {}
    for index in chosen:
        members.setdefault(blocks[index].trial, []).append(index)
    for trial, mine in members.items():
        of_trial[trial] = _any_of(of_block[mine])
    names: dict[str, list[int]] = {}
    for trial in members:
        names.setdefault(design.trials[trial].name, []).append(trial)
    found = {name: log_mean_exp(of_trial[mine], 0) for name, mine in names.items()}
    best: dict[str, Cause] = {}
    for name, mine in names.items():
        trial = mine[int(np.argmax(of_trial[mine, 0]))]
        best[name] = _cause(name, trial, members[trial], of_block[:, 0], blocks)
    return Scan(found, of_trial, best)


def _any_of(each: FloatArray) -> FloatArray:
    """ln of the mean of Π B over all subsets of blocks but the empty one: (b, j) → (j,)."""
    together = np.sum(np.logaddexp(0.0, each), axis=0)
    subsets = 2.0 ** len(each) - 1.0
    return together + np.log1p(-np.exp(-np.maximum(together, 1e-12))) - np.log(subsets)


def _cause(
    name: str, trial: int, members: Sequence[int], of_block: FloatArray, blocks: Sequence[Block]
) -> Cause:
    acting = [i for i in members if of_block[i] > 0.0] or [max(members, key=lambda i: float(of_block[i]))]
    channels = sorted({c for i in acting for c in blocks[i].columns}, key=lambda c: c.name)
    return Cause(name, trial, tuple(acting), tuple(channels))


def projected(
    systems: Mapping[Channel, ChannelSystem], design: Design, cause: Cause
) -> dict[Channel, ChannelSystem]:
    """The systems with a cause's columns summed over; a noise puts its levels in place of the believed.

    The neighbouring shapes of the cause's grid go with it: else what lies between two of them would look like
    another effect.
    """
    changed = dict(systems)
    if cause.trial < 0:
        for channel in cause.channels:
            changed[channel] = beyond_belief(systems[channel], cause.shapes)
        return changed
    for channel in cause.channels:
        place = sorted(
            {
                int(i) - NUISANCES
                for b in _with_neighbours(design, cause)
                for i in design.blocks[b].columns.get(channel, np.array([], dtype=np.int64))
                if i >= 0
            }
        )
        changed[channel] = _without_columns(systems[channel], place)
    return changed


def _with_neighbours(design: Design, cause: Cause) -> list[int]:
    """The cause's blocks, and those of the same scalars in the trials beside its own."""
    trial = design.trials[cause.trial]
    beside = [
        other
        for other in (cause.trial - 1, cause.trial + 1)
        if 0 <= other < len(design.trials) and is_neighbour(trial, design.trials[other])
    ]
    mine = {(tuple(design.blocks[b].columns), design.blocks[b].scalars) for b in cause.blocks}
    near = [
        number
        for number, block in enumerate(design.blocks)
        if block.trial in beside and (tuple(block.columns), block.scalars) in mine
    ]
    return [*cause.blocks, *near]


def beyond_belief(system: ChannelSystem, shapes: Sequence[int]) -> ChannelSystem:
    """The levels above the believed ones, of some shapes, take their place."""
    kept = _beyond(system, shapes)
    return ChannelSystem(
        system.gram[kept],
        system.cross[kept],
        system.log_likelihood[kept],
        system.log_weight[kept] - log_sum_exp(system.log_weight[kept], 0),
        len(kept),
        system.shape[kept],
    )


def _beyond(system: ChannelSystem, shapes: Sequence[int]) -> NDArray[np.int64]:
    numbers = np.arange(len(system.log_weight))
    return np.flatnonzero((numbers >= system.believed) & np.isin(system.shape, shapes))


def _without_columns(system: ChannelSystem, place: Sequence[int]) -> ChannelSystem:
    rows = system.gram[:, place]
    head = rows[:, :, place]
    diagonal = np.einsum("hkk->hk", head)
    head = head + (PROJECTION_RIDGE * diagonal + 1e-12)[:, :, np.newaxis] * np.eye(len(place))
    solved = np.linalg.solve(head, rows)
    solved_cross = np.linalg.solve(head, system.cross[:, place])
    across = np.swapaxes(rows, 1, 2)
    gram, cross = across @ solved, across @ solved_cross  # in their own place: they are large
    np.subtract(system.gram, gram, out=gram)
    np.subtract(system.cross, cross, out=cross)
    gram[:, place] = 0.0
    gram[:, :, place] = 0.0
    cross[:, place] = 0.0
    gain = 0.5 * np.sum(system.cross[:, place] * solved_cross, axis=1)
    return ChannelSystem(
        gram, cross, system.log_likelihood + gain, system.log_weight, system.believed, system.shape
    )


@dataclass(frozen=True)
class Search:
    """All sets that were weighed.

    Attributes:
        sets: most probable first, the empty one among them.
        probability: of each.
        single: name → ln B alone.
        effects: how many names took part.
    """

    sets: tuple[CauseSet, ...]
    probability: FloatArray
    single: Mapping[str, float]
    effects: int


def search(
    systems: Mapping[Channel, ChannelSystem],
    design: Design,
    noises: Sequence[SlowExcess],
    *,
    largest: int = MAX_EFFECTS,
) -> Search:
    """Singles over the whole catalogue, then pairs and triples by a beam. Data only."""
    start = CauseSet((), 0.0)
    found: dict[tuple[str, ...], CauseSet] = {(): start}
    grown = [start]
    single: dict[str, float] = {}
    for size in range(1, largest + 1):
        added: dict[tuple[str, ...], CauseSet] = {}
        for base in grown:
            left = dict(systems)
            for cause in base.causes:
                left = projected(left, design, cause)
            for one in _additions(left, design, noises, base):
                if size == 1:
                    single[one.names[0]] = one.log_bayes_factor
                known = added.get(one.names)
                if known is None or one.log_bayes_factor > known.log_bayes_factor:
                    added[one.names] = one
        found |= added
        ranked = sorted(added.values(), key=lambda one: -one.log_bayes_factor)
        if not ranked:
            break
        best_smaller = max(one.log_bayes_factor for one in grown)
        listed = [one for one in ranked if UNLISTED not in one.names][:BEAM]
        grown = [one for one in listed if one.log_bayes_factor > best_smaller + WORTH_ADDING]
        if not grown:
            break
    names = len(single.keys() - {UNLISTED})
    sets = list(found.values())
    score = np.array([one.log_bayes_factor + _log_prior(one.names, names) for one in sets])
    probability = np.exp(score - log_sum_exp(score, 0))
    order = np.argsort(-probability, kind="stable")
    return Search(tuple(sets[i] for i in order), probability[order], single, names)


def _log_prior(members: Sequence[str], names: int) -> float:
    """Of a set out of `names` effects and something that is not listed, but for a constant."""
    if not members:
        return 0.0
    unlisted = members.count(UNLISTED)
    listed = len(members) - unlisted
    share = listed * np.log((1.0 - UNLISTED_SHARE) / max(names, 1)) + unlisted * np.log(UNLISTED_SHARE)
    return np.log(ODDS_OF_A_GAP) + share + (len(members) - 1) * np.log(EXPECTED_EFFECTS)


def _additions(
    left: Mapping[Channel, ChannelSystem], design: Design, noises: Sequence[SlowExcess], base: CauseSet
) -> list[CauseSet]:
    held = set(base.names)
    alone = scan(left, design, data_only=True, without=frozenset(held))
    base_gain = base.log_bayes_factor - INEXACT**2 * max(base.log_bayes_factor, 0.0)
    found = [
        CauseSet((*base.causes, alone.best[name]), base_gain + float(value[0]))
        for name, value in alone.log_bayes_factor.items()
    ]
    excessive = {channel for cause in base.causes if cause.trial < 0 for channel in cause.channels}
    for noise in noises:
        there = sorted(noise.channels & left.keys() - excessive, key=lambda channel: channel.name)
        if noise.name in held or not there:
            continue
        each = np.array([[excess_of(left[channel], noise.shapes)] for channel in there])
        acting = [c for c, value in zip(there, each[:, 0], strict=True) if value > 0.0]
        chosen = acting or [there[int(np.argmax(each[:, 0]))]]
        cause = Cause(noise.name, -1, (), tuple(chosen), noise.shapes)
        found.append(CauseSet((*base.causes, cause), base.log_bayes_factor + float(_any_of(each)[0])))
    return found


def excess_of(system: ChannelSystem, shapes: Sequence[int]) -> float:
    """ln of how much likelier levels beyond the belief, of some shapes, are than the believed ones."""
    kept = _beyond(system, shapes)
    if not len(kept):
        return -np.inf
    weighted = system.log_likelihood[:, 0] + system.log_weight
    believed = float(log_sum_exp(weighted[: system.believed], 0))
    return float(log_sum_exp(weighted[kept], 0) - log_sum_exp(system.log_weight[kept], 0)) - believed

# pyright: strict
"""What the weighed sets come to: probabilities of effects, and which effects the test cannot tell apart."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES, Block, Design
from gap_diagnosis.fitting import JointFit
from gap_diagnosis.observation import Channel
from gap_diagnosis.search import CauseSet, Search
from gap_diagnosis.whitened import ChannelSystem

Indices = NDArray[np.int64]

CONFUSABLE_LOG_BAYES = 3.0
"""Two effects whose expected ln B = ½ d² (1 − ρ²) is below this cannot be told apart (gap report, step 5)."""
MOSTLY = 0.5
"""Share of an effect's whitened signal that a look-alike explains at least."""
SETS_KEPT = 40
COVERED = 0.95


@dataclass(frozen=True)
class Attribution:
    """The outcome of the search.

    Attributes:
        best: the most probable set with an effect in it; None where no effect was weighed.
        probability: of `best` among all sets.
        inclusion: name → probability that it is part of the cause.
        confusable: name of each effect of `best` → others that the test cannot tell from it.
        class_probability: of all sets that are `best` but for confusable effects.
        sets: the most probable ones with their probabilities, up to 95 % and at least one.
    """

    best: CauseSet | None
    probability: float
    inclusion: Mapping[str, float]
    confusable: Mapping[str, tuple[str, ...]]
    class_probability: float
    sets: tuple[tuple[tuple[str, ...], float], ...]


def attribute(
    search: Search, systems: Mapping[Channel, ChannelSystem], design: Design, fit: JointFit | None
) -> Attribution:
    """Probabilities over sets, and the class of the best one."""
    acting = [(one, float(p)) for one, p in zip(search.sets, search.probability, strict=True) if one.causes]
    if not acting:
        return Attribution(None, 0.0, {}, {}, 0.0, (((), 1.0),))
    best, probability = acting[0]
    inclusion: dict[str, float] = {}
    for one, p in zip(search.sets, search.probability, strict=True):
        for name in one.names:
            inclusion[name] = inclusion.get(name, 0.0) + float(p)
    confusable = _confusable(best, systems, design, fit, _rivals_seen(best, probability, acting))
    in_class = sum(float(p) for one, p in acting if _same_class(one.names, best.names, confusable))
    sets: list[tuple[tuple[str, ...], float]] = []
    covered = 0.0
    for one, p in zip(search.sets[:SETS_KEPT], search.probability, strict=False):
        sets.append((one.names, float(p)))
        covered += float(p)
        if covered >= COVERED:
            break
    return Attribution(best, probability, inclusion, confusable, in_class, tuple(sets))


def _same_class(names: Sequence[str], best: Sequence[str], confusable: Mapping[str, tuple[str, ...]]) -> bool:
    """Each effect of `best` is there, or one that is confusable with it; and nothing else."""
    left = list(names)
    for name in best:
        there = next((other for other in left if other == name), None) or next(
            (other for other in left if other in confusable.get(name, ())), None
        )
        if there is None:
            return False
        left.remove(there)
    return not left


def _rivals_seen(
    best: CauseSet, probability: float, sets: Sequence[tuple[CauseSet, float]]
) -> dict[str, set[str]]:
    """Name of an effect of `best` → others that took its place in sets nearly as probable."""
    found: dict[str, set[str]] = {name: set() for name in best.names}
    for one, p in sets:
        added, missing = set(one.names) - set(best.names), set(best.names) - set(one.names)
        if len(added) == len(missing) == 1 and p > probability * math.exp(-CONFUSABLE_LOG_BAYES):
            found[missing.pop()].add(added.pop())
    return found


def _confusable(
    best: CauseSet,
    systems: Mapping[Channel, ChannelSystem],
    design: Design,
    fit: JointFit | None,
    seen: Mapping[str, set[str]],
) -> dict[str, tuple[str, ...]]:
    """Others that would explain all but ½ d² (1 − ρ²) < 3 of what each effect of the set explains.

    So is one that these data leave within the same odds, if it explains most of the effect.
    """
    found: dict[str, tuple[str, ...]] = {}
    signals = (
        {} if fit is None else {cause.name: d for cause, d in zip(fit.causes, _signals(fit), strict=True)}
    )
    for cause in best.causes:
        if cause.trial < 0:
            found[cause.name] = tuple(
                sorted(n for n in ("gyro.bias_instability", "gyro.rate_random_walk") if n != cause.name)
                if cause.name.startswith("gyro.") and "angle" not in cause.name
                else ()
            )
            continue
        own = [design.blocks[b] for b in cause.blocks]
        explained = _explained(own, design, systems)
        d2 = signals.get(cause.name, 0.0) ** 2
        alike = {
            name
            for name, share in explained.items()
            if name != cause.name
            and (
                0.5 * d2 * (1.0 - share) < CONFUSABLE_LOG_BAYES
                or (share > MOSTLY and name in seen.get(cause.name, ()))
            )
        }
        found[cause.name] = tuple(sorted(alike - set(best.names)))
    return found


def _signals(fit: JointFit) -> list[float]:
    by_cause = [0.0] * len(fit.causes)
    for number, cause in enumerate(fit.causes):
        by_cause[number] = float(np.sqrt(sum(e.signal**2 for e in fit.effects if e.name == cause.name)))
    return by_cause


def _explained(
    own: Sequence[Block], design: Design, systems: Mapping[Channel, ChannelSystem]
) -> dict[str, float]:
    """Name → the largest share of the effect's whitened signal that one of its trials explains, ρ²."""
    signal = _signal_of(own, systems)
    total = sum(float(a @ _gram(systems[c], i, i) @ a) for c, (i, a) in signal.items())
    if total <= 0.0:
        return {}
    by_trial: dict[int, float] = {}
    for block in design.blocks:
        share = 0.0
        k = len(block.scalars)
        gram, cross = np.zeros((k, k)), np.zeros(k)
        for channel, columns in block.columns.items():
            if channel not in systems:
                continue
            held = columns >= 0
            gram[np.ix_(held, held)] += _gram(systems[channel], columns[held], columns[held])
            if channel in signal:
                index, amplitude = signal[channel]
                cross[held] += _gram(systems[channel], columns[held], index) @ amplitude
        gram[np.diag_indices(k)] += 1e-7 * np.diag(gram) + 1e-12
        share = float(cross @ np.linalg.solve(gram, cross))
        by_trial[block.trial] = by_trial.get(block.trial, 0.0) + share
    shares: dict[str, float] = {}
    for trial, share in by_trial.items():
        name = design.trials[trial].name
        shares[name] = max(shares.get(name, 0.0), min(share / total, 1.0))
    return shares


def _signal_of(
    own: Sequence[Block], systems: Mapping[Channel, ChannelSystem]
) -> dict[Channel, tuple[Indices, FloatArray]]:
    """Channel → columns and fitted amplitudes of the blocks, each block by itself."""
    found: dict[Channel, tuple[Indices, FloatArray]] = {}
    for block in own:
        k = len(block.scalars)
        gram, cross = np.zeros((k, k)), np.zeros(k)
        for channel, columns in block.columns.items():
            held = columns >= 0
            system = systems[channel]
            gram[np.ix_(held, held)] += _gram(system, columns[held], columns[held])
            cross[held] += system.cross[_likeliest(system), columns[held] - NUISANCES, 0]
        gram[np.diag_indices(k)] += 1e-7 * np.diag(gram) + 1e-12
        amplitude = np.asarray(np.linalg.solve(gram, cross), dtype=np.float64)
        for channel, columns in block.columns.items():
            held = columns >= 0
            index, a = found.get(channel, (np.zeros(0, dtype=np.int64), np.zeros(0)))
            found[channel] = np.concatenate([index, columns[held]]), np.concatenate([a, amplitude[held]])
    return found


def _likeliest(system: ChannelSystem) -> int:
    use = slice(0, system.believed)
    return int(np.argmax(system.log_likelihood[use, 0] + system.log_weight[use]))


def _gram(system: ChannelSystem, rows: Indices, columns: Indices) -> FloatArray:
    return system.gram[_likeliest(system)][np.ix_(rows - NUISANCES, columns - NUISANCES)]

# pyright: strict
"""What the weighed sets come to: probabilities of effects, and which effects the test cannot tell apart."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES, Design
from gap_diagnosis.evidence import STEPS_OF_DATA, profile
from gap_diagnosis.fitting import JointFit, grams_at, joint_terms, noisy_channels
from gap_diagnosis.observation import Channel
from gap_diagnosis.search import Cause, CauseSet, Search, beyond_belief
from gap_diagnosis.unlisted import UNLISTED, Unlisted
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
        best: the most probable set of effects; None where no effect was weighed.
        probability: of `best` among all sets.
        with_more: probability of `best`, alone or with further causes beside it.
        inclusion: name → probability that it is part of the cause.
        confusable: name of each effect of `best` → others that the test cannot tell from it.
        class_probability: of all sets that are `best` but for confusable effects, alone or with further ones.
        sets: the most probable ones with their probabilities, up to 95 % and at least one. What is missing to
            the whole are sets with something that is not listed.
        left_unlisted: gain Q of the most probable unlisted cause beside `best`, less what chance gives; 0 or
            more.
        unlisted: probability that something is among the causes that the catalogue does not list.
        follows: what that follows on which channels; None where nothing of the kind was weighed.
    """

    best: CauseSet | None
    probability: float
    inclusion: Mapping[str, float]
    confusable: Mapping[str, tuple[str, ...]]
    class_probability: float
    sets: tuple[tuple[tuple[str, ...], float], ...]
    unlisted: float = 0.0
    follows: str | None = None
    with_more: float = 0.0
    left_unlisted: float = 0.0


def attribute(
    search: Search, systems: Mapping[Channel, ChannelSystem], design: Design, fit: JointFit | None
) -> Attribution:
    """Probabilities over sets, and the class of the best one."""
    weighed = [(one, float(p)) for one, p in zip(search.sets, search.probability, strict=True)]
    acting = [(one, p) for one, p in weighed if one.causes and UNLISTED not in one.names]
    if not acting:
        return Attribution(None, 0.0, {}, {}, 0.0, (((), 1.0),))
    best, probability = acting[0]
    inclusion: dict[str, float] = {}
    for one, p in weighed:
        for name in one.names:
            inclusion[name] = inclusion.get(name, 0.0) + p
    unlisted = inclusion.pop(UNLISTED, 0.0)
    confusable = _confusable(best, systems, design, fit, _rivals_seen(best, probability, acting))
    in_class = sum(p for one, p in weighed if _same_class(one.names, best.names, confusable))
    with_more = sum(p for one, p in weighed if set(best.names) <= set(one.names))
    sets: list[tuple[tuple[str, ...], float]] = []
    covered = 0.0
    for one, p in weighed[:SETS_KEPT]:
        covered += p
        if UNLISTED not in one.names:
            sets.append((one.names, p))
        if covered >= COVERED and sets:
            break
    follows = _followed(weighed, design)
    return Attribution(
        best,
        probability,
        inclusion,
        confusable,
        in_class,
        tuple(sets),
        unlisted,
        follows,
        with_more,
        _left_unlisted(best, search),
    )


def _left_unlisted(best: CauseSet, search: Search) -> float:
    """See `Attribution`."""
    more = tuple(sorted((*best.names, UNLISTED)))
    gained = (one.log_bayes_factor - best.log_bayes_factor for one in search.sets if one.names == more)
    return 2.0 * max(0.0, *gained, 0.0)


def _followed(weighed: Sequence[tuple[CauseSet, float]], design: Design) -> str | None:
    """What the most probable unlisted cause follows, and where."""
    causes = (cause for one, _ in weighed for cause in one.causes if cause.name == UNLISTED)
    cause = next(causes, None)
    if cause is None:
        return None
    (form,) = design.trials[cause.trial].effects
    on = ", ".join(channel.name for channel in cause.channels)
    return f"{on} follows {form.description}" if isinstance(form, Unlisted) else None


def _same_class(names: Sequence[str], best: Sequence[str], confusable: Mapping[str, tuple[str, ...]]) -> bool:
    """Each effect of `best` is there, or one that is confusable with it."""
    left = list(names)
    for name in best:
        there = next((other for other in left if other == name), None) or next(
            (other for other in left if other in confusable.get(name, ())), None
        )
        if there is None:
            return False
        left.remove(there)
    return True


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
    grams, of_cause = _signals_of(best.causes, systems, design)
    for cause in best.causes:
        if cause.trial < 0:
            found[cause.name] = tuple(
                sorted(n for n in ("gyro.bias_instability", "gyro.rate_random_walk") if n != cause.name)
                if cause.name.startswith("gyro.") and "angle" not in cause.name
                else ()
            )
            continue
        explained = _explained(of_cause[cause], design, grams)
        d2 = signals.get(cause.name, 0.0) ** 2
        alike = {
            name
            for name, share in explained.items()
            if name not in (cause.name, UNLISTED)
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


_Signal = dict[Channel, tuple[Indices, FloatArray]]
"""Channel → columns, and the amplitudes fitted to them."""


def _signals_of(
    causes: Sequence[Cause], systems: Mapping[Channel, ChannelSystem], design: Design
) -> tuple[dict[Channel, FloatArray], dict[Cause, _Signal]]:
    """XᵀC⁻¹X of each channel at the noise that is likely beside the causes; the signal of each."""
    noisy = noisy_channels(causes)
    seen = {c: beyond_belief(s, noisy[c]) if c in noisy else s for c, s in systems.items()}
    acting = [cause for cause in causes if cause.trial >= 0]
    places, terms = joint_terms(seen, design, acting)
    amplitude = profile(terms, STEPS_OF_DATA)[1][0, 0] if terms else np.zeros(0)
    found: dict[Cause, _Signal] = {cause: {} for cause in acting}
    for (number, block, k), value in zip(places, amplitude, strict=True):
        signal = found[acting[number]]
        for channel, columns in design.blocks[block].columns.items():
            if columns[k] >= 0 and channel in seen:
                index, a = signal.get(channel, (np.zeros(0, dtype=np.int64), np.zeros(0)))
                signal[channel] = np.append(index, columns[k]), np.append(a, value)
    return grams_at(seen, design, acting, amplitude), found


def _explained(signal: _Signal, design: Design, grams: Mapping[Channel, FloatArray]) -> dict[str, float]:
    """Name → the largest share of a whitened signal that one of its trials explains, ρ²."""
    total = sum(float(a @ _part(grams[c], i, i) @ a) for c, (i, a) in signal.items())
    if total <= 0.0:
        return {}
    by_trial: dict[int, float] = {}
    for block in design.blocks:
        k = len(block.scalars)
        gram, cross = np.zeros((k, k)), np.zeros(k)
        for channel, columns in block.columns.items():
            if channel not in grams:
                continue
            held = columns >= 0
            gram[np.ix_(held, held)] += _part(grams[channel], columns[held], columns[held])
            if channel in signal:
                index, amplitude = signal[channel]
                cross[held] += _part(grams[channel], columns[held], index) @ amplitude
        gram[np.diag_indices(k)] += 1e-7 * np.diag(gram) + 1e-12
        share = float(cross @ np.linalg.solve(gram, cross))
        by_trial[block.trial] = by_trial.get(block.trial, 0.0) + share
    shares: dict[str, float] = {}
    for trial, share in by_trial.items():
        name = design.trials[trial].name
        shares[name] = max(shares.get(name, 0.0), min(share / total, 1.0))
    return shares


def _part(gram: FloatArray, rows: Indices, columns: Indices) -> FloatArray:
    return gram[np.ix_(rows - NUISANCES, columns - NUISANCES)]

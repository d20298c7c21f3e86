# pyright: strict
"""Which effects a cohort is searched for: what its units' reports name, each in one shape for all of them."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dut_emulator.effects.catalogue import CATALOGUE
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from gap_diagnosis.candidates import CONSTANT, SEEN_OTHERWISE, Trial
from gap_diagnosis.report_document import NAMES_A_SET, Attribution, ReportDocument
from gap_diagnosis.twin_change import found_effect
from protocol.errors import TestloomError

MOST_EFFECTS = 12
LEAST_PROBABILITY = 0.5


@dataclass(frozen=True)
class _Named:
    """An effect as the unit that shows it best has it."""

    chance: float
    clearness: float
    entries: tuple[Attribution, ...]


def cohort_trials(reports: Mapping[str, ReportDocument]) -> tuple[Trial, ...]:
    """Effects of the reports' first sets, and others that are more likely than not, at most `MOST_EFFECTS`.

    Of effects that reports could not tell apart the one with the larger sum of probabilities is taken; the
    shape (a time constant, an axis) is that of the unit which shows it most clearly.

    Args:
        reports: serial → its report.
    """
    named: dict[str, _Named] = {}
    confused: dict[str, set[str]] = {}
    for report in reports.values():
        by_effect: dict[str, list[Attribution]] = {}
        for entry in report.which:
            by_effect.setdefault(entry.effect, []).append(entry)
        first = report.sets[0].effects if report.sets and report.verdict in NAMES_A_SET else ()
        for effect, entries in by_effect.items():
            chance = max(entry.probability for entry in entries)
            if effect not in first and (chance < LEAST_PROBABILITY or report.verdict == "no_gap"):
                continue
            confused.setdefault(effect, set()).update(*(entry.confusable_with for entry in entries))
            known = named.get(effect)
            clear = max(map(_clearness, entries))
            kept = (
                known
                if known is not None and known.clearness >= clear
                else _Named(0.0, clear, tuple(entries))
            )
            total = chance + (known.chance if known is not None else 0.0)
            named[effect] = dataclasses.replace(kept, chance=total)
    chosen: list[str] = []
    for effect in sorted(named, key=lambda name: (-named[name].chance, name)):
        rivals = confused[effect] | {other for other in chosen if effect in confused[other]}
        if not rivals & set(chosen) and len(chosen) < MOST_EFFECTS:
            chosen.append(effect)
    trials = (_trial(effect, named[effect].entries) for effect in chosen)
    return tuple(trial for trial in trials if trial is not None)


def _clearness(entry: Attribution) -> float:
    over = [
        abs(one.value) / one.standard_uncertainty
        for one in entry.parameters.values()
        if one.standard_uncertainty
    ]
    return max(over, default=0.0)


def _trial(name: str, entries: Sequence[Attribution]) -> Trial | None:
    """On every triad that it can act on; None for noise and what regressors do not show."""
    if name not in CATALOGUE:
        return None
    kind, sensors = CATALOGUE[name]
    if kind.stochastic or kind.word in CONSTANT | SEEN_OTHERWISE:
        return None
    effects: dict[str, CatalogueEffect] = {}
    for entry in entries:
        try:
            effect = found_effect(entry, "cohort").effect
        except TestloomError:  # all its parameters are below their uncertainties there
            continue
        effects[effect.sensor] = effect
    if not effects:
        return None
    model = next(iter(effects.values()))
    common = kind.origin in {"stand", "link"}
    every = tuple(
        effects.get(sensor) or dataclasses.replace(model, sensor=sensor)
        for sensor in sensors
        if common or sensor in effects
    )
    return Trial(name, every, tied=common and len(every) > 1)

# pyright: strict
"""From what a diagnosis found to the next test: its most probable sets, fitted, and the believed noise."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.parameters import with_values
from dut_emulator.products.catalogue import PRODUCTS
from gap_diagnosis.attribution import Attribution
from gap_diagnosis.fitting import FittedEffect, fit_set
from gap_diagnosis.next_test import next_test
from gap_diagnosis.observation import Channel, Observation
from gap_diagnosis.predicted_columns import Hypothesis, OutputNoise
from gap_diagnosis.prepared import Prepared
from gap_diagnosis.report import GapReport
from gap_diagnosis.search import Search

MAX_CANDIDATES = 4
LEAST_CHANCE = 0.005
"""What is less likely is no candidate: no test is chosen for its sake."""


def with_next_test(
    report: GapReport,
    observations: Sequence[Observation],
    prepared: Prepared,
    search: Search,
    attribution: Attribution,
) -> GapReport:
    """The report with its 'next_test'; where there is no gap there is nothing to tell apart."""
    if report.verdict == "no_gap":
        return report
    proposed = proposed_test(observations, prepared, search, attribution)
    return dataclasses.replace(report, document={**report.document, "next_test": proposed})


def proposed_test(
    observations: Sequence[Observation], prepared: Prepared, search: Search, attribution: Attribution
) -> dict[str, Any] | None:
    """'next_test' of report.json; None where there is no second candidate, or no test that helps.

    Args:
        observations: that the diagnosis saw.
        prepared: as searched.
        search: all sets that were weighed, the most probable first.
        attribution: probabilities of sets by the names in them.
    """
    first = observations[0]
    if first.product not in PRODUCTS:
        return None
    candidates: list[Hypothesis] = []
    for names, chance in attribution.sets[:MAX_CANDIDATES]:
        if chance < LEAST_CHANCE:
            continue
        causes = next((one.causes for one in search.sets if one.names == tuple(sorted(names))), None)
        if causes is None:
            continue
        fit = fit_set(observations, prepared, causes) if causes else None
        if causes and fit is None:
            continue
        candidates.append(hypothesis_of(fit.effects if fit is not None else (), chance))
    kinds = {one.stand_kind for one in observations}
    found = next_test(
        first.product, candidates, noise_of(observations), kinds.pop() if len(kinds) == 1 else ""
    )
    return None if found is None else found.as_document()


def hypothesis_of(effects: Sequence[FittedEffect], probability: float) -> Hypothesis:
    """A fitted set as a candidate. What is smaller than its uncertainty was not seen: 0 give or take that."""
    known: list[Mapping[str, float]] = []
    seen: list[CatalogueEffect] = []
    for one in effects:
        known.append({scalar.name: scalar.standard_uncertainty for scalar in one.parameters})
        unseen = {
            scalar.name: 0.0 for scalar in one.parameters if abs(scalar.value) < scalar.standard_uncertainty
        }
        seen.append(with_values(one.effect, unseen))
    return Hypothesis(tuple(seen), probability, tuple(known))


def noise_of(observations: Sequence[Observation]) -> dict[Channel, OutputNoise]:
    """Channels that have samples and a believed white noise."""
    found: dict[Channel, OutputNoise] = {}
    for one in observations:
        for sensor, output in one.outputs.items():
            noise = OutputNoise.of(output)
            for axis in range(3 if sensor != "temperature" else 1):
                seen = bool(np.isfinite(output.residual_si[:, axis]).any())
                if seen and noise.white_si_per_sqrt_hz > 0:
                    found.setdefault(Channel(sensor, axis), noise)
    return found

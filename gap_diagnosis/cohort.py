# pyright: strict
"""Many units on several stands: is a cause the unit's, the lot's, the stand's or the link's?

Every parameter of every effect that was found anywhere is taken from each mount (`mount_estimates`), and what
it varies with is weighed (`variance_parts`). A link's effect that does not go with the unit is the link's.
Levels that these recordings do not tell apart are named as such, with the recording that would.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gap_diagnosis.mount_constants import MountPair, constants_of, mount_pairs
from gap_diagnosis.mount_estimates import MountEstimate, ParameterEstimate
from gap_diagnosis.variance_parts import LEVELS, PRIOR_PRESENT, Level, VarianceParts, variance_parts

ENOUGH, ENOUGH_FOR_NOTHING = 0.95, 0.8
"""No recording excludes an effect far below its noise: to call it absent takes less."""
LINK, NOTHING, NOT_TOLD_APART = "link", "none", "not told apart"
PRIORS: Mapping[str, Mapping[Level, float]] = {
    "stand": {"lot": 0.05, "unit": 0.1, "stand": 0.5, "mount": 0.1},
    "link": {"lot": 0.4, "unit": 0.3, "stand": 0.2, "mount": 0.1},
    "constant": {"lot": 0.2, "unit": 0.5, "stand": 0.2, "mount": 0.3},
}
"""Origin of an effect → probability that a level adds anything; `PRIOR_PRESENT` for all others."""
UNSEEN_UNCERTAINTIES = 3.0
"""What the samples show by themselves, and one mount does not, is nought there to so many uncertainties."""


@dataclass(frozen=True)
class ParameterFindings:
    """One parameter over the cohort: what each mount says, and what it varies with."""

    sensor: str
    name: str
    unit: str
    estimates: tuple[tuple[MountEstimate, float, float], ...]
    units: tuple[str, ...]
    stands: tuple[str, ...]
    parts: VarianceParts


@dataclass(frozen=True)
class EffectFindings:
    """One effect over the cohort.

    Attributes:
        effect: name in the catalogue.
        assigned: 'unit', 'lot', 'stand', 'mount', 'link', 'none' or 'not told apart'.
        between: what is not told apart; else the one assigned.
        probabilities: of each, summing to 1.
        parameters: as they are named in the catalogue.
    """

    effect: str
    assigned: str
    between: tuple[str, ...]
    probabilities: Mapping[str, float]
    parameters: tuple[ParameterFindings, ...]


@dataclass(frozen=True)
class CohortFindings:
    """`effects`: of diagnoses; `constants`: of mounts, which no single unit shows; `pairs` of mounts."""

    mounts: tuple[MountEstimate, ...]
    effects: tuple[EffectFindings, ...]
    constants: tuple[EffectFindings, ...]
    pairs: tuple[MountPair, ...]


def cohort_findings(mounts: Sequence[MountEstimate]) -> CohortFindings:
    """Assign every effect of these mounts."""
    ordered = tuple(sorted(mounts, key=lambda one: (one.serial, one.stand_id, one.mount)))
    told = [(one, one.parameters) for one in ordered]
    constant = [(one, constants_of(one)) for one in ordered]
    return CohortFindings(
        ordered,
        _effects(told, None),
        _effects(constant, PRIORS["constant"]),
        mount_pairs(ordered),
    )


def _effects(
    told: Sequence[tuple[MountEstimate, Sequence[ParameterEstimate]]], prior: Mapping[Level, float] | None
) -> tuple[EffectFindings, ...]:
    by_effect: dict[str, dict[tuple[str, str], list[tuple[MountEstimate, ParameterEstimate]]]] = {}
    for mount, parameters in told:
        for one in parameters:
            by_effect.setdefault(one.effect, {}).setdefault((one.sensor, one.name), []).append((mount, one))
    every = [mount for mount, _ in told]
    found: list[EffectFindings] = []
    for effect, by_parameter in by_effect.items():
        chosen = prior or PRIORS.get(effect.partition(".")[0], PRIOR_PRESENT)
        parameters = tuple(
            _parameter(_filled(estimates, every), chosen) for estimates in by_parameter.values()
        )
        found.append(_assigned(effect, parameters))
    return tuple(sorted(found, key=lambda one: (one.probabilities.get(NOTHING, 0.0), one.effect)))


def _filled(
    estimates: Sequence[tuple[MountEstimate, ParameterEstimate]], every: Sequence[MountEstimate]
) -> list[tuple[MountEstimate, ParameterEstimate]]:
    """With noughts for mounts whose samples do not show what others' show by themselves."""
    first = estimates[0][1]
    if not first.direct:
        return list(estimates)
    typical = float(np.median([one.standard_uncertainty for _, one in estimates])) or abs(first.value) * 0.01
    unseen = ParameterEstimate(
        first.effect, first.sensor, first.name, 0.0, UNSEEN_UNCERTAINTIES * typical, first.unit, direct=True
    )
    seen = {id(mount): one for mount, one in estimates}
    return [(mount, seen.get(id(mount), unseen)) for mount in every]


def _parameter(
    estimates: Sequence[tuple[MountEstimate, ParameterEstimate]], prior: Mapping[Level, float]
) -> ParameterFindings:
    units, unit_codes = _codes([mount.serial for mount, _ in estimates])
    stands, stand_codes = _codes([mount.stand_id for mount, _ in estimates])
    value = np.array([one.value for _, one in estimates])
    uncertainty = np.array([one.standard_uncertainty for _, one in estimates])
    uncertainty = np.maximum(uncertainty, 1e-9 * max(float(np.abs(value).max()), 1e-300))
    first = estimates[0][1]
    return ParameterFindings(
        first.sensor,
        first.name,
        first.unit,
        tuple((m, float(v), float(u)) for (m, _), v, u in zip(estimates, value, uncertainty, strict=True)),
        units,
        stands,
        variance_parts(value, uncertainty, unit_codes, stand_codes, prior),
    )


def _codes(names: Sequence[str]) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    known = {name: code for code, name in enumerate(dict.fromkeys(names))}
    return tuple(known), np.array([known[name] for name in names], dtype=np.int64)


def _assigned(effect: str, parameters: tuple[ParameterFindings, ...]) -> EffectFindings:
    """Parameters count by how clearly they show the effect at all: those at nought say nothing of where from.

    What is nought everywhere in all parameters is 'none'.
    """
    nothing = min(one.parts.nothing for one in parameters)
    clear = np.array([max(one.parts.log_evidence, 0.0) * (1.0 - one.parts.nothing) for one in parameters])
    weights = clear / clear.sum() if clear.sum() > 0.0 else np.full(len(clear), 1.0 / len(clear))
    shares: dict[tuple[str, ...], float] = {}
    for one, weight in zip(parameters, weights, strict=True):
        something = max(1.0 - one.parts.nothing, 1e-300)
        for part in one.parts.parts:
            names = tuple(dict.fromkeys(_named(effect, level) for level in part.levels))
            share = float(weight) * (1.0 - nothing) * part.explains_most / something
            shares[names] = shares.get(names, 0.0) + share
    probabilities = {NOTHING: nothing, NOT_TOLD_APART: 0.0}
    for names, share in shares.items():
        key = names[0] if len(names) == 1 else NOT_TOLD_APART
        probabilities[key] = probabilities.get(key, 0.0) + share
    wanted = {NOTHING: ENOUGH_FOR_NOTHING}
    single = next(
        (k for k, p in probabilities.items() if p >= wanted.get(k, ENOUGH) and k != NOT_TOLD_APART), None
    )
    if single is not None:
        return EffectFindings(effect, single, (single,), probabilities, parameters)
    ranked = sorted([*shares.items(), ((NOTHING,), nothing)], key=lambda item: -item[1])
    between: list[str] = []
    reached = 0.0
    for names, share in ranked:
        if reached >= ENOUGH:
            break
        between += names
        reached += share
    return EffectFindings(effect, NOT_TOLD_APART, tuple(dict.fromkeys(between)), probabilities, parameters)


def _named(effect: str, level: Level) -> str:
    return LINK if effect.startswith("link.") and level != "unit" else level


FURTHER: Mapping[frozenset[str], str] = {
    frozenset({"lot", "stand"}): "Record some of these units on another stand.",
    frozenset({"lot", "unit"}): "Record another unit of the lot on the same stand.",
    frozenset({"unit", "stand"}): "Exchange: record a unit on the stand that another one was recorded on.",
    frozenset({"unit", "mount"}): "Mount one of the units once more on the same stand and record it again.",
    frozenset({"stand", "mount"}): "Mount one of the units once more on the same stand and record it again.",
    frozenset({"lot", "mount"}): "Mount one of the units once more on the same stand and record it again.",
    frozenset({"unit", "link"}): "Record one of the units over another cable, adapter and computer.",
}
LONGER = "Record longer, or with more motion: the effect is barely above the noise."
MORE = "Record more units, each on at least two stands."


def further_recordings(between: Sequence[str]) -> tuple[str, ...]:
    """English: what would tell these apart."""
    if len(between) <= 1:
        return ()
    found: list[str] = [LONGER] if NOTHING in between else []
    named = [one for one in between if one != NOTHING]
    for i, one in enumerate(named):
        found += [FURTHER[key] for other in named[i + 1 :] if (key := frozenset({one, other})) in FURTHER]
    return tuple(dict.fromkeys(found)) or (MORE,)


NOT_THE_STANDS = (
    "An effect of a stand that goes with the unit is the unit's own: see what its report confuses it with."
)
NOT_THE_UNITS = (
    "An effect of a unit that goes with the stand is the stand's: see what its report confuses it with."
)


def remarks(one: EffectFindings) -> tuple[str, ...]:
    """English: what would tell more, and where a level contradicts an effect's name."""
    origin = one.effect.partition(".")[0]
    if origin == "stand" and one.assigned == "unit":
        return (NOT_THE_STANDS,)
    if origin not in ("stand", "link") and one.assigned == "stand":
        return (NOT_THE_UNITS,)
    return further_recordings(one.between)


def document(findings: CohortFindings) -> dict[str, object]:
    """What cohort.json says of effects, constants and mounts, SI and the catalogue's units."""
    return {
        "effects": [_effect_entry(one) for one in findings.effects],
        "mount_constants": [_effect_entry(one) for one in findings.constants],
        "mount_pairs": [one.entry() for one in findings.pairs],
        "mounts": [_mount_entry(one) for one in findings.mounts],
    }


def _effect_entry(one: EffectFindings) -> dict[str, object]:
    return {
        "effect": one.effect,
        "assigned": one.assigned,
        "between": list(one.between),
        "probabilities": dict(one.probabilities),
        "remarks": list(remarks(one)),
        "parameters": [_parameter_entry(parameter) for parameter in one.parameters],
    }


def _parameter_entry(one: ParameterFindings) -> dict[str, object]:
    names: Mapping[Level, Sequence[str]] = {"lot": ("lot",), "unit": one.units, "stand": one.stands}
    return {
        "sensor": one.sensor,
        "name": one.name,
        "unit": one.unit,
        "probability_of_none": one.parts.nothing,
        "parts": [
            {
                "levels": list(part.levels),
                "present": part.present,
                "explains_most": part.explains_most,
                "standard_deviation": part.deviation,
                "interval95": list(part.interval95),
                "mean_square": part.mean_square,
                "members": {
                    names[part.levels[0]][code]: {"value": value, "standard_uncertainty": u}
                    for code, (value, u) in part.members.items()
                },
            }
            for part in one.parts.parts
        ],
        "estimates": [
            {
                "serial": mount.serial,
                "stand": mount.stand_id,
                "mount": mount.mount,
                "value": value,
                "standard_uncertainty": uncertainty,
            }
            for mount, value, uncertainty in one.estimates
        ],
    }


def _mount_entry(one: MountEstimate) -> dict[str, object]:
    return {
        "serial": one.serial,
        "stand": one.stand_id,
        "mount": one.mount,
        "recordings": list(one.recordings),
        "matrices": {
            matrix.sensor: {
                "change": matrix.change.tolist(),
                "standard_uncertainty": [
                    [math.sqrt(max(float(x), 0.0)) for x in row]
                    for row in np.diag(matrix.covariance).reshape(3, 3)
                ],
                "told": matrix.told.tolist(),
            }
            for matrix in one.matrices
        },
    }


__all__ = [
    "LEVELS",
    "CohortFindings",
    "EffectFindings",
    "cohort_findings",
    "document",
    "further_recordings",
    "remarks",
]

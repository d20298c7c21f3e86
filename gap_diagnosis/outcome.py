# pyright: strict
"""From findings to the report's document: verdict, where, which, how far."""

from collections.abc import Mapping, Sequence
from typing import Any

from gap_diagnosis.drawings import drawn
from gap_diagnosis.findings import SIGNIFICANT_P, Findings, NoiseClaim, alike, certain_oddities, noise_claims
from gap_diagnosis.held_out import Shrinkage, shrinkage_of
from gap_diagnosis.jumps import CLEARLY_P
from gap_diagnosis.localisation import Localisation
from gap_diagnosis.observation import Channel
from gap_diagnosis.report import REPORT_FORMAT, GapReport, HeatCell, Verdict
from gap_diagnosis.report_entries import not_used, sets_of, shrinkage_document, which
from gap_diagnosis.report_places import where
from gap_diagnosis.search import INEXACT

REMAINDER_P = 0.002
"""Beyond all nulls: what is left by an effect that is not listed is mostly told by its forms (`unlisted`)."""
NAMED_PROBABILITY = 0.95
CLOSED_SHARE = 0.8
UNLISTED_PROBABILITY = 0.5
"""From here on that something unlisted acts is likelier than not, and is what the report says."""
MAX_ODDITIES = 3
_NAMED = ("attributed", "confusable")


def report_of(found: Findings) -> GapReport:
    """The report."""
    noises = noise_claims(found)
    gap = (
        found.located.p < SIGNIFICANT_P or bool(found.timing) or bool(noises) or bool(certain_oddities(found))
    )
    shrinkage = _shrinkage(found)
    verdict, why = _verdict(found, gap, noises, shrinkage)
    if verdict == "unattributed" and found.oddities:
        seen = list(dict.fromkeys([one.description for one in found.oddities][:MAX_ODDITIES]))
        why = "; ".join([*seen, *([why] if why else [])])
    document: dict[str, Any] = {
        "format": REPORT_FORMAT,
        "verdict": verdict,
        "where": where(found) if gap else [],
        "which": which(found, noises),
        "sets": sets_of(found, noises),
        "class_probability": found.attribution.class_probability if gap else None,
        "shrinkage": shrinkage_document(found, shrinkage) if gap else None,
        "unattributed": {
            "p": None if found.left is None else found.left.p,
            "description": why,
        },
        "next_test": None,
        "product": found.prepared.observations[0].product,
        "not_used": not_used(found),
    }
    heat = tuple(
        HeatCell(c.channel.name, c.variable, c.low, c.high, c.unit, c.sigmas, c.p_adjusted)
        for c in found.located.cells
    )
    effects = tuple(one.effect for one in found.fit.effects) if found.fit and verdict in _NAMED else ()
    series, spectra = drawn(found.prepared, found.fit, _telling_channels(found))
    return GapReport(document, effects, heat, series, spectra, tuple(document["not_used"]))


def _telling_channels(found: Findings) -> tuple[Channel, ...]:
    """Those that the best set changes, the most first; then those with the clearest cells."""
    changed = {
        channel: one.signal for one in (found.fit.effects if found.fit else ()) for channel in one.rms_si
    }
    ordered = sorted(changed, key=lambda channel: -changed[channel])
    clearest = sorted(found.located.cells, key=lambda cell: -abs(cell.sigmas))
    return tuple(dict.fromkeys([*ordered, *(cell.channel for cell in clearest[:2])]))


def _verdict(
    found: Findings, gap: bool, noises: Sequence[NoiseClaim], shrinkage: Shrinkage | None
) -> tuple[Verdict, str | None]:
    """The verdict, and what remains in words where the data do not fit a set."""
    if not gap:
        return "no_gap", None
    if certain_oddities(found):
        return "unattributed", None
    best = found.attribution.best
    if best is None or (found.search.sets and not found.search.sets[0].causes):
        return _without_a_set(found, noises)
    against = _against(found, shrinkage)
    if against is not None:
        return "unattributed", against
    if found.attribution.with_more >= NAMED_PROBABILITY:
        return ("confusable" if any(alike(one) for one in found.timing) else "attributed"), None
    if found.attribution.class_probability >= NAMED_PROBABILITY:
        return "confusable", None
    return "unattributed", _likeliest(found.attribution.inclusion)


def _against(found: Findings, shrinkage: Shrinkage | None) -> str | None:
    """What speaks against the best set, in words: something unlisted, noise that is none, what it leaves."""
    named = found.attribution.best.causes if found.attribution.best is not None else ()
    deterministic = [cause for cause in named if cause.trial >= 0]
    if found.attribution.unlisted > UNLISTED_PROBABILITY:
        return f"{found.attribution.follows} in a way that no effect of the catalogue does"
    if found.rivals:
        rival = found.rivals[0]
        return f"{rival.channel.name} follows {rival.variable} in a way that no effect of the catalogue does"
    if found.jumps and found.jumps[0].p * len(found.jumps) < CLEARLY_P:
        jump = found.jumps[0]
        run = found.prepared.observations[jump.recording].recording_id
        return f"{jump.channel.name} jumps at {jump.at_s:.4g} s of {run}, as noise does not"
    if found.left is not None and found.left.p < REMAINDER_P and not _is_inexactness(found, found.left):
        return _describe(found.left)
    if found.held is not None:
        idle = [cause.name for number, cause in enumerate(deterministic) if not found.held.gains(number)]
        if idle:
            return f"{', '.join(idle)} gains nothing on held-out data"
    if shrinkage is not None and shrinkage.interval_95[1] < CLOSED_SHARE and len(named) == len(deterministic):
        share = 100.0 * shrinkage.fraction_closed
        return f"the best set closes {share:.0f} % of the gap on held-out data"
    return None


def _is_inexactness(found: Findings, left: Localisation) -> bool:
    """Whether all that stands out in what is left is too little of what was taken away to tell.

    An effect that is a thousand times the noise leaves some of it behind: see `INEXACT`.
    """
    taken: dict[Channel, float] = {}
    for one in found.fit.effects if found.fit is not None else ():
        for channel in one.channels:
            taken[channel] = taken.get(channel, 0.0) + one.signal**2
    clear = [cell for cell in left.cells if cell.p_adjusted < REMAINDER_P]
    return (
        bool(clear)
        and all(cell.sigmas**2 <= INEXACT**2 * taken.get(cell.channel, 0.0) for cell in clear)
        and not any(noise.p_adjusted < REMAINDER_P for noise in left.noises)
    )


def _likeliest(inclusion: Mapping[str, float]) -> str:
    """What is known where no set is likely enough: effects that are part of nearly all sets."""
    sure = sorted(name for name, p in inclusion.items() if p >= NAMED_PROBABILITY)
    if not sure:
        return "no set of effects is likely enough"
    return f"{', '.join(sure)} is likely, and what acts beside it is not clear"


def _without_a_set(found: Findings, noises: Sequence[NoiseClaim]) -> tuple[Verdict, str | None]:
    """The verdict where all that is named shows by itself: but for a delay, that moves no cell's mean."""
    if any(alike(finding) for finding in found.timing):
        return "confusable", None
    left = min((cell.p_adjusted for cell in found.located.cells), default=1.0)
    if (noises or found.timing) and left > REMAINDER_P:
        return "attributed", None
    return "unattributed", _describe(found.located)


def _describe(located: Localisation) -> str:
    cells = sorted(located.cells, key=lambda c: c.p_adjusted)[:1]
    noises = sorted(located.noises, key=lambda n: n.p_adjusted)[:1]
    if cells and (not noises or cells[0].p_adjusted <= noises[0].p_adjusted):
        c = cells[0]
        return (
            f"most on {c.channel.name} where {c.variable} is {c.low:.4g} to {c.high:.4g} {c.unit} "
            f"({c.sigmas:+.1f} sigma)"
        )
    if noises:
        n = noises[0]
        return f"{n.kind} noise of {n.channel.name} is {n.ratio:.2g} times what is believed"
    return "no cell stands out"


def _shrinkage(found: Findings) -> Shrinkage | None:
    if found.held is None or not found.held.folds or found.fit is None:
        return None
    return shrinkage_of(found.held, found.attribution.left_unlisted)

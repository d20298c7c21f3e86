# pyright: strict
"""From findings to the report's document: verdict, where, which, how far."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dut_emulator.effects.parameters import scalars
from gap_diagnosis.attribution import Attribution
from gap_diagnosis.drawings import drawn
from gap_diagnosis.fitting import FittedEffect, JointFit
from gap_diagnosis.held_out import HeldOut, Shrinkage, shrinkage_of
from gap_diagnosis.localisation import CellFinding, Localisation
from gap_diagnosis.observation import Channel, Oddity, TimingFinding
from gap_diagnosis.prepared import AXIS_SHARE, Prepared
from gap_diagnosis.regimes import variable_of
from gap_diagnosis.report import REPORT_FORMAT, GapReport, HeatCell, Verdict
from gap_diagnosis.rivals import Rival
from gap_diagnosis.search import EXPECTED_EFFECTS, Search

SIGNIFICANT_P = 0.05
REMAINDER_P = 0.01
NAMED_PROBABILITY = 0.95
CLOSED_SHARE = 0.8
MAX_PLACES, MAX_NAMES = 24, 12
MAX_ODDITIES = 3
LARGEST_FACTOR = 30.0
KIND_OF = {
    **dict.fromkeys(("aliasing", "mains_interference", "saturation"), "deterministic"),
    "quantization": "stochastic",
}
"""Of what the samples show by themselves; the rest is timing."""
FIELD: Mapping[str, tuple[str, float]] = {
    "gyro": ("deg/s", math.pi / 180.0),
    "acc": ("m/s^2", 1.0),
    "mag": ("uT", 1e-6),
    "temperature": ("degC", 1.0),
    "gnss": ("m", 1.0),
}
WHITE_NAMES = {"gyro": "gyro.angle_random_walk", "acc": "acc.velocity_random_walk", "mag": "mag.white_noise"}


@dataclass(frozen=True)
class Findings:
    """All that the steps found; see `diagnosis`."""

    prepared: Prepared
    located: Localisation
    search: Search
    attribution: Attribution
    fit: JointFit | None
    held: HeldOut | None
    left: Localisation | None
    timing: tuple[TimingFinding, ...]
    without: frozenset[str]
    rivals: tuple[Rival, ...] = ()
    oddities: tuple[Oddity, ...] = ()


def report_of(found: Findings) -> GapReport:
    """The report."""
    noises = _noise_claims(found)
    gap = (
        found.located.p < SIGNIFICANT_P
        or bool(found.timing)
        or bool(noises)
        or bool(_certain_oddities(found))
    )
    shrinkage = _shrinkage(found)
    verdict, why = _verdict(found, gap, noises, shrinkage)
    if verdict == "unattributed" and found.oddities:
        seen = list(dict.fromkeys([one.description for one in found.oddities][:MAX_ODDITIES]))
        why = "; ".join([*seen, *([why] if why else [])])
    document: dict[str, Any] = {
        "format": REPORT_FORMAT,
        "verdict": verdict,
        "where": _where(found) if gap else [],
        "which": _which(found, noises),
        "sets": _sets(found, noises),
        "class_probability": found.attribution.class_probability if gap else None,
        "shrinkage": _shrinkage_document(found, shrinkage) if gap else None,
        "unattributed": {
            "p": None if found.left is None else found.left.p,
            "description": why,
        },
        "next_test": None,
        "product": found.prepared.observations[0].product,
        "not_used": _not_used(found),
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


_NAMED = ("attributed", "confusable")


@dataclass(frozen=True)
class NoiseClaim:
    """White noise beyond belief."""

    name: str
    probability: float
    channels: tuple[Channel, ...]


def _verdict(
    found: Findings, gap: bool, noises: Sequence[NoiseClaim], shrinkage: Shrinkage | None
) -> tuple[Verdict, str | None]:
    """The verdict, and what remains in words where the data do not fit a set."""
    if not gap:
        return "no_gap", None
    if _certain_oddities(found):
        return "unattributed", None
    best = found.attribution.best
    deterministic = [cause for cause in best.causes if cause.trial >= 0] if best is not None else []
    probability = found.attribution.probability
    if best is None or (found.search.sets and not found.search.sets[0].causes):
        named = [claim.name for claim in noises] + [finding.effect for finding in found.timing]
        if any(_alike(finding) for finding in found.timing):
            return "confusable", None
        return ("attributed", None) if named else ("unattributed", _describe(found.located))
    if found.rivals:
        rival = found.rivals[0]
        return (
            "unattributed",
            f"{rival.channel.name} follows {rival.variable} in a way that no effect of the catalogue does",
        )
    if found.left is not None and found.left.p < REMAINDER_P:
        return "unattributed", _describe(found.left)
    if found.held is not None:
        idle = [cause.name for number, cause in enumerate(deterministic) if not found.held.gains(number)]
        if idle:
            return "unattributed", f"{', '.join(idle)} gains nothing on held-out data"
    if (
        shrinkage is not None
        and shrinkage.interval_95[1] < CLOSED_SHARE
        and len(best.causes) == len(deterministic)
    ):
        share = 100.0 * shrinkage.fraction_closed
        return "unattributed", f"the best set closes {share:.0f} % of the gap on held-out data"
    if probability >= NAMED_PROBABILITY:
        return ("confusable" if any(_alike(one) for one in found.timing) else "attributed"), None
    if found.attribution.class_probability >= NAMED_PROBABILITY:
        return "confusable", None
    return "unattributed", "no set of effects is likely enough"


def _certain_oddities(found: Findings) -> list[Oddity]:
    return [one for one in found.oddities if one.is_certain]


def _alike(finding: TimingFinding) -> list[str]:
    """A filter's lag delays as a link does."""
    lags = [f"{sensor}.bandwidth" for sensor in finding.sensors if sensor != "mag"]
    return lags if finding.effect == "link.fixed_delay" else []


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


def _where(found: Findings) -> list[dict[str, Any]]:
    """Significant cells; at least the strongest one, with the p of the whole."""
    places: list[dict[str, Any]] = []
    cells = sorted(found.located.cells, key=lambda c: (c.p_adjusted, -abs(c.sigmas)))
    floor = 1.0 / (len(found.prepared.noise[next(iter(found.prepared.noise))].nulls.level_si) + 1)
    chosen = [c for c in cells if c.p_adjusted < SIGNIFICANT_P][:MAX_PLACES]
    places += [_place(c, c.p_adjusted, c.p_adjusted < floor) for c in chosen]
    for noise in sorted(found.located.noises, key=lambda n: n.p_adjusted):
        if noise.p_adjusted < SIGNIFICANT_P:
            unit, factor = FIELD[noise.channel.sensor]
            white = next(iter(found.prepared.noise[noise.channel].white_si.values()))
            excess = white * math.sqrt(abs(1.0 - 1.0 / noise.ratio**2)) / factor
            places.append(
                {
                    "channel": noise.channel.name,
                    "kind": "stochastic",
                    "regime": None,
                    "p_adjusted": noise.p_adjusted,
                    "excess_rms": excess,
                    "unit": unit,
                    "fitted_tail": noise.p_adjusted < floor,
                }
            )
    for finding in found.timing:
        for sensor in finding.sensors or tuple({c.sensor for c in found.prepared.moments}):
            for channel in (
                c
                for c in found.prepared.moments
                if c.sensor == sensor and (not finding.sensors or finding.is_on(c))
            ):
                places.append(
                    {
                        "channel": channel.name,
                        "kind": KIND_OF.get(finding.effect.split(".")[1], "timing"),
                        "regime": None,
                        "p_adjusted": math.exp(-min(finding.log_likelihood_ratio, 600.0)),
                        "excess_rms": 0.0,
                        "unit": FIELD[channel.sensor][0],
                        "fitted_tail": True,
                    }
                )
    for oddity in _certain_oddities(found):
        places.append(
            {
                "channel": oddity.channel,
                "kind": "deterministic",
                "regime": None,
                "p_adjusted": oddity.p,
                "excess_rms": 0.0,
                "unit": FIELD[oddity.channel.split("_")[0]][0],
                "fitted_tail": True,
            }
        )
    if not places and found.located.cells:
        places.append(_strongest(found))
    return places


def _strongest(found: Findings) -> dict[str, Any]:
    """A gap that templates see and no single cell does: where the likeliest effect shows most."""
    best = found.attribution.best
    channels = {c for cause in best.causes for c in cause.channels} if best is not None else set[Channel]()
    variables = {variable_of(name) for name in best.names} if best is not None else set[str]()
    fitting = [
        c
        for c in found.located.cells
        if c.channel in channels and any(c.variable.startswith(v) for v in variables)
    ]
    cell = max(fitting or list(found.located.cells), key=lambda c: abs(c.sigmas))
    return _place(cell, found.located.p, found.located.beyond_nulls)


def _place(cell: CellFinding, p: float, tail: bool) -> dict[str, Any]:
    unit, factor = FIELD[cell.channel.sensor]
    return {
        "channel": cell.channel.name,
        "kind": "deterministic",
        "regime": {"variable": cell.variable, "low": cell.low, "high": cell.high, "unit": cell.unit},
        "p_adjusted": p,
        "excess_rms": abs(cell.excess_si) / factor,
        "unit": unit,
        "fitted_tail": tail,
    }


def _noise_claims(found: Findings) -> list[NoiseClaim]:
    """White noise beyond the spread that the belief allows: of a triad as a whole, or of one axis."""
    claims: list[NoiseClaim] = []
    threshold = math.log(max(found.search.effects, 1) / EXPECTED_EFFECTS)
    for sensor, name in WHITE_NAMES.items():
        if name in found.without:
            continue
        ratios = {
            channel: noise.log_white_ratio
            for channel, noise in found.prepared.noise.items()
            if channel.sensor == sensor and noise.log_white_ratio is not None
        }
        if not ratios:
            continue
        spread = found.prepared.noise[next(iter(ratios))].belief.white_spread
        evidence, channels = white_excess(ratios, spread)
        if evidence > threshold:
            probability = 1.0 / (1.0 + math.exp(-min(evidence - threshold, 600.0)))
            claims.append(NoiseClaim(name, probability, channels))
    return sorted(claims, key=lambda claim: -claim.probability)


def white_excess(log_ratios: Mapping[Channel, float], spread: float) -> tuple[float, tuple[Channel, ...]]:
    """ln B of more white noise than believed, by any factor up to `LARGEST_FACTOR`, and on which axes.

    A unit's level is common to its axes (recording.md); an axis strays from it by `AXIS_SHARE` of the spread.
    """
    values = list(log_ratios.values())

    def of(excess: float, deviation: float) -> float:
        if excess <= 0.0:
            return -math.inf
        flat = math.log(math.log(LARGEST_FACTOR))
        return 0.5 * (excess / deviation) ** 2 + math.log(deviation * math.sqrt(2.0 * math.pi)) - flat

    best = of(sum(values) / len(values), spread), tuple(log_ratios)
    for channel, value in log_ratios.items():
        others = [v for c, v in log_ratios.items() if c != channel]
        if not others:
            continue
        alone = of(
            value - sum(others) / len(others), AXIS_SHARE * spread * math.sqrt(1.0 + 1.0 / len(others))
        )
        alone -= math.log(len(values))
        if alone > best[0]:
            best = alone, (channel,)
    return best


def _which(found: Findings, noises: Sequence[NoiseClaim]) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = []
    fitted: dict[str, list[FittedEffect]] = {}
    for one in found.fit.effects if found.fit is not None else ():
        fitted.setdefault(one.name, []).append(one)
    ranked = sorted(found.attribution.inclusion.items(), key=lambda item: -item[1])
    for name, probability in ranked[:MAX_NAMES]:
        confusable = list(found.attribution.confusable.get(name, ()))
        if name in fitted:
            entries += [_entry(one, min(probability, 1.0), confusable) for one in fitted[name]]
        elif probability > 1e-4 or not entries:
            cause = next((c for s in found.search.sets for c in s.causes if c.name == name), None)
            channels = [c.name for c in cause.channels] if cause is not None else []
            entries.append(
                {
                    "effect": name,
                    "probability": min(probability, 1.0),
                    "channels": channels,
                    "parameters": _noise_parameters(found, name, cause.channels if cause else ()),
                    "confusable_with": confusable,
                    "sensor": cause.channels[0].sensor if cause is not None and cause.channels else None,
                }
            )
    for claim in noises:
        entries.append(
            {
                "effect": claim.name,
                "probability": claim.probability,
                "channels": [channel.name for channel in claim.channels],
                "parameters": _white_parameters(found, claim.channels),
                "confusable_with": [],
                "sensor": claim.channels[0].sensor,
            }
        )
    for finding in found.timing:
        entries.append(
            {
                "effect": finding.effect,
                "probability": 1.0 - math.exp(-min(finding.log_likelihood_ratio, 600.0)),
                "channels": [c.name for c in found.prepared.moments if finding.is_on(c)],
                "parameters": {
                    name: {"value": value, "standard_uncertainty": uncertainty, "unit": unit}
                    for name, value, uncertainty, unit in (
                        (finding.parameter, finding.value, finding.standard_uncertainty, finding.unit),
                        *finding.more,
                    )
                },
                "confusable_with": _alike(finding),
                "sensor": finding.sensors[0] if finding.sensors else None,
            }
        )
    return sorted(entries, key=lambda entry: -entry["probability"])


def _entry(one: FittedEffect, probability: float, confusable: list[str]) -> dict[str, Any]:
    held = {s.name: {"value": s.value, "unit": s.unit} for s in scalars(one.effect) if s.held}
    return {
        "effect": one.name,
        "probability": probability,
        "channels": [c.name for c in one.channels],
        "parameters": {
            p.name: {"value": p.value, "standard_uncertainty": p.standard_uncertainty, "unit": p.unit}
            for p in one.parameters
        },
        "confusable_with": confusable,
        "sensor": one.effect.sensor,
        "axis": getattr(one.effect, "axis", None),
        "held": held,
    }


def _noise_parameters(found: Findings, name: str, channels: Sequence[Channel]) -> dict[str, Any]:
    if not name.endswith("bias_instability"):
        return {}
    parameters: dict[str, Any] = {}
    for channel in channels:
        noise = found.prepared.noise[channel]
        ratio = next(
            (n.ratio for n in found.located.noises if n.channel == channel and n.kind == "slow"), 1.0
        )
        level = float(noise.levels.level_si[noise.levels.believed // 2]) * ratio
        unit = {"gyro": "rad/s", "acc": "m/s^2", "mag": "T"}.get(channel.sensor, "1")
        parameters[f"standard_deviation_si_{channel.name[-1]}"] = {
            "value": level,
            "standard_uncertainty": 0.5 * level,
            "unit": unit,
        }
    return parameters


def _white_parameters(found: Findings, channels: Sequence[Channel]) -> dict[str, Any]:
    parameters: dict[str, Any] = {}
    for channel in channels:
        noise = found.prepared.noise[channel]
        if noise.belief.white_si_per_sqrt_hz is None or noise.log_white_ratio is None:
            continue
        value = noise.belief.white_si_per_sqrt_hz * math.exp(noise.log_white_ratio)
        rows = sum(m.rows for m in found.prepared.moments[channel].values())
        unit = {"gyro": "rad/sqrt(s)", "acc": "m/s/sqrt(s)"}.get(channel.sensor, "T per sqrt(Hz)")
        parameters[f"density_si_per_sqrt_hz_{channel.name[-1]}"] = {
            "value": value,
            "standard_uncertainty": value / math.sqrt(max(rows, 1)),
            "unit": unit,
        }
    return parameters


def _sets(found: Findings, noises: Sequence[NoiseClaim]) -> list[dict[str, Any]]:
    """The most probable sets; what timing and white noise show by themselves is part of each."""
    certain = [claim.name for claim in noises] + [finding.effect for finding in found.timing]
    sets = [
        {"effects": sorted({*names, *certain}), "probability": min(p, 1.0)}
        for names, p in found.attribution.sets
    ]
    return sorted(sets, key=lambda one: -float(one["probability"]))  # type: ignore[arg-type]


def _shrinkage(found: Findings) -> Shrinkage | None:
    if found.held is None or not found.held.folds or found.fit is None:
        return None
    unexplained = 0.0
    return shrinkage_of(found.held, unexplained)


def _shrinkage_document(found: Findings, shrinkage: Shrinkage | None) -> dict[str, Any] | None:
    if shrinkage is None or found.held is None or found.fit is None:
        return None
    by_channel: dict[Channel, float] = {}
    for one in found.fit.effects:
        for channel, rms in one.rms_si.items():
            by_channel[channel] = math.hypot(by_channel.get(channel, 0.0), rms)
    return shrinkage_entry(shrinkage, found.held, by_channel)


def shrinkage_entry(shrinkage: Shrinkage, held: HeldOut, rms_si: Mapping[Channel, float]) -> dict[str, Any]:
    """`shrinkage` of a report. `rms_si`: what the effects change in each channel."""
    closed = min(max(shrinkage.fraction_closed, 0.0), 1.0)
    channels: dict[str, Any] = {}
    for channel, rms in rms_si.items():
        unit, factor = FIELD[channel.sensor]
        after = rms * math.sqrt(1.0 - closed)
        channels[channel.name] = {"before": rms / factor, "after": after / factor, "unit": unit}
    low, high = shrinkage.interval_95
    return {
        "held_out": [fold.label for fold in held.folds],
        "before": shrinkage.before,
        "after": shrinkage.after,
        "noise_floor": 1.0,
        "unit": "1 (whitened rms)",
        "fraction_closed": shrinkage.fraction_closed,
        "ci95": [low, high],
        "channels": channels,
    }


def _not_used(found: Findings) -> list[str]:
    return [
        f"{one.recording_id}: {part.what}, {part.count} rows: {part.why}"
        for one in found.prepared.observations
        for part in one.set_aside
    ]

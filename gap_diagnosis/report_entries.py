# pyright: strict
"""`which`, `sets`, `shrinkage` and `not_used` of a report."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dut_emulator.effects.parameters import scalars
from gap_diagnosis.findings import Findings, NoiseClaim, alike, field_of
from gap_diagnosis.fitting import FittedEffect
from gap_diagnosis.held_out import HeldOut, Shrinkage
from gap_diagnosis.observation import Channel, Observation

MAX_NAMES = 12


def which(found: Findings, noises: Sequence[NoiseClaim]) -> list[dict[str, Any]]:
    """Effects by probability, with parameters where they were fitted."""
    entries: list[dict[str, Any]] = []
    fitted: dict[str, list[FittedEffect]] = {}
    for one in found.fit.effects if found.fit is not None else ():
        fitted.setdefault(one.name, []).append(one)
    ranked = sorted(found.attribution.inclusion.items(), key=lambda item: -item[1])
    for name, probability in ranked[:MAX_NAMES]:
        confusable = list(found.attribution.confusable.get(name, ()))
        if name in fitted:
            entries += [_entry(found, one, min(probability, 1.0), confusable) for one in fitted[name]]
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
                "confusable_with": alike(finding),
                "sensor": finding.sensors[0] if finding.sensors else None,
            }
        )
    return sorted(entries, key=lambda entry: -entry["probability"])


def _entry(found: Findings, one: FittedEffect, probability: float, confusable: list[str]) -> dict[str, Any]:
    held = {s.name: {"value": s.value, "unit": s.unit} for s in scalars(one.effect) if s.held}
    unit, factor = field_of(one.channels[0], found.prepared.observations)
    shown = {p.name: (p.unit, 1.0) for p in one.parameters}
    if unit == "1":  # outputs in plain numbers: so are parameters in the unit of the field
        shown |= {p.name: (unit, factor) for p in one.parameters if p.unit == "T"}
    return {
        "effect": one.name,
        "probability": probability,
        "channels": [c.name for c in one.channels],
        "parameters": {
            p.name: {
                "value": p.value / shown[p.name][1],
                "standard_uncertainty": p.standard_uncertainty / shown[p.name][1],
                "unit": shown[p.name][0],
            }
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


def sets_of(found: Findings, noises: Sequence[NoiseClaim]) -> list[dict[str, Any]]:
    """The most probable sets; what timing and white noise show by themselves is part of each."""
    certain = [claim.name for claim in noises] + [finding.effect for finding in found.timing]
    sets = [
        {"effects": sorted({*names, *certain}), "probability": min(p, 1.0)}
        for names, p in found.attribution.sets
    ]
    return sorted(sets, key=lambda one: -float(one["probability"]))  # type: ignore[arg-type]


def shrinkage_document(found: Findings, shrinkage: Shrinkage | None) -> dict[str, Any] | None:
    if shrinkage is None or found.held is None or found.fit is None:
        return None
    by_channel: dict[Channel, float] = {}
    for one in found.fit.effects:
        for channel, rms in one.rms_si.items():
            by_channel[channel] = math.hypot(by_channel.get(channel, 0.0), rms)
    return shrinkage_entry(shrinkage, found.held, by_channel, found.prepared.observations)


def shrinkage_entry(
    shrinkage: Shrinkage,
    held: HeldOut,
    rms_si: Mapping[Channel, float],
    observations: Sequence[Observation] = (),
) -> dict[str, Any]:
    """`shrinkage` of a report. `rms_si`: what the effects change in each channel."""
    closed = min(max(shrinkage.fraction_closed, 0.0), 1.0)
    channels: dict[str, Any] = {}
    for channel, rms in rms_si.items():
        unit, factor = field_of(channel, observations)
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


def not_used(found: Findings) -> list[str]:
    """A sentence for each lot of rows that was set aside."""
    return [
        f"{one.recording_id}: {part.what}, {part.count} rows: {part.why}"
        if part.count
        else f"About the {part.what} of {one.recording_id}: {part.why}"
        for one in found.prepared.observations
        for part in one.set_aside
    ]

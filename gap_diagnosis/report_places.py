# pyright: strict
"""`where` of a report: cells, noise levels and timing that stand out."""

import math
from typing import Any

from gap_diagnosis.findings import FIELD, SIGNIFICANT_P, Findings, certain_oddities, field_of
from gap_diagnosis.localisation import CellFinding
from gap_diagnosis.observation import Channel
from gap_diagnosis.regimes import variable_of

MAX_PLACES = 24
KIND_OF = {
    **dict.fromkeys(("aliasing", "mains_interference", "saturation"), "deterministic"),
    "quantization": "stochastic",
}
"""Of what the samples show by themselves; the rest is timing."""


def where(found: Findings) -> list[dict[str, Any]]:
    """Significant cells; at least the strongest one, with the p of the whole."""
    places: list[dict[str, Any]] = []
    cells = sorted(found.located.cells, key=lambda c: (c.p_adjusted, -abs(c.sigmas)))
    floor = 1.0 / (len(found.prepared.noise[next(iter(found.prepared.noise))].nulls.level_si) + 1)
    chosen = [c for c in cells if c.p_adjusted < SIGNIFICANT_P][:MAX_PLACES]
    places += [_place(found, c, c.p_adjusted, c.p_adjusted < floor) for c in chosen]
    for noise in sorted(found.located.noises, key=lambda n: n.p_adjusted):
        if noise.p_adjusted < SIGNIFICANT_P:
            unit, factor = field_of(noise.channel, found.prepared.observations)
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
    for oddity in certain_oddities(found):
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
    return _place(found, cell, found.located.p, found.located.beyond_nulls)


def _place(found: Findings, cell: CellFinding, p: float, tail: bool) -> dict[str, Any]:
    unit, factor = field_of(cell.channel, found.prepared.observations)
    return {
        "channel": cell.channel.name,
        "kind": "deterministic",
        "regime": {"variable": cell.variable, "low": cell.low, "high": cell.high, "unit": cell.unit},
        "p_adjusted": p,
        "excess_rms": abs(cell.excess_si) / factor,
        "unit": unit,
        "fitted_tail": tail,
    }

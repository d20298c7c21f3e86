"""Parameters that a report and a label can be compared by, whatever the engine calls them.

The contract leaves the names of parameters to the effect. Compared are effects whose coefficients have one
natural dimension, on a single channel or jointly: by dimension, and in the order of the names.
"""

import math
import re

from tests.blind.effect_shapes import STANDARD_GRAVITY
from tests.blind.verdicts import Judged

_ATOMS: dict[str, tuple[float, str]] = {
    "1": (1.0, ""), "ppm": (1e-6, ""), "rad": (1.0, "rad"), "deg": (math.pi / 180, "rad"), "s": (1.0, "s"),
    "ms": (1e-3, "s"), "us": (1e-6, "s"), "min": (60.0, "s"), "h": (3600.0, "s"), "m": (1.0, "m"),
    "mm": (1e-3, "m"), "degC": (1.0, "K"), "V": (1.0, "V"), "T": (1.0, "T"), "uT": (1e-6, "T"),
}  # fmt: skip

COMPARED: dict[str, tuple[str, float]] = {
    "gyro.g_sensitivity": ("deg/s/g", 1.0),
    "gyro.supply_sensitivity": ("deg/s/V", 1.0),
    "gyro.magnetic_sensitivity": ("deg/s/uT", 1.0),
    "gyro.even_nonlinearity": ("1 per deg/s", 1 / 200),
    "gyro.scale_factor_nonlinearity": ("1 per deg/s per deg/s", 1 / 200**2),
    "gyro.scale_factor_temperature": ("1/degC", 1.0),
    "gyro.temperature_rate": ("deg/s per degC/min", 1.0),
    "gyro.warm_up": ("deg/s", 1.0),
    "gyro.bandwidth": ("s", 1.0),
    "acc.scale_factor_temperature": ("1/degC", 1.0),
    "acc.quadratic_nonlinearity": ("1/g", 1.0),
    "acc.odd_quadratic_nonlinearity": ("1/g", 1.0),
    "acc.cubic_nonlinearity": ("1/g/g", 1.0),
    "acc.warm_up": ("g", 1.0),
    "link.fixed_delay": ("s", 1.0),
    "stand.lever_arm": ("m", 1.0),
}
"""Effect to the unit of the label's coefficients and a factor: its columns have sizes of their own."""


def si(unit: str) -> tuple[float, dict[str, int]] | None:
    """(size in SI, exponents of base units) of `deg/s/g`, `rad/s per m/s^2`, …; None if not understood."""
    groups = re.sub(r"/\(([^)]*)\)", r" per \1", unit).split(" per ")
    size, exponents = 1.0, dict.fromkeys(("rad", "m", "s", "K", "V", "T"), 0)
    for number, group in enumerate(groups):
        for place, word in enumerate(group.strip().split("/")):
            name, _, power = word.partition("^")
            sign = (1 if place == 0 else -1) * (1 if number == 0 else -1) * (int(power) if power else 1)
            if name in ("g", "mg", "ug"):
                size *= (STANDARD_GRAVITY * {"g": 1, "mg": 1e-3, "ug": 1e-6}[name]) ** sign
                exponents["m"] += sign
                exponents["s"] -= 2 * sign
            elif name in _ATOMS:
                size *= _ATOMS[name][0] ** sign
                if _ATOMS[name][1]:
                    exponents[_ATOMS[name][1]] += sign
            else:
                return None
    return size, exponents


def normalised_errors(one: Judged) -> list[float]:
    """Errors of a report's parameters in Cramér–Rao standard deviations; empty where not comparable."""
    facts, bounds = one.label["facts"][0], one.oracle.get("cramer_rao", [])
    coefficients = facts.get("coefficients", [])
    which = one.report.get("which") or []
    if one.truth[0] not in COMPARED or len(coefficients) != 1 or not which:
        return []
    unit, factor = COMPARED[one.truth[0]]
    wanted = si(unit)
    assert wanted is not None
    found = []
    for _, parameter in sorted(which[0].get("parameters", {}).items()):
        given = si(str(parameter.get("unit")))
        if given is not None and given[1] == wanted[1]:
            found.append(float(parameter["value"]) * given[0] / wanted[0] / factor)
    values = coefficients[0]["values"]
    if len(found) != len(values) or len(bounds) < len(values):
        return []
    return [(x - y) / b for x, y, b in zip(found, values, bounds, strict=False) if b > 0]

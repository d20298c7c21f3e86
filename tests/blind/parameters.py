"""Parameters that a report and a label can be compared by, whatever the engine calls them.

The contract leaves the names of parameters to the effect. Only effects whose coefficients have one
natural unit are compared, on a single channel or jointly, by that unit and in the order of the names.
"""

from tests.blind.verdicts import Judged

UNITS: dict[str, tuple[str, float]] = {
    "deg/s/g": ("g_sensitivity", 1.0),
    "deg/s/V": ("per_volt", 1.0),
    "deg/s/uT": ("per_field", 1.0),
    "1/degC": ("per_degree", 1.0),
    "ppm/degC": ("per_degree", 1e-6),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "g/g^2": ("quadratic", 1.0),
    "ug/g^2": ("quadratic", 1e-6),
    "deg/s/(degC/min)": ("rate_of_change", 1.0),
    "deg/s/(degC/s)": ("rate_of_change", 1 / 60),
}
"""Unit of a report to what it measures and its size in the label's unit."""

COMPARED = {
    "gyro.g_sensitivity": "g_sensitivity",
    "gyro.supply_sensitivity": "per_volt",
    "gyro.magnetic_sensitivity": "per_field",
    "gyro.scale_factor_temperature": "per_degree",
    "acc.scale_factor_temperature": "per_degree",
    "acc.quadratic_nonlinearity": "quadratic",
    "gyro.temperature_rate": "rate_of_change",
    "gyro.bandwidth": "time",
    "link.fixed_delay": "time",
    "stand.lever_arm": "length",
}


def normalised_errors(one: Judged) -> list[float]:
    """Errors of a report's parameters in Cramér–Rao standard deviations; empty where not comparable."""
    facts, bounds = one.label["facts"][0], one.oracle.get("cramer_rao", [])
    coefficients = facts.get("coefficients", [])
    quantity = COMPARED.get(one.truth[0])
    which = one.report.get("which") or []
    if quantity is None or len(coefficients) != 1 or not which:
        return []
    found = []
    for _, parameter in sorted(which[0].get("parameters", {}).items()):
        kind, size = UNITS.get(str(parameter.get("unit")), ("", 0.0))
        if kind == quantity:
            found.append(float(parameter["value"]) * size)
    values = coefficients[0]["values"]
    if len(found) != len(values) or len(bounds) < len(values):
        return []
    return [(x - y) / b for x, y, b in zip(found, values, bounds, strict=False) if b > 0]

# pyright: strict
"""Quantities as the floor says them: degrees and g for SI, the uncertainty to two digits."""

import math

from calibration.certificate.rounding import plain, with_uncertainty
from dut_emulator.effects.parameters import conversion_to
from protocol.errors import TestloomError
from protocol.units_of_measure import is_known_unit, quantity_of

_SHOWN_IN = {
    "rad/s": "deg/s",
    "m/s^2": "g",
    "T": "uT",
    "rad": "deg",
    "rad/sqrt(s)": "deg/sqrt(h)",
    "m/s/sqrt(s)": "m/s/sqrt(h)",
}
_SMALLER = {"deg/s": "deg/h", "g": "mg", "mg": "ug", "1": "ppm", "deg": "arcsec", "s": "ms", "ms": "us"}
_SMALL = {"deg/s": 1e-3}
_SMALL_ELSE = 0.01
"""A value below it is shown in the smaller unit."""
_SIGNS = (("degC", "°C"), ("deg", "°"), ("arcsec", "″"), ("^2", "²"), ("sqrt", "√"))
_MICRO = {"uT": "µT", "ug": "µg", "us": "µs", "ug/sqrt(Hz)": "µg/√(Hz)", "uT/sqrt(Hz)": "µT/√(Hz)"}
DIGITS_ALONE = 4


def field_quantity(value: float, unit: str, uncertainty: float | None = None) -> str:
    """Value, standard uncertainty and unit for people: '0.0040 ± 0.0003 °/s per g'."""
    factor, shown_unit = field_unit(unit, abs(value))
    scaled = None if uncertainty is None else uncertainty * factor
    sign = unit_sign(shown_unit)
    return number(value * factor, scaled) + (f" {sign}" if sign else "")


def field_unit(unit: str, largest: float = math.inf) -> tuple[float, str]:
    """(factor, unit) of the field for values up to `largest`; an unknown unit stays as it is."""
    first, *divisors = (_SHOWN_IN.get(part, part) for part in unit.split(" per "))
    try:
        factor = conversion_to(unit, " per ".join((first, *divisors)))
        while first in _SMALLER and 0.0 < largest * factor < _SMALL.get(first, _SMALL_ELSE):
            first = _SMALLER[first]
            factor = conversion_to(unit, " per ".join((first, *divisors)))
    except TestloomError:
        return 1.0, unit
    return factor, " per ".join((first, *divisors))


def unit_sign(unit: str) -> str:
    """A unit as it is printed; nothing for a plain number."""
    if unit == "1":
        return ""
    parts: list[str] = []
    for part in unit.split(" per "):
        text = _MICRO.get(part, part)
        for written, sign in _SIGNS:
            text = text.replace(written, sign)
        parts.append(text)
    return " per ".join(parts)


def spelled_like(unit: str, declared: str) -> str:
    """A unit as the catalogue spells it: 'deg/s/g' is 'deg/s per g' there."""
    if " per " in unit or " per " not in declared:
        return unit
    parts: list[str] = []
    rest = unit
    for _ in range(declared.count(" per ")):
        rest, _, last = rest.rpartition("/")
        parts.insert(0, last)
    spelled = " per ".join((rest, *parts))
    quantities = [
        [quantity_of(p) if is_known_unit(p) else p for p in u.split(" per ")] for u in (spelled, declared)
    ]
    return spelled if quantities[0] == quantities[1] else unit


def number(value: float, uncertainty: float | None = None) -> str:
    """A number with its standard uncertainty to two significant digits (JCGM 100:2008, 7.2.6)."""
    if uncertainty is None or not (math.isfinite(uncertainty) and uncertainty > 0):
        return plain(value, DIGITS_ALONE)
    shown, beside = with_uncertainty(value, uncertainty)
    mantissa, power_sign, power = shown.partition(" × ")
    if not power_sign:
        return f"{shown} ± {beside}"
    return f"({mantissa} ± {beside.partition(' × ')[0]}) × {power}"

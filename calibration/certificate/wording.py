# pyright: strict
"""Names and units of a record as people write them, in both languages."""

import re

from calibration.certificate.document import Say
from calibration.records.derived_units import derived_conversion_factor
from protocol.errors import TestloomError
from protocol.units_of_measure import is_known_unit

_PARTS = re.compile(r"(?P<stem>[a-z0-9_]*?[a-z0-9])(?:_(?P<axes>[xyz]{1,3}))?(?:_(?P<index>\d+))?")
_SHOWN_AS = {
    "rad": "deg",
    "rad/s": "deg/s",
    "rad/sqrt(s)": "deg/sqrt(h)",
    "m/s/sqrt(s)": "m/s/sqrt(h)",
    "T": "uT",
}
"""SI units inside, the field's units on paper."""
_SMALL_TIMES = ((1e-3, "us"), (1.0, "ms"))
_SPELLINGS = (
    ("sqrt(", "√("),
    ("degC", "°C"),
    ("deg", "°"),
    ("arcsec", "″"),
    ("^2", "²"),
    ("^3", "³"),
    ("ohm", "Ω"),
    ("gauss", "Gs"),
    ("*", "·"),
)
UNCERTAINTY_OF = "u_"
"""Begins the name of a column of standard uncertainties."""
GREEK = {"tau": "τ", "sigma": "σ", "alpha": "α", "omega": "ω", "epsilon": "ε", "phi": "φ", "theta": "θ"}
_MICRO = re.compile(r"\bu(?=[gTs]\b)")
_HYPHENATED = re.compile(
    r"\b(cross|single|two|three|multi|g|g2|non) (?=axis|sensitivity|position|orthogonality)"
)
_SINGLE = re.compile(r"\(([^()/√^ ]+)\)")


def quantity_words(name: str, say: Say) -> str:
    """'cross_axis_sensitivity_xy' → 'cross-axis sensitivity xy', or what the catalogue has for it."""
    if name.startswith(UNCERTAINTY_OF):
        return f"u({quantity_words(name.removeprefix(UNCERTAINTY_OF), say)})"
    found = _PARTS.fullmatch(name)
    if found is None:
        return name.replace("_", " ")
    words = say(_HYPHENATED.sub(r"\1-", found["stem"].replace("_", " ")))
    return " ".join(part for part in (words, found["axes"], found["index"]) if part)


def capital(words: str) -> str:
    """The first letter large, unless it is a symbol: 'u(bias x)'."""
    return words if words[1:2] == "(" else words[:1].upper() + words[1:]


def symbol_cell(symbol: str) -> str:
    """'tau_x' → '$τ_x', a symbol in a cell of a `Grid`; no symbol, an empty cell."""
    letter, mark, index = symbol.partition("_")
    return f"${GREEK.get(letter, letter)}{mark}{index}" if symbol else ""


def unit_words(unit: str) -> str:
    """'V/(deg/s)' → 'V/(°/s)', 'ug/sqrt(Hz)' → 'µg/√Hz'."""
    text = _MICRO.sub("µ", unit)
    for spelled, written in _SPELLINGS:
        text = text.replace(spelled, written)
    return _SINGLE.sub(r"\1", text)


def shown_unit(unit: str, largest: float = 1.0) -> str:
    """The unit that a value is printed in: degrees for radians, also in quotients; small times in ms, µs."""
    if unit == "s":
        return next((small for limit, small in _SMALL_TIMES if 0.0 < largest < limit), "s")
    candidate = _SHOWN_AS.get(unit, "")
    if not candidate and not is_known_unit(unit):
        candidate = re.sub(r"(?<![a-z])rad(?![a-z])", "deg", unit)
    if not candidate:
        return unit
    try:
        derived_conversion_factor(unit, candidate)
    except TestloomError:
        return unit
    return candidate

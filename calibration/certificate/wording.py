# pyright: strict
"""Names, units and equations of a record as people write them, in both languages."""

import re

from calibration.certificate.document import Say
from calibration.certificate.rounding import power_of_ten

_PARTS = re.compile(r"(?P<stem>[a-z0-9_]*?[a-z0-9])(?:_(?P<axes>[xyz]{1,3}))?(?:_(?P<index>\d+))?")
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
    r"\b(cross|single|two|three|multi|g|g2|non|turn) (?=axis|sensitivity|position|orthogonality|on\b)"
)
_OF_A_NODE = re.compile(r"(?P<what>[a-z]+(?: [a-z]+)*?) of (?P<node>.+)")
_BETWEEN_NODES = re.compile(r"(?P<what>thermal conductance) (?P<one>.+) to (?P<other>.+)")
_SINGLE = re.compile(r"\(([^()/√^ ]+)\)")
_LONG_NAME = re.compile(r"\b[a-z]{3,}(?:_[a-z]{3,})+\b")
_SIGNS = (
    (re.compile(r" - "), " − "),
    (re.compile(r"(?<=[(=, ])-(?=[a-z])"), "−"),
    (re.compile(r"\binv\((\w+)\)"), r"\1⁻¹"),
    (re.compile(r"\bsum\b(?= m_)"), "Σ"),
    (re.compile(r"\bw\b"), "ω"),
    *((re.compile(rf"\b{name}\b"), letter) for name, letter in {**GREEK, "pi": "π"}.items()),
    (re.compile(r"\^2"), "²"),
)
_WITH_EXPONENT = re.compile(r"(?<![\w.])(−?-?\d+(?:\.\d+)?)e([+-]\d+)\b")


def quantity_words(name: str, say: Say) -> str:
    """'cross_axis_sensitivity_xy' → 'cross-axis sensitivity xy', or what the catalogue has for it."""
    if name.startswith(UNCERTAINTY_OF):
        return f"u({quantity_words(name.removeprefix(UNCERTAINTY_OF), say)})"
    found = _PARTS.fullmatch(name)
    if found is None:
        return name.replace("_", " ")
    words = _said(_HYPHENATED.sub(r"\1-", found["stem"].replace("_", " ")), say).replace("allan", "Allan")
    if found["stem"].endswith("limit") and found["index"]:
        return f"{words} {found['index']} %"
    return " ".join(part for part in (words, found["axes"], found["index"]) if part)


def _said(words: str, say: Say) -> str:
    """As the catalogue has it; 'heat capacity of housing' by its parts, since units name their nodes."""
    if (known := say(words)) != words:
        return known
    if found := _BETWEEN_NODES.fullmatch(words):
        what, one, other = (say(found[part]) for part in ("what", "one", "other"))
        return say("{what} {one} to {other}", what=what, one=one, other=other)
    if found := _OF_A_NODE.fullmatch(words):
        return say("{what} of {node}", what=say(found["what"]), node=say(found["node"]))
    return words


def stem_of(name: str) -> str:
    """'scale_factor_x' → 'scale_factor': what the axes share."""
    found = _PARTS.fullmatch(name)
    return found["stem"] if found else name


def capital(words: str) -> str:
    """The first letter large, unless it is a symbol: 'u(bias x)'."""
    return words if words[1:2] == "(" else words[:1].upper() + words[1:]


def symbol_cell(symbol: str) -> str:
    """'tau_x' → '$τ_x', a symbol in a cell of a `Grid`; no symbol, an empty cell."""
    letter, mark, index = symbol.partition("_")
    return f"${GREEK.get(letter, letter)}{mark}{index}" if symbol else ""


def unit_words(unit: str) -> str:
    """'V/(deg/s)' → 'V/(°/s)', 'ug/sqrt(Hz)' → 'µg/√Hz'."""
    if unit == "ppm/(g)":
        return "µg/g²"  # the same number, as data sheets have it
    text = _MICRO.sub("µ", unit)
    for spelled, written in _SPELLINGS:
        text = text.replace(spelled, written)
    return _SINGLE.sub(r"\1", text)


def equation_words(equation: str, say: Say) -> str:
    """'y = M u + b; u = inv(M) (y - b)' → 'y = M u + b; u = M⁻¹ (y − b)'; long names become words."""
    if not equation:
        return ""
    text = _LONG_NAME.sub(lambda found: quantity_words(found[0], say), equation)
    for written, sign in _SIGNS:
        text = written.sub(sign, text)
    return f"eq|{text}"


def sentence_words(text: str) -> str:
    """Numbers in a sentence as pages have them: '2.7e-05' → '2.7 × 10⁻⁵'."""
    return _WITH_EXPONENT.sub(lambda found: f"{found[1]} × {power_of_ten(int(found[2]))}", text)

# pyright: strict
"""Units that results are printed in: SI inside, the field's units on paper.

Degrees for radians, degrees per hour for the drift of a good gyro, mg and µg for accelerometers, µg/g² for
their quadratic terms, ppm for deviations from a line, µs and ms for delays. What is not known here is
printed in the unit that it has.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from calibration.records.derived_units import derived_conversion_factor
from protocol.errors import TestloomError

_HEAD = re.compile(r"(?P<head>[^()]+?)(?P<below>/(?:sqrt)?\(.*)?")
_RADIAN = re.compile(r"(?<![a-z])rad(?![a-z])")
_DEVIATIONS = re.compile(
    r"nonlinearity|linearity|asymmetry|hysteresis|repeatability|scale_factor_error|drift"
)
"""Names of numbers that are parts of something."""
_SCALED = {
    "s": ("us", "ms"),
    "m/s^2": ("ug", "mg"),
    "rad/s": ("deg/h", "deg/s"),
    "rad": ("arcsec", "deg"),
    "T": ("uT",),
}
"""Smaller units first; each is left for the next where numbers in it grow beyond `_LARGEST_IN`."""
_LARGEST_IN = {"us": 1e3, "ms": 1e3, "ug": 1e3, "mg": 500.0, "deg/h": 18.0, "arcsec": 10.0}
_ALWAYS = {
    "rad/sqrt(s)": "deg/sqrt(h)",
    "m/s/sqrt(s)": "m/s/sqrt(h)",
    "rad/s/sqrt(s)": "deg/h/sqrt(h)",
    "1/(m/s^2)": "ppm/(g)",
}
_BELOW = {"/(m/s^2)": "/(g)"}
_MOST_UNCERTAIN = 99.5
"""Two digits of an uncertainty up to here need no power of ten."""
_LARGEST_PPM = 1e4


@dataclass(frozen=True)
class Size:
    """How large numbers are, and how uncertain, in the unit that they have."""

    largest: float = math.inf
    uncertainty: float = 0.0


def shown_unit(unit: str, size: Size | None = None, name: str = "") -> str:
    """The unit that a number of that size is printed in; a column of numbers gets one unit.

    Args:
        unit: that it has.
        size: None: not known, so only the kind of unit counts.
        name: of the quantity: a linearity is a part of something, and no plain number.
    """
    size = size or Size()
    for candidate in _candidates(unit, name):
        try:
            factor = derived_conversion_factor(unit, candidate)
        except TestloomError:
            continue
        limit = _limit(candidate)
        if size.largest * factor <= limit and (
            limit == math.inf or size.uncertainty * factor < _MOST_UNCERTAIN
        ):
            return candidate
    return _plainest(unit)


def common_size(values: Sequence[float], uncertainties: Sequence[float] = ()) -> Size:
    """Of numbers that share a unit."""
    return Size(max(map(abs, values), default=0.0), max(uncertainties, default=0.0))


def _candidates(unit: str, name: str) -> tuple[str, ...]:
    if unit in _ALWAYS:
        return (_ALWAYS[unit],)
    if unit == "1":
        return ("ppm", "%") if _DEVIATIONS.search(name) else ()
    found = _HEAD.fullmatch(unit)
    if found is None:
        return ()
    below = found["below"] or ""
    below = _BELOW.get(below, below)
    return tuple(f"{small}{below}" for small in _SCALED.get(found["head"], ()))


def _limit(candidate: str) -> float:
    if candidate == "ppm":
        return _LARGEST_PPM
    found = _HEAD.fullmatch(candidate)
    return _LARGEST_IN.get(found["head"], math.inf) if found else math.inf


def _plainest(unit: str) -> str:
    """Degrees for radians, gravity's multiples for its quotients; else as it is."""
    degrees = _ALWAYS.get(unit) or _RADIAN.sub("deg", unit)
    for written, short in _BELOW.items():
        degrees = degrees.replace(written, short)
    try:
        derived_conversion_factor(unit, degrees)
    except TestloomError:
        return unit
    return degrees

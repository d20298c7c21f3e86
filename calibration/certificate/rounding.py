# pyright: strict
"""Numbers as a certificate prints them: as many digits as are known, and one power of ten for a pair.

The uncertainty has two significant digits, and the value ends at the same place (JCGM 100:2008, 7.2.6).
"""

import math
from collections.abc import Sequence
from decimal import ROUND_HALF_EVEN, Decimal

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
LEAST_PLAIN, MOST_PLAIN = -5, 6
"""Powers of ten between which numbers are written out."""
MOST_PLACES = 7
UNCERTAINTY_DIGITS = 2
INTERVAL_DIGITS = 3


def with_uncertainty(value: float, uncertainty: float) -> tuple[str, str]:
    """Value and expanded uncertainty as texts, ended at the same place.

    An uncertainty of 0 (exact by definition) gives the value as it is.
    """
    if uncertainty == 0.0:
        return plain(value, 7), "0"
    last = _last_place(uncertainty, UNCERTAINTY_DIGITS)
    exponent = _exponent(max(abs(value), uncertainty), last)
    return _written(value, last, exponent), _written(uncertainty, last, exponent)


def interval(lower: float, upper: float, value: float) -> tuple[str, str, str]:
    """Limits and a value between them, to three significant digits of the interval's half-width."""
    half_width = (upper - lower) / 2.0
    if half_width == 0.0:
        return plain(lower, 7), plain(upper, 7), plain(value, 7)
    last = _last_place(half_width, INTERVAL_DIGITS)
    exponent = _exponent(max(abs(lower), abs(upper), abs(value)), last)
    low, high, between = (
        "0" if one == 0.0 else _written(one, last, exponent) for one in (lower, upper, value)
    )
    return low, high, between


def plain(value: float, digits: int) -> str:
    """A number alone, with at most so many significant digits and no zeros that say nothing."""
    if value == 0.0:
        return "0"
    last = max(_last_place(value, digits), -_decimals(value))
    exponent = _exponent(abs(value), last if last < 0 else 0)
    return _written(value, last if exponent else min(last, 0), exponent)


def column(values: Sequence[float], digits: int) -> tuple[tuple[str, ...], int]:
    """Numbers that stand below each other, and the power of ten that belongs into their heading.

    They end at one place: that of `digits` significant digits of the largest, or before, where none of
    them has as many.
    """
    largest = max((abs(value) for value in values), default=0.0)
    if largest == 0.0:
        return ("0",) * len(values), 0
    needed = max(_decimals(value) for value in values)
    last = max(_last_place(largest, digits), -needed)
    exponent = _exponent(largest, last)
    return tuple(_written(value, min(last, exponent), exponent, power=False) for value in values), exponent


def significant_digits(values: Sequence[float], uncertainty: float, most: int) -> int:
    """Digits of the largest number, at most so many, that end at the second digit of an uncertainty."""
    largest = max((abs(value) for value in values), default=0.0)
    if largest == 0.0:
        return most
    order = _last_place(largest, 1)
    return max(1, min(most, order - _last_place(uncertainty, UNCERTAINTY_DIGITS) + 1))


def power_of_ten(exponent: int) -> str:
    """'10⁻⁵'."""
    return "10" + str(exponent).translate(SUPERSCRIPTS)


def _last_place(value: float, digits: int) -> int:
    """Power of ten of the last of so many significant digits, after rounding: 0.0999 is 0.10."""
    order = math.floor(math.log10(abs(value)))
    place = order - digits + 1
    rounded = Decimal(repr(abs(value))).quantize(Decimal(1).scaleb(place), ROUND_HALF_EVEN)
    return place + 1 if rounded >= Decimal(1).scaleb(order + 1) else place


def _decimals(value: float) -> int:
    """Digits after the point that a number has when it is written out."""
    exponent = Decimal(repr(value)).normalize().as_tuple().exponent
    return max(0, -int(exponent))


def _exponent(largest: float, last: int) -> int:
    """0 where numbers up to `largest` are written out to the place `last`, else their power of ten."""
    rounded = Decimal(repr(largest)).quantize(Decimal(1).scaleb(last), ROUND_HALF_EVEN)
    order = (rounded or Decimal(repr(largest))).adjusted()
    if LEAST_PLAIN <= order < MOST_PLAIN and -MOST_PLACES <= last <= 0:
        return 0
    return order


def _written(value: float, last: int, exponent: int, power: bool = True) -> str:
    scaled = Decimal(repr(value)).scaleb(-exponent)
    rounded = scaled.quantize(Decimal(1).scaleb(min(last - exponent, 0)), ROUND_HALF_EVEN)
    text = f"{abs(rounded):f}" if rounded == 0 else f"{rounded:f}"
    text = text.replace("-", "−")
    return f"{text} × {power_of_ten(exponent)}" if exponent and power else text

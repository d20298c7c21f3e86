"""Values and uncertainties as a report writes them."""

import math

PLAIN_FROM = 1e-3
"""Numbers below this are written with a power of ten: zeros after the point are miscounted."""


def gum(value: float, standard_uncertainty: float) -> str:
    """Value and standard uncertainty, the uncertainty to two significant digits (JCGM 100:2008, 7.2.6).

    Small ones share a power of ten in steps of a thousand: (-2.368 ± 0.010)e-06.
    """
    if not (math.isfinite(standard_uncertainty) and standard_uncertainty > 0):
        return plain(value, 6)
    power = _power(max(abs(value), standard_uncertainty))
    value, standard_uncertainty = value * 10.0**-power, standard_uncertainty * 10.0**-power
    digits = 1 - math.floor(math.log10(standard_uncertainty))
    if float(f"{standard_uncertainty:.1e}") >= 10 ** (2 - digits):  # 0.0999 rounds up to 0.10
        digits -= 1
    places = max(digits, 0)
    both = f"{round(value, digits):.{places}f} ± {round(standard_uncertainty, digits):.{places}f}"
    return f"({both})e{power:03d}" if power else both


def plain(value: float, digits: int) -> str:
    """A value to so many significant digits, written as `gum` writes it."""
    power = _power(abs(value))
    if not power:
        return f"{value:.{digits}g}"
    # between 1 and 1000: never with a second power of ten, as 6.4e+02e-06
    scaled = float(f"{value * 10.0**-power:.{digits}g}")
    return f"{scaled:.{max(digits, 4)}g}e{power:03d}"


def two_digits(uncertainty: float) -> str:
    """An uncertainty alone, to two significant digits."""
    return plain(uncertainty, 2)


def _power(magnitude: float) -> int:
    if not 0.0 < magnitude < PLAIN_FROM:
        return 0
    return 3 * math.floor(math.log10(magnitude) / 3.0)

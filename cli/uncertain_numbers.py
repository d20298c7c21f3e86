"""Values and uncertainties as a report writes them."""

import math


def gum(value: float, standard_uncertainty: float) -> str:
    """Value and standard uncertainty, the uncertainty to two significant digits (JCGM 100:2008, 7.2.6)."""
    if not (math.isfinite(standard_uncertainty) and standard_uncertainty > 0):
        return f"{value:.6g}"
    digits = 1 - math.floor(math.log10(standard_uncertainty))
    if float(f"{standard_uncertainty:.1e}") >= 10 ** (2 - digits):  # 0.0999 rounds up to 0.10
        digits -= 1
    places = max(digits, 0)
    return f"{round(value, digits):.{places}f} ± {round(standard_uncertainty, digits):.{places}f}"


def two_digits(uncertainty: float) -> str:
    """An uncertainty alone, to two significant digits."""
    return f"{uncertainty:.2g}"

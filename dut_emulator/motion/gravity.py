# pyright: strict
"""How normal gravity falls with height above the Earth's ellipsoid (NIMA TR8350.2, WGS 84, chapter 4)."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SEMI_MAJOR_AXIS_M = 6378137.0
FLATTENING = 1 / 298.257223563
_CENTRIFUGAL_RATIO = 0.00344978650684
"""m = ω² a² b / GM."""


def height_coefficients(latitude_deg: float) -> tuple[float, float]:
    """c1, c2 of γ(h) = γ (1 + c1 h + c2 h²), h in m above the ellipsoid (eq. 4-3); to 1e-8 at 10 km."""
    square = float(np.sin(np.radians(latitude_deg)) ** 2)
    first = -2 / SEMI_MAJOR_AXIS_M * (1 + FLATTENING + _CENTRIFUGAL_RATIO - 2 * FLATTENING * square)
    return first, 3 / SEMI_MAJOR_AXIS_M**2

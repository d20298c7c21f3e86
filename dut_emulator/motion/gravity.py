# pyright: strict
"""Normal gravity of the Earth's ellipsoid by latitude and height (NIMA TR8350.2, WGS 84, chapter 4)."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SEMI_MAJOR_AXIS_M = 6378137.0
FLATTENING = 1 / 298.257223563
EQUATORIAL_GRAVITY_M_S2 = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)
_CENTRIFUGAL_RATIO = 0.00344978650684
"""m = ω² a² b / GM."""


def normal_gravity_m_s2(latitude_deg: float) -> float:
    """On the ellipsoid (Somigliana, eq. 4-1)."""
    square = np.sin(np.radians(latitude_deg)) ** 2
    root = np.sqrt(1 - _ECCENTRICITY_SQUARED * square)
    return float(EQUATORIAL_GRAVITY_M_S2 * (1 + _SOMIGLIANA * square) / root)


def height_coefficients(latitude_deg: float) -> tuple[float, float]:
    """c1, c2 of γ(h) = γ (1 + c1 h + c2 h²), h in m above the ellipsoid (eq. 4-3); to 1e-8 at 10 km."""
    square = float(np.sin(np.radians(latitude_deg)) ** 2)
    first = -2 / SEMI_MAJOR_AXIS_M * (1 + FLATTENING + _CENTRIFUGAL_RATIO - 2 * FLATTENING * square)
    return first, 3 / SEMI_MAJOR_AXIS_M**2

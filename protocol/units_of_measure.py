"""Units of measure that recordings, plans and coefficients may use, and their SI factors.

Inside the product everything is SI (rad, rad/s, m/s^2, T, s, degC); other units live only in
recordings, plans and views. One table: no unit is ever guessed.
"""

import math

from protocol.errors import Fault, TestloomError

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of gravity, exact (BIPM, 3rd CGPM 1901)."""

_DEG = math.pi / 180

# unit -> (quantity, factor to the SI unit of that quantity)
_TABLE: dict[str, tuple[str, float]] = {
    "1": ("number", 1.0),
    "ppm": ("number", 1e-6),
    "%": ("number", 1e-2),
    "count": ("number", 1.0),
    "rad": ("angle", 1.0),
    "deg": ("angle", _DEG),
    "arcsec": ("angle", _DEG / 3600),
    "rad/s": ("angular_rate", 1.0),
    "deg/s": ("angular_rate", _DEG),
    "deg/h": ("angular_rate", _DEG / 3600),
    "rev/s": ("angular_rate", 2 * math.pi),
    "deg/s^2": ("angular_acceleration", _DEG),
    "rad/sqrt(s)": ("angle_random_walk", 1.0),
    "deg/sqrt(h)": ("angle_random_walk", _DEG / 60),
    "deg/s/sqrt(Hz)": ("angle_random_walk", _DEG),
    "deg/s/g": ("g_sensitivity", _DEG / STANDARD_GRAVITY_M_S2),
    "m/s^2": ("acceleration", 1.0),
    "g": ("acceleration", STANDARD_GRAVITY_M_S2),
    "mg": ("acceleration", STANDARD_GRAVITY_M_S2 * 1e-3),
    "ug": ("acceleration", STANDARD_GRAVITY_M_S2 * 1e-6),
    "m/s/sqrt(s)": ("velocity_random_walk", 1.0),
    "m/s/sqrt(h)": ("velocity_random_walk", 1 / 60),
    "ug/sqrt(Hz)": ("velocity_random_walk", STANDARD_GRAVITY_M_S2 * 1e-6),
    "T": ("magnetic_flux_density", 1.0),
    "uT": ("magnetic_flux_density", 1e-6),
    "gauss": ("magnetic_flux_density", 1e-4),
    "uT/sqrt(Hz)": ("magnetic_noise_density", 1e-6),
    "degC": ("temperature", 1.0),
    "degC/min": ("temperature_rate", 1 / 60),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "W": ("power", 1.0),
    "J": ("energy", 1.0),
    "A": ("current", 1.0),
    "mA": ("current", 1e-3),
    "ohm": ("resistance", 1.0),
    "Mohm": ("resistance", 1e6),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "Hz": ("frequency", 1.0),
    "m": ("length", 1.0),
    "m/s": ("speed", 1.0),
    "kg": ("mass", 1.0),
}

KNOWN_UNITS = tuple(_TABLE)


def is_known_unit(unit: str) -> bool:
    """True if `unit` is spelled as one of `KNOWN_UNITS`."""
    return unit in _TABLE


def quantity_of(unit: str) -> str:
    """The kind of quantity (VIM 1.2) that a unit measures.

    Raises:
        TestloomError: the unit is not known.
    """
    return _entry(unit)[0]


def factor_to_si(unit: str) -> float:
    """Multiply a value in `unit` by this to have it in SI.

    Raises:
        TestloomError: the unit is not known.
    """
    return _entry(unit)[1]


def conversion_factor(unit_from: str, unit_to: str) -> float:
    """Multiply a value in `unit_from` by this to have it in `unit_to`.

    Raises:
        TestloomError: a unit is not known, or the two measure different quantities.
    """
    quantity_from, factor_from = _entry(unit_from)
    quantity_to, factor_to = _entry(unit_to)
    if quantity_from != quantity_to:
        raise TestloomError(
            f"'{unit_from}' measures {quantity_from}, '{unit_to}' measures {quantity_to}: "
            "one cannot be converted into the other.",
            fault=Fault.DATA,
            remedy="correct the unit in the plan or in recording.json.",
        )
    return factor_from / factor_to


def _entry(unit: str) -> tuple[str, float]:
    try:
        return _TABLE[unit]
    except KeyError:
        raise TestloomError(
            f"The unit '{unit}' is not known.",
            fault=Fault.DATA,
            remedy=f"use one of: {', '.join(_TABLE)}.",
        ) from None

# pyright: strict
"""Geometry of a three-axis turntable and of what the Earth does to a unit on it. Pure functions.

Laboratory frame: z up, y at the azimuth `heading_deg` east of north, x to its right (east at heading 0).
At zero angles the body axes are the laboratory's, and

    C_body_from_lab = Rx(inner) · Ry(middle) · Rz(outer)

with passive rotations (coordinates turn), Rz(a) = [[cos a, sin a, 0], [−sin a, cos a, 0], [0, 0, 1]]. Angles
are (n, 3): outer, middle, inner, in rad. So body x points up at middle = −90°.
"""

import numpy as np
from numpy.typing import NDArray

from protocol.bench_description import Site

FloatArray = NDArray[np.float64]

EARTH_RATE_RAD_S = 7.292115e-5
"""WGS 84 (NIMA TR8350.2, table 3.1)."""
FIELD_EAST_NORTH_UP_T = (-1.5e-6, 27.0e-6, -45.0e-6)
"""Flux density of a quiet laboratory at mid latitude, of the order of what the IGRF gives for 34° N."""


def dcm_body_from_lab(angles_rad: FloatArray) -> FloatArray:
    """(n, 3) gimbal angles → (n, 3, 3)."""
    outer, middle, inner = angles_rad.T
    so, co, sm, cm, si, ci = _sines(outer, middle, inner)
    rows = [
        [co * cm, so * cm, -sm],
        [co * sm * si - so * ci, so * sm * si + co * ci, cm * si],
        [co * sm * ci + so * si, so * sm * ci - co * si, cm * ci],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


class Attitude:
    """Poses (n, 3) whose sines are worked out once, for several vectors."""

    def __init__(self, angles_rad: FloatArray) -> None:
        self._like = angles_rad
        self._sines = _sines(*angles_rad.T)

    def into_body(self, vector_lab: FloatArray) -> FloatArray:
        """One laboratory vector (3,) in body axes at each pose: (n, 3). Cheaper than the matrices."""
        so, co, sm, cm, si, ci = self._sines
        x, y, z = vector_lab
        x1, y1 = co * x + so * y, co * y - so * x
        z2 = sm * x1 + cm * z
        body = np.empty_like(self._like)
        body[:, 0], body[:, 1], body[:, 2] = cm * x1 - sm * z, ci * y1 + si * z2, ci * z2 - si * y1
        return body

    def up(self, length: float) -> FloatArray:
        """A laboratory vector of this length along z in body axes: (n, 3)."""
        _, _, sm, cm, si, ci = self._sines
        along = length * cm
        body = np.empty_like(self._like)
        body[:, 0], body[:, 1], body[:, 2] = -length * sm, si * along, ci * along
        return body

    def body_rate(self, gimbal_rates: FloatArray) -> FloatArray:
        """(n, 3) rate of the body relative to the laboratory, in body axes, in the gimbals' unit.

        ω = Rx Ry e_z ȯ + Rx e_y ṁ + e_x i̇: each axis turns in the frame that it carries.
        """
        _, _, sm, cm, si, ci = self._sines
        o, m, i = gimbal_rates.T
        across = cm * o
        rate = np.empty_like(self._like)
        rate[:, 0], rate[:, 1], rate[:, 2] = i - sm * o, ci * m + si * across, ci * across - si * m
        return rate


def into_body(vector_lab: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """One laboratory vector (3,) in body axes at each pose: (n, 3)."""
    return Attitude(angles_rad).into_body(vector_lab)


def body_rate_rad_s(angles_rad: FloatArray, rates_rad_s: FloatArray) -> FloatArray:
    """(n, 3) rate of the body relative to the laboratory, in body axes, from gimbal angles and rates."""
    return Attitude(angles_rad).body_rate(rates_rad_s)


def body_acceleration_rad_s2(
    angles_rad: FloatArray, rates_rad_s: FloatArray, accelerations_rad_s2: FloatArray
) -> FloatArray:
    """(n, 3) time derivative of `body_rate_rad_s` in body axes."""
    _, _, sm, cm, si, ci = _sines(*angles_rad.T)
    o, m, i = rates_rad_s.T
    oo, mm, ii = accelerations_rad_s2.T
    result = np.empty_like(angles_rad)
    result[:, 0] = ii - cm * m * o - sm * oo
    result[:, 1] = ci * mm - si * i * m + (ci * cm * i - si * sm * m) * o + si * cm * oo
    result[:, 2] = -si * mm - ci * i * m - (si * cm * i + ci * sm * m) * o + ci * cm * oo
    return result


def lever_arm_force_m_s2(
    rate_rad_s: FloatArray, acceleration_rad_s2: FloatArray, arm_m: FloatArray
) -> FloatArray:
    """(n, 3) specific force that turning adds at an arm (3,) from the centre: ω × (ω × r) + ω̇ × r."""
    arm = np.broadcast_to(arm_m, rate_rad_s.shape)
    return np.cross(rate_rad_s, np.cross(rate_rad_s, arm)) + np.cross(acceleration_rad_s2, arm)


def lab_from_east_north_up(vector_enu: FloatArray, heading_deg: float) -> FloatArray:
    """A vector (3,) given east, north, up, in laboratory axes."""
    sine, cosine = np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg))
    east, north, up = vector_enu
    return np.array([cosine * east - sine * north, sine * east + cosine * north, up])


def earth_rate_lab_rad_s(site: Site) -> FloatArray:
    """(3,) Earth rate in laboratory axes."""
    latitude = np.radians(site.latitude_deg)
    enu = EARTH_RATE_RAD_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    return lab_from_east_north_up(enu, site.heading_deg)


def specific_force_lab_m_s2(site: Site) -> FloatArray:
    """(3,) of a unit at rest: up."""
    return np.array([0.0, 0.0, site.gravity_m_s2])


def field_lab_t(site: Site) -> FloatArray:
    """(3,) magnetic flux density in laboratory axes."""
    return lab_from_east_north_up(np.array(FIELD_EAST_NORTH_UP_T), site.heading_deg)


def _sines(outer: FloatArray, middle: FloatArray, inner: FloatArray) -> tuple[FloatArray, ...]:
    return np.sin(outer), np.cos(outer), np.sin(middle), np.cos(middle), np.sin(inner), np.cos(inner)

# pyright: strict
"""An epoch of the receiver as it sends it: NAV-PVT, GGA, RMC. Where the antenna stands is at the origin.

Bench time 0 is 1 January 2026, 00:00 UTC; GPS time is 18 s ahead of UTC.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.motion.gravity import FLATTENING, SEMI_MAJOR_AXIS_M
from dut_emulator.products.gnc_module.gnss_receiver import Fixes
from protocol.gnc_module import (
    GNSS_ANTENNA_HEIGHT_M,
    GNSS_ANTENNA_LATITUDE_DEG,
    GNSS_ANTENNA_LONGITUDE_DEG,
    GnssProtocol,
)
from protocol.gnss.nmea import Gga, Rmc, gga_bytes, rmc_bytes
from protocol.gnss.ubx import NavPvt, nav_pvt_bytes

FloatArray = NDArray[np.float64]

LEAP_SECONDS = 18
_YEAR, _TOW_AT_START_S = 2026, 4 * 86_400  # a Thursday
_WEEK_S, _DAY_S = 604_800, 86_400
GEOID_SEPARATION_M = -35.0
"""Height of the geoid above the ellipsoid at the roof's antenna, of the order of EGM96's there."""
_ITERATIONS = 6


def geodetic_of(
    position_m: FloatArray, latitude_rad: float, longitude_rad: float, height_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """East, north, up (n, 3) of an origin → latitude, longitude (rad) and height (m), WGS 84, (n,) each."""
    square = FLATTENING * (2 - FLATTENING)
    sin_o, cos_o = math.sin(latitude_rad), math.cos(latitude_rad)
    normal_o = SEMI_MAJOR_AXIS_M / math.sqrt(1 - square * sin_o**2)
    east, north, up = position_m.T
    # in the origin's meridian plane (p, z), and e out of it
    p = (normal_o + height_m) * cos_o + up * cos_o - north * sin_o
    z = (normal_o * (1 - square) + height_m) * sin_o + up * sin_o + north * cos_o
    distance = np.hypot(p, east)
    latitude = np.arctan2(z, distance * (1 - square))
    for _ in range(_ITERATIONS):  # each gains a factor of e² h / N: 1e-9 rad after two
        normal = SEMI_MAJOR_AXIS_M / np.sqrt(1 - square * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + square * normal * np.sin(latitude), distance)
    normal = SEMI_MAJOR_AXIS_M / np.sqrt(1 - square * np.sin(latitude) ** 2)
    height = (
        distance * np.cos(latitude) + z * np.sin(latitude) - normal * (1 - square * np.sin(latitude) ** 2)
    )
    return latitude, longitude_rad + np.arctan2(east, p), height


def epoch_bytes(fixes: Fixes, row: int, protocols: int) -> bytes:
    """What the receiver sends of one epoch. `protocols`: bits of `GnssProtocol`."""
    fix = nav_pvt_of(fixes, row)
    data = b""
    if protocols & GnssProtocol.UBX:
        data += nav_pvt_bytes(fix)
    if protocols & GnssProtocol.NMEA:
        data += gga_bytes(_gga(fix)) + rmc_bytes(_rmc(fix))
    return data


def nav_pvt_of(fixes: Fixes, row: int) -> NavPvt:
    """Without a fix all figures are 0 and the accuracies as large as can be said."""
    time_s = float(fixes.time_s[row])
    whole = math.floor(time_s)
    month, day, seconds = _calendar(whole)
    fixed = bool(fixes.fix_type[row])
    origin = math.radians(GNSS_ANTENNA_LATITUDE_DEG), math.radians(GNSS_ANTENNA_LONGITUDE_DEG)
    latitude, longitude, height = geodetic_of(fixes.position_m[row : row + 1], *origin, GNSS_ANTENNA_HEIGHT_M)
    east, north, up = (float(v) if fixed else 0.0 for v in fixes.velocity_m_s[row])
    deviation = fixes.deviation_m[row]
    return NavPvt(
        time_of_week_ms=round((_TOW_AT_START_S + LEAP_SECONDS + time_s) % _WEEK_S * 1000),
        **{"year": _YEAR, "month": month, "day": day},
        **{"hour": seconds // 3600, "minute": seconds // 60 % 60, "second": seconds % 60},
        nanosecond=round((time_s - whole) * 1e9),
        fix_type=int(fixes.fix_type[row]),
        satellites_used=int(fixes.satellites_used[row]),
        longitude_rad=float(longitude[0]) if fixed else 0.0,
        latitude_rad=float(latitude[0]) if fixed else 0.0,
        height_m=float(height[0]) if fixed else 0.0,
        height_above_sea_m=float(height[0]) - GEOID_SEPARATION_M if fixed else 0.0,
        horizontal_accuracy_m=math.hypot(deviation[0], deviation[1]) if fixed else 4e6,
        vertical_accuracy_m=float(deviation[2]) if fixed else 4e6,
        velocity_north_m_s=north,
        velocity_east_m_s=east,
        velocity_down_m_s=-up,
        speed_accuracy_m_s=0.1 if fixed else 1e5,
        position_dop=float(fixes.position_dop[row]) if fixed else 99.99,
        time_accuracy_s=20e-9 if fixed else 1.0,
    )


def _time_of_day_s(fix: NavPvt) -> float:
    return fix.hour * 3600 + fix.minute * 60 + fix.second + fix.nanosecond * 1e-9


def _gga(fix: NavPvt) -> Gga:
    if not fix.fix_type:
        return Gga(_time_of_day_s(fix), None, None, 0, fix.satellites_used, None, None, None)
    return Gga(
        _time_of_day_s(fix),
        fix.latitude_rad,
        fix.longitude_rad,
        1,
        fix.satellites_used,
        fix.position_dop,
        fix.height_above_sea_m,
        GEOID_SEPARATION_M,
    )


def _rmc(fix: NavPvt) -> Rmc:
    date, time = (fix.day, fix.month, fix.year % 100), _time_of_day_s(fix)
    if not fix.fix_type:
        return Rmc(time, False, None, None, None, None, date)
    speed, course = fix.ground_speed_m_s, fix.heading_of_motion_rad
    return Rmc(time, True, fix.latitude_rad, fix.longitude_rad, speed, course, date)


def _calendar(seconds: int) -> tuple[int, int, int]:
    """Month, day and second of the day; after a year it begins again."""
    day, rest = divmod(seconds % (365 * _DAY_S), _DAY_S)
    for month, length in enumerate((31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31), 1):
        if day < length:
            return month, day + 1, rest
        day -= length
    raise AssertionError("a year has twelve months")

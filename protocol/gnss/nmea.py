# pyright: strict
"""NMEA 0183: a receiver's sentences GGA (fix) and RMC (least recommended data), as they are on the wire.

The sentence with its checksum is pynmeagps's. Its fields are written here: pynmeagps 1.1 leaves no numeric
field empty (a receiver without a fix does) and can write 60.00000 minutes. Source: NMEA 0183 version 4.10 as
u-blox UBX-13003221, section 31, gives it. None is an empty field.

Out of scope: other sentences, RMC's magnetic variation (receivers leave it empty), and reading, which is a
client's (`pynmeagps.NMEAReader`).
"""

import math
from dataclasses import dataclass

from pynmeagps import GET, NMEAMessage  # pyright: ignore[reportMissingTypeStubs]

KNOT_M_S = 1852.0 / 3600.0
_TALKER = "GN"
_MINUTE_DIGITS = 5


@dataclass(frozen=True)
class Gga:
    """A fix. `time_of_day_s` is UTC; `quality`: 0 none, 1 autonomous, 2 differential."""

    time_of_day_s: float | None
    latitude_rad: float | None
    longitude_rad: float | None
    quality: int
    satellites_used: int
    horizontal_dop: float | None
    height_above_sea_m: float | None
    geoid_separation_m: float | None


@dataclass(frozen=True)
class Rmc:
    """Position, speed and date. `is_valid`: status A. `date`: day, month, year of the century."""

    time_of_day_s: float | None
    is_valid: bool
    latitude_rad: float | None
    longitude_rad: float | None
    ground_speed_m_s: float | None
    course_rad: float | None
    date: tuple[int, int, int] | None


def gga_bytes(fix: Gga) -> bytes:
    """The sentence GGA."""
    return _sentence(
        "GGA",
        _clock(fix.time_of_day_s),
        *_angle(fix.latitude_rad, 2, "NS"),
        *_angle(fix.longitude_rad, 3, "EW"),
        str(fix.quality),
        f"{fix.satellites_used:02d}",
        _number(fix.horizontal_dop, 2),
        *(_number(fix.height_above_sea_m, 3), "M"),
        *(_number(fix.geoid_separation_m, 1), "M"),
        *("", ""),
    )


def rmc_bytes(fix: Rmc) -> bytes:
    """The sentence RMC, of NMEA 4.10 (mode and navigational status at its end)."""
    speed = None if fix.ground_speed_m_s is None else fix.ground_speed_m_s / KNOT_M_S
    course = None if fix.course_rad is None else math.degrees(fix.course_rad) % 360.0
    return _sentence(
        "RMC",
        _clock(fix.time_of_day_s),
        "A" if fix.is_valid else "V",
        *_angle(fix.latitude_rad, 2, "NS"),
        *_angle(fix.longitude_rad, 3, "EW"),
        _number(speed, 3),
        _number(course, 2),
        "" if fix.date is None else "".join(f"{part:02d}" for part in fix.date),
        *("", ""),
        "A" if fix.is_valid else "N",
        "V",
    )


def _sentence(kind: str, *fields: str) -> bytes:
    return NMEAMessage(_TALKER, kind, GET, payload=list(fields)).serialize()


def _clock(seconds: float | None) -> str:
    """hhmmss.ss; rounded first, so that 59.999 s does not become 60."""
    if seconds is None:
        return ""
    hundredths = round(seconds * 100) % 8_640_000
    minutes, rest = divmod(hundredths, 6000)
    return f"{minutes // 60:02d}{minutes % 60:02d}{rest // 100:02d}.{rest % 100:02d}"


def _angle(angle_rad: float | None, width: int, hemispheres: str) -> tuple[str, str]:
    """Degrees and minutes, and the hemisphere; rounded first, so that minutes stay below 60."""
    if angle_rad is None:
        return "", ""
    unit = 10**_MINUTE_DIGITS
    parts = round(math.degrees(abs(angle_rad)) * 60 * unit)
    degrees, minutes = divmod(parts, 60 * unit)
    text = f"{degrees:0{width}d}{minutes // unit:02d}.{minutes % unit:0{_MINUTE_DIGITS}d}"
    return text, hemispheres[int(angle_rad < 0)]


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"

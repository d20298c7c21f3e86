# pyright: strict
"""NMEA 0183: a receiver's sentences GGA (fix) and RMC (least recommended data).

    $ talker kind , field , … * checksum CR LF

The checksum is the exclusive-or of all characters between '$' and '*', in two hexadecimal digits. Source:
NMEA 0183 version 4.10 as u-blox UBX-13003221, section 31, gives it. An empty field is None.

Out of scope: other sentences, and RMC's magnetic variation (receivers leave it empty).
"""

import math
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

from protocol.errors import Fault, LinkError

MAX_SENTENCE_BYTES = 100
"""From '$' to line feed. The standard has 82; receivers with more decimals go a little beyond it."""
KNOT_M_S = 1852.0 / 3600.0
_MINUTE_DIGITS = 5


class NmeaSentence(NamedTuple):
    """A sentence with a right checksum. `address`: talker and kind, such as 'GNGGA'."""

    address: str
    fields: tuple[str, ...]


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


def checksum(body: bytes) -> int:
    """Exclusive-or of all bytes between '$' and '*'."""
    return reduce(lambda one, other: one ^ other, body, 0)


def encode_nmea(sentence: NmeaSentence) -> bytes:
    """The sentence as it is on the wire."""
    body = ",".join((sentence.address, *sentence.fields)).encode("ascii")
    return b"$%s*%02X\r\n" % (body, checksum(body))


def parse_sentence(line: bytes) -> NmeaSentence:
    """The sentence in one line, with or without its line end.

    Raises:
        LinkError: no '$' or '*', a character that is none, or a wrong checksum.
    """
    body, star, given = line.strip(b"\r\n").removeprefix(b"$").rpartition(b"*")
    printable = all(0x20 <= byte < 0x7F for byte in body)
    if not (line.startswith(b"$") and star and len(given) == 2 and printable):
        raise _refused("This is no NMEA sentence", line)
    if given.upper() != b"%02X" % checksum(body):
        raise _refused(f"The checksum is {given!r}, not {checksum(body):02X}", line)
    address, *fields = body.decode("ascii").split(",")
    return NmeaSentence(address, tuple(fields))


def gga_sentence(fix: Gga, talker: str = "GN") -> NmeaSentence:
    """The sentence GGA."""
    return NmeaSentence(
        f"{talker}GGA",
        (
            _clock(fix.time_of_day_s),
            *_angle(fix.latitude_rad, 2, "NS"),
            *_angle(fix.longitude_rad, 3, "EW"),
            str(fix.quality),
            f"{fix.satellites_used:02d}",
            _number(fix.horizontal_dop, 2),
            *(_number(fix.height_above_sea_m, 3), "M"),
            *(_number(fix.geoid_separation_m, 1), "M"),
            *("", ""),
        ),
    )


def decode_gga(sentence: NmeaSentence) -> Gga:
    """Raises LinkError: another sentence, or a field that cannot be read."""
    f = _fields(sentence, "GGA", 14)
    try:
        return Gga(
            _seconds(f[0]),
            _radians(f[1], f[2], 2, "NS"),
            _radians(f[3], f[4], 3, "EW"),
            int(f[5]),
            int(f[6] or 0),
            _optional(f[7]),
            _optional(f[8]),
            _optional(f[10]),
        )
    except ValueError as error:
        raise _refused(f"A field cannot be read: {error}", ",".join(sentence.fields).encode()) from None


def rmc_sentence(fix: Rmc, talker: str = "GN") -> NmeaSentence:
    """The sentence RMC, of NMEA 4.10 (mode and navigational status at its end)."""
    speed = None if fix.ground_speed_m_s is None else fix.ground_speed_m_s / KNOT_M_S
    course = None if fix.course_rad is None else math.degrees(fix.course_rad) % 360.0
    return NmeaSentence(
        f"{talker}RMC",
        (
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
        ),
    )


def decode_rmc(sentence: NmeaSentence) -> Rmc:
    """Raises LinkError: another sentence, or a field that cannot be read."""
    f = _fields(sentence, "RMC", 10)
    try:
        speed, course, date = _optional(f[6]), _optional(f[7]), f[8]
        return Rmc(
            _seconds(f[0]),
            f[1] == "A",
            _radians(f[2], f[3], 2, "NS"),
            _radians(f[4], f[5], 3, "EW"),
            None if speed is None else speed * KNOT_M_S,
            None if course is None else math.radians(course),
            (int(date[0:2]), int(date[2:4]), int(date[4:6])) if date else None,
        )
    except ValueError as error:
        raise _refused(f"A field cannot be read: {error}", ",".join(sentence.fields).encode()) from None


def _fields(sentence: NmeaSentence, kind: str, least: int) -> tuple[str, ...]:
    if sentence.address[2:] != kind or len(sentence.fields) < least:
        raise _refused(f"This is no {kind} of {least} fields", sentence.address.encode())
    return sentence.fields


def _clock(seconds: float | None) -> str:
    """hhmmss.ss; rounded first, so that 59.999 s does not become 60."""
    if seconds is None:
        return ""
    hundredths = round(seconds * 100) % 8_640_000
    minutes, rest = divmod(hundredths, 6000)
    return f"{minutes // 60:02d}{minutes % 60:02d}{rest // 100:02d}.{rest % 100:02d}"


def _seconds(text: str) -> float | None:
    return int(text[0:2]) * 3600 + int(text[2:4]) * 60 + float(text[4:]) if text else None


def _angle(angle_rad: float | None, width: int, hemispheres: str) -> tuple[str, str]:
    """Degrees and minutes, and the hemisphere; rounded first, so that minutes stay below 60."""
    if angle_rad is None:
        return "", ""
    unit = 10**_MINUTE_DIGITS
    parts = round(math.degrees(abs(angle_rad)) * 60 * unit)
    degrees, minutes = divmod(parts, 60 * unit)
    text = f"{degrees:0{width}d}{minutes // unit:02d}.{minutes % unit:0{_MINUTE_DIGITS}d}"
    return text, hemispheres[int(angle_rad < 0)]


def _radians(text: str, hemisphere: str, width: int, hemispheres: str) -> float | None:
    if not text:
        return None
    degrees = int(text[:width]) + float(text[width:]) / 60
    return math.radians(degrees) * (1 - 2 * hemispheres.index(hemisphere))


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _optional(text: str) -> float | None:
    return float(text) if text else None


def _refused(what: str, line: bytes) -> LinkError:
    return LinkError(
        f"{what}.",
        where=f"NMEA sentence {line[:MAX_SENTENCE_BYTES].decode('ascii', 'backslashreplace')!r}",
        fault=Fault.UNIT,
        remedy="check the link's rate, and which sentences the receiver is set to send.",
    )

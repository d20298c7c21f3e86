"""A receiver's bytes: the printed layout of NAV-PVT, and what libraries that others use read in them."""

import dataclasses
import datetime
import io
import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pyubx2 import UBXReader

from protocol.errors import LinkError
from protocol.gnss import nmea, ubx
from protocol.gnss.nmea import Gga, Rmc
from protocol.gnss.ubx import NavPvt

FIX = NavPvt(
    time_of_week_ms=345_600_200,
    year=2026,
    month=1,
    day=1,
    hour=0,
    minute=0,
    second=0,
    nanosecond=200_000_000,
    fix_type=3,
    satellites_used=11,
    longitude_rad=math.radians(108.9),
    latitude_rad=math.radians(-34.2),
    height_m=430.0,
    height_above_sea_m=455.5,
    horizontal_accuracy_m=1.25,
    vertical_accuracy_m=2.5,
    velocity_north_m_s=-3.0,
    velocity_east_m_s=4.0,
    velocity_down_m_s=0.125,
    speed_accuracy_m_s=0.05,
    position_dop=1.31,
)


def fletcher(data: bytes) -> bytes:
    """RFC 1145, as the loop that the receiver description prints."""
    a = b = 0
    for byte in data:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return bytes((a, b))


def test_nav_pvt_lies_where_its_description_says() -> None:
    """Offsets and scales of UBX-13003221, 32.17.15, field by field."""
    frame = ubx.nav_pvt_bytes(FIX)
    assert frame[:6] == bytes.fromhex("B5 62 01 07 5C 00")
    assert frame[-2:] == fletcher(frame[2:-2])
    payload = frame[6:-2]
    assert len(payload) == 92

    def at(offset: int, code: str) -> int:
        return struct.unpack_from(f"<{code}", payload, offset)[0]

    assert at(0, "I") == 345_600_200
    assert (at(4, "H"), *payload[6:11]) == (2026, 1, 1, 0, 0, 0)
    assert at(16, "i") == 200_000_000
    assert (payload[20], payload[21] & 1, payload[23]) == (3, 1, 11)
    assert (at(24, "i"), at(28, "i")) == (1_089_000_000, -342_000_000)
    assert (at(32, "i"), at(36, "i"), at(40, "I"), at(44, "I")) == (430_000, 455_500, 1250, 2500)
    assert [at(offset, "i") for offset in (48, 52, 56, 60)] == [-3000, 4000, 125, 5000]
    assert at(64, "i") == round((180 - math.degrees(math.atan2(4, 3))) * 1e5)
    assert (at(68, "I"), at(76, "H")) == (50, 131)
    no_fix = ubx.nav_pvt_bytes(dataclasses.replace(FIX, fix_type=0))[6:]
    assert (no_fix[20], no_fix[21]) == (0, 0)


degrees_1e7 = st.integers(-(10**9), 10**9)
millimetres = st.integers(-(10**7), 10**7)


@given(
    degrees_1e7, degrees_1e7, millimetres, millimetres, millimetres, st.integers(0, 5), st.integers(0, 255)
)
def test_a_library_reads_nav_pvt_as_it_was_meant(
    longitude: int, latitude: int, height: int, north: int, down: int, fix: int, used: int
) -> None:
    said = dataclasses.replace(
        FIX,
        longitude_rad=math.radians(longitude * 1e-7),
        latitude_rad=math.radians(latitude * 1e-7),
        height_m=height * 1e-3,
        velocity_north_m_s=north * 1e-3,
        velocity_down_m_s=down * 1e-3,
        fix_type=fix,
        satellites_used=used,
    )
    read: Any = UBXReader.parse(ubx.nav_pvt_bytes(said))
    assert read.identity == "NAV-PVT"
    assert (read.fixType, read.gnssFixOk, read.numSV) == (fix, int(fix > 0), used)
    assert (read.lon, read.lat) == pytest.approx((longitude * 1e-7, latitude * 1e-7), abs=1e-9)
    assert (read.height, read.hMSL, read.hAcc, read.vAcc) == (height, 455_500, 1250, 2500)
    assert (read.velN, read.velE, read.velD, read.sAcc) == (north, 4000, down, 50)
    assert read.gSpeed == round(math.hypot(north, 4000))
    heading = math.degrees(math.atan2(4000, north)) % 360
    assert read.headMot == pytest.approx(heading, abs=0.6e-5)
    assert (read.pDOP, read.nano, read.fullyResolved) == (1.31, 200_000_000, 1)


def test_what_cannot_be_said_is_refused() -> None:
    for wrong in ({"height_m": math.nan}, {"height_m": 3e6}, {"satellites_used": 256}):
        with pytest.raises(LinkError, match="cannot be said"):
            ubx.nav_pvt_bytes(dataclasses.replace(FIX, **wrong))


@settings(max_examples=50)
@given(
    st.integers(0, 8_639_999),
    st.floats(-90, 90),
    st.floats(-180, 180),
    st.integers(0, 99),
    millimetres,
)
def test_a_library_reads_sentences_as_they_were_meant(
    hundredths: int, latitude: float, longitude: float, used: int, height: int
) -> None:
    place = math.radians(latitude), math.radians(longitude)
    wire = nmea.gga_bytes(Gga(hundredths / 100, *place, 1, used, 1.31, height * 1e-3, -12.5))
    assert len(wire) <= 82 + 7  # more decimals than the standard's line has room for
    gga: Any = NMEAReader.parse(wire)
    assert gga.identity == "GNGGA"
    assert seconds(gga.time) == pytest.approx(hundredths / 100, abs=1e-6)
    assert (gga.lat, gga.lon) == pytest.approx((latitude, longitude), abs=0.51 * MINUTE)
    assert (gga.quality, gga.numSV, gga.HDOP, gga.alt, gga.sep) == (1, used, 1.31, height / 1000, -12.5)
    rmc: Any = NMEAReader.parse(nmea.rmc_bytes(Rmc(hundredths / 100, True, *place, 12.5, 1.0, (1, 2, 26))))
    assert (rmc.status, rmc.posMode, rmc.date) == ("A", "A", datetime.date(2026, 2, 1))
    assert (rmc.lat, rmc.lon) == pytest.approx((latitude, longitude), abs=0.51 * MINUTE)
    assert rmc.spd == pytest.approx(12.5 / 0.5144444, abs=6e-4)
    assert rmc.cog == pytest.approx(math.degrees(1.0), abs=0.0051)


MINUTE = 1e-5 / 60


def seconds(time: datetime.time) -> float:
    return time.hour * 3600 + time.minute * 60 + time.second + time.microsecond * 1e-6


def test_rounding_never_makes_sixty_minutes_or_seconds() -> None:
    north, west = math.radians(34.99999999999), math.radians(-108.99999999999)
    wire = nmea.gga_bytes(Gga(86_399.999, north, west, 1, 8, 0.9, 545.4, 46.9))
    assert wire.startswith(b"$GNGGA,000000.00,3500.00000,N,10900.00000,W,1,08,0.90,545.400,M,46.9,M,,*")
    assert b",001640.00," in nmea.gga_bytes(Gga(999.999, None, None, 0, 0, None, None, None))


def test_without_a_fix_fields_are_empty() -> None:
    gga: Any = NMEAReader.parse(nmea.gga_bytes(Gga(None, None, None, 0, 0, None, None, None)))
    assert (gga.time, gga.lat, gga.lon, gga.HDOP, gga.alt, gga.sep) == ("",) * 6
    rmc: Any = NMEAReader.parse(nmea.rmc_bytes(Rmc(1.5, False, None, None, None, None, None)))
    assert (rmc.status, rmc.posMode, rmc.lat, rmc.spd, rmc.cog, rmc.date) == ("V", "N", "", "", "", "")


def test_a_client_reads_both_protocols_from_one_stream() -> None:
    fix = Gga(1.0, 0.5, 1.9, 1, 8, 0.9, 545.4, 46.9)
    wire = ubx.nav_pvt_bytes(FIX) + nmea.gga_bytes(fix) + ubx.nav_pvt_bytes(FIX)
    reads: list[Any] = [read for _, read in UBXReader(io.BytesIO(wire))]
    assert [read.identity for read in reads] == ["NAV-PVT", "GNGGA", "NAV-PVT"]

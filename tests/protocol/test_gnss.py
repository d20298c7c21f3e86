"""Receiver codecs: published sentences and frames, the printed layout of NAV-PVT, and every round trip."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.errors import LinkError
from protocol.gnss import nmea, ubx
from protocol.gnss.nmea import Gga, NmeaSentence, Rmc
from protocol.gnss.stream import GnssStreamParser
from protocol.gnss.ubx import NavPvt, UbxFrame

GGA_LINE = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
RMC_LINE = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n"
"""The two sentences that every description of NMEA 0183 prints."""

PUBLISHED_FRAMES = [  # u-blox application notes and driver sources: CFG-MSG, CFG-RATE (5 Hz), MON-VER poll
    ("B5 62 06 01 03 00 01 07 01 13 51", (0x06, 0x01), bytes((1, 7, 1))),
    ("B5 62 06 08 06 00 C8 00 01 00 01 00 DE 6A", (0x06, 0x08), bytes((0xC8, 0, 1, 0, 1, 0))),
    ("B5 62 0A 04 00 00 0E 34", (0x0A, 0x04), b""),
]

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


def test_published_frames() -> None:
    for text, kind, payload in PUBLISHED_FRAMES:
        wire = bytes.fromhex(text)
        assert ubx.encode_ubx(UbxFrame(kind, payload)) == wire
        assert GnssStreamParser().feed(wire) == [UbxFrame(kind, payload)]


@given(st.binary(max_size=1024))
def test_the_checksum_is_fletchers(data: bytes) -> None:
    assert ubx.checksum(data) == fletcher(data)


def test_nav_pvt_lies_where_its_description_says() -> None:
    """Offsets and scales of UBX-13003221, 32.17.15, field by field."""
    payload = ubx.nav_pvt_frame(FIX).payload
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
    no_fix = ubx.nav_pvt_frame(NavPvt(**{**vars(FIX), "fix_type": 0})).payload
    assert (no_fix[20], no_fix[21]) == (0, 0)


angles = st.integers(-(10**9), 10**9).map(lambda n: math.radians(n * 1e-7))
lengths = st.integers(-(10**7), 10**7).map(lambda n: n * 1e-3)


@given(angles, angles, lengths, lengths, lengths, st.integers(0, 5), st.integers(0, 255))
def test_nav_pvt_there_and_back(
    longitude: float, latitude: float, height: float, north: float, down: float, fix: int, used: int
) -> None:
    said = NavPvt(
        **{
            **vars(FIX),
            "longitude_rad": longitude,
            "latitude_rad": latitude,
            "height_m": height,
            "velocity_north_m_s": north,
            "velocity_down_m_s": down,
            "fix_type": fix,
            "satellites_used": used,
        }
    )
    back = ubx.decode_nav_pvt(ubx.nav_pvt_frame(said))
    for name, value in vars(said).items():
        assert getattr(back, name) == pytest.approx(value, abs=1e-9), name


def test_what_cannot_be_said_or_read_is_refused() -> None:
    with pytest.raises(LinkError, match="cannot be said"):
        ubx.nav_pvt_frame(NavPvt(**{**vars(FIX), "height_m": math.nan}))
    with pytest.raises(LinkError, match="no NAV-PVT"):
        ubx.decode_nav_pvt(UbxFrame((1, 7), bytes(84)))
    with pytest.raises(LinkError, match="1025"):
        ubx.encode_ubx(UbxFrame((1, 7), bytes(1025)))
    with pytest.raises(LinkError, match="checksum"):
        nmea.parse_sentence(GGA_LINE.replace(b"545.4", b"545.5"))
    with pytest.raises(LinkError, match="no GGA"):
        nmea.decode_gga(nmea.parse_sentence(RMC_LINE))


def test_published_sentences() -> None:
    gga = nmea.decode_gga(nmea.parse_sentence(GGA_LINE))
    assert gga.time_of_day_s == 12 * 3600 + 35 * 60 + 19
    assert math.degrees(gga.latitude_rad or 0) == pytest.approx(48 + 7.038 / 60, abs=1e-12)
    assert math.degrees(gga.longitude_rad or 0) == pytest.approx(11 + 31 / 60, abs=1e-12)
    assert (gga.quality, gga.satellites_used) == (1, 8)
    assert (gga.horizontal_dop, gga.height_above_sea_m, gga.geoid_separation_m) == (0.9, 545.4, 46.9)
    rmc = nmea.decode_rmc(nmea.parse_sentence(RMC_LINE))
    assert rmc.is_valid
    assert rmc.ground_speed_m_s == pytest.approx(22.4 * 0.514444, rel=1e-6)
    assert math.degrees(rmc.course_rad or 0) == pytest.approx(84.4)
    assert rmc.date == (23, 3, 94)
    body = GGA_LINE.decode().strip("$\r\n").partition("*")[0].split(",")
    assert nmea.encode_nmea(NmeaSentence(body[0], tuple(body[1:]))) == GGA_LINE


hundredths = st.integers(0, 8_639_999).map(lambda n: n / 100)
minute = 1e-5 / 60


@given(hundredths, st.floats(-90, 90), st.floats(-180, 180), st.integers(0, 99), lengths)
def test_sentences_there_and_back(
    time: float, latitude: float, longitude: float, used: int, height: float
) -> None:
    gga = Gga(time, math.radians(latitude), math.radians(longitude), 1, used, 1.31, height, -12.5)
    wire = nmea.encode_nmea(nmea.gga_sentence(gga))
    assert len(wire) <= 82 + 7  # more decimals than the standard's line has room for
    back = nmea.decode_gga(nmea.parse_sentence(wire))
    assert math.degrees(back.latitude_rad or 0) == pytest.approx(latitude, abs=0.51 * minute)
    assert math.degrees(back.longitude_rad or 0) == pytest.approx(longitude, abs=0.51 * minute)
    assert back.time_of_day_s == pytest.approx(time, abs=1e-9)
    assert back.height_above_sea_m == pytest.approx(height, abs=1e-9)
    rmc = Rmc(time, True, math.radians(latitude), math.radians(longitude), 12.5, 1.0, (1, 2, 26))
    again = nmea.decode_rmc(nmea.parse_sentence(nmea.encode_nmea(nmea.rmc_sentence(rmc))))
    assert again.date == (1, 2, 26)
    assert again.ground_speed_m_s == pytest.approx(12.5, abs=0.0005 * 1852 / 3600 * 1.01)
    assert again.course_rad == pytest.approx(1.0, abs=math.radians(0.0051))


def test_empty_fields_are_none_both_ways() -> None:
    gga = Gga(None, None, None, 0, 0, None, None, None)
    assert nmea.decode_gga(nmea.parse_sentence(nmea.encode_nmea(nmea.gga_sentence(gga)))) == gga
    rmc = Rmc(None, False, None, None, None, None, None)
    assert nmea.decode_rmc(nmea.parse_sentence(nmea.encode_nmea(nmea.rmc_sentence(rmc)))) == rmc


pieces = st.one_of(
    st.binary(max_size=30).map(lambda noise: (noise, None)),
    st.sampled_from([ubx.nav_pvt_frame(FIX), UbxFrame((5, 1), b"$\xb5\x62\n")]).map(
        lambda frame: (ubx.encode_ubx(frame), frame)
    ),
    st.just((GGA_LINE, nmea.parse_sentence(GGA_LINE))),
)


@settings(max_examples=60)
@given(st.lists(pieces, max_size=12), st.integers(1, 40))
def test_a_stream_finds_its_way_through_noise(parts: list[tuple[bytes, object]], cut: int) -> None:
    """However it is cut, the same comes out, and every byte is either in it or counted as dropped."""
    wire = b"".join(part for part, _ in parts)
    whole, piecewise = GnssStreamParser(), GnssStreamParser()
    found = whole.feed(wire)
    assert [item for at in range(0, len(wire), cut) for item in piecewise.feed(wire[at : at + cut])] == found
    assert piecewise.statistics == whole.statistics
    sent = [item for _, item in parts if item is not None]
    if all(item is not None for _, item in parts):
        assert found == sent
        assert whole.statistics.dropped_bytes == 0


def test_a_damaged_frame_costs_itself_only() -> None:
    frame = ubx.encode_ubx(ubx.nav_pvt_frame(FIX))
    for at in range(len(frame)):
        damaged = bytearray(frame)
        damaged[at] ^= 0x10
        parser = GnssStreamParser()
        found = parser.feed(bytes(damaged) + GGA_LINE + frame + bytes(2000))
        assert found[-2:] == [nmea.parse_sentence(GGA_LINE), ubx.nav_pvt_frame(FIX)], at
        assert parser.statistics.dropped_bytes >= len(frame)

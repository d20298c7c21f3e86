"""The module's receiver: geometry and ephemeris by hand, latency and arm on known tracks, what it sends."""

import dataclasses
import datetime
import io
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import ERR_RAISE, UBXReader

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.dynamics import GnssClockStep, GnssLatency
from dut_emulator.effects.effect import Stimulus
from dut_emulator.effects.fields_and_tones import AntennaLeverArm
from dut_emulator.effects.slow_noise import Multipath
from dut_emulator.motion.satellite_profiles import (
    OFF_DBM,
    SatelliteSignals,
    Track,
    dcm_local_from_body,
    lines_of_sight,
)
from dut_emulator.products.gnc_module.gnss_messages import epoch_bytes, geodetic_of, nav_pvt_of
from dut_emulator.products.gnc_module.gnss_receiver import Fixes, GnssReceiver
from dut_emulator.products.gnc_module.gnss_solution import ephemeris_wait_s, geometry_of
from dut_emulator.products.gnc_module.unit_truth import GnssTruth
from dut_emulator.twin import Twin

PERFECT = GnssTruth(True, 12, (0.0, 0.0, 0.0), 0.0, 20e-9)
STRONG_DBM = -90.0
"""Forty dB above the sky's: ranges to centimetres."""


class Sky:
    """A receiver on a track, under signals whose power a test sets."""

    def __init__(self, track: Track, power_dbm: float = STRONG_DBM, count: int = 12) -> None:
        self.track, self.count = track, count
        self.power = lambda t: np.where(t >= 0, power_dbm, OFF_DBM)

    def stimulus(self, times_s: np.ndarray) -> Stimulus:
        position, _, heading = self.track.at(times_s)
        dcm = dcm_local_from_body(heading)
        temperature = np.full(len(times_s), 25.0)
        return Stimulus(times_s, temperature, math.nan, position_m=position, dcm_local_from_body=dcm)

    def signals(self, times_s: np.ndarray) -> SatelliteSignals:
        power = np.repeat(np.asarray(self.power(times_s), dtype=float)[:, None], self.count, axis=1)
        return SatelliteSignals(power, lines_of_sight(self.count), np.zeros(len(times_s)))


def received(
    sky: Sky, *effects: CatalogueEffect, to_s: float = 100.0, rate_hz: int = 10, truth: GnssTruth = PERFECT
) -> Fixes:
    receiver = GnssReceiver(truth, Twin("gnc_module", effects), np.random.SeedSequence(5), 0.0, sky)
    return receiver.fixes(np.arange(0, round(to_s * rate_hz) + 1) * (100 // rate_hz))


def heard_by_hand(phase: float) -> float:
    """Second by hundredth: when the last of subframes 1 to 3 that began after the phase has ended."""
    ends = []
    for subframe in (0, 1, 2):
        begin = 6.0 * subframe
        while begin < phase:
            begin += 30.0
        ends.append(begin + 6.0)
    return max(ends) - phase


@given(st.integers(0, 29_999).map(lambda n: n / 1000))
def test_the_ephemeris_takes_subframes_one_to_three_whole(phase: float) -> None:
    waited = float(ephemeris_wait_s(np.array([phase]))[0])
    assert waited == pytest.approx(heard_by_hand(phase), abs=1e-9)
    assert 18.0 - 1e-9 <= waited <= 36.0


def test_the_geometry_of_four_satellites_by_hand() -> None:
    """One overhead, three level, 120° apart: DOP east = north = √(2/3), up = √(1 + 1/3) (clock 1/√3)."""
    azimuth = np.radians([0.0, 120.0, 240.0])
    level = np.stack([np.sin(azimuth), np.cos(azimuth), np.zeros(3)], axis=1)
    sight = np.vstack([[0.0, 0.0, 1.0], level])
    found = geometry_of(sight, np.full(4, -130.0))
    range_noise_m = 0.6  # at 40 dB-Hz, which -130 dBm is over -174 + 2 + 2 dBm/Hz
    expected = range_noise_m * np.sqrt([2 / 3, 2 / 3, 4 / 3])
    np.testing.assert_allclose(found.deviation_m, expected, rtol=1e-9)
    assert found.position_dop == pytest.approx(math.sqrt(8 / 3))
    np.testing.assert_allclose(geometry_of(sight, np.full(4, -110.0)).deviation_m, expected / 10, rtol=1e-9)
    assert [geometry_of(sight[:n], np.full(n, -130.0)).fix_type for n in (0, 2, 3, 4)] == [0, 0, 2, 3]
    assert geometry_of(np.tile(sight[:1], (5, 1)), np.full(5, -130.0)).fix_type == 0


def test_signals_that_go_and_come_back() -> None:
    sky = Sky(Track())
    sky.power = lambda t: np.select([t < 0, (t > 60) & (t < 70), t > 90], [OFF_DBM, -170.0, -155.0], -130.0)
    found = received(sky, to_s=120.0, rate_hz=1)
    fixed = found.time_s[found.fix_type == 3]
    assert 18.5 <= fixed[0] <= 39.0
    assert (found.fix_type[(found.time_s > 60) & (found.time_s < 71)] == 0).all()
    assert found.fix_type[found.time_s == 71] == 3  # found again within a second
    assert (found.fix_type[found.time_s > 72] == 3).all()  # −155 dBm is enough to track …
    cold = received(Sky(Track(), -155.0), to_s=120.0, rate_hz=1)
    assert (cold.fix_type == 0).all()  # … but not to begin
    assert np.isnan(cold.position_m).all()
    assert np.isnan(cold.pulse_error_s).all()
    dead = dataclasses.replace(PERFECT, acquires=False)
    assert (received(sky, to_s=60.0, rate_hz=1, truth=dead).satellites_used == 0).all()
    assert (received(Sky(Track(), count=0), to_s=60.0, rate_hz=1).fix_type == 0).all()


def test_a_receiver_that_was_on_before_knows_the_sky_but_not_what_begins_now() -> None:
    class Roof:
        stimulus = Sky(Track()).stimulus

    for place, earliest, latest in ((Roof(), 0.0, 0.0), (Sky(Track()), 18.5, 39.0)):
        receiver = GnssReceiver(PERFECT, Twin(), np.random.SeedSequence(2), -600.0, place)
        found = receiver.fixes(np.arange(0, 6000, 10))
        assert earliest <= found.time_s[found.fix_type == 3][0] <= latest


def test_latency_arm_and_clock_step_move_the_fix_as_they_should() -> None:
    """On a circle of 200 m at 30 m/s: 60 ms is 1.8 m behind, an arm 2 m forward is 2 m ahead."""
    track = Track(0.0, 100.0, 30.0, 40.0, 200.0, 10.0)
    latency, arm = GnssLatency("gnss", 0.06), AntennaLeverArm("gnss", (2.0, 0.0, 0.5))
    step = GnssClockStep("gnss", 0.5, 80.0)
    found = received(Sky(track), arm, latency, step, to_s=100.0)
    late_s = found.time_s - 0.06 - np.where(found.time_s >= 80.0, 0.5, 0.0)
    position, velocity, heading = track.at(late_s)
    expected = position + dcm_local_from_body(heading) @ [2.0, 0.0, 0.5]
    use = (found.time_s > 45) & (np.abs(found.time_s - 80.0) > 0.05)
    assert np.abs(found.position_m[use] - expected[use]).max() < 0.05
    turn = 2.0 * 30.0 / 200.0  # of the arm: ω × r
    across = np.stack([np.cos(heading), -np.sin(heading), np.zeros(len(heading))], axis=1)
    assert np.abs(found.velocity_m_s[use] - velocity[use] - turn * across[use]).max() < 0.02


def test_errors_have_the_size_that_is_stated() -> None:
    truth = dataclasses.replace(PERFECT, position_error_m=(3.0, -2.0, 5.0))
    found = received(Sky(Track(), -130.0), Multipath("gnss", (0.0, 0.0, 0.0)), to_s=800.0, truth=truth)
    use = found.time_s > 60
    np.testing.assert_allclose(found.position_m[use].std(axis=0), found.deviation_m[-1], rtol=0.04)
    np.testing.assert_allclose(found.position_m[use].mean(axis=0), [3.0, -2.0, 5.0], atol=0.05)
    np.testing.assert_allclose(found.velocity_m_s[use].std(axis=0), 0.03 * found.deviation_m[-1], rtol=0.04)
    pulse = found.pulse_error_s[use]
    assert pulse.mean() == pytest.approx(20e-9, abs=0.2e-9)
    assert pulse.std() == pytest.approx(2e-9, rel=0.05)
    assert np.hypot(*found.deviation_m[-1][:2]) < 10.0  # paper 1, Table 3: 10 m level, 15 m in height


@settings(max_examples=8)
@given(st.lists(st.integers(0, 600), max_size=4))
def test_pieces_are_the_whole(cuts: list[int]) -> None:
    effects = (
        AntennaLeverArm("gnss", (1.0, 0.0, 0.0)),
        Multipath("gnss", (1.0, 1.0, 1.0)),
        GnssLatency("gnss", 0.07),
    )
    sky = Sky(Track(40.0, 3.0, 20.0, 1.0, 50.0, 3.0), -130.0)
    whole = received(sky, *effects, to_s=60.0)
    receiver = GnssReceiver(PERFECT, Twin("gnc_module", effects), np.random.SeedSequence(5), 0.0, sky)
    edges = [0, *sorted(cuts), 601]
    parts = [receiver.fixes(np.arange(a, b) * 10) for a, b in pairwise(edges)]
    for name, values in vars(whole).items():
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, values, err_msg=name)


def ecef(latitude: float, longitude: float, height: float) -> np.ndarray:
    """WGS 84, from its two constants."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    n = a / math.sqrt(1 - e2 * math.sin(latitude) ** 2)
    level = (n + height) * math.cos(latitude)
    return np.array(
        [
            level * math.cos(longitude),
            level * math.sin(longitude),
            (n * (1 - e2) + height) * math.sin(latitude),
        ]
    )


@given(
    st.floats(-1.4, 1.4),
    st.floats(-3.0, 3.0),
    st.floats(-5e4, 5e4),
    st.floats(-5e4, 5e4),
    st.floats(-100, 9e3),
)
def test_local_positions_become_geodetic_ones(
    latitude: float, longitude: float, east: float, north: float, up: float
) -> None:
    """Back through ECEF and the rotation at the origin (Groves, eq. 2.150)."""
    found = geodetic_of(np.array([[east, north, up]]), latitude, longitude, 430.0)
    difference = ecef(*(float(value[0]) for value in found)) - ecef(latitude, longitude, 430.0)
    s, c, sl, cl = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    rotation = np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])
    np.testing.assert_allclose(rotation @ difference, [east, north, up], atol=2e-5)


def read(data: bytes) -> list[Any]:
    """Messages as a client reads them."""
    return [message for _, message in UBXReader(io.BytesIO(data), quitonerror=ERR_RAISE)]


def test_an_epoch_says_the_same_in_both_protocols() -> None:
    found = received(Sky(Track(0.0, 1.0, 25.0, 1e4, 1.0, 0.0)), to_s=70.0)
    fix, gga, rmc = read(epoch_bytes(found, 650, 3))
    assert (fix.year, fix.month, fix.day, fix.hour, fix.min, fix.second) == (2026, 1, 1, 0, 1, 5)
    time_of_week_ms = int.from_bytes(epoch_bytes(found, 650, 1)[6:10], "little")
    assert time_of_week_ms == (4 * 86_400 + 65 + 18) * 1000  # a Thursday; GPS is 18 s ahead
    assert fix.fixType == 3
    assert fix.velN == pytest.approx(25_000, abs=20)  # mm/s
    assert gga.lat == pytest.approx(fix.lat, abs=1.5e-7)
    assert gga.alt == pytest.approx(fix.hMSL * 1e-3, abs=2e-3)
    assert rmc.spd * 1852 / 3600 == pytest.approx(fix.gSpeed * 1e-3, abs=2e-3)
    assert rmc.date == datetime.date(2026, 1, 1)
    north_m = math.radians(fix.lat - 34.2) * 6_356_000  # the meridian's radius there, to 0.1 %
    assert north_m == pytest.approx(25 * 65 - 25**2 / 2, rel=2e-3)
    early = nav_pvt_of(found, 10)
    assert (early.fix_type, early.latitude_rad, early.horizontal_accuracy_m) == (0, 0.0, 4e6)
    lost, _ = read(epoch_bytes(found, 10, 2))
    assert (lost.quality, lost.lat) == (0, "")

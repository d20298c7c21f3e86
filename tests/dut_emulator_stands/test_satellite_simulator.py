"""A satellite simulator: its track against derivatives, its limits, and its port as it is operated."""

import math

import numpy as np
import pytest

from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.satellite_profiles import SignalSource, Track, dcm_local_from_body, lines_of_sight
from dut_emulator.stands.catalogue import live_stand, recording_stand
from dut_emulator.stands.recording_stand import LiveStand
from protocol.bench_description import Site
from protocol.errors import TestloomError

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797)
TRACK = Track(rest_s=10.0, acceleration_m_s2=2.0, speed_m_s=30.0, straight_s=20.0, radius_m=200.0, turns=1.0)


def values(profile: str, **given: float) -> dict[str, float]:
    return profile_named(profile).values(given)


def test_the_track_is_one_smooth_way_and_closes_its_circle() -> None:
    times = np.linspace(0.0, TRACK.duration_s, 40_001)
    position, velocity, heading = TRACK.at(times)
    step = times[1] - times[0]
    slope = (position[2:] - position[:-2]) / (2 * step)
    np.testing.assert_allclose(slope, velocity[1:-1], atol=2e-3)
    # by hand: 30²/(2·2) m to speed, 20 s of 30 m/s, then round
    corner = 225.0 + 600.0
    np.testing.assert_allclose(TRACK.at(np.array([TRACK.circle_from_s]))[0][0], [0.0, corner, 0.0], atol=1e-9)
    np.testing.assert_allclose(position[-1], [0.0, corner, 0.0], atol=1e-9)
    assert TRACK.duration_s == pytest.approx(10 + 15 + 20 + 2 * math.pi * 200 / 30)
    circle = times > TRACK.circle_from_s
    np.testing.assert_allclose(np.hypot(position[circle, 0] - 200, position[circle, 1] - corner), 200.0)
    forward = dcm_local_from_body(heading)[:, :, 0]
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1)[:, None] * forward, velocity, atol=1e-9)
    dcm = dcm_local_from_body(heading[::4000])
    np.testing.assert_allclose(dcm @ np.swapaxes(dcm, 1, 2), np.tile(np.eye(3), (len(dcm), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(dcm), 1.0)


def test_the_sky_is_well_spread_from_four_satellites_on() -> None:
    for count in range(4, 17):
        sight = lines_of_sight(count)
        np.testing.assert_allclose(np.linalg.norm(sight, axis=1), 1.0)
        design = np.column_stack([sight, np.ones(count)])
        assert math.sqrt(np.trace(np.linalg.inv(design.T @ design))) < 8.0, count  # GDOP


def test_the_unit_rests_while_its_receiver_is_told_to_move() -> None:
    stand = recording_stand("satellite_simulator", 3, SITE)
    run = stand.run("satellite_trajectory", values("satellite_trajectory"))
    acting = run.stimulus(np.array([0.0, run.duration_s]))
    np.testing.assert_allclose(acting.channel("specific_force_m_s2"), [[0, 0, 9.797]] * 2)
    assert acting.channel("position_m")[-1, 1] > 800
    read = run.reading(np.array([70.0]))
    assert set(read) == set(run.reading_units)
    assert read["velocity_north"][0] == pytest.approx(2.0 * 10)
    assert isinstance(run, SignalSource)
    heard = run.signals(np.array([-1.0, 0.0]))
    assert np.isneginf(heard.power_dbm[0]).all()
    assert np.abs(heard.power_dbm[1] + 130).max() < 0.91  # three deviations of 0.3 dB
    assert len(np.unique(heard.power_dbm[1])) == 12
    again = recording_stand("satellite_simulator", 3, SITE).run(
        "satellite_static", values("satellite_static")
    )
    assert isinstance(again, SignalSource)
    np.testing.assert_array_equal(again.signals(np.array([1.0])).power_dbm[0], heard.power_dbm[1])
    np.testing.assert_array_equal(run.trigger_times_s[:3], [0, 1, 2])


@pytest.mark.parametrize(
    ("profile", "given", "said", "remedy"),
    [
        ("satellite_trajectory", {"speed_m_s": 400.0}, "400.0 m/s is above", "up to 300"),
        ("satellite_trajectory", {"radius_m": 10.0}, "90.0 m/s^2 is above", "radius_m of 18"),
        ("satellite_trajectory", {"acceleration_m_s2": 60.0}, "60.0 m/s^2 is above", "up to 50"),
        ("satellite_static", {"power_dbm": -168.0}, "-168 dBm lies outside", "-165 to -115"),
        ("swing", {}, "cannot play 'swing'", "satellite_static"),
    ],
)
def test_what_is_beyond_the_limits_is_refused(
    profile: str, given: dict[str, float], said: str, remedy: str
) -> None:
    with pytest.raises(TestloomError) as refusal:
        recording_stand("satellite_simulator", 1, SITE).run(profile, values(profile, **given))
    assert said in refusal.value.what
    assert remedy in refusal.value.remedy


@pytest.fixture
def stand() -> LiveStand:
    return live_stand("satellite_simulator", 1, SITE, "GS-07")


def powers(stand: LiveStand, time_s: float) -> np.ndarray:
    assert isinstance(stand.surroundings, SignalSource)
    return stand.surroundings.signals(np.array([time_s])).power_dbm[0]


def test_a_scenario_is_loaded_played_and_stopped(stand: LiveStand) -> None:
    ask = stand.port.command
    assert ask("*IDN?", 0.0) == "Testloom,GS1,GS-07,1.0"
    assert ask("LIM?", 0.0) == "-165,-115,16,300,50"
    assert ask("CAL?", 0.0) == recording_stand("satellite_simulator", 1, SITE).identity.calibration_due
    assert ask("STAR", 0.0).startswith("ERR 16 ")
    assert ask("SCEN satellite_trajectory,rest_s=5,speed_m_s=10", 0.0).startswith("OK ")
    assert np.isneginf(powers(stand, 0.5)).all()
    assert ask("STAR", 1.0) == f"OK {5 + 5 + 20 + 40 * math.pi:.9f}"
    assert ask("STAR", 2.0).startswith("ERR 10 ")
    assert ask("SCEN satellite_static", 2.0).startswith("ERR 10 ")
    # at 8 s it is 7 s old: 2 s of 2 m/s² make 4 m and 4 m/s
    assert ask("STAT?", 8.0) == "PLAYING,12,7.000000,0.000000,4.000000,0.000000,4.000000"
    assert float(ask("PPS?", 8.25)) == pytest.approx(0.75)
    moved = stand.surroundings.stimulus(np.array([0.5, 8.0])).channel("position_m")
    np.testing.assert_allclose(moved, [[0, 0, 0], [0, 4, 0]], atol=1e-9)
    assert ask("STOP", 9.0) == "OK"
    assert ask("STAT?", 9.0).startswith("READY,0,")
    assert ask("PPS?", 9.0).startswith("ERR 16 ")
    # what was is still known: units ask about the last moments
    assert np.isfinite(powers(stand, 8.5)[:12]).all()
    assert np.isneginf(powers(stand, 9.5)).all()


def test_power_and_satellites_are_set_each(stand: LiveStand) -> None:
    ask = stand.port.command
    ask("SCEN satellite_static,duration_s=600", 0.0)
    ask("STAR", 0.0)
    full = powers(stand, 0.5)
    assert ask("POW 3,-150", 1.0) == "OK"
    assert ask("SATS 5", 2.0) == "OK"
    assert powers(stand, 1.5)[2] == pytest.approx(full[2] - 20)
    assert np.isfinite(powers(stand, 2.5)).sum() == 5
    assert ask("POW? 3", 3.0) == "-150.00"
    assert ask("POW -120", 3.0) == "OK"
    assert powers(stand, 3.5)[0] == pytest.approx(full[0] + 10)
    for line, code in (
        ("POW -170", 12),
        ("SATS 17", 12),
        ("POW 17,-130", 12),
        ("POW x", 2),
        ("POW", 2),
        ("GO", 1),
    ):
        assert ask(line, 4.0).startswith(f"ERR {code} "), line
    assert ask("SCEN satellite_static,power_dbm=-168", 1000.0).startswith("ERR 12 ")
    assert ask("SCEN satellite_static,speed=1", 1000.0).startswith("ERR 15 ")
    assert ask("SCEN satellite_static,duration_s", 1000.0).startswith("ERR 2 ")
    assert ask("STAT?", 1000.0).startswith("READY,0,")  # over by itself


def test_faults_are_seen_and_cleared(stand: LiveStand) -> None:
    ask = stand.port.command
    ask("SCEN satellite_static,duration_s=600", 0.0)
    ask("STAR", 0.0)
    stand.port.inject("no_signal", 10.0)
    assert ask("STAT?", 11.0).startswith("FAULT,0,")
    assert np.isneginf(powers(stand, 11.0)).all()
    stand.port.inject("none", 12.0)
    assert np.isfinite(powers(stand, 13.0)).sum() == 12
    stand.port.inject("reference_unlocked", 20.0)
    assert ask("REF?", 21.0) == "UNLOCKED"
    assert isinstance(stand.surroundings, SignalSource)
    late = stand.surroundings.signals(np.array([15.0, 30.0])).reference_error_s
    assert late[1] - late[0] == pytest.approx(1e-6)  # 1e-7 for 10 s
    ask("STOP", 31.0)
    assert ask("STAR", 32.0).startswith("ERR 11 ")
    stand.port.inject("none", 33.0)
    assert ask("STAR", 34.0).startswith("OK ")
    with pytest.raises(BenchModelError, match="door_open"):
        stand.port.inject("door_open", 35.0)


def test_the_stream_is_what_is_played_however_it_is_cut(stand: LiveStand) -> None:
    other = live_stand("satellite_simulator", 1, SITE, "GS-07")
    for one in (stand, other):
        one.port.command("SCEN satellite_trajectory,rest_s=1", 0.0)
        one.port.command("STRE ON,10", 0.0)
        one.port.command("STAR", 0.5)
    # the sample of the moment of a command is taken before it
    whole = stand.port.advance(4.0)
    assert b"".join(other.port.advance(t) for t in (0.55, 1.7, 4.0)) == whole
    rows = np.frombuffer(whole, "<f8").reshape(-1, 8)
    np.testing.assert_allclose(rows[:, 0], np.arange(41) / 10)
    np.testing.assert_array_equal(rows[:, 7], np.where(rows[:, 0] > 0.5, 12, 0))
    np.testing.assert_allclose(rows[:, 5], 2.0 * np.maximum(rows[:, 0] - 1.5, 0), atol=1e-9)
    assert stand.port.next_event_s() == pytest.approx(4.1)
    assert stand.port.command("STRE ON,1000", 4.0).startswith("ERR 2 ")
    assert stand.port.command("STRE OFF", 4.0) == "OK"
    assert stand.port.next_event_s() is None


def test_pulses_come_once_a_second_of_the_simulators_time(stand: LiveStand) -> None:
    line = stand.trigger_line
    assert line is not None
    assert line.next_edge_s(0.0) is None
    stand.port.command("SCEN satellite_static,duration_s=600", 0.0)
    stand.port.command("STAR", 0.25)
    first = line.next_edge_s(0.3)
    assert first == pytest.approx(1.25, abs=1e-8)  # some ns of its own error
    assert first is not None
    assert line.next_edge_s(first) == pytest.approx(first + 1.0, abs=1e-12)
    stand.port.inject("reference_unlocked", 100.5)
    far = line.next_edge_s(300.0)
    assert far == pytest.approx(first + 299.0 + 1e-7 * (300.25 - 100.5), abs=1e-10)
    assert line.next_edge_s(599.5) is None  # the scenario ends before the next

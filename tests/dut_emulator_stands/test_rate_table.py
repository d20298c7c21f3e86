"""The rate table of paper 4: kinematics in closed form, limits, the command port, its faults."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dut_emulator.effects.effect import name_of
from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.rate_table_profile import RateAxis
from dut_emulator.stands.rate_table import RateTableRun, live_stand, recording_stand
from dut_emulator.stands.rate_table_model import drawn_errors
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError
from protocol.stand_stream import STAND_SAMPLE_DTYPE

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=20.0)
EARTH_RATE = 7.292115e-5
VERTICAL_EARTH_RATE = EARTH_RATE * math.sin(math.radians(34.2))
BODY_AXES = np.eye(3)


def run(**values: float) -> RateTableRun:
    kind = profile_named("eleven_point")
    return recording_stand(1, SITE).run("eleven_point", kind.values(values))


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_each_body_axis_turns_at_the_eleven_rates(axis: int) -> None:
    """In a reading the input is R along the axis, plus Earth rate; along the vertical that is Ω sin φ."""
    one = run(axis=axis, cycles=2, full_scale_rate_deg_s=150.0)
    (points,) = one.events()
    begins, rates = points.columns["t"], points.columns["rate"]
    up = [-150, -120, -90, -60, -30, 0, 30, 60, 90, 120, 150]
    np.testing.assert_allclose(rates, (up + up[::-1]) * 2, atol=1e-12)
    for at_s in (begins, begins + points.columns["duration"] - 1e-6):
        acting = one.stimulus(at_s)
        turning = acting.rate_rad_s - acting.earth_rate_rad_s
        np.testing.assert_allclose(turning, np.radians(rates)[:, None] * BODY_AXES[axis - 1], atol=1e-13)
        np.testing.assert_allclose(acting.earth_rate_rad_s[:, axis - 1], VERTICAL_EARTH_RATE, rtol=1e-12)
        np.testing.assert_allclose(
            np.linalg.norm(acting.earth_rate_rad_s, axis=1), EARTH_RATE, rtol=1e-12, atol=0
        )
        np.testing.assert_allclose(acting.specific_force_m_s2[:, axis - 1], 9.797, rtol=1e-12)
        read = one.reading(at_s)
        np.testing.assert_allclose(read[f"rate_{'xyz'[axis - 1]}"], rates, atol=1e-4)  # no Earth rate in it


def test_a_run_takes_the_time_of_its_ramps_readings_and_tilts() -> None:
    """Per axis: 10 s of rest, 66 points of 2.5 s, 6 strokes of 200 °/s, from 0 down and back, at 50 °/s².

    Two tilts of 90° at 15 °/s and 30 °/s²: 90 / 15 + 15 / 30 s.
    """
    one = run()
    assert one.duration_s == pytest.approx(3 * (10 + 66 * 2.5 + (6 * 200 + 2 * 100) / 50) + 2 * 6.5)
    assert not one.reading(np.array([one.duration_s]))["rate_z"].any()


def test_the_table_is_locked_at_zero_and_nothing_jumps() -> None:
    one = run(axis=3, cycles=1)
    times_s = np.linspace(0.0, one.duration_s, 200_001)
    acting = one.stimulus(times_s)
    rate_deg_s = np.degrees(acting.rate_rad_s - acting.earth_rate_rad_s)[:, 2]
    (points,) = one.events()
    for begin_s in points.columns["t"][points.columns["rate"] == 0]:
        inside = (times_s >= begin_s) & (times_s <= begin_s + 2)
        assert (rate_deg_s[inside] == 0).all()
    step_s = times_s[1]
    assert np.abs(np.diff(rate_deg_s)).max() <= 50 * step_s * (1 + 1e-9)
    angle_deg = np.degrees(acting.angles_rad[:, 0])
    midpoints = (rate_deg_s[1:] + rate_deg_s[:-1]) / 2 * step_s  # exact but for the pieces with a corner
    np.testing.assert_allclose(np.diff(angle_deg), midpoints, atol=50 * step_s**2 / 4)


def test_static_is_the_locked_table() -> None:
    one = recording_stand(1, SITE).run("static", {"duration_s": 60.0})
    acting = one.stimulus(np.array([0.0, 30.0, 60.0]))
    heading = math.radians(20.0)
    north = EARTH_RATE * math.cos(math.radians(34.2))
    expected = [-north * math.sin(heading), north * math.cos(heading), VERTICAL_EARTH_RATE]
    np.testing.assert_allclose(acting.rate_rad_s, [expected] * 3, rtol=1e-12)
    assert one.duration_s == 60.0
    assert one.events() == ()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"full_scale_rate_deg_s": 1451.0}, "1451 deg/s is above the limit of 1450"),
        ({"full_scale_rate_deg_s": 24.0}, "4.8 deg/s is below the least rate of 5"),
        ({"acceleration_deg_s2": 201.0}, "acceleration 201 deg/s2 is not between 0 and 200"),
        ({"cycles": 2.5}, "cycles cannot be 2.5"),
        ({"axis": 1.5}, "axis cannot be 1.5"),
    ],
)
def test_what_the_table_cannot_do_is_refused_beforehand(values: dict[str, float], words: str) -> None:
    with pytest.raises(TestloomError, match="stand rate_table") as refused:
        run(**values)
    assert words in refused.value.what.replace("-", "")
    assert refused.value.fault is Fault.OPERATOR
    run(full_scale_rate_deg_s=1450.0, acceleration_deg_s2=200.0, cycles=1)
    run(full_scale_rate_deg_s=25.0, cycles=1)


def test_the_rates_of_many_tables_lie_inside_their_accuracy() -> None:
    """Uniform within ±1e-4, as paper 4 has it: standard deviation 1e-4 / √3."""
    shares = np.array([drawn_errors(seed)[0].share for seed in range(400)])
    assert np.abs(shares).max() < 1e-4
    assert shares.std() == pytest.approx(1e-4 / math.sqrt(3), rel=0.06)
    assert abs(shares.mean()) < 4 * 1e-4 / math.sqrt(3 * 400)
    of_gyro = {name_of(effect) for effect in drawn_errors(3) if effect.sensor == "gyro"}
    assert {"stand.rate_scale_factor", "stand.rate_ripple", "stand.remount_misalignment"} <= of_gyro
    assert (
        drawn_errors(3) == recording_stand(3, SITE).effects == live_stand(3, SITE, "T").surroundings.effects
    )


# --- the command port


def test_a_session_at_the_command_port() -> None:
    port = live_stand(1, SITE, "RT-7").port
    assert port.command("*IDN?", 0.0).split(",")[2] == "RT-7"
    assert port.command("LIM?", 0.0) == "5,1450,200"
    assert port.command("CAL?", 0.0) == recording_stand(1, SITE).identity.calibration_due
    assert port.command("RATE 100", 0.0).startswith("ERR 11 ")
    assert port.command("STAT?", 0.0).startswith("NOREF,")
    answer = port.command("HOME", 0.0)
    assert float(answer.removeprefix("OK ")) == pytest.approx(360 / 30 + 30 / 50)
    assert port.command("RATE 100", 1.0).startswith("ERR 10 ")
    assert port.command("STAT?", 20.0) == "LOCKED,0.000000,0.000000,0.000000,3,23.000000"
    for refused in ("RATE 4.99", "RATE -4.99", "RATE 1450.1", "RATE 100,201", "RATE 100,0", "RATE 100,-1"):
        assert port.command(refused, 20.0).startswith("ERR 12 "), refused
    for wrong in ("RATE", "RATE x", "RATE nan", "TILT 1,2", "STRE", "LOCK 1"):
        assert port.command(wrong, 20.0).startswith("ERR 2 "), wrong
    assert port.command("SPIN 3", 20.0).startswith("ERR 1 ")
    assert port.command("RATE 100", 20.0) == "OK 2.000000000"
    assert port.command("STAT?", 21.0) == "RAMPING,50.000000,100.000000,25.000000,3,23.000000"
    assert port.command("STAT?", 24.0) == "HOLDING,100.000000,100.000000,300.000000,3,23.000000"
    assert port.command("TILT 1", 24.0).startswith("ERR 16 ")
    assert port.command("RATE -50,100", 24.0) == "OK 1.500000000"
    assert port.command("lock", 30.0) == "OK 1.000000000"
    assert port.command("TILT 4", 32.0).startswith("ERR 15 ")
    assert port.command("TILT 1", 32.0) == "OK 6.500000000"
    assert port.command("STAT?", 35.0).startswith("TILTING,")
    assert port.command("STAT?", 35.0).split(",")[4] == "0"
    assert port.command("STAT?", 39.0).split(",")[::4] == ["LOCKED", "1"]


def _homed():
    stand = live_stand(1, SITE, "RT-7")
    stand.port.command("HOME", 0.0)
    return stand


def test_an_open_door_brakes_and_refuses_until_it_is_closed() -> None:
    stand = _homed()
    stand.port.command("RATE 100", 20.0)
    stand.port.inject("door_open", 25.0)
    assert stand.port.command("STAT?", 25.1).startswith("FAULT,80.000000,0.000000,")
    assert stand.port.command("RATE 10", 30.0).startswith("ERR 13 ")
    assert stand.port.command("TILT 1", 30.0).startswith("ERR 13 ")
    stand.port.inject("none", 31.0)
    assert stand.port.command("STAT?", 31.0).startswith("LOCKED,0.000000,")
    with pytest.raises(BenchModelError, match="rate_not_reached"):
        stand.port.inject("fire", 31.0)
    stand.port.command("TILT 2", 32.0)
    stand.port.inject("door_open", 34.0)
    stand.port.inject("none", 40.0)
    assert stand.port.command("STAT?", 40.0).split(",")[::4] == ["LOCKED", "0"]  # half-way up, and at rest
    stand.port.command("TILT 2", 40.0)
    assert stand.port.command("STAT?", 50.0).split(",")[::4] == ["LOCKED", "2"]


def test_a_weak_drive_says_that_it_falls_short() -> None:
    stand = _homed()
    stand.port.inject("rate_not_reached", 20.0)
    stand.port.command("RATE 100", 20.0)
    assert stand.port.command("STAT?", 30.0).startswith("SHORT,90.000000,100.000000,")
    acting = stand.surroundings.stimulus(np.array([30.0]))
    assert np.degrees(acting.rate_rad_s - acting.earth_rate_rad_s)[0, 2] == pytest.approx(90.0)
    stand.port.inject("none", 31.0)
    assert stand.port.command("STAT?", 32.0).startswith("HOLDING,100.000000,100.000000,")
    stand.port.inject("rate_not_reached", 33.0)
    assert stand.port.command("STAT?", 34.0).startswith("SHORT,90.000000,")


def test_a_lost_reference_has_to_be_found_again() -> None:
    stand = _homed()
    stand.port.command("RATE 100", 20.0)
    stand.port.inject("lost_reference", 25.0)
    assert stand.port.command("STAT?", 26.0).startswith("NOREF,0.000000,")
    assert stand.port.command("HOME", 26.0).startswith("ERR 14 ")
    stand.port.inject("none", 27.0)
    assert stand.port.command("RATE 10", 27.0).startswith("ERR 11 ")
    assert stand.port.command("HOME", 27.0).startswith("OK ")
    stand.port.command("STOP", 28.0)  # a search that is given up finds nothing
    assert stand.port.command("STAT?", 40.0).startswith("NOREF,0.000000,")


def test_stream_samples_are_the_encoders_reading_however_they_are_fetched() -> None:
    def streamed(stops_s: list[float]) -> bytes:
        stand = _homed()
        stand.port.command("STRE ON,50", 20.0)
        stand.port.command("RATE -30", 20.5)
        return b"".join(stand.port.advance(stop_s) for stop_s in stops_s)

    whole = streamed([25.0])
    assert whole == streamed([20.1, 20.5, 20.50001, 23.3, 25.0])
    rows = np.frombuffer(whole, dtype=STAND_SAMPLE_DTYPE)
    assert len(rows) == 251
    np.testing.assert_allclose(rows["time_s"], 20 + np.arange(251) / 50, atol=1e-12)
    expected = -np.minimum(np.maximum(rows["time_s"] - 20.5, 0) * 50, 30)
    np.testing.assert_allclose(np.degrees(rows["rate_rad_s"][:, 2]), expected, atol=1e-4)
    np.testing.assert_allclose(rows["specific_force_m_s2"], [[0, 0, 9.797]] * 251, atol=1e-12)


@settings(max_examples=50)
@given(
    st.lists(
        st.tuples(st.floats(0.01, 5.0), st.floats(-1450, 1450), st.floats(1.0, 200.0)), min_size=1, max_size=8
    )
)
def test_whatever_is_commanded_angle_and_rate_are_continuous(steps: list[tuple[float, float, float]]) -> None:
    axis, now_s, greatest = RateAxis(64), 0.0, 0.0
    for wait_s, rate, acceleration in steps:
        now_s += wait_s
        before = axis.now(now_s)
        axis.to_rate(rate, acceleration, now_s)
        assert axis.now(now_s) == pytest.approx(before, abs=1e-9)
        greatest = max(greatest, acceleration)
    times_s = np.linspace(0.0, now_s + 30, 4001)
    angles, rates, _ = axis.at(times_s)
    step_s = times_s[1]
    assert np.abs(np.diff(rates)).max() <= greatest * step_s + 1e-9
    trapezoids = (rates[1:] + rates[:-1]) / 2 * step_s
    np.testing.assert_allclose(np.diff(angles), trapezoids, atol=greatest * step_s**2 + 1e-9)

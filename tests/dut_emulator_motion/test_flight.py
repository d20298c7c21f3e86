"""Flights and drives: what acts is held against the numerical derivatives of the way, and closed forms."""

import math
from typing import Any

import numpy as np
import pytest

from dut_emulator.motion.course import Course
from dut_emulator.motion.flight import flight
from dut_emulator.motion.gravity import height_coefficients
from dut_emulator.motion.path import Path, Step, Steps
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.vehicle_run import drive
from protocol.bench_description import Site

LATITUDE_DEG, GRAVITY_M_S2 = 34.2, 9.797
SITE = Site(latitude_deg=LATITUDE_DEG, gravity_m_s2=GRAVITY_M_S2, heading_deg=40.0)
EARTH_ENU = 7.292115e-5 * np.array(
    [0.0, math.cos(math.radians(LATITUDE_DEG)), math.sin(math.radians(LATITUDE_DEG))]
)
ARM = {"arm_forward_m": 0.7, "arm_left_m": -0.4, "arm_up_m": 0.3}
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
"""Central differences of eighth order (B. Fornberg, Mathematics of Computation 51, 1988)."""


def course(profile: str, **values: float) -> Course:
    given = profile_named(profile).values({"vibration_m_s2": 0.0, **values})
    return {"flight": flight, "vehicle_run": drive}[profile](given, SITE, 1)


def derivative(function: Any, times: np.ndarray, step: float, weights: np.ndarray) -> np.ndarray:
    values = [function(times + k * step) for k in range(-4, 5)]
    total = np.tensordot(weights, np.stack(values), axes=1)
    return total / step ** (1 if weights is FIRST else 2)


def moments(whole: Course, count: int = 1500) -> np.ndarray:
    return np.sort(np.random.default_rng(3).uniform(1.0, whole.duration_s - 1.0, count))


@pytest.mark.parametrize("profile", ["flight", "vehicle_run"])
def test_rates_are_the_derivative_of_the_attitude(profile: str) -> None:
    whole = course(profile)
    times = moments(whole)
    acting = whole.stimulus(times)
    dcm = acting.dcm_local_from_body
    assert dcm is not None
    assert np.allclose(dcm @ np.swapaxes(dcm, 1, 2), np.eye(3), atol=1e-14)
    change = derivative(lambda t: whole.stimulus(t).dcm_local_from_body, times, 2e-3, FIRST)
    cross = np.swapaxes(dcm, 1, 2) @ change  # [ω ×]
    turning = np.stack([cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0]], axis=1)
    inertial = turning + np.einsum("nij,i->nj", dcm, EARTH_ENU)
    assert np.abs(inertial - acting.rate_rad_s).max() < 1e-9
    angular = derivative(lambda t: whole.path.motion(t).rate_rad_s, times, 2e-3, FIRST)
    assert np.abs(angular - whole.path.motion(times).angular_acceleration_rad_s2).max() < 1e-8


@pytest.mark.parametrize("profile", ["flight", "vehicle_run"])
def test_force_is_the_second_derivative_of_the_units_own_place(profile: str) -> None:
    """f = C (p̈ + 2 Ω × ṗ + g up), p the place of the unit at the end of its arm."""
    whole = course(profile, **ARM)
    times = moments(whole)
    acting = whole.stimulus(times)

    def place(at: np.ndarray) -> Any:
        return whole.stimulus(at).position_m

    velocity, acceleration = derivative(place, times, 0.05, FIRST), derivative(place, times, 0.05, SECOND)
    centre = whole.path.motion(times)
    centre_velocity = derivative(whole.path.position_local_m, times, 0.05, FIRST)
    assert np.abs(centre_velocity - centre.velocity_local_m_s).max() < 1e-7
    # free-air gradient at this latitude by hand: 2 g (1 + f + m − 2 f sin² L) / a
    sine_square = math.sin(math.radians(LATITUDE_DEG)) ** 2
    height = centre.position_local_m[:, 2]
    gradient = 2 * (1 + 1 / 298.257 + 0.00344979 - 2 / 298.257 * sine_square) / 6378137.0
    gravity = GRAVITY_M_S2 * (1 - gradient * height + 3 * (height / 6378137.0) ** 2)
    force = acceleration + 2.0 * np.cross(EARTH_ENU, velocity)
    force[:, 2] += gravity
    dcm, true = acting.dcm_local_from_body, acting.specific_force_m_s2
    assert dcm is not None
    assert true is not None
    assert np.abs(np.einsum("nij,ni->nj", dcm, force) - true).max() < 2e-6


def test_a_coordinated_turn_has_its_closed_form() -> None:
    """tan φ = V ψ̇ / g and f = g / cos φ along body z, with the Coriolis force of a turn to the right."""
    speed, bank = 55.0, math.radians(40.0)
    turn = GRAVITY_M_S2 * math.tan(bank) / speed
    still = Path(Steps(speed), Steps(), Steps(turn), gravity_m_s2=GRAVITY_M_S2, latitude_deg=90.0)
    times = np.array([1.0, 2.5, 17.0])
    motion = still.motion(times)
    earth = 7.292115e-5
    across = speed * (turn - 2 * earth)  # at the pole the Earth turns left under the aircraft
    roll = math.atan2(across, GRAVITY_M_S2)
    assert np.allclose(motion.euler_rad[:, 0], roll, rtol=0, atol=1e-12)
    assert abs(roll - bank) < 1e-3
    expected = [0.0, 0.0, math.hypot(across, GRAVITY_M_S2)]
    assert np.allclose(motion.specific_force_m_s2, expected, rtol=0, atol=1e-9)
    assert np.allclose(motion.rate_rad_s, [0, -turn * math.sin(roll), -turn * math.cos(roll)], atol=1e-12)
    radius = speed / turn
    east, north = radius * (1 - np.cos(turn * times)), radius * np.sin(turn * times)
    assert np.allclose(motion.position_local_m[:, :2], np.stack([east, north], axis=1), atol=1e-9)


def test_no_force_acts_across_an_aircraft_at_any_moment() -> None:
    whole = course("flight", bank_deg=50.0)
    force = whole.path.motion(moments(whole)).specific_force_m_s2
    assert np.abs(force[:, 1]).max() < 1e-12
    assert force[:, 2].min() > 0.3 * GRAVITY_M_S2


def test_a_flight_ends_where_aircraft_end_and_passes_through_its_phases() -> None:
    whole = course("flight", height_m=400.0)
    end = whole.path.motion(np.array([whole.duration_s]))
    assert abs(end.position_local_m[0, 2]) < 1e-6
    assert np.abs(end.velocity_local_m_s).max() < 1e-9
    assert np.abs(end.euler_rad[0, :2]).max() < 1e-9
    names = [phase.name for phase in whole.phases]
    expected = "rest take_off climb cruise turn circling pitch_manoeuvre descent landing rest"
    assert names == expected.split()
    begins = dict(zip(names, (phase.begin_s for phase in whole.phases), strict=True))
    cruise = whole.path.motion(np.array([begins["cruise"] + 1.0]))
    assert abs(cruise.position_local_m[0, 2] - 400.0) < 120.0
    assert np.linalg.norm(cruise.velocity_local_m_s) == pytest.approx(60.0)
    circle_s = 2 * math.pi / (GRAVITY_M_S2 * math.tan(math.radians(30.0)) / 60.0)
    middle = begins["circling"] + 10.0
    here, opposite = whole.path.position_local_m(np.array([middle, middle + circle_s / 2]))
    assert np.linalg.norm(opposite - here) == pytest.approx(60.0 * circle_s / math.pi, abs=1e-6)


def test_a_chunk_is_what_the_whole_is_there() -> None:
    whole = course("vehicle_run", vibration_m_s2=0.5, **ARM)
    times = np.arange(0.0, whole.duration_s, 0.02)
    at_once = whole.stimulus(times)
    for begin in range(0, len(times), 997):
        part = whole.stimulus(times[begin : begin + 997])
        for name in ("rate_rad_s", "specific_force_m_s2", "position_m", "field_t"):
            assert np.array_equal(part.channel(name), at_once.channel(name)[begin : begin + 997])


def test_vibration_has_the_level_that_was_asked_for_and_follows_its_seed() -> None:
    quiet, shaken = course("flight"), course("flight", vibration_m_s2=2.0)
    times = np.arange(0.0, 20.0, 1e-3)
    added = shaken.stimulus(times).channel("specific_force_m_s2") - quiet.stimulus(times).channel(
        "specific_force_m_s2"
    )
    assert math.sqrt(np.mean(np.sum(added**2, axis=1))) == pytest.approx(2.0, rel=1e-3)
    values = profile_named("flight").values({"vibration_m_s2": 2.0})
    other = flight(values, SITE, 2).stimulus(times).channel("specific_force_m_s2")
    assert not np.allclose(other, shaken.stimulus(times).channel("specific_force_m_s2"))


def test_a_braked_way_is_the_same_before_and_smooth_after() -> None:
    whole = course("vehicle_run")
    now = next(phase.begin_s for phase in whole.phases if phase.name == "slalom") + 3.3
    braked = whole.ended(now)
    before = np.linspace(now - 5.0, now, 50)
    assert np.allclose(braked.path.position_local_m(before), whole.path.position_local_m(before), atol=1e-9)
    fine = np.linspace(now - 0.01, now + 0.01, 201)
    force = braked.path.motion(fine).specific_force_m_s2
    assert np.abs(np.diff(force, axis=0)).max() < 1e-3
    end = braked.path.motion(np.array([braked.duration_s, braked.duration_s + 100.0]))
    assert np.abs(end.velocity_local_m_s).max() < 1e-9
    assert np.abs(end.position_local_m[1] - end.position_local_m[0]).max() < 1e-9


def test_steps_are_smooth_and_add_up() -> None:
    steps = Steps(1.0, (Step(2.0, 4.0, 3.0), Step(5.0, 2.0, -1.0)))
    times = np.linspace(0.0, 9.0, 901)
    series = steps.series(times)
    assert series[0, 0] == 1.0
    assert series[0, -1] == pytest.approx(3.0)
    assert np.allclose(np.gradient(series[0], times)[2:-2], series[1, 2:-2], atol=2e-3)
    assert np.allclose(np.gradient(steps.integral(times), times)[2:-2], series[0, 2:-2], atol=1e-4)


def test_gravity_falls_by_the_free_air_gradient() -> None:
    first, second = height_coefficients(45.0)
    assert 9.80620 * first == pytest.approx(-3.0863e-6, rel=2e-3)
    assert second == pytest.approx(3 / 6378137.0**2)

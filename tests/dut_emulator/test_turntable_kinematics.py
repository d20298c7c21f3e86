"""The turntable and the board against hand matrices, numerical derivatives and conservation of norms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.interfaces import EmulatedStand, StandRefusal
from dut_emulator.motion.axis_motion import MAX_PIECES, AxisMotion, Trapezoid
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.three_axis_turntable import (
    ERR_ARGUMENT,
    ERR_BUSY,
    ERR_DOOR_OPEN,
    ERR_LIMIT,
    ERR_NO_MARK,
    ERR_NO_REFERENCE,
    ThreeAxisTurntableModel,
)
from protocol.bench_description import Site

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=0.0)
ANGLE = st.floats(-720.0, 720.0)
RATE = st.floats(-300.0, 300.0)


def rotation_about(axis: int, angle_rad: float) -> np.ndarray:
    """Passive elementary rotation by Rodrigues' formula: exp of minus the cross-product matrix."""
    unit = np.zeros(3)
    unit[axis] = 1.0
    cross = np.array([[0, -unit[2], unit[1]], [unit[2], 0, -unit[0]], [-unit[1], unit[0], 0]])
    return np.eye(3) - math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * cross @ cross


def homed(site: Site = SITE, **options: object) -> tuple[ThreeAxisTurntableModel, float]:
    """A table that has found its reference, and when."""
    table = ThreeAxisTurntableModel(site, **options)
    duration = table.home(0.0)
    assert isinstance(duration, float)
    return table, duration


def logarithm(rotation: np.ndarray) -> np.ndarray:
    """Rotation vector of a small active rotation matrix."""
    angle = math.acos(min(1.0, (np.trace(rotation) - 1) / 2))
    skew = rotation - rotation.T
    vector = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return vector / 2 if angle < 1e-9 else vector * angle / (2 * math.sin(angle))


@given(ANGLE, ANGLE, ANGLE)
def test_attitude_is_inner_after_middle_after_outer(outer: float, middle: float, inner: float) -> None:
    angles = np.radians([[outer, middle, inner]])
    by_hand = (
        rotation_about(0, angles[0, 2]) @ rotation_about(1, angles[0, 1]) @ rotation_about(2, angles[0, 0])
    )
    np.testing.assert_allclose(geometry.dcm_body_from_lab(angles)[0], by_hand, atol=1e-12)
    vector = np.array([0.3, -1.2, 0.7])
    np.testing.assert_allclose(geometry.into_body(vector, angles)[0], by_hand @ vector, atol=1e-12)


@given(ANGLE, ANGLE, ANGLE, RATE, RATE, RATE)
def test_body_rate_is_the_logarithm_of_the_relative_rotation(
    outer: float, middle: float, inner: float, rate_o: float, rate_m: float, rate_i: float
) -> None:
    angles, rates = np.radians([[outer, middle, inner]]), np.radians([[rate_o, rate_m, rate_i]])
    step_s = 1e-5
    before, after = (geometry.dcm_body_from_lab(angles + s * rates * step_s / 2)[0] for s in (-1, 1))
    # C(t+dt) C(t)^T is the passive exp(-[w dt]x): the body's turn in body axes is its transpose's log
    expected = logarithm((after @ before.T).T) / step_s
    np.testing.assert_allclose(geometry.body_rate_rad_s(angles, rates)[0], expected, atol=1e-6)


@given(ANGLE, ANGLE, ANGLE, RATE, RATE, RATE)
def test_angular_acceleration_is_the_derivative_of_the_rate(
    outer: float, middle: float, inner: float, rate_o: float, rate_m: float, rate_i: float
) -> None:
    angles, rates = np.radians([[outer, middle, inner]]), np.radians([[rate_o, rate_m, rate_i]])
    acceleration = np.array([[1.3, -0.4, 2.1]])
    step_s = 1e-5

    def rate_at(t: float) -> np.ndarray:
        moved = angles + rates * t + acceleration * t * t / 2
        return geometry.body_rate_rad_s(moved, rates + acceleration * t)[0]

    expected = (rate_at(step_s) - rate_at(-step_s)) / (2 * step_s)
    got = geometry.body_acceleration_rad_s2(angles, rates, acceleration)[0]
    np.testing.assert_allclose(got, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("angles_deg", "axis", "sign"),
    [
        ((0, 0, 0), 2, 1),
        ((0, 180, 0), 2, -1),
        ((0, -90, 0), 0, 1),
        ((0, 90, 0), 0, -1),
        ((0, 0, 90), 1, 1),
        ((0, 0, -90), 1, -1),
    ],
)
def test_six_positions_point_each_axis_up_and_down(
    angles_deg: tuple[float, float, float], axis: int, sign: int
) -> None:
    table, now = homed()
    duration = table.move(angles_deg, now)
    assert isinstance(duration, float)
    force = table.stimulus(np.array([now + duration])).specific_force_m_s2[0]
    expected = np.zeros(3)
    expected[axis] = sign * 9.797
    np.testing.assert_allclose(force, expected, atol=1e-12)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 217.0])
def test_earth_rate_by_latitude_and_heading(heading_deg: float) -> None:
    site = SITE.model_copy(update={"heading_deg": heading_deg})
    acting = LevelBoard(site).stimulus(np.zeros(4))
    heading, latitude = math.radians(heading_deg), math.radians(34.2)
    horizontal = 15.041067 * math.cos(latitude)  # deg/h
    # the north component seen by an axis is the cosine of the angle between them: y at the heading, x 90° on
    expected = (
        horizontal * math.cos(heading + math.pi / 2),
        horizontal * math.cos(heading),
        15.041067 * math.sin(latitude),
    )
    np.testing.assert_allclose(np.degrees(acting.rate_rad_s[2]) * 3600, expected, atol=1e-4)
    north = acting.field_t[0, 1] * math.cos(heading) - acting.field_t[0, 0] * math.sin(heading)
    assert north == pytest.approx(27e-6)
    assert np.linalg.norm(acting.field_t[0]) == pytest.approx(math.hypot(1.5e-6, 27e-6, 45e-6))


def test_norms_stay_while_the_table_turns() -> None:
    table, now = homed()
    assert not isinstance(table.move((30.0, 50.0, -20.0), now), StandRefusal)
    times = np.linspace(now, now + 2.0, 500)
    acting = table.stimulus(times)
    turning = geometry.body_rate_rad_s(*table.pose(times)[:2])
    earth = np.linalg.norm(acting.rate_rad_s - turning, axis=1)
    np.testing.assert_allclose(earth, geometry.EARTH_RATE_RAD_S, rtol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(acting.specific_force_m_s2, axis=1), 9.797, rtol=1e-12)


def test_board_tilt_shows_as_horizontal_gravity() -> None:
    force = LevelBoard(SITE, tilt_rad=(1e-3, 2e-3)).stimulus(np.zeros(1)).specific_force_m_s2[0]
    np.testing.assert_allclose(force, [-9.797 * 2e-3, 9.797 * 1e-3, 9.797], atol=1e-4)


def test_lever_arm_feels_the_centripetal_force() -> None:
    table, now = homed(lever_arm_m=(0.1, 0.0, 0.0))
    assert table.rotate("outer", 360.0, 5.0, 1.0, now) == 5.0
    force = table.stimulus(np.array([now + 2.5, now + 0.5])).specific_force_m_s2
    rate = math.radians(90.0)  # 360° / (5 − 1) s
    assert force[0] == pytest.approx([-(rate**2) * 0.1, 0.0, 9.797])
    assert force[1] == pytest.approx([-((rate / 2) ** 2) * 0.1, rate * 0.1, 9.797])


@pytest.mark.parametrize(("axis", "body_axis"), [("outer", 2), ("middle", 1), ("inner", 0)])
def test_three_turns_in_five_seconds(axis: str, body_axis: int) -> None:
    table, now = homed()
    assert table.rotate(axis, 1080.0, 5.0, 2.2, now) == 5.0
    times = np.linspace(now, now + 5.0, 50_001)
    _, rates, _ = table.pose(times)
    assert np.degrees(np.abs(rates).max()) == pytest.approx(1080 / 2.8)
    relative = geometry.body_rate_rad_s(*table.pose(times)[:2])
    integral = np.trapezoid(relative, times, axis=0)
    expected = np.zeros(3)
    expected[body_axis] = 6 * math.pi
    np.testing.assert_allclose(integral, expected, atol=1e-6)
    status = table.status(now + 5.0)
    assert status.state == "READY"
    assert sum(status.angles_deg) == 1080.0


def test_encoder_reading_sums_up_to_the_turn_and_is_only_nearly_true() -> None:
    table, now = homed()
    table.rotate("outer", 1080.0, 5.0, 2.2, now)
    times = now + np.arange(0, 5.0 + 1e-9, 1 / 1000)
    rows = table.encoder_samples(times)
    assert rows.shape == (len(times), 15)
    np.testing.assert_array_equal(rows[:, 0], times)
    angles, rates, _ = table.pose(times)
    error = rows[:, 7:10] - angles
    assert 0 < np.abs(error).max() < math.radians(3 / 3600)
    np.testing.assert_allclose(rows[:, 10:13], rates, atol=1e-4)
    np.testing.assert_allclose(np.trapezoid(rows[:, 3], times), 6 * math.pi, atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:7], axis=1), 9.797, rtol=1e-9)


def test_limits_are_checked_before_anything_moves() -> None:
    table, now = homed()
    triangular = table.rotate("outer", 1080.0, 5.0, 2.5, now)  # peaks at 432 °/s
    assert isinstance(triangular, StandRefusal)
    assert triangular.code == ERR_LIMIT
    assert "432" in triangular.text
    steep = table.rotate("inner", 1080.0, 5.0, 0.3, now)
    assert isinstance(steep, StandRefusal)
    assert steep.code == ERR_LIMIT
    for bad in (("roll", 1.0, 5.0, 1.0), ("inner", 1.0, 5.0, 2.6), ("inner", math.nan, 5.0, 1.0)):
        refusal = table.rotate(*bad, now)
        assert isinstance(refusal, StandRefusal)
        assert refusal.code == ERR_ARGUMENT
    assert table.status(now + 1.0).rates_deg_s == (0.0, 0.0, 0.0)
    assert table.limits() == (400.0, 400.0, 1000.0, 250.0, 250.0, 500.0)


def code_of(answer: float | StandRefusal) -> int | None:
    return answer.code if isinstance(answer, StandRefusal) else None


def test_commands_by_state() -> None:
    table: EmulatedStand = ThreeAxisTurntableModel(SITE)
    assert table.status(0.0).state == "NOREF"
    assert code_of(table.move((1.0, 0.0, 0.0), 0.0)) == ERR_NO_REFERENCE
    duration = table.home(0.0)
    assert isinstance(duration, float)
    assert table.status(duration / 2).state == "MOVING"
    assert code_of(table.move((1.0, 0.0, 0.0), duration / 2)) == ERR_BUSY
    assert table.status(duration).state == "READY"
    moved = table.move((10.0, -20.0, 90.0), duration)
    assert isinstance(moved, float)
    assert table.status(duration + moved).angles_deg == (10.0, -20.0, 90.0)
    assert table.move((10.0, -20.0, 90.0), duration + moved) == 0.0


def test_a_search_that_is_stopped_has_found_nothing() -> None:
    table = ThreeAxisTurntableModel(SITE)
    table.home(0.0)
    table.stop(1.0)
    assert table.status(10.0).state == "NOREF"


def test_open_door_brakes_at_the_limit_and_refuses() -> None:
    table, now = homed()
    table.rotate("outer", 1080.0, 5.0, 2.2, now)
    at = now + 2.5
    rate = table.status(at).rates_deg_s[0]
    table.inject("door_open", at)
    assert table.status(at).state == "FAULT"
    stopped = table.status(at + rate / 250.0)
    assert stopped.rates_deg_s == (0.0, 0.0, 0.0)
    assert stopped.angles_deg[0] == pytest.approx(540.0 + rate**2 / (2 * 250.0))
    assert code_of(table.home(at + 3.0)) == ERR_DOOR_OPEN
    table.inject("none", at + 4.0)
    assert table.status(at + 4.0).state == "READY"


def test_lost_reference_must_be_found_again() -> None:
    table, now = homed()
    table.inject("lost_reference", now)
    assert code_of(table.home(now)) == ERR_NO_MARK
    table.inject("none", now + 1.0)
    assert table.status(now + 1.0).state == "NOREF"
    assert code_of(table.rotate("inner", 10.0, 5.0, 1.0, now + 1.0)) == ERR_NO_REFERENCE
    assert isinstance(table.home(now + 1.0), float)


@given(st.floats(0.01, 2000.0), st.floats(1.0, 400.0), st.floats(1.0, 500.0), st.sampled_from([-1, 1]))
def test_fastest_turn_keeps_both_limits_and_arrives(
    way: float, rate: float, acceleration: float, sign: int
) -> None:
    turn = Trapezoid.fastest(sign * way, rate, acceleration)
    assert abs(turn.peak_rate) <= rate * (1 + 1e-9)
    assert abs(turn.acceleration) <= acceleration * (1 + 1e-9)
    motion = AxisMotion(5.0)
    motion.turn(turn, 10.0)
    times = 10.0 + np.linspace(0.0, turn.duration_s, 4001)
    angles, rates, _ = motion.at(times)
    assert angles[-1] == pytest.approx(5.0 + sign * way)
    np.testing.assert_allclose(np.gradient(angles, times), rates, atol=acceleration * turn.duration_s / 1000)


def test_a_long_history_is_forgotten_at_its_old_end_only() -> None:
    motion = AxisMotion()
    for number in range(MAX_PIECES):
        motion.turn(Trapezoid(1.0, 1.0, 0.25), 2.0 * number)
    angles, _, _ = motion.at(np.array([2.0 * MAX_PIECES, 2.0 * MAX_PIECES - 10.0]))
    assert angles == pytest.approx([MAX_PIECES, MAX_PIECES - 5.0])

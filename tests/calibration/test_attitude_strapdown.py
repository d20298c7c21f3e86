"""Strapdown attitude: closed forms of motion and of the correction, gates, what is stated of its errors."""

import math

import numpy as np
import pytest

from calibration.algorithms.attitude_angles import (
    accumulated,
    angle_about_rad,
    conjugate,
    matrix_of,
    normalised,
    of_rotation_vector,
    product,
    quaternion_of,
    quaternion_of_angles,
    roll_pitch_yaw_rad,
)
from calibration.algorithms.attitude_gates import admitted_horizontal_acceleration
from calibration.algorithms.attitude_uncertainty import (
    AttitudeErrorSources,
    GateIntent,
    gates_of_run,
    roll_pitch_uncertainty_rad,
)
from calibration.algorithms.strapdown_attitude import (
    Alignment,
    CorrectionSettings,
    OpenGates,
    align_at_rest,
    gyro_attitude,
    strapdown_attitude,
)
from protocol.errors import CalibrationError

G = 9.80665
START = np.array([1.0, 0.0, 0.0, 0.0])
WIDE = OpenGates(0.1, 0.1, 1.0)


def matrix_by_hand(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """C_body_from_level = Rx(roll) Ry(-pitch) Rz(-yaw), passive, written out."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, -pitch, -yaw))
    x = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    z = np.array([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
    return x @ y @ z


def error_deg(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Rotation between attitudes (n, 4), degrees."""
    return np.degrees(2.0 * np.linalg.norm(product(conjugate(true), found)[..., 1:], axis=-1))


def perfect(attitude: np.ndarray) -> Alignment:
    """As if a noiseless rest had come before."""
    return Alignment(attitude, np.zeros(3), np.array(G), np.zeros(()), np.zeros(()), np.zeros(()), 10.0)


def test_angles_are_those_of_the_written_out_matrices() -> None:
    rng = np.random.default_rng(1)
    for angles in (*rng.uniform(-1.4, 1.4, (20, 3)), np.array([3.0, 0.2, -3.0])):
        quaternion = quaternion_of_angles(angles)
        np.testing.assert_allclose(matrix_of(quaternion).T, matrix_by_hand(*angles), atol=1e-14)
        np.testing.assert_allclose(roll_pitch_yaw_rad(quaternion), angles, atol=1e-12)
    some = normalised(rng.standard_normal((200, 4)))
    some[:4] = np.eye(4)  # half turns: one component only
    np.testing.assert_allclose(matrix_of(quaternion_of(matrix_of(some))), matrix_of(some), atol=1e-14)


def test_gravity_levels_the_attitude() -> None:
    """f = g (sin p, cos p sin r, cos p cos r), y being left."""
    roll, pitch = math.radians(10.0), math.radians(-20.0)
    up = [math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)]
    force = np.tile(G * np.array(up), (400, 1))
    rest = align_at_rest(np.full((400, 3), 1e-3), force, 0.01)
    np.testing.assert_allclose(roll_pitch_yaw_rad(rest.attitude), [roll, pitch, 0.0], atol=1e-12)
    np.testing.assert_allclose(rest.bias_rad_s, 1e-3)
    assert float(rest.norm_m_s2) == pytest.approx(G)


def test_a_constant_rate_turns_by_rate_times_time() -> None:
    rate = np.radians([30.0, -20.0, 50.0])
    found = gyro_attitude(START, np.tile(rate, (1001, 1)), 0.01)
    assert error_deg(found[-1], of_rotation_vector(10.0 * rate)) == pytest.approx(0.0, abs=1e-9)
    for axis in range(3):
        alone = np.zeros((501, 3))
        alone[:, axis] = 2.0
        angle = angle_about_rad(gyro_attitude(START, alone, 0.01), START, axis)
        np.testing.assert_allclose(angle, 0.02 * np.arange(501), atol=1e-12)


def coning(count: int, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact attitude and rate of a cone of 5 deg at 2 Hz (Goodman & Robinson)."""
    t = np.arange(count) * period_s
    half, omega = math.radians(2.5), 4.0 * math.pi
    sine = math.sin(half)
    attitude = np.stack(
        [np.full(count, math.cos(half)), sine * np.cos(omega * t), sine * np.sin(omega * t), 0.0 * t], axis=1
    )
    rate = omega * np.stack(
        [-math.sin(2 * half) * np.sin(omega * t), math.sin(2 * half) * np.cos(omega * t), 0.0 * t], axis=1
    )
    rate[:, 2] = -2.0 * omega * sine**2
    return attitude, rate


def test_a_cone_is_followed_where_the_trapezoid_drifts_away() -> None:
    attitude, rate = coning(12_000, 0.01)  # 2 min
    found = gyro_attitude(attitude[0], rate, 0.01)
    assert error_deg(found, attitude).max() < 0.006
    plain = of_rotation_vector(0.005 * (rate[1:] + rate[:-1]))
    drifted = accumulated(np.concatenate([attitude[:1], plain]))
    assert error_deg(drifted[-1], attitude[-1]) > 1.0
    exact, finer = coning(24_000, 0.005)
    half_step = gyro_attitude(exact[0], finer, 0.005)
    assert error_deg(half_step[-1], exact[-1]) < error_deg(found[-1], attitude[-1]) / 12.0, "fourth order"


def test_the_correction_is_the_second_order_response_that_it_says() -> None:
    """A bias step b: delta'' + delta' / T + delta / (T Tb) = 0; with Tb = 4 T it is b t exp(-t / 2 T)."""
    period_s, count = 0.02, 15_000
    rate, force = np.zeros((count, 3)), np.tile([0.0, 0.0, G], (count, 1))
    rate[:, 0] = math.radians(0.05)
    settings = CorrectionSettings(20.0, 80.0, 0.5)
    run = strapdown_attitude(rate, force, period_s, perfect(START), WIDE, settings)
    t = period_s * np.arange(count)
    expected = math.radians(0.05) * t * np.exp(-t / 40.0)
    np.testing.assert_allclose(run.roll_pitch_yaw_rad[:, 0], expected, atol=0.02 * expected.max())
    assert run.gates_open.all()
    np.testing.assert_allclose(run.bias_rad_s[-1], [math.radians(0.05), 0, 0], atol=1e-5)
    # a tilt alone, bias kept: exp(-t / T)
    tilted = perfect(quaternion_of_angles(np.array([0.02, -0.01, 0.0])))
    still = strapdown_attitude(
        0 * rate, force, period_s, tilted, WIDE, CorrectionSettings(20.0, None, 0.1)
    ).roll_pitch_yaw_rad
    np.testing.assert_allclose(still[:, 0], 0.02 * np.exp(-t / 20.0), atol=2e-4)
    np.testing.assert_allclose(still[:, 1], -0.01 * np.exp(-t / 20.0), atol=2e-4)


def test_gates_keep_a_push_and_a_banked_turn_out_and_say_what_they_admit() -> None:
    rng = np.random.default_rng(3)
    period_s, count = 0.01, 8_000
    rate = 1e-3 * rng.standard_normal((count, 3))
    force = np.tile([0.0, 0.0, G], (count, 1)) + 0.05 * rng.standard_normal((count, 3))
    rest = align_at_rest(rate[:1000], force[:1000], period_s)
    gates = gates_of_run(rest, G, GateIntent(speed_m_s=60.0))
    # paper 2, corrected: sqrt(g^2 + xi^2) - g = 0.49 mm/s^2 (vectors), and sqrt(3) dw'
    assert gates.norm.theoretical == pytest.approx(0.00049032, abs=6e-9)
    assert gates.norm.printed == pytest.approx(1.135672, abs=6e-7)
    assert gates.angular_acceleration.theoretical == pytest.approx(
        0.0980665 / math.hypot(0.3, 0.02), rel=1e-9
    )
    assert not gates.norm.meets_intent
    assert gates.norm.admitted_m_s2 == pytest.approx(
        admitted_horizontal_acceleration(gates.norm.bound, G), rel=1e-12
    )
    force[2_000:4_000, 0] += 2.0  # a push forward: 11.5 deg of pitch if it were believed
    rate[5_000:7_000, 2] += 0.09  # a turn at 60 m/s, banked so that nothing shows across
    force[5_000:7_000, 2] = G / math.cos(math.radians(30.0))
    run = strapdown_attitude(rate, force, period_s, rest, gates.bounds)
    at = np.repeat(run.gates_open, run.block_samples)
    assert not at[2_000:4_000].any()
    assert not at[5_050:6_950].any()
    assert at[:2_000].mean() > 0.9
    assert np.degrees(np.abs(run.roll_pitch_yaw_rad[:, :2])).max() < 0.25


def flown(units: int, seed: int):
    """Units side by side on one way with a turn and a climb: true attitude, rates, forces, sources."""
    rng = np.random.default_rng(seed)
    period_s = 0.05
    t = np.arange(0.0, 140.0, period_s)

    def level(begin: float, end: float) -> np.ndarray:
        return np.clip((t - begin) / 2, 0, 1) * np.clip((end - t) / 2, 0, 1)

    yaw = np.cumsum(np.radians(6.0) * level(31, 59)) * period_s
    attitude = quaternion_of_angles(
        np.stack([np.radians(30.0) * level(30, 60), np.radians(8.0) * level(80, 95), yaw], axis=1)
    )
    steps = 2.0 * product(conjugate(attitude[:-1]), attitude[1:])[:, 1:] / period_s
    rate = np.zeros((len(t), 3))
    rate[1:-1] = 0.5 * (steps[1:] + steps[:-1])
    force = matrix_of(attitude)[:, 2] * G
    force[(level(30, 60) > 0) | (level(80, 95) > 0)] *= 1.1  # shut
    n, b, m, c, v = np.radians(0.3) / 60, np.radians(15.0) / 3600, 2e-3, 0.03, 1e-3
    keep = math.exp(-period_s / 300.0)
    walk = b * rng.standard_normal((len(t), units, 3))
    for k in range(1, len(t)):
        walk[k] = keep * walk[k - 1] + math.sqrt(1 - keep**2) * walk[k]
    turned = np.einsum("uij,nj->nui", m * rng.standard_normal((units, 3, 3)), rate)
    rates = rate[:, None] + turned + walk + n / math.sqrt(period_s) * rng.standard_normal(walk.shape)
    forces = force[:, None] + c * rng.standard_normal((units, 3))
    forces = forces + v / math.sqrt(period_s) * rng.standard_normal(walk.shape)
    sources = AttitudeErrorSources(n, b, 300.0, m, m, c, v)
    return attitude, rate, force, rates, forces, sources, period_s


def test_the_stated_uncertainty_is_the_scatter_of_many_units() -> None:
    attitude, rate, force, rates, forces, sources, period_s = flown(150, 5)
    settings, gates = CorrectionSettings(20.0, 80.0, 0.5), OpenGates(0.2, 0.02, 0.5)
    rest = round(10.0 / period_s)
    units = strapdown_attitude(
        rates, forces, period_s, align_at_rest(rates[:rest], forces[:rest], period_s), gates, settings
    )
    alignment = align_at_rest(rate[:rest], force[:rest], period_s)
    one = strapdown_attitude(rate, force, period_s, alignment, gates, settings)
    assert units.gates_open.mean() == pytest.approx(one.gates_open.mean(), abs=0.02)
    stated = roll_pitch_uncertainty_rad(one, alignment, sources, settings, G)
    error = (units.roll_pitch_yaw_rad - roll_pitch_yaw_rad(attitude)[:, None])[:, :, :2]
    for second in (15, 29, 45, 62, 88, 105, 138):
        k = round(second / period_s)
        scatter = np.sqrt(np.mean(error[k] ** 2, axis=0))
        np.testing.assert_allclose(scatter, stated[k // one.block_samples], rtol=0.25)
    # many side by side are each as alone
    alone = strapdown_attitude(
        rates[:, 3],
        forces[:, 3],
        period_s,
        align_at_rest(rates[:rest, 3], forces[:rest, 3], period_s),
        gates,
        settings,
    )
    np.testing.assert_allclose(alone.quaternion, units.quaternion[:, 3], atol=1e-12)


def test_what_cannot_be_integrated_is_refused() -> None:
    rate, force = np.zeros((500, 3)), np.tile([0.0, 0.0, G], (500, 1))
    with pytest.raises(CalibrationError, match="too short to align"):
        align_at_rest(rate[:100], force[:100], 0.01)
    holed = rate.copy()
    holed[7] = np.nan
    with pytest.raises(CalibrationError, match=r"Samples of the rest are missing"):
        align_at_rest(holed, force, 0.01)
    with pytest.raises(CalibrationError, match="cannot be integrated across"):
        strapdown_attitude(holed, force, 0.01, perfect(START), WIDE)
    with pytest.raises(CalibrationError, match="time constant is not a positive"):
        strapdown_attitude(rate, force, 0.01, perfect(START), WIDE, CorrectionSettings(-1.0))

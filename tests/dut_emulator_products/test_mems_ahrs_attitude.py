"""The unit's attitude algorithm: closed forms of motion, gates, and paper 2's swing test with two clocks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dut_emulator.products.mems_ahrs.attitude import AttitudeFilter, gates, roll_pitch_yaw_rad
from dut_emulator.recording.recorder import recorded

PERIOD_S = 0.005
G = 9.80665


def attitude_deg(
    rate: np.ndarray, force: np.ndarray, compensated: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Roll, pitch, yaw (n, 3) in degrees, and whether the gates were open (n,)."""
    found = AttitudeFilter(PERIOD_S, gates(compensated=compensated)).process(rate, force)
    return np.degrees(roll_pitch_yaw_rad(found.attitude)), found.steady


def level(count: int) -> np.ndarray:
    return np.tile([0.0, 0.0, G], (count, 1))


def test_it_levels_on_gravity() -> None:
    """Nose up by 20°, right side down by 10°: f = g (sin p, cos p sin r, cos p cos r), y being left."""
    roll, pitch = math.radians(10.0), math.radians(20.0)
    force = G * np.array(
        [math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)]
    )
    angles, steady = attitude_deg(np.zeros((400, 3)), np.tile(force, (400, 1)))
    np.testing.assert_allclose(angles, np.tile([10.0, 20.0, 0.0], (400, 1)), atol=1e-9)
    assert steady.all()


def test_turns_have_the_signs_of_a_vehicle() -> None:
    """A turn to the left is a rate about z up and makes the heading (clockwise) fall; nose up is −y."""
    count, rate = 200, math.radians(30.0)
    for axis, angle, sign in ((0, 0, 1.0), (1, 1, -1.0), (2, 2, -1.0)):
        rates = np.zeros((count, 3))
        rates[1:, axis] = rate
        rates[0, axis] = 0.0
        angles, steady = attitude_deg(rates, level(count))  # the gates are shut: the force plays no part
        travelled_s = (count - 1.5) * PERIOD_S
        assert angles[-1, angle] == pytest.approx(sign * 30.0 * travelled_s, abs=1e-6)
        assert not steady[30:].any()


def test_a_cone_is_followed() -> None:
    """ω = C_bᵀ of a known C(t) = Rz(ψ) Ry(θ) Rx(φ): exact for 60 s, all angles at work."""
    t = np.arange(12_000) * PERIOD_S
    phi, theta, psi = 0.5 * np.sin(1.1 * t), 0.4 * np.sin(0.7 * t), 0.3 * t
    dphi, dtheta, dpsi = 0.55 * np.cos(1.1 * t), 0.28 * np.cos(0.7 * t), np.full_like(t, 0.3)
    rate = np.stack(
        [
            dphi - dpsi * np.sin(theta),
            dtheta * np.cos(phi) + dpsi * np.cos(theta) * np.sin(phi),
            -dtheta * np.sin(phi) + dpsi * np.cos(theta) * np.cos(phi),
        ],
        axis=1,
    )
    force = G * np.stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)], axis=1)
    angles, steady = attitude_deg(rate, force)
    expected = np.degrees(np.stack([phi, -theta, -psi], axis=1))
    error = (angles - expected + 180.0) % 360.0 - 180.0
    assert np.abs(error).max() < 0.02
    assert steady.mean() < 0.05


def test_a_bias_is_found_in_the_first_second_and_a_later_one_by_the_level() -> None:
    count = 60_000  # 300 s
    rate = np.zeros((count, 3))
    rate[:, 0] = math.radians(0.1)
    rate[30_000:, 0] += math.radians(0.05)
    angles, steady = attitude_deg(rate, level(count))
    assert steady.all()
    assert np.abs(angles[:30_000, 0]).max() < 0.1
    # δ̈ + k δ̇ + k²/4 δ = 0 from a bias step b: δ = b t e^(−k t / 2), greatest b · 2 / (k e) at t = 2 / k
    after = angles[30_000:, 0]
    assert after.max() == pytest.approx(0.05 * 2.0 / (0.08 * math.e), rel=0.03)
    assert np.argmax(after) * PERIOD_S == pytest.approx(2.0 / 0.08, rel=0.05)
    assert abs(after[-1]) < 0.02


def test_gates_are_the_corrected_ones() -> None:
    limits = gates(compensated=True)
    # vectors of paper 2: ξ = 0.01 g on the norm, 0.49 mm/s²; √3 δω̇, 0.166297 rad/s²; ξ / V, 0.002 rad/s
    assert limits.norm_m_s2 == pytest.approx(0.00049032 + 3 * 2e-3 + 0.005 * G, rel=1e-6)
    assert limits.acceleration_rad_s2 == pytest.approx(0.166297526 + 3 * math.radians(0.3), rel=1e-6)
    assert limits.rate_rad_s == pytest.approx(0.002 + math.radians(0.26), rel=1e-6)
    # what the norm lets through horizontally is far above ξ: √(2 g σ) (README of the paper's errors)
    assert math.sqrt(limits.norm_m_s2 * (2 * G + limits.norm_m_s2)) > 10 * 0.01 * G


def test_a_horizontal_acceleration_beyond_the_gate_turns_nothing() -> None:
    count = 8_000
    force = level(count)
    force[2_000:4_000, 0] = 2.0
    angles, steady = attitude_deg(np.zeros((count, 3)), force)
    assert not steady[2_050:3_950].any()
    assert np.abs(angles[2_050:4_000, :2]).max() < 0.3, "11.5° if it were believed"


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(1, 899), unique=True, max_size=5).map(sorted))
def test_cutting_changes_nothing(cuts: list[int]) -> None:
    rng = np.random.default_rng(3)
    rate = 0.05 * rng.standard_normal((900, 3)) + 0.2 * np.sin(np.arange(900) / 50.0)[:, np.newaxis]
    force = level(900) + 0.2 * rng.standard_normal((900, 3))
    whole = AttitudeFilter(PERIOD_S, gates(compensated=False)).process(rate, force)
    cut = AttitudeFilter(PERIOD_S, gates(compensated=False))
    parts = [cut.process(*both) for both in zip(np.split(rate, cuts), np.split(force, cuts), strict=True)]
    for name in ("attitude", "steady", "aligned"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name)
        )


def lag_of_roll_s(triggered: bool) -> tuple[float, float]:
    """Lag of the roll behind the table's angle by the two clocks, and the largest difference in degrees."""
    recording = recorded("mems_ahrs", "swing", values={"cycles": 4.0}, triggered=triggered)
    dut, stand = recording.streams["dut"].columns, recording.streams["stand"].columns
    inside = (dut["t"] > 6.0) & (dut["t"] < stand["t"][-1] - 0.2)
    at = np.interp(dut["t"], stand["t"], stand["angle_inner"])[inside]
    turning = np.interp(dut["t"], stand["t"], stand["rate_x"])[inside]
    roll = dut["roll"][inside]
    slope = np.linalg.lstsq(np.stack([at, turning, np.ones_like(at)], 1), roll, rcond=None)[0][1]
    return -float(slope), float(np.abs(roll - at).max())


def test_only_a_common_trigger_tells_the_clock_from_a_lag() -> None:
    """Paper 2, 4.1: 2.6° at 200 °/s are 13 ms between the clocks."""
    own_lag_s, own_error_deg = lag_of_roll_s(triggered=True)
    both_s, error_deg = lag_of_roll_s(triggered=False)
    assert own_lag_s == pytest.approx(1.5e-3 + 1 / (2 * math.pi * 80), abs=4e-4)
    assert abs(both_s - own_lag_s) == pytest.approx(0.013, abs=2e-4)
    assert abs(both_s - own_lag_s) * 200.0 == pytest.approx(2.6, abs=0.05)
    assert error_deg > 1.4 > own_error_deg

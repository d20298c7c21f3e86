"""Paper 2's gates, corrected and as printed. The oracle was computed independently from the physics."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.algorithms.attitude_gates import (
    accepted_at_rest,
    admitted_horizontal_acceleration,
    angular_acceleration_gate,
    centripetal_acceleration,
    norm_gate,
    printed_axis_accelerations,
    printed_lever_arm_magnitudes,
    printed_turn_rate_gate,
    strict_turn_rate,
    tangential_acceleration,
    turn_rate_gate,
)
from protocol.errors import CalibrationError

VECTORS = json.loads((Path(__file__).parent / "vectors_attitude_gates.json").read_text(encoding="utf-8"))
G = 9.80665
MEMS_NOISE_M_S2 = 0.02


@pytest.mark.parametrize("row", VECTORS["sigma_a"])
def test_the_printed_norm_gate_admits_half_of_gravity(row) -> None:
    gate = norm_gate(row["xi_a"], G, 0.0)
    assert gate.printed == pytest.approx(row["sigma_a_paper"], abs=6e-7)
    np.testing.assert_allclose(
        printed_axis_accelerations(row["xi_a"], G), [row["dFx"], row["dFz"]], atol=6e-7
    )
    admitted = admitted_horizontal_acceleration(gate.printed, G)
    assert admitted == pytest.approx(row["passed_horizontal_accel"], abs=6e-6)
    assert math.degrees(math.atan(admitted / G)) == pytest.approx(row["attitude_err_deg"], abs=6e-5)
    assert gate.theoretical == pytest.approx(row["gate_if_xi_is_horizontal_accel"], abs=6e-9)
    assert gate.admitted_m_s2 == pytest.approx(row["xi_a"], rel=1e-9)
    assert gate.meets_intent
    # The norm alone cannot do it at the noise of a MEMS accelerometer.
    noisy = norm_gate(row["xi_a"], G, MEMS_NOISE_M_S2)
    assert noisy.bound == pytest.approx(gate.theoretical + 0.06)
    assert not noisy.meets_intent
    assert noisy.attitude_error_rad > gate.attitude_error_rad


def test_a_turns_rate_is_gated_by_speed_and_not_by_a_radius_that_nobody_knows() -> None:
    row = VECTORS["sigma_w"]
    assert printed_turn_rate_gate(row["xi"], row["L"]) == pytest.approx(row["paper"], abs=6e-10)
    assert strict_turn_rate(row["xi"], row["L"]) == pytest.approx(row["strict_text"], abs=6e-10)
    gate = turn_rate_gate(row["xi"], 50.0, 0.001, row["L"])
    assert gate.theoretical == pytest.approx(0.002, rel=1e-12)
    assert gate.printed == pytest.approx(row["paper"], abs=6e-10)
    assert gate.bound == pytest.approx(0.005)
    admitted = printed_turn_rate_gate(row["xi"], row["L"]) ** 2 * 2000.0
    assert admitted == pytest.approx(row["centripetal_admitted_at_paper_gate_L2000"], rel=1e-9)


def test_angular_acceleration_and_lever_arm() -> None:
    row = VECTORS["sigma_wdot"]
    gate = angular_acceleration_gate(row["xi"], np.array(row["d"]), 0.01)
    assert gate.theoretical == pytest.approx(row["correct_sqrt3_times_dwy"], abs=6e-10)
    assert gate.printed == pytest.approx(row["printed_sqrt_of_3dwy"], abs=6e-10)
    assert gate.noise == pytest.approx(0.03)
    arm = {name: np.array(value) for name, value in VECTORS["lever_arm"].items() if isinstance(value, list)}
    d, w, wdot = arm["d"], arm["w"], arm["wdot"]
    np.testing.assert_allclose(centripetal_acceleration(w, d), arm["true_centripetal"], atol=1e-12)
    np.testing.assert_allclose(tangential_acceleration(wdot, d), arm["true_tangential"], atol=1e-12)
    for first, name in (
        (w**2, "paper_centripetal"),
        (wdot, "paper_tangential_with_wdot"),
        (w, "paper_tangential_as_printed_with_w"),
    ):
        printed = printed_lever_arm_magnitudes(np.abs(first), d)
        np.testing.assert_allclose(printed, np.abs(arm[name]), atol=6e-10)


def test_what_noise_alone_lets_through_at_rest() -> None:
    assert accepted_at_rest(1.0) == pytest.approx(0.682689, abs=6e-7)
    assert accepted_at_rest(3.0) == pytest.approx(0.997300, abs=6e-7)


@given(
    st.lists(st.floats(-10, 10), min_size=3, max_size=3), st.lists(st.floats(-1, 1), min_size=3, max_size=3)
)
def test_the_accelerations_are_those_of_a_rotating_point(rate: list[float], arm: list[float]) -> None:
    """Centripetal: across w, never outwards, |w| times the tangential one of w' = w."""
    w, d = np.array(rate), np.array(arm)
    inward, along = centripetal_acceleration(w, d), tangential_acceleration(w, d)
    assert inward @ w == pytest.approx(0.0, abs=1e-9)
    assert inward @ d <= 1e-12
    assert np.linalg.norm(inward) == pytest.approx(np.linalg.norm(w) * np.linalg.norm(along), abs=1e-9)
    assert along @ d == pytest.approx(0.0, abs=1e-9)


@given(st.floats(1e-4, 5.0), st.floats(0.0, 0.5))
def test_more_noise_admits_more(wanted: float, noise: float) -> None:
    quiet, noisy = norm_gate(wanted, G, 0.0), norm_gate(wanted, G, noise)
    assert quiet.admitted_m_s2 == pytest.approx(wanted, rel=1e-9)
    assert noisy.admitted_m_s2 >= quiet.admitted_m_s2
    assert quiet.theoretical < quiet.printed


def test_what_makes_no_gate_is_said() -> None:
    with pytest.raises(CalibrationError, match="wanted_m_s2 is 0, not a positive"):
        norm_gate(0.0, G, 0.0)
    with pytest.raises(CalibrationError, match="lever_arm_x_z_m is 0"):
        angular_acceleration_gate(0.1, np.array([0.0, 0.3, 0.0]), 0.0)
    with pytest.raises(CalibrationError, match="rate_noise_rad_s is -1"):
        turn_rate_gate(0.1, 50.0, -1.0, 500.0)

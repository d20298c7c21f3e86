"""Every figure of vectors_gnc_imu_mag.json, which was computed from the physics without this project."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.earth import earth_rate_ned
from calibration.algorithms.linear_triad import fit_linear_triad
from calibration.algorithms.magnetometer_spin import spin_ellipse, spin_min_max
from calibration.algorithms.noise_covariance import NoiseHypothesis, Observations
from calibration.algorithms.paper_forms import six_position, turn_pairs
from calibration.algorithms.roll_error import nonorthogonality_of_skew_rad, roll_of_latency_rad
from dut_emulator.motion.axis_motion import Trapezoid

VECTORS: dict[str, Any] = json.loads(
    Path(__file__).with_name("vectors_gnc_imu_mag.json").read_text(encoding="utf-8")
)


def test_turns_give_the_inverse_and_the_bias_as_a_rate() -> None:
    gyro = VECTORS["gyro"]
    integrals = {name: np.array(values) for name, values in gyro["integrals_LSB_s"].items()}
    matrix, bias = turn_pairs(integrals, gyro["N_turns"], gyro["capture_s"])
    np.testing.assert_allclose(matrix, gyro["M_recovered"], atol=2e-6)
    np.testing.assert_allclose(matrix, gyro["M_forward_LSB_per_rad_s"], atol=2e-6)
    np.testing.assert_allclose(matrix.T, gyro["paper_eq3_matrix (=M^T)"], atol=2e-6)
    np.testing.assert_allclose(np.linalg.inv(matrix), gyro["Kg=inv(M)"], atol=1e-10)
    np.testing.assert_allclose(bias, gyro["bias_raw_correct (sum/(4*T))"], atol=1e-6)
    np.testing.assert_allclose(bias, gyro["n0_LSB"], atol=2e-4)  # Earth rate along the spin axis leaks
    found = TriadCoefficients("angular_rate", matrix, bias, np.zeros((12, 12)), 0.0, 0)
    np.testing.assert_allclose(found.bias_input_referred(), gyro["eps_rad_s = Kg @ bias_raw"], atol=1e-9)
    np.testing.assert_allclose(found.compensate(np.array(gyro["test_N"])), gyro["w_out_correct"], atol=1e-8)
    wrong = np.linalg.inv(matrix.T) @ (np.array(gyro["test_N"]) - bias)
    np.testing.assert_allclose(wrong, gyro["w_out_transposed_inverse (inv(M.T))"], atol=1e-7)
    of_angle = 4 * gyro["capture_s"] / (8 * np.pi * gyro["N_turns"])
    assert of_angle == pytest.approx(gyro["ratio_paper_over_true"], rel=1e-12)
    np.testing.assert_allclose(bias * of_angle, gyro["bias_paper (sum/(8 pi N))"], atol=1e-6)


def test_the_transposed_inverse_doubles_a_small_error_but_not_a_rotation() -> None:
    figures = VECTORS["prescaled"]
    matrix = np.eye(3) + np.array(figures["E"])
    # M from turns of whole radians, compensated by the inverse and, as printed, by the transpose.
    integrals = {
        f"{'xyz'[k]}{sign}": int(f"{sign}1") * 2 * np.pi * matrix[:, k] for k in range(3) for sign in "+-"
    }
    found, _ = turn_pairs(integrals, 1, 1.0)
    assert np.abs(np.linalg.inv(found) @ matrix - np.eye(3)).max() == pytest.approx(0.0, abs=1e-15)
    assert np.abs(found.T @ matrix - np.eye(3)).max() == pytest.approx(
        figures["max_resid_paper_MT"], rel=1e-9
    )
    assert np.abs(matrix - np.eye(3)).max() == pytest.approx(figures["max_resid_uncalibrated"], rel=1e-9)
    x, y, z = 0.0008, 0.0005, 0.001
    rotation = np.eye(3) + np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
    hidden = np.abs(rotation.T @ rotation - np.eye(3)).max()
    assert hidden == pytest.approx(figures["pure_rotation_hides_bug_resid"], rel=1e-6)


def test_earth_rate_and_the_turns_profile() -> None:
    earth, profile = VECTORS["earth"], VECTORS["spin_profile"]
    north, _, _ = np.degrees(earth_rate_ned(np.radians(earth["lat_deg"]))) * 3600
    assert north == pytest.approx(earth["horizontal_component_deg_h"], rel=1e-6)
    assert north * 10 / 15 == pytest.approx(earth["static_10s_of_15s_leak_deg_h"], rel=1e-6)
    triangle = Trapezoid(1080.0, 5.0, 2.5)
    assert triangle.peak_rate == pytest.approx(profile["triangular_peak_deg_s"])
    longest = Trapezoid(1080.0, 5.0, profile["max_ramp_s"])
    assert longest.peak_rate == pytest.approx(profile["range_deg_s"])
    assert longest.acceleration == pytest.approx(profile["min_accel_deg_s2_for_peak_400"])


def test_six_positions_and_what_the_printed_form_leaves() -> None:
    acc = VECTORS["accel"]
    force, output = np.array(acc["f_g"], dtype=np.float64), np.array(acc["N_A"])
    compensation, nabla = six_position(output, force)
    np.testing.assert_allclose(compensation, acc["K_a=X[:3].T"], atol=1e-9)
    np.testing.assert_allclose(nabla, acc["nabla"], atol=1e-9)
    without, *_ = np.linalg.lstsq(output, force, rcond=None)
    np.testing.assert_allclose(without.T, acc["K_no_augmentation=X.T"], atol=1e-9)
    assert np.abs(output @ without - force).max() == pytest.approx(acc["max_resid_no_aug_g"], rel=1e-8)
    printed = np.abs(output @ compensation + nabla - force).max()
    assert printed == pytest.approx(acc["max_resid_if_K_not_transposed_g"], rel=1e-8)


def test_the_noise_of_six_positions_is_that_of_theory_and_monte_carlo() -> None:
    acc = VECTORS["accel"]
    force, output = np.array(acc["f_g"], dtype=np.float64), np.array(acc["N_A"])
    stated = acc["mc_1mg_noise_on_each_position_mean"]
    for samples, of_matrix, of_bias in (
        (1, stated["theory_sd_K=1e-3/sqrt2"], stated["theory_sd_b=1e-3/sqrt6"]),
        (300_000, acc["300s_at_1kHz_white_1mg"]["sd_K"], acc["300s_at_1kHz_white_1mg"]["sd_bias_g"]),
    ):
        covariance = np.tile(np.eye(6) * 1e-6 / samples, (3, 1, 1))
        runs = np.arange(6)
        observations = Observations(
            force, output, runs * 1.0, np.ones(6), runs, tuple(map(str, runs)), np.zeros((6, 3, 3))
        )
        hypotheses = (NoiseHypothesis(covariance, 1.0, "white"),)
        found = fit_linear_triad("acceleration", observations, hypotheses, "vectors").coefficients
        np.testing.assert_allclose(found.matrix_standard_uncertainty(), of_matrix, rtol=1e-6)
        np.testing.assert_allclose(found.bias_standard_uncertainty(), of_bias, rtol=1e-6)
    rng = np.random.default_rng(1)
    trials = [six_position(output + 1e-3 * rng.standard_normal((6, 3)), force) for _ in range(2000)]
    spread_k = np.array([k for k, _ in trials]).std(axis=0).mean()
    assert spread_k == pytest.approx(stated["sd_K"], rel=0.03)
    spread_b = np.array([b for _, b in trials]).std(axis=0).mean()
    assert spread_b == pytest.approx(stated["sd_bias_g"], rel=0.04)


def _outputs(theta: np.ndarray, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    mag = VECTORS["mag"]
    x = mag["offset"][0] + mag["B_gauss"] * np.cos(theta - np.radians(mag["alpha_deg"]))
    y = mag["offset"][1] + mag["Y_gain"] * mag["B_gauss"] * np.sin(theta)
    return x + noise * rng.standard_normal(len(theta)), y + noise * rng.standard_normal(len(theta))


def test_a_spin_gives_the_figures_of_the_magnetometer() -> None:
    mag, rng = VECTORS["mag"], np.random.default_rng(0)
    theta = np.radians(np.arange(0, 360, mag["theta_deg_step"]))
    x_out, y_out = _outputs(theta, 0.0, rng)
    for found in (spin_min_max(x_out, y_out), spin_ellipse(x_out, y_out)):
        assert found.zero_x == pytest.approx(mag["dX"], abs=1e-9)
        assert found.zero_y == pytest.approx(mag["dY"], abs=1e-9)
        assert found.ratio_y == pytest.approx(mag["Ky"], abs=1e-9)
        assert np.sin(found.nonorthogonality_rad) == pytest.approx(mag["sin_alpha"], abs=1e-9)
        x, y = found.correct_as_printed(x_out, y_out)
        assert np.ptp(x) / np.ptp(y) == pytest.approx(mag["radius_x_paper_over_y"], abs=1e-8)
        for roll, error in (
            (np.arctan2(y, x), mag["roll_err_max_deg_paper"]),
            (found.roll_rad(x_out, y_out), mag["roll_err_max_deg_with_1/cos"]),
            (np.arctan2(y_out, x_out), mag["roll_err_uncorrected_deg"]),
        ):
            largest = np.degrees(np.abs(np.angle(np.exp(1j * (roll - theta)))).max())
            assert largest == pytest.approx(error, rel=1e-6, abs=1e-8)
    traps = VECTORS["mag"]["rate_traps"]
    spin = np.radians(traps["15_rps_deg_per_s"])
    assert np.degrees(roll_of_latency_rad(1e-3, spin)) == pytest.approx(traps["deg_per_ms_latency"])
    skew = np.degrees(nonorthogonality_of_skew_rad(1e-4, spin))
    assert skew == pytest.approx(traps["adc_skew_100us_false_nonorthogonality_deg"])


def test_monte_carlo_of_the_spin_scatters_as_printed() -> None:
    """Twelve spins of 180 s at 1 kHz: rms within what twelve can tell."""
    mag = VECTORS["mag"]
    stated = mag["mc_180s_1kHz_15rps_noise_500uG"]
    theta = 2 * np.pi * 15 * np.arange(180_000) / 1000
    errors = {"minmax": [], "lsq": []}
    for seed in range(12):
        outputs = _outputs(theta + 0.01 * seed, 500e-6, np.random.default_rng(seed))
        for name, method in (("minmax", spin_min_max), ("lsq", spin_ellipse)):
            found = method(*outputs)
            errors[name].append(
                [
                    np.degrees(found.nonorthogonality_rad) - mag["alpha_deg"],
                    1e6 * (found.zero_x - mag["dX"]),
                    found.ratio_y / mag["Ky"] - 1,
                ]
            )
    rms = {name: np.sqrt(np.mean(np.square(found), axis=0)) for name, found in errors.items()}
    expected = {
        "minmax": [
            stated["alpha_rms_err_deg_peak_method"],
            stated["offset_rms_uG_minmax"],
            stated["Ky_rel_rms_minmax"],
        ],
        "lsq": [stated["alpha_rms_err_deg_lsq"], stated["offset_rms_uG_lsq"], stated["Ky_rel_rms_lsq"]],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(rms[name], values, rtol=0.6)

"""Paper 5: K_a, K_2 and D on an overload rig. The oracle was computed independently from the physics.

The motion is integrated here, from the crank's geometry; nothing of it is shared with the solution.
"""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from calibration.algorithms.overload_g_sensitivity import GyroRun, calibrate_g_sensitivity, response_along
from calibration.algorithms.sinusoidal_overload import (
    HalfCycles,
    KnownAccelerometer,
    calibrate_overload,
    joint_solve,
    printed_forms,
)
from protocol.errors import CalibrationError

VECTORS = json.loads((Path(__file__).parent / "vectors_sinusoidal_overload.json").read_text(encoding="utf-8"))
G = 9.80665
P = SimpleNamespace(**VECTORS["params"])
TRUTH = np.array([P.Kax, P.K2])
KNOWN = KnownAccelerometer(P.K1 / G, P.K0 * G, 0.0, 0.0, 0.0)
BY_G = {case["A0_g"]: case for case in VECTORS["cases"]}


def sinusoid(amplitude_g: float, cycles: int = 1) -> HalfCycles:
    omega = math.sqrt(amplitude_g * G / P.r_m)
    both = np.ones((cycles, 2))
    speed, squared = 2 * amplitude_g * G / omega, (amplitude_g * G) ** 2 * math.pi / omega / 2
    return HalfCycles(math.pi / omega * both, speed * both, squared * both)


def pulses_of(motion: HalfCycles, a: float = P.Kax, k_per_g: float = P.K2, even_per_g: float = 0.0):
    """Forward model in units of g, both halves."""
    t, v, s = motion.duration_s, motion.speed_change_m_s / G, motion.squared_m2_s3 / G**2
    sign = np.array([1.0, -1.0])
    return P.K1 * (1 + sign * a) * (P.K0 * t + sign * v + sign * k_per_g * s + even_per_g * s)


def in_g(pair) -> np.ndarray:
    """(K_a, K_2 in s^2/m) → (K_a, K_2 per g)."""
    return np.asarray(pair) * [1.0, G]


def slider_crank(ratio: float, amplitude_g: float = 10.0, split_at_middle: bool = False):
    """Half-cycles (1, 2) and pulses (1, 2) of x = r cos(phi) + sqrt(b^2 - r^2 sin^2 phi), r/b = ratio."""
    count = 400_000
    omega = math.sqrt(amplitude_g * G / P.r_m)
    step = 2 * math.pi / omega / count
    phi = (np.arange(count) + 0.5) * 2 * math.pi / count
    sin, cos = np.sin(phi), np.cos(phi)
    rod = np.sqrt(1 - (ratio * sin) ** 2)
    bend = np.cos(2 * phi) / rod + (ratio * sin * cos) ** 2 / rod**3
    a = -P.r_m * omega**2 * (cos + ratio * bend) / G
    x = cos + (rod - 1.0) / ratio if ratio else cos
    positive = x < 0 if split_at_middle else a > 0
    rate = P.K1 * (1 + P.Kax * np.sign(a)) * (P.K0 + a + P.K2 * a * np.abs(a))
    halves = (positive, ~positive)
    motion = HalfCycles(
        step * np.array([[half.sum() for half in halves]]),
        step * G * np.array([[abs(a[half].sum()) for half in halves]]),
        step * G**2 * np.array([[(a[half] ** 2).sum() for half in halves]]),
    )
    return motion, step * np.array([[rate[half].sum() for half in halves]])


@pytest.mark.parametrize("amplitude_g", [1.0, 5.0, 10.0, 12.0])
def test_each_overload_of_the_oracle(amplitude_g: float) -> None:
    case, motion = BY_G[amplitude_g], sinusoid(amplitude_g)
    assert motion.duration_s.sum() == pytest.approx(case["T_s"], abs=6e-10)
    assert motion.speed_change_m_s[0, 0] / G == pytest.approx(case["dV_gs"], abs=6e-10)
    assert motion.squared_m2_s3[0, 0] / G**2 == pytest.approx(case["S_g2s"], abs=6e-9)
    pulses = pulses_of(motion)
    np.testing.assert_allclose(pulses[0], [case["Nplus"], case["Nminus"]], atol=6e-7)
    np.testing.assert_allclose(in_g(joint_solve(motion, pulses, KNOWN)[0]), TRUTH, rtol=2e-9)
    asymmetry, quadratic = in_g(printed_forms(motion, pulses, KNOWN))
    assert asymmetry == pytest.approx(case["Kax_est"], rel=1e-9)
    assert quadratic == pytest.approx(case["K2_est"], rel=1e-6)
    assert asymmetry / P.Kax - 1 == pytest.approx(case["Kax_rel_bias_pred"], rel=1e-4)
    assert quadratic - P.K2 == pytest.approx(case["K2_abs_bias_pred"], rel=1e-3)


@pytest.mark.parametrize("index", range(4))
def test_what_is_wrongly_known_moves_the_coefficients_as_reported(index: int) -> None:
    """The trends over overload that paper 5 reports have the shape of these artefacts."""
    even, scale, bias = (VECTORS[name][index] for name in ("even", "scale_factor", "bias"))
    motion = sinusoid(float(even["A0"]), cycles=4)
    found = calibrate_overload(motion, pulses_of(motion), KNOWN)
    of_bias, of_scale, of_even, of_grating = found.sensitivities
    assert of_even.asymmetry * 1e-5 / G == pytest.approx(-even["Kax_bias"], rel=2e-4)
    leaked = calibrate_overload(motion, pulses_of(motion, even_per_g=1e-5), KNOWN)
    assert leaked.asymmetry - found.asymmetry == pytest.approx(even["Kax_bias"], rel=2e-4)
    wrong_scale = KnownAccelerometer(P.K1 / G * (1 - 1e-4), P.K0 * G, 0.0, 0.0, 0.0)
    moved = in_g(printed_forms(motion.total(), pulses_of(motion.total()), wrong_scale))[1] - P.K2
    assert moved == pytest.approx(scale["K2_bias"], rel=1e-3)
    assert of_scale.odd_quadratic_s2_m * G * -1e-4 == pytest.approx(scale["pred"], rel=1e-3)
    wrong_bias = KnownAccelerometer(P.K1 / G, (P.K0 - 1e-3) * G, 0.0, 0.0, 0.0)
    moved = joint_solve(motion, pulses_of(motion), wrong_bias)[0][0] - P.Kax
    assert moved == pytest.approx(bias["Kax_bias"], rel=1e-3)
    assert of_bias.asymmetry * -1e-3 * G == pytest.approx(bias["Kax_bias"], rel=1e-3)
    longer = HalfCycles(motion.duration_s, motion.speed_change_m_s * 1.0001, motion.squared_m2_s3 * 1.0001**2)
    moved = (
        joint_solve(longer, pulses_of(motion), KNOWN)[0] - joint_solve(motion, pulses_of(motion), KNOWN)[0]
    )
    expected = [of_grating.asymmetry * 1e-4, of_grating.odd_quadratic_s2_m * 1e-4]
    np.testing.assert_allclose(moved, expected, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("expected", VECTORS["slider_crank"], ids=lambda row: f"r/b={row['lam']}")
def test_a_slider_crank_is_no_sinusoid(expected) -> None:
    motion, pulses = slider_crank(expected["lam"])
    assert motion.duration_s[0, 0] / motion.duration_s.sum() == pytest.approx(expected["Tp_over_T"], abs=6e-6)
    np.testing.assert_allclose(motion.squared_m2_s3[0] / G**2, [expected["Sp"], expected["Sm"]], rtol=1e-6)
    # The measured halves give the truth back, whatever the geometry.
    np.testing.assert_allclose(in_g(joint_solve(motion, pulses, KNOWN)[0]), TRUTH, rtol=1e-8)
    asymmetry, quadratic = in_g(printed_forms(motion, pulses, KNOWN)) - TRUTH
    assert asymmetry == pytest.approx(expected["Kax_bias"], rel=1e-3, abs=1e-12)
    assert quadratic == pytest.approx(expected["K2_bias_measuredS"], rel=1e-3, abs=1e-12)
    sinusoidal = printed_forms(motion.as_if_sinusoidal(P.r_m), pulses, KNOWN)
    assert in_g(sinusoidal)[1] - P.K2 == pytest.approx(expected["K2_bias_sinusS"], rel=1e-3, abs=1e-12)
    four = HalfCycles(*(np.repeat(v, 4, axis=0) for v in vars(motion).values()))
    found = calibrate_overload(four, np.repeat(pulses, 4, axis=0), KNOWN, amplitude_m=P.r_m)
    assert found.half_ratio == pytest.approx(expected["S_ratio"], rel=1e-5)
    assert found.sinusoid_shift is not None
    if expected["lam"] == 0.2:
        assert found.half_ratio == pytest.approx(0.72, abs=0.005)
        assert abs(found.sinusoid_shift[1] * G) > 1e-6  # a tenth of K_2 and more


def test_counting_leaves_one_pulse_in_the_sum_of_any_number_of_cycles() -> None:
    expected = VECTORS["pulse_quantisation"]
    one = sinusoid(10.0)
    base = printed_forms(one, pulses_of(one), KNOWN)
    extra = in_g(printed_forms(one, pulses_of(one) + np.array([[1.0, 0.0]]), KNOWN)) - in_g(base)
    assert abs(pulses_of(one)[0]).mean() == pytest.approx(expected["pulses_half"], rel=1e-3)
    np.testing.assert_allclose(extra, [expected["one_pulse_Kax"], expected["one_pulse_K2"]], rtol=1e-9)
    quantum = [
        calibrate_overload(sinusoid(10.0, m), pulses_of(sinusoid(10.0, m)), KNOWN).standard_uncertainty
        for m in (10, 40)
    ]
    assert quantum[0][0] / quantum[1][0] == pytest.approx(4.0, rel=1e-3)  # K_a: as 1/m
    assert quantum[0][1] / quantum[1][1] == pytest.approx(2.0, rel=2e-2)  # K_2: as 1/sqrt(m)
    assert quantum[0][0] == pytest.approx(expected["one_pulse_Kax"] / math.sqrt(6) / 10, rel=1e-2)


def test_stated_uncertainties_cover_the_truth_at_their_rate() -> None:
    """300 axes whose K_0, K_1 and grating are known to their stated uncertainty, 20 noisy cycles each."""
    generator = np.random.default_rng(7)
    known = KnownAccelerometer(P.K1 / G, P.K0 * G, 3e-4, 5e-4 * G, 1e-4, 0.0, 1e-4 / G)
    pulls = []
    crank, _ = slider_crank(0.2, 5.0)
    motion = HalfCycles(*(np.repeat(v, 20, axis=0) for v in vars(crank).values()))
    for _ in range(300):
        e_k1, e_k0, e_grating, e_even = generator.normal(0.0, [3e-4, 5e-4, 1e-4, 1e-4])
        true = HalfCycles(
            motion.duration_s,
            motion.speed_change_m_s * (1 + e_grating),
            motion.squared_m2_s3 * (1 + e_grating) ** 2,
        )
        pulses = pulses_of(true, even_per_g=e_even) + P.K1 * e_k0 * true.duration_s
        pulses = pulses * (1 + e_k1) + generator.normal(0.0, 1.0, (20, 2))
        found = calibrate_overload(motion, pulses, known)
        estimate = [found.asymmetry, found.odd_quadratic_nonlinearity_s2_m]
        pulls.append((estimate - TRUTH / [1.0, G]) / found.standard_uncertainty)
    pulls = np.abs(pulls)
    for column in range(2):
        assert (pulls[:, column] < 1.0).mean() == pytest.approx(0.683, abs=0.085)
        assert (pulls[:, column] < 1.96).mean() == pytest.approx(0.95, abs=0.04)


def test_a_bias_that_wanders_between_cycles_is_seen_and_widens() -> None:
    """K_0 as an AR(1) series over 250 cycles: its mean is told less well than by the scatter alone."""
    generator = np.random.default_rng(21)
    motion = sinusoid(5.0, cycles=250)
    pulls, naive = [], []
    for _ in range(200):
        steps = generator.normal(0.0, 2e-2, 350)
        wander = lfilter([1.0], [1.0, -0.7], steps)[100:, None]
        pulses = pulses_of(motion) + P.K1 * wander * motion.duration_s
        pulses += generator.normal(0.0, 0.3, pulses.shape)
        found = calibrate_overload(motion, pulses, KNOWN)
        pulls.append((found.asymmetry - P.Kax) / found.standard_uncertainty[0])
        r = found.correlation[0]
        naive.append(pulls[-1] * math.sqrt((1 + r) / (1 - r)))
        assert r == pytest.approx(0.7, abs=0.2)
        assert found.correlation[1] < 0.4
    assert (np.abs(pulls) < 1.96).mean() == pytest.approx(0.95, abs=0.04)
    assert (np.abs(naive) < 1.96).mean() < 0.75


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-0.01, 0.01),
    st.floats(-1e-3, 1e-3),
    st.floats(0.5, 12.0),
    st.floats(0.6, 1.6),
    st.floats(-1e-4, 1e-4),
)
def test_the_joint_solution_is_exact(a: float, k: float, g: float, uneven: float, even: float) -> None:
    one = sinusoid(g)
    skew = np.array([[uneven, 2 - uneven]])
    motion = HalfCycles(one.duration_s * skew, one.speed_change_m_s, one.squared_m2_s3 / skew)
    known = KnownAccelerometer(P.K1 / G, P.K0 * G, 0.0, 0.0, 0.0, even_quadratic_s2_m=even / G)
    found = in_g(joint_solve(motion, pulses_of(motion, a, k, even), known)[0])
    np.testing.assert_allclose(found, [a, k], atol=1e-11)


def test_g_sensitivity_of_the_oracle() -> None:
    o = SimpleNamespace(**VECTORS["gyro"])
    motion = sinusoid(o.A0_g)
    sign = np.array([1.0, -1.0])
    constant = o.D0x + o.omega_x + o.D2x * o.Ay_g
    pulses = o.E1x * (constant * motion.duration_s + sign * o.D1x * motion.speed_change_m_s / G)
    np.testing.assert_allclose(pulses[0], [o.Wplus, o.Wminus], atol=6e-9)
    response, rate = response_along(motion, pulses, o.E1x)
    assert response[0] * G == pytest.approx(o.D1x_expected, rel=1e-12)
    assert rate[0] == pytest.approx(constant, rel=1e-12)


D_TRUE = np.array([[5e-4, -2e-4, 1e-4], [3e-5, 4e-4, -6e-5], [-1e-4, 2e-5, -3e-4]]) / G
TILTED = np.linalg.qr(np.eye(3) + 0.05 * np.arange(9).reshape(3, 3))[0]


def gyro_runs(generator, ratio: float, noise: float) -> list[GyroRun]:
    crank, _ = slider_crank(ratio, 10.0)
    motion = HalfCycles(*(np.repeat(v, 12, axis=0) for v in vars(crank).values()))
    sign = np.array([1.0, -1.0])[None, :, None]
    runs = []
    for direction in TILTED:
        response = sign * motion.speed_change_m_s[..., None] * (D_TRUE @ direction)
        pulses = 3600.0 * (np.array([0.012, -0.02, 0.005]) * motion.duration_s[..., None] + response)
        runs.append(GyroRun(direction, motion, pulses + generator.normal(0.0, noise, pulses.shape)))
    return runs


def test_three_runs_give_the_matrix_and_the_printed_form_leaks_the_bias() -> None:
    exact = calibrate_g_sensitivity(
        gyro_runs(np.random.default_rng(0), 0.2, 0.0), np.full(3, 3600.0), 0.0, 0.0
    )
    np.testing.assert_allclose(exact.matrix, D_TRUE, atol=1e-12)
    leak = np.abs(exact.printed - D_TRUE).max() * G
    assert leak > 1e-4  # of a D of 5e-4 rad/s per g
    even = calibrate_g_sensitivity(
        gyro_runs(np.random.default_rng(0), 0.0, 0.0), np.full(3, 3600.0), 0.0, 0.0
    )
    np.testing.assert_allclose(even.printed, D_TRUE, atol=1e-9)


def test_the_matrix_is_covered_at_its_stated_rate() -> None:
    pulls = []
    crank_runs = gyro_runs(np.random.default_rng(0), 0.2, 0.0)
    generator = np.random.default_rng(11)
    for _ in range(200):
        runs = [
            GyroRun(run.direction_body, run.motion, run.pulses + generator.normal(0.0, 4.0, run.pulses.shape))
            for run in crank_runs
        ]
        found = calibrate_g_sensitivity(runs, np.full(3, 3600.0), 0.0, 0.0)
        pulls.append((found.matrix - D_TRUE) / found.standard_uncertainty)
    pulls = np.abs(pulls)
    assert (pulls < 1.0).mean() == pytest.approx(0.70, abs=0.05)
    assert (pulls < 1.96).mean() == pytest.approx(0.95, abs=0.025)


def test_what_cannot_carry_coefficients_is_said() -> None:
    motion = sinusoid(5.0, cycles=5)
    pulses = pulses_of(motion)
    with pytest.raises(CalibrationError, match="3 cycles carry no standard uncertainty"):
        calibrate_overload(sinusoid(5.0, 3), pulses[:3], KNOWN)
    with pytest.raises(CalibrationError, match="mixed up"):
        joint_solve(motion, pulses[:, ::-1], KNOWN)
    with pytest.raises(CalibrationError, match="is none of an accelerometer"):
        joint_solve(motion, pulses * [1.5, 1.0], KNOWN)
    with pytest.raises(CalibrationError, match="some are missing"):
        joint_solve(motion, np.where(pulses > 0, np.nan, pulses), KNOWN)
    with pytest.raises(CalibrationError, match="do not close a cycle"):
        HalfCycles(motion.duration_s, motion.speed_change_m_s * [1.0, 1.3], motion.squared_m2_s3)
    with pytest.raises(CalibrationError, match="not positive"):
        HalfCycles(motion.duration_s * 0, motion.speed_change_m_s, motion.squared_m2_s3)
    runs = gyro_runs(np.random.default_rng(0), 0.0, 0.0)
    flat = [
        GyroRun(axis, run.motion, run.pulses) for axis, run in zip(np.eye(3)[[0, 1, 0]], runs, strict=True)
    ]
    with pytest.raises(CalibrationError, match="No run moves along body z"):
        calibrate_g_sensitivity(flat, np.full(3, 3600.0), 0.0, 0.0)

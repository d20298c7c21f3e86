"""Rate staircases: hand computations, coverage in white and slow noise, damage, an emulated module."""

import dataclasses
import math

import numpy as np
import pytest

from calibration.algorithms.axis_geometry import axis_geometry, decompose, relative_misalignment
from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.repeatability import repeatability
from calibration.algorithms.scale_factor_figures import Dwell, find_dwells, staircase_figures
from dut_emulator.effects.nonlinearity import ScaleFactorAsymmetry, ScaleFactorNonlinearity
from dut_emulator.recording.recorder import RecordingOrder, RecordingSession, recorded
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, white

EARTH_RAD_S = 7.292115e-5
MATRIX = np.array([[1.012, 0.004, -0.006], [-0.003, 0.985, 0.008], [0.005, -0.007, 1.021]])
BIAS = np.array([0.012, -0.007, 0.004])
PERIOD_S, DWELL_S, FULL_SCALE = 0.05, 2.0, 5.0
DENSITY = 1e-7


def staircase(
    seed: int, *, sigma: float = 0.0, tau_s: float = 100.0, asymmetry: float = 0.0, cubic: float = 0.0
):
    """Three levels to each side about each axis, the Earth rate turning with a horizontal spin axis."""
    rng, per = np.random.default_rng(seed), round(DWELL_S / PERIOD_S)
    steps = FULL_SCALE / 3 * np.array([0, 1, 2, 3, 2, 1, 0, -1, -2, -3, -2, -1, 0])
    count = 3 * len(steps) * per
    time_s = PERIOD_S * np.arange(count)
    noise = white(rng, count, 3, DENSITY, PERIOD_S) + exponential(rng, count, 3, sigma, tau_s, PERIOD_S)
    dwells = []
    for number in range(3 * len(steps)):
        axis, level = number // len(steps), steps[number % len(steps)]
        rows = slice(number * per, (number + 1) * per)
        rate = np.zeros((per, 3))
        rate[:, axis] = level
        angle = level * time_s[rows]
        earth = np.zeros((per, 3))
        earth[:, (axis + 1) % 3] = EARTH_RAD_S * np.cos(angle)
        earth[:, (axis + 2) % 3] = EARTH_RAD_S * np.sin(angle)
        true = rate + earth
        bent = true * (1 + asymmetry / 2 * np.sign(true)) + cubic * true**3
        dwells.append(
            Dwell(f"dwell {number}", time_s[rows], bent @ MATRIX.T + BIAS + noise[rows], rate, earth)
        )
    return dwells


def pulls_of(seed: int, known: bool, sigma: float) -> np.ndarray:
    found = staircase_figures(
        staircase(seed, sigma=sigma), known_slow=((sigma, 100.0),) if known and sigma else None
    )
    matrix = (found.coefficients.matrix - MATRIX) / found.coefficients.matrix_standard_uncertainty()
    asymmetry = [axis.asymmetry[0] / axis.asymmetry[1] for axis in found.axes]
    residual = [axis.residuals[1] / math.sqrt(axis.residual_covariance[1, 1]) for axis in found.axes]
    return np.concatenate([matrix.ravel(), asymmetry, residual])


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("seeds", "sigma"),
    [(30, 3e-4), *(pytest.param(200, sigma, marks=pytest.mark.slow) for sigma in (0.0, 3e-4))],
)
def test_intervals_hold_in_white_and_in_slow_noise(seeds: int, sigma: float) -> None:
    pulls = np.array([pulls_of(seed, seeds < 200, sigma) for seed in range(seeds)])
    check_coverage(pulls.reshape(-1, 1) if seeds < 200 else pulls, more=0.2)
    assert np.abs(pulls.mean(axis=0)).max() < 4 / math.sqrt(seeds)


def test_a_gyro_without_noise_says_its_figures() -> None:
    """Cubic k: the line through 0, +-1/3, +-2/3, +-1 of F; residuals by hand. Asymmetry 2a."""
    straight = staircase_figures(noiseless(staircase(0)))
    np.testing.assert_allclose(straight.coefficients.matrix, MATRIX, atol=1e-9)
    np.testing.assert_allclose(straight.coefficients.bias, BIAS, atol=1e-9)
    bent = staircase_figures(noiseless(staircase(0, asymmetry=2e-3)))
    assert [axis.asymmetry[0] for axis in bent.axes] == pytest.approx([2e-3] * 3, rel=2e-2)
    rates = FULL_SCALE / 3 * np.arange(-3, 4)
    cubic = 1e-5
    bowed = rates + cubic * rates**3
    left = bowed - rates * (rates @ bowed) / (rates @ rates)
    # the levels count once, whatever time was spent at them
    found = staircase_figures(noiseless(staircase(0, cubic=cubic)))
    assert found.axes[0].nonlinearity[0] == pytest.approx(np.abs(left).max() / FULL_SCALE, rel=5e-3)
    assert found.axes[0].nonlinearity_minimax < found.axes[0].nonlinearity[0]
    np.testing.assert_allclose(found.axes[0].rates_rad_s, rates, atol=2e-4)


def noiseless(dwells: list[Dwell]) -> list[Dwell]:
    """The same without its noise, by the model's own words: white noise of the generator is seeded."""
    rng = np.random.default_rng(0)
    count = sum(len(one.time_s) for one in dwells)
    noise = white(rng, count, 3, DENSITY, PERIOD_S)
    starts = np.cumsum([0, *(len(one.time_s) for one in dwells)])
    return [
        dataclasses.replace(one, output_rad_s=one.output_rad_s - noise[start : start + len(one.time_s)])
        for one, start in zip(dwells, starts, strict=False)
    ]


def test_noise_alone_makes_a_nonlinearity_and_it_is_said() -> None:
    found = [staircase_figures(staircase(seed), known_slow=()) for seed in range(20)]
    largest = np.mean([axis.nonlinearity[0] for one in found for axis in one.axes])
    assert largest == pytest.approx(
        np.mean([a.nonlinearity_of_noise for one in found for a in one.axes]), rel=0.2
    )


def test_the_repeatability_of_the_scale_factor_over_runs() -> None:
    runs = [staircase_figures(staircase(seed), known_slow=()) for seed in range(6)]
    values = np.array([one.coefficients.scale_factor_error() for one in runs])
    doubt = np.array([one.coefficients.scale_factor_standard_uncertainty() for one in runs])
    found = repeatability(values, doubt, "same_power_on")
    np.testing.assert_allclose(found.repeatability, values.std(axis=0, ddof=1))
    assert not found.beyond_noise_resolved.all()


def test_damage_and_missing_motion_are_named() -> None:
    dwells = staircase(1)
    with pytest.raises(CalibrationError, match="turns about body z"):
        staircase_figures([one for one in dwells if not one.rate_body_rad_s[0, 2]])
    with pytest.raises(CalibrationError, match="y turns at 0 negative rates"):
        staircase_figures([one for one in dwells if one.rate_body_rad_s[0, 1] >= 0])
    found = staircase_figures(dwells, range_rad_s=5.0)
    told = [note.why for note in found.not_used]
    assert told.count("whole dwell: part of it is saturated") >= 2
    np.testing.assert_allclose(found.coefficients.matrix, MATRIX, atol=1e-3)
    earth_left_out = [
        dataclasses.replace(one, earth_rate_body_rad_s=one.earth_rate_body_rad_s + 0.5 * EARTH_RAD_S)
        for one in dwells
    ]
    moved = staircase_figures(earth_left_out).coefficients.bias - staircase_figures(dwells).coefficients.bias
    np.testing.assert_allclose(moved, -0.5 * EARTH_RAD_S * MATRIX.sum(axis=1), rtol=1e-3)


def test_a_rotation_and_a_skew_of_the_same_cross_coupling() -> None:
    """A pure rotation has no N; a symmetric matrix has no phi; the mixture adds up, exactly for one axis."""
    angle = 0.01
    turned = np.array(
        [[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    nine = decompose(turned)
    np.testing.assert_allclose(nine, [0, 0, 0, 0, 0, angle, 0, 0, 0], atol=1e-12)
    skew = np.eye(3)
    skew[0, 1] = skew[1, 0] = angle
    nine = decompose(skew / np.linalg.norm(skew, axis=1)[:, None])
    np.testing.assert_allclose(nine[[3, 4, 5, 7, 8]], 0, atol=1e-12)
    assert nine[6] == pytest.approx(angle, rel=1e-3)
    coefficients = TriadCoefficients(
        "angular_rate", np.diag([1.01, 0.99, 1.0]) @ turned, np.zeros(3), np.eye(12) * 1e-10, 0.0, 1
    )
    found = axis_geometry(coefficients, 1e-4)
    np.testing.assert_allclose(found.scale_factor_error, [0.01, -0.01, 0.0], atol=1e-12)
    assert found.misalignment_share() == pytest.approx(1.0)
    # phi_z = (e_xy - e_yx) / 2, so u^2 = (u^2 + u^2) / 4 to first order, and the mounting's
    assert found.standard_uncertainty[5] == pytest.approx(math.hypot(1e-5 / math.sqrt(2), 1e-4), rel=1e-3)
    assert found.standard_uncertainty[6] == pytest.approx(1e-5 / math.sqrt(2), rel=0.02)
    difference, covariance = relative_misalignment(found, found)
    assert not difference.any()
    assert covariance[2, 2] == pytest.approx(2 * found.covariance[5, 5])


def test_an_emulated_module_on_a_three_axis_turntable() -> None:
    """M and b of the unit, with an asymmetry and a cubic term put in; the stand's own errors allowed for."""
    order = {"values": {"dwell_s": 2.0}, "powered_before_s": 3600.0}
    twin = RecordingSession(RecordingOrder("gnc_module", "rate_staircase", **order)).twin
    for effect in (
        ScaleFactorAsymmetry("gyro", (1e-3, -5e-4, 0.0)),
        ScaleFactorNonlinearity("gyro", (0.0, 0.0, 4e-5)),
    ):
        twin = twin.with_effect(effect)
    recording = recorded("gnc_module", "rate_staircase", twin=twin, **order)
    dwells = dwells_of(recording)
    found = staircase_figures(dwells, range_rad_s=math.radians(399.0), rate_standard_uncertainty=5e-6)
    effects = {effect.word: effect for effect in twin.effects if effect.sensor == "gyro"}
    warm = recording.stream("dut").si("temp").mean() - 25.0
    scale = (1 + np.array(effects["scale_factor_error"].scale_factor_error)) * (
        1 + np.array(effects["scale_factor_temperature"].coefficients_per_c[0]) * warm
    )
    asymmetry = [axis.asymmetry for axis in found.axes]
    for (value, doubt), true in zip(asymmetry, (2e-3, -1e-3, 0.0), strict=True):
        assert abs(value - true) < 4 * doubt + 1e-5
    assert max(doubt for _, doubt in asymmetry) < 2e-4
    straight = found.coefficients.matrix - scale[:, None] * (
        np.eye(3) + effects["misalignment"].misalignment_rad
    )
    # y is straight but for 1e-3 of asymmetry, which moves no symmetric line; 1e-4 rad is the mounting
    doubt = np.hypot(found.coefficients.matrix_standard_uncertainty(), 1.2e-4 * (1 - np.eye(3)))
    assert np.abs(straight / doubt)[:2].max() < 4
    top = math.radians(300.0)
    rates = top / 5 * np.arange(-5, 6)
    bowed = 4e-5 * rates**3
    left = np.abs(bowed - rates * (rates @ bowed) / (rates @ rates)).max() / top
    assert found.axes[2].nonlinearity[0] == pytest.approx(left, abs=4 * found.axes[2].nonlinearity[1])
    assert found.axes[2].nonlinearity[0] > 5 * found.axes[2].nonlinearity_of_noise


def dwells_of(recording) -> list[Dwell]:
    """Dwells of a staircase from a recording; x east, y north, z up at zero angles."""
    dut, stand = recording.stream("dut"), recording.stream("stand")
    time_s, stand_s = dut.time_s(), stand.time_s()
    rates = stand.si("rate_x", "rate_y", "rate_z")
    angles = stand.si("angle_outer", "angle_middle", "angle_inner")
    latitude = math.radians(recording.site["latitude_deg"])
    east_north_up = EARTH_RAD_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])
    earth = np.array([attitude(*row) @ east_north_up for row in angles[::25]])
    at = {
        "rate": np.stack([np.interp(time_s, stand_s, rates[:, axis]) for axis in range(3)], axis=1),
        "earth": np.stack([np.interp(time_s, stand_s[::25], earth[:, axis]) for axis in range(3)], axis=1),
    }
    output = dut.si("gyro_x", "gyro_y", "gyro_z")
    found = find_dwells(at["rate"], time_s, tolerance_rad_s=1e-6, least_s=1.0, settle_s=0.2)
    return [
        Dwell(f"dwell {n}", time_s[a:b], output[a:b], at["rate"][a:b], at["earth"][a:b])
        for n, (a, b) in enumerate(found)
    ]


def attitude(outer: float, middle: float, inner: float) -> np.ndarray:
    """C_body_from_lab = Rx(inner) Ry(middle) Rz(outer), passive."""
    so, co, sm, cm, si, ci = (f(a) for a in (outer, middle, inner) for f in (math.sin, math.cos))
    rz = np.array([[co, so, 0], [-so, co, 0], [0, 0, 1]])
    ry = np.array([[cm, 0, -sm], [0, 1, 0], [sm, 0, cm]])
    rx = np.array([[1, 0, 0], [0, ci, si], [0, -si, ci]])
    return rx @ ry @ rz

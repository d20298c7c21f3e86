"""Degrees of freedom against matrices and allantools; coefficients and intervals against simulated noise.

The generator is this file's own: sums, differences and Kasdin's fractional filter (Proc. IEEE 83 (1995) 802).
"""

import allantools
import numpy as np
import pytest

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_noise import (
    TERMS,
    NoiseModel,
    confidence_intervals,
    degrees_of_freedom,
    variance_covariance,
)
from calibration.algorithms.allan_variance import (
    logarithmic_taus,
    modified_allan_deviation,
    overlapping_allan_deviation,
)
from protocol.errors import CalibrationError

RATE_HZ = 20.0
SAMPLES = 2**15
SEEDS = [40, pytest.param(200, marks=pytest.mark.slow)]
ALPHA = {"quantization": 2, "random_walk": 0, "bias_instability": -1, "rate_random_walk": -2}


def _noise(model: NoiseModel, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    period = 1 / RATE_HZ
    samples = model.random_walk / np.sqrt(period) * rng.standard_normal(count)
    samples += model.quantization / period * np.diff(rng.standard_normal(count + 1))
    samples += model.rate_random_walk * np.sqrt(period) * np.cumsum(rng.standard_normal(count))
    samples += model.rate_ramp * period * np.arange(count)
    steps = np.arange(1, count)
    filtered = np.cumprod(np.concatenate([[1.0], (steps - 0.5) / steps]))
    drive = model.bias_instability * rng.standard_normal(count)
    return samples + np.fft.irfft(np.fft.rfft(filtered, 2 * count) * np.fft.rfft(drive, 2 * count))[:count]


def test_covariance_of_variances_equals_that_of_explicit_matrices() -> None:
    """N and Q on 120 samples, z = D y with D written out: Cov(y' A y, y' B y) = 2 tr(A V B V)."""
    count, white, quantum = 120, 0.3, 0.07
    period = 1 / RATE_HZ
    of_integral = np.vstack([np.zeros(count), np.tril(np.ones((count, count)))]) * period
    integral_covariance = white**2 / period * of_integral @ of_integral.T + quantum**2 * np.eye(count + 1)
    factors = (1, 3, 7, 20)
    forms = []
    for m in factors:
        terms = count + 1 - 2 * m
        difference = np.zeros((terms, count + 1))
        for row in range(terms):
            difference[row, [row, row + m, row + 2 * m]] = 1.0, -2.0, 1.0
        forms.append(difference.T @ difference / (2 * (m * period) ** 2 * terms))
    expected = [
        [2 * np.trace(a @ integral_covariance @ b @ integral_covariance) for b in forms] for a in forms
    ]
    model = NoiseModel(quantization=quantum, random_walk=white)
    found = variance_covariance(factors, count, RATE_HZ).of(model.squares)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    np.testing.assert_allclose(
        model.deviation(np.array(factors) * period) ** 2,
        [np.trace(a @ integral_covariance) for a in forms],
        rtol=1e-9,
    )


@pytest.mark.parametrize("name", ALPHA)
@pytest.mark.parametrize("kind", ["overlapping", "modified"])
def test_degrees_of_freedom_are_those_of_greenhall_and_riley(kind: str, name: str) -> None:
    count = 20_000
    form = overlapping_allan_deviation if kind == "overlapping" else modified_allan_deviation
    measured = form(np.random.default_rng(0).standard_normal(count), 1.0, np.array([40.0, 200, 1500, 5000]))
    expected = [
        allantools.ci.edf_greenhall(ALPHA[name], 2, int(m), count + 1, True, kind == "modified")
        for m in measured.factors
    ]
    found = degrees_of_freedom(measured, NoiseModel(**{name: 2.5}))
    np.testing.assert_allclose(found, expected, rtol=0.03 if name == "random_walk" else 0.01)


def test_white_noise_at_one_sample_has_two_thirds_of_its_terms() -> None:
    measured = overlapping_allan_deviation(
        np.random.default_rng(0).standard_normal(3001), 1.0, np.array([1.0])
    )
    found = degrees_of_freedom(measured, NoiseModel(random_walk=1.0))
    assert found[0] == pytest.approx(3000 * 2 / 3, rel=1e-3)


@pytest.mark.parametrize("kind", ["overlapping", "modified"])
@pytest.mark.parametrize("seeds", SEEDS)
def test_chi_squared_intervals_hold_the_truth_at_their_level(kind: str, seeds: int) -> None:
    form = overlapping_allan_deviation if kind == "overlapping" else modified_allan_deviation
    white = NoiseModel(random_walk=1.0)
    taus = np.array([1, 8, 64, 256]) / RATE_HZ
    # Of white noise the modified variance is half the overlapping one for long taus: SP 1065, section 5.5.
    m = taus * RATE_HZ
    truth = white.deviation(taus) * (np.sqrt((m**2 + 1) / (2 * m**2)) if kind == "modified" else 1.0)
    inside = np.zeros(len(taus))
    for seed in range(seeds):
        measured = form(_noise(white, 1024, seed), RATE_HZ, taus)
        found = confidence_intervals(measured, white, 0.9)
        inside += (found.lower <= truth) & (truth <= found.upper)
    np.testing.assert_allclose(inside / seeds, 0.9, atol=4 * np.sqrt(0.9 * 0.1 / seeds))


CASES = {
    "random walks": NoiseModel(random_walk=0.05, rate_random_walk=0.005),
    "tactical": NoiseModel(random_walk=0.05, bias_instability=0.03),
    "quantised": NoiseModel(quantization=0.01, random_walk=0.02, rate_ramp=3e-4),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seeds", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_coefficients_lie_within_their_uncertainties(case: str, seeds: int) -> None:
    """Many records each: 68 and 95 % of the squares within one and 1.96 u, for the terms that are there.

    All five terms are fitted. Squares cannot go below 0, so that terms at the edge cover more than
    stated, never less: four standard deviations of the count below, and unbiased within 0.6 u.
    """
    truth = CASES[case]
    pulls = np.empty((seeds, 5))
    relative = np.empty((seeds, 5))
    described = 0
    for seed in range(seeds):
        fit = fit_allan_coefficients(overlapping_allan_deviation(_noise(truth, SAMPLES, seed), RATE_HZ))
        spread = np.sqrt(np.diag(fit.covariance))
        pulls[seed] = (fit.squares - truth.squares) / spread
        relative[seed] = spread / np.maximum(truth.squares, 1e-300)
        described += fit.described
    for sigmas, stated in ((1.0, 0.683), (1.96, 0.95)):
        covered = (np.abs(pulls) <= sigmas).mean(axis=0)
        assert (covered >= stated - 4 * np.sqrt(stated * (1 - stated) / seeds)).all(), (sigmas, covered)
    assert (np.abs(pulls.mean(axis=0)) < (0.6 if seeds > 100 else 1.0)).all(), pulls.mean(axis=0)
    assert described >= (0.97 if seeds > 100 else 0.9) * seeds
    there = truth.squares > 0
    # The uncertainty is no fig leaf: at most as large as the square of the term, mostly far less.
    assert np.median(relative, axis=0)[there].max() < 1.0
    assert pulls.std(axis=0)[there].min() > 0.3


def test_an_ideal_plot_gives_its_coefficients_back_and_limits_for_the_absent() -> None:
    measured = overlapping_allan_deviation(_noise(NoiseModel(random_walk=1.0), SAMPLES, 1), RATE_HZ)
    truth = NoiseModel(random_walk=0.05, bias_instability=0.2, rate_random_walk=0.08)
    ideal = type(measured)(
        "overlapping",
        measured.tau_s,
        measured.factors,
        truth.deviation(measured.tau_s),
        measured.terms,
        SAMPLES,
        RATE_HZ,
    )
    fit = fit_allan_coefficients(ideal)
    np.testing.assert_allclose(fit.squares[1:4], truth.squares[1:4], rtol=1e-4)
    assert fit.chi_square_ratio < 1e-3
    assert fit.standard_uncertainty("random_walk") < 0.05 * fit.model.random_walk
    lower, upper = fit.interval("quantization")
    assert lower == 0.0
    assert 0.0 < upper < 1e-2
    assert not fit.determined("quantization")
    assert fit.determined("random_walk")


def test_a_vibration_line_is_said_not_averaged_away() -> None:
    samples = _noise(NoiseModel(random_walk=0.05), SAMPLES, 3)
    samples += 0.02 * np.sin(2 * np.pi * 0.11 * np.arange(SAMPLES) / RATE_HZ)
    fit = fit_allan_coefficients(overlapping_allan_deviation(samples, RATE_HZ))
    assert not fit.described
    assert fit.chi_square_ratio > 2.5


def test_what_cannot_be_fitted_is_refused() -> None:
    white = _noise(NoiseModel(random_walk=1.0), 512, 1)
    with pytest.raises(CalibrationError, match="do not carry 5 coefficients"):
        fit_allan_coefficients(overlapping_allan_deviation(white[:60], RATE_HZ))
    short = fit_allan_coefficients(overlapping_allan_deviation(white[:100], RATE_HZ), ("random_walk",))
    assert short.interval("random_walk", 3.0)[0] < 1.0 < short.interval("random_walk", 3.0)[1]
    with pytest.raises(CalibrationError, match="constant"):
        fit_allan_coefficients(overlapping_allan_deviation(np.ones(512), RATE_HZ))
    with pytest.raises(CalibrationError, match="modified"):
        fit_allan_coefficients(modified_allan_deviation(white, RATE_HZ))
    with pytest.raises(CalibrationError, match="no noise term"):
        fit_allan_coefficients(overlapping_allan_deviation(white, RATE_HZ), ("drift",))
    assert len(logarithmic_taus(512, RATE_HZ)) > len(TERMS)

"""Accelerometer in unknown attitudes: round trips, coverage, and attitudes that leave something open."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.algorithms.multi_position import fit_multi_position
from protocol.errors import CalibrationError

GRAVITY = 9.79
FORWARD = np.array([[1.02, 0.006, -0.004], [0.0, 0.97, 0.008], [0.0, 0.0, 1.035]])  # upper, as its inverse
BIAS = np.array([0.35, -0.2, -1.1])


def rests(rng: np.random.Generator, count: int, noise: float) -> NDArray[np.float64]:
    """Means of rests in random attitudes."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return GRAVITY * direction @ FORWARD.T + BIAS + rng.normal(size=(count, 3)) * noise


def test_exact_rests_give_exact_coefficients() -> None:
    fit = fit_multi_position(rests(np.random.default_rng(0), 20, 0.0), np.zeros(20), GRAVITY, "test")
    np.testing.assert_allclose(fit.coefficients.matrix, FORWARD, atol=1e-9)
    np.testing.assert_allclose(fit.coefficients.bias, BIAS, atol=1e-8)
    assert fit.assumed == ()


@pytest.mark.parametrize("stated", [True, False])
def test_uncertainties_cover_the_truth(stated: bool) -> None:
    """Noise that is stated, and noise that only shows as scatter between the rests."""
    noise = 0.004
    pulls = []
    for seed in range(100):
        means = rests(np.random.default_rng(seed), 24, noise)
        variance = np.full(24, noise**2 if stated else 1e-10)
        found = fit_multi_position(means, variance, GRAVITY, "test").coefficients
        of_matrix = (found.matrix - FORWARD)[np.triu_indices(3)]
        of_matrix /= found.matrix_standard_uncertainty()[np.triu_indices(3)]
        pulls.append([*of_matrix, *((found.bias - BIAS) / found.bias_standard_uncertainty())])
    # Scatter beyond the stated noise is never taken as negative: stated noise comes out a little wide.
    assert (0.65 if stated else 0.8) < (np.array(pulls) ** 2).mean() < 1.25


def test_axes_never_tilted_together_leave_their_nonorthogonality_assumed() -> None:
    rng = np.random.default_rng(5)
    angles = np.linspace(0.2, 6.4, 12)
    sweep = np.array(
        [[0.0, np.cos(a), np.sin(a)] for a in angles] + [[np.cos(a), 0.0, np.sin(a)] for a in angles]
    )
    means = GRAVITY * sweep @ FORWARD.T + BIAS + rng.normal(size=sweep.shape) * 1e-4
    fit = fit_multi_position(means, np.full(24, 1e-8), GRAVITY, "test")
    assert fit.assumed == ("k_xy",)
    assert fit.coefficients.matrix_standard_uncertainty()[0, 1] == pytest.approx(0.02, rel=0.1)
    np.testing.assert_allclose(np.diag(fit.coefficients.matrix), np.diag(FORWARD), atol=3e-4)
    np.testing.assert_allclose(fit.coefficients.bias, BIAS, atol=5e-3)


def test_attitudes_that_carry_no_scale_factor_are_refused_and_named() -> None:
    rng = np.random.default_rng(1)
    level = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 6, 20)])
    means = GRAVITY * level @ FORWARD.T + BIAS + rng.normal(size=level.shape) * 1e-4
    with pytest.raises(CalibrationError, match="k_zz") as refusal:
        fit_multi_position(means, np.full(20, 1e-8), GRAVITY, "test")
    assert "z up, down and level" in refusal.value.remedy


def test_too_few_rests_and_wrong_units_are_refused() -> None:
    means = rests(np.random.default_rng(2), 8, 0.0)
    with pytest.raises(CalibrationError, match="at least 9 rests; 8 can be used"):
        fit_multi_position(means, np.zeros(8), GRAVITY, "test")
    means = rests(np.random.default_rng(2), 12, 0.0) / 9.80665
    with pytest.raises(CalibrationError, match="far from"):
        fit_multi_position(means, np.zeros(12), GRAVITY, "test")

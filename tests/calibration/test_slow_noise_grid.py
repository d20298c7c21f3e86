"""All hypotheses of slow noise whitened together, against a Cholesky factor of each."""

import numpy as np
import pytest

from calibration.algorithms.linear_triad import fit_linear_triad, fit_with_unknown_slow_noise
from calibration.algorithms.noise_covariance import (
    Observations,
    gauss_markov_covariance,
    noise_hypotheses,
)
from calibration.algorithms.slow_noise_grid import can_whiten, whitened_products


def test_products_are_those_of_the_dense_covariance() -> None:
    rng = np.random.default_rng(1)
    duration = rng.uniform(0.5, 3.0, 20)
    middle = np.cumsum(duration + rng.uniform(0, 4, 20)) - duration / 2
    order = rng.permutation(20)  # turns are handed over after all the rests
    middle, duration = middle[order], duration[order]
    columns = rng.standard_normal((20, 5))
    level, correlation = np.array([0.0, 0.4, 3.0]), np.array([10.0, 0.8, 60.0])
    assert can_whiten(duration, correlation)
    assert not can_whiten(duration, correlation / 10)
    products, log_determinant = whitened_products(columns, middle, duration, level, correlation)
    for k in range(3):
        dense = np.diag(1 / duration)
        dense += level[k] ** 2 * gauss_markov_covariance(middle, duration, correlation[k])
        np.testing.assert_allclose(products[k], columns.T @ np.linalg.solve(dense, columns), rtol=1e-9)
        assert log_determinant[k] == pytest.approx(np.linalg.slogdet(dense)[1], abs=1e-9)


@pytest.mark.parametrize("slow", [0.0, 0.02])
def test_the_fit_is_that_of_the_dense_hypotheses(slow: float) -> None:
    rng = np.random.default_rng(2)
    runs, blocks = 9, 8
    run = np.repeat(np.arange(runs), blocks)
    inputs = np.vstack([np.eye(3), -np.eye(3), np.eye(3)])[run] * 9.8
    output = inputs + 0.1 + 0.01 * rng.standard_normal((runs * blocks, 3))
    output += slow * np.cumsum(rng.standard_normal((runs * blocks, 3)), axis=0)
    middle = 0.5 + np.arange(runs * blocks) + 3.0 * run
    observations = Observations(
        inputs,
        output,
        middle,
        np.ones(runs * blocks),
        run,
        tuple(map(str, range(runs))),
        np.zeros((runs, 3, 3)),
    )
    fast = fit_with_unknown_slow_noise("acceleration", observations, "test")
    hypotheses = noise_hypotheses(observations, (), True)
    dense = fit_linear_triad("acceleration", observations, hypotheses, "test")
    np.testing.assert_allclose(fast.weights, dense.weights, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(fast.coefficients.matrix, dense.coefficients.matrix, atol=1e-10)
    np.testing.assert_allclose(
        fast.coefficients.covariance, dense.coefficients.covariance, rtol=1e-5, atol=1e-14
    )
    assert fast.likeliest == dense.likeliest
    assert fast.chi_square_ratio == pytest.approx(dense.chi_square_ratio, rel=1e-6)

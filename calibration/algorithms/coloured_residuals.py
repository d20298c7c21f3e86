"""A least-squares fit weighed anew for noise with a memory: estimate and covariance.

A fit by ordinary least squares is as certain as it says only where its noise is white. Around its solution
the model is taken as linear, and Gauss-Markov noise of several levels and correlation times beside the white
one is weighed by its restricted likelihood (Patterson & Thompson, Biometrika 58 (1971) 545), as in
`linear_triad`: mean over the hypotheses, covariances plus the spread of the estimates.
"""

# pyright: strict
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray

SPANS = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1.0)
"""Correlation times that are weighed, relative to the longest series."""
RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Standard deviations of the slow noise, relative to the white noise of one value."""
MOST_VALUES = 200
"""Of a series: longer ones are averaged in blocks, since a covariance grows with the square."""


def weigh_colours(
    jacobian: FloatArray, residual: FloatArray, series: Sequence[tuple[NDArray[np.intp], FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """What to add to the parameters, shape (p,), and their covariance, shape (p, p).

    Args:
        jacobian: d(model) / d(parameters) at the ordinary solution, shape (n, p).
        residual: measured less model there, shape (n,).
        series: rows and times, s, of each stretch in which noise runs on; together all rows, independent of
            each other, alike in level.
    """
    reduced = [_blocks(jacobian[rows], residual[rows], time_s) for rows, time_s in series if len(rows)]
    longest_s = max(float(np.ptp(time_s)) for _, _, time_s in reduced)
    grid = [(0.0, 1.0)] + [(ratio, span * longest_s) for ratio in RATIOS for span in SPANS]
    prior = np.array([0.5, *np.full(len(grid) - 1, 0.5 / (len(grid) - 1))])
    freedom = sum(len(time_s) for _, _, time_s in reduced) - jacobian.shape[1]
    solved = [_solve(reduced, ratio, correlation_s, freedom) for ratio, correlation_s in grid]
    log_weights = np.log(prior) + np.array([one[2] for one in solved])
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    steps, covariances = np.array([one[0] for one in solved]), np.array([one[1] for one in solved])
    mean = weights @ steps
    spread = steps - mean
    covariance = np.einsum("h,hpq->pq", weights, covariances)
    covariance += np.einsum("h,hp,hq->pq", weights, spread, spread)
    return np.asarray(mean, dtype=np.float64), np.asarray(covariance, dtype=np.float64)


def _blocks(
    jacobian: FloatArray, residual: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means over blocks of as many values each, at most `MOST_VALUES` of them; a rest at the end is left."""
    each = math.ceil(len(time_s) / MOST_VALUES)
    count = len(time_s) // each
    rows = np.s_[: count * each]
    return (
        np.asarray(jacobian[rows].reshape(count, each, -1).mean(axis=1), dtype=np.float64),
        np.asarray(residual[rows].reshape(count, each).mean(axis=1), dtype=np.float64),
        np.asarray(time_s[rows].reshape(count, each).mean(axis=1), dtype=np.float64),
    )


def _solve(
    series: Sequence[tuple[FloatArray, FloatArray, FloatArray]],
    ratio: float,
    correlation_s: float,
    freedom: int,
) -> tuple[FloatArray, FloatArray, float]:
    """Step, covariance and logarithm of the restricted likelihood under one hypothesis."""
    size = series[0][0].shape[1]
    normal, right, squares, log_determinant = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
    shared: dict[bytes, FloatArray] = {}
    for jacobian, residual, time_s in series:
        factor = shared.get(time_s.tobytes())
        if factor is None:
            apart = np.abs(time_s[:, None] - time_s[None, :])
            covariance = np.eye(len(time_s)) + ratio**2 * np.exp(-apart / correlation_s)
            factor = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
            shared[time_s.tobytes()] = factor
        white = np.linalg.solve(factor, np.column_stack([jacobian, residual]))
        normal += white[:, :-1].T @ white[:, :-1]
        right += white[:, :-1].T @ white[:, -1]
        squares += float(white[:, -1] @ white[:, -1])
        log_determinant += 2.0 * float(np.log(np.diag(factor)).sum())
    inverse = np.asarray(np.linalg.pinv(normal, rcond=1e-14, hermitian=True), dtype=np.float64)
    step = inverse @ right
    chi_square = max(squares - float(right @ step), 1e-300)
    variance = chi_square / max(freedom - 2, 1)  # of the t distribution
    sign, log_normal = np.linalg.slogdet(normal)
    likelihood = -0.5 * (freedom * math.log(chi_square) + log_determinant + (log_normal if sign > 0 else 0.0))
    return step, inverse * variance, likelihood

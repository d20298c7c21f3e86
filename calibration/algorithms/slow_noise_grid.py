"""Generalised least squares under many Gauss-Markov levels and correlation times at once.

The covariance of block means under white and Gauss-Markov noise, `noise_covariance`, is off its diagonal
exp(-|t1 - t2| / tau) a_1 a_2: a first-order recursion whitens it exactly, one observation after the other
(innovations form of the Kalman filter: Anderson & Moore, Optimal Filtering (1979), ch. 5, 9), for all
hypotheses together. A Cholesky factor of each would give the same numbers, forty times as slowly.
"""

# pyright: strict
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MAX_STRETCH = 4.0
"""Longest stretch, in correlation times, up to which the recursion keeps its digits."""


def can_whiten(duration_s: FloatArray, correlation_s: FloatArray) -> bool:
    """Whether the recursion is exact enough for these stretches and correlation times."""
    return bool(float(duration_s.max()) <= MAX_STRETCH * float(correlation_s.min()))


def whitened_products(
    columns: FloatArray,
    middle_s: FloatArray,
    duration_s: FloatArray,
    level: FloatArray,
    correlation_s: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """C^T V^-1 C, shape (h, c, c), and ln det V, shape (h,), of each hypothesis.

    V = diag(1 / D) + level^2 times the Gauss-Markov covariance of `gauss_markov_covariance`.

    Args:
        columns: C, shape (k, c).
        middle_s, duration_s: of the stretches averaged, shape (k,), none overlapping another.
        level: standard deviation of the slow noise, shape (h,).
        correlation_s: its correlation time, shape (h,).
    """
    order = np.argsort(middle_s, kind="stable")
    middle, duration, values = middle_s[order], duration_s[order], columns[order]
    half = duration[:, None] / (2.0 * correlation_s)
    average = np.where(half > 1e-6, np.sinh(half) / np.maximum(half, 1e-12), 1.0)
    whole = 2.0 * half
    own = np.where(
        whole > 1e-4, 2.0 * (whole + np.expm1(-whole)) / np.maximum(whole, 1e-12) ** 2, 1.0 - whole / 3
    )
    own_variance = 1.0 / duration[:, None] + level**2 * (own - average**2)
    gain_shape = level * average  # (k, h): output = gain_shape x state + what is its own
    decay = np.exp(-np.diff(middle)[:, None] / correlation_s)
    state = np.zeros((len(level), values.shape[1]))
    variance = np.ones(len(level))
    white = np.empty((len(values), len(level), values.shape[1]))
    spread = np.empty((len(values), len(level)))
    for k in range(len(values)):
        if k:
            state *= decay[k - 1][:, None]
            variance = decay[k - 1] ** 2 * (variance - 1.0) + 1.0
        scaled = gain_shape[k] * variance
        spread[k] = gain_shape[k] * scaled + own_variance[k]
        innovation = values[k] - gain_shape[k][:, None] * state
        gain = scaled / spread[k]
        state += gain[:, None] * innovation
        variance = variance - gain * scaled
        white[k] = innovation
    white /= np.sqrt(spread)[:, :, None]
    by_hypothesis = np.ascontiguousarray(white.transpose(1, 2, 0))
    products = by_hypothesis @ by_hypothesis.transpose(0, 2, 1)
    return products, np.log(spread).sum(axis=0)

# pyright: strict
"""Jitter of the samples' times: noise whose variance grows with the square of the prediction's slope.

A sample taken j early or late is off by j ∂ŷ/∂t, with one j for the three axes. Of the residual, what a
sample differs from the mean of its two neighbours is taken: white noise stays (× √1.5), what a lag, a kink or
a coupling leaves is smooth and goes. Along the slope g, in units of each axis' own noise,

    z = Σ h_a g_a / |g|,   var z = c + σ² q,   q = (|g_t|² + (|g_(t−1)|² + |g_(t+1)|²) / 4) / 1.5

and c, σ² follow by weighted least squares of z². Uncertainty: sandwich over blocks of time.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray

LEAST_ROWS = 200
ITERATIONS = 20
BLOCKS = 50
LARGEST_SQUARE = 12.0
"""z² of so many times its variance counts as that: knocks at the bench are no jitter."""
MEDIAN_OF_SQUARE = 0.4549
"""Of χ² with one degree of freedom."""


@dataclass(frozen=True)
class JitterFit:
    """σ² with its standard uncertainty, s², and the log likelihood ratio against none."""

    variance_s2: float
    uncertainty_s2: float
    log_likelihood_ratio: float


def fitted_jitter(residual: FloatArray, slope: FloatArray, piece: NDArray[np.int64]) -> JitterFit | None:
    """σ²; None where the motion does not tell it.

    Args:
        residual: (n, 3) SI, nuisances and delay taken out.
        slope: (n, 3) ∂ŷ/∂t.
        piece: (n,) rows of one number follow each other.
    """
    there = np.isfinite(residual) & np.isfinite(slope)
    axes = there.sum(axis=0) > LEAST_ROWS
    if not axes.any():
        return None
    e, g = residual[:, axes], slope[:, axes]
    h = (e[1:-1] - 0.5 * (e[:-2] + e[2:])) / np.sqrt(1.5)
    rows = np.isfinite(h).all(axis=1) & np.isfinite(g[1:-1]).all(axis=1) & (piece[2:] == piece[:-2])
    rows &= np.isfinite(g[:-2]).all(axis=1) & np.isfinite(g[2:]).all(axis=1)
    if rows.sum() < LEAST_ROWS:
        return None
    deviation = _quiet_deviation(h[rows], g[1:-1][rows])
    if (deviation <= 0).any():
        return None
    g = g / deviation
    size = (g**2).sum(axis=1)
    q = ((size[1:-1] + 0.25 * (size[:-2] + size[2:])) / 1.5)[rows]
    middle = size[1:-1][rows, np.newaxis]
    usual = np.sqrt(np.nanmean(g**2, axis=0))  # at rest the noise is taken along the usual slope
    at_rest = usual / max(float(np.linalg.norm(usual)), 1e-300)
    along = np.where(middle > 0, g[1:-1][rows] / np.sqrt(np.where(middle > 0, middle, 1.0)), at_rest)
    z2 = ((h[rows] / deviation) * along).sum(axis=1) ** 2
    return _fit(z2, q) if q.max() > 0 and np.ptp(q) > 1e-6 * q.max() else None


def _quiet_deviation(h: FloatArray, slope: FloatArray) -> FloatArray:
    """(k,) of each axis, from the half of the rows with the least slope."""
    size = (slope**2).sum(axis=1)
    quiet = size <= np.median(size)
    return np.sqrt(np.mean(h[quiet] ** 2, axis=0))


def _fit(z2: FloatArray, q: FloatArray) -> JitterFit | None:
    scale = float(q.mean())
    x = q / scale
    level, grows = float(np.median(z2)) / MEDIAN_OF_SQUARE, 0.0
    if level <= 0:
        return None
    for _ in range(ITERATIONS):
        v = np.maximum(level + grows * x, 1e-3 * level)
        (a, b, c), (p, r) = _normal(z2, x, v)
        before, (level, grows) = grows, ((c * p - b * r) / (a * c - b * b), (a * r - b * p) / (a * c - b * b))
        level = max(level, 1e-12)
        if abs(grows - before) < 1e-6 * level:
            break
    v = np.maximum(level + grows * x, 1e-3 * level)
    y = np.minimum(z2, LARGEST_SQUARE * v)
    (a, b, c), _ = _normal(z2, x, v)
    weight, left = 1.0 / v**2, y - level - grows * x
    number = np.arange(len(y)) * BLOCKS // len(y)
    scores = weight * left * (a * x - b) / (a * c - b * b)  # of the second parameter
    sandwich = float((np.bincount(number, weights=scores, minlength=BLOCKS) ** 2).sum())
    uncertainty = float(np.sqrt(max(sandwich, 2.0 * a / (a * c - b * b))))
    alone = float(np.mean(np.minimum(z2, LARGEST_SQUARE * np.median(z2) / MEDIAN_OF_SQUARE)))
    gained = 0.5 * float(np.sum(np.log(alone / v) + y / alone - y / v))
    ratio = max(0.0, min(gained, 0.5 * (grows / uncertainty) ** 2)) if grows > 0 else 0.0
    return JitterFit(grows / scale, uncertainty / scale, ratio)


def _normal(
    z2: FloatArray, x: FloatArray, v: FloatArray
) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Sums of the normal equations of z² = level + grows x, weighted with 1 / v²."""
    weight, y = 1.0 / v**2, np.minimum(z2, LARGEST_SQUARE * v)
    weighted = weight * x
    left = float(weight.sum()), float(weighted.sum()), float((weighted * x).sum())
    return left, (float((weight * y).sum()), float((weighted * y).sum()))

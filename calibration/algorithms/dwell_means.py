"""Means of an output over dwells at a steady input: what was missing, far off, or not yet steady is told."""

# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.screening import MAX_LOST_FRACTION

FloatArray = NDArray[np.float64]

OUTLIER_SIGMAS = 8.0
"""Robust standard deviations of its dwell beyond which a sample is none of it."""
UNSTEADY = 2e-3
"""Of the span of all dwells: larger a change from the first to the second half is no steady output."""
UNSTEADY_SIGMAS = 6.0
_ROBUST_SIGMA = 1.4826
_MIN_SAMPLES_TO_JUDGE = 8


@dataclass(frozen=True)
class DwellMeans:
    """One value a dwell, shapes (k,).

    Attributes:
        mean: NaN where more of the samples than `MAX_LOST_FRACTION` are missing.
        unsteady: whether the output still changed, or more of it than `MAX_LOST_FRACTION` is far off.
        missing, outliers: how many samples of all dwells were left out.
    """

    mean: FloatArray
    unsteady: NDArray[np.bool_]
    missing: int
    outliers: int


def dwell_means(
    time_s: FloatArray, output: FloatArray, begin_s: FloatArray, duration_s: FloatArray, period_s: float
) -> DwellMeans:
    """Mean of each dwell.

    Args:
        time_s, output: samples, shape (n,), times ascending.
        begin_s, duration_s: of the dwells, shape (k,).
        period_s: between samples.
    """
    count = len(begin_s)
    first = np.searchsorted(time_s, begin_s - 1e-6)
    last = np.searchsorted(time_s, begin_s + duration_s - 1e-6)
    mean, change, noise = np.full(count, np.nan), np.zeros(count), np.zeros(count)
    restless = np.zeros(count, dtype=np.bool_)
    missing = outliers = 0
    for row, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        expected = max(round(float(duration_s[row]) / period_s), 1)
        samples = output[a:b]
        samples = samples[np.isfinite(samples)]
        lost = max(expected - len(samples), 0)
        missing += lost
        kept = samples
        if len(samples) >= _MIN_SAMPLES_TO_JUDGE:
            away = np.abs(samples - np.median(samples))
            kept = samples[
                away <= OUTLIER_SIGMAS * _ROBUST_SIGMA * max(float(np.median(away)), _step(samples))
            ]
        off = len(samples) - len(kept)
        if off > MAX_LOST_FRACTION * expected + 1:
            restless[row] = True
            continue
        outliers += off
        if len(kept) == 0 or expected - len(kept) > MAX_LOST_FRACTION * expected + 1:
            continue
        mean[row] = kept.mean()
        if len(kept) >= _MIN_SAMPLES_TO_JUDGE:
            half = len(kept) // 2
            change[row] = abs(float(kept[:half].mean() - kept[half:].mean()))
            noise[row] = float(kept.std()) * 2.0 / np.sqrt(len(kept))
    there = np.isfinite(mean)
    span = float(np.ptp(mean[there])) if there.any() else 0.0
    typical = float(np.median(noise[there])) if there.any() else 0.0
    unsteady = restless | there & (change > np.maximum(UNSTEADY * span, UNSTEADY_SIGMAS * typical))
    return DwellMeans(mean, unsteady, missing, outliers)


def _step(samples: FloatArray) -> float:
    """The smallest step between samples that are not alike: a coarse output has no finer deviation."""
    steps = np.diff(np.unique(samples))
    return float(steps.min()) if len(steps) else 0.0

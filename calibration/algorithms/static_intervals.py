"""Rests in a session made by hand, where no stand says when the rate was zero.

A stretch is at rest while the variance of every channel in a short window stays near that of the
quietest windows of the session. What the window cannot see is a slow, steady turn: the gravity norm
of each rest is checked by the fit that follows.
"""

# pyright: strict
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WINDOW_S = 0.5
MIN_WINDOW_SAMPLES = 16
QUIET_QUANTILE = 0.1
"""The session's noise is taken from its quietest tenth: a session that never rests has none to show."""
MAX_VARIANCE_RATIO = 12.0
"""Window variance, over the quiet one, up to which a window counts as at rest (each sensor)."""
MIN_REST_S = 0.75
MAX_RESTS = 200


def detect_rests(time_s: FloatArray, sensors: tuple[FloatArray, ...]) -> tuple[tuple[int, int], ...]:
    """First and last-plus-one row of each rest, in order; empty when there is none.

    Args:
        time_s: shape (n,), uniform.
        sensors: arrays (n, 3), each judged on the sum of its channels' variances. Rows that are
            not finite end a rest.
    """
    period = float(np.median(np.diff(time_s)))
    window = max(MIN_WINDOW_SAMPLES, round(WINDOW_S / period))
    if len(time_s) < 2 * window:
        return ()
    quiet = np.ones(len(time_s) - window + 1, dtype=np.bool_)
    for samples in sensors:
        variance = _moving_variance(samples, window)
        finite = np.isfinite(variance)
        if not finite.any():
            return ()
        floor = float(np.quantile(variance[finite], QUIET_QUANTILE))
        quiet &= finite & (np.nan_to_num(variance, nan=np.inf) <= MAX_VARIANCE_RATIO * floor)
    # A sample is at rest if every window that holds it is: the ends of a rest are cut off by half a window.
    starts = np.flatnonzero(np.diff(np.concatenate([[False], quiet]).astype(np.int8)) == 1)
    ends = np.flatnonzero(np.diff(np.concatenate([quiet, [False]]).astype(np.int8)) == -1) + 1
    rests: list[tuple[int, int]] = []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        first, last = start + window // 4, end + window - window // 4 - 1
        if (last - first) * period >= MIN_REST_S:
            rests.append((first, last))
    return tuple(rests[:MAX_RESTS])


def _moving_variance(samples: FloatArray, window: int) -> FloatArray:
    """Sum of the channels' variances in each window, shape (n - window + 1,); NaN where a sample is."""
    missing: NDArray[np.bool_] = np.asarray(np.any(~np.isfinite(samples), axis=1), dtype=np.bool_)
    centred = np.where(missing[:, None], 0.0, samples)
    centred = centred - centred.mean(axis=0)

    def moving(values: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        return (total[window:] - total[:-window]) / window

    variance = (moving(centred**2) - moving(centred) ** 2).sum(axis=1)
    holes = moving(missing[:, None].astype(np.float64))[:, 0] > 0
    return np.where(holes, np.nan, np.maximum(variance, 0.0))

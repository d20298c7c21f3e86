# pyright: strict
"""The unit's temperature without its sensor's noise: effects take its rate of change."""

import numpy as np

from dut_emulator.effects.effect import FloatArray

SMOOTHED_OVER_S = 5.0
"""Units follow the chamber within minutes. A sensor with 0.03 °C of noise at 200 Hz then tells the rate of
change to 0.02 °C/min; unsmoothed, to 500."""


def smoothed(values: FloatArray, period_s: float) -> FloatArray:
    """(n,) two sliding means of `SMOOTHED_OVER_S`, symmetric up to the ends: straight lines stay as they are.

    NaN are left out of the means; NaN only where there is nothing within reach.
    """
    half = round(0.5 * SMOOTHED_OVER_S / period_s)
    if half < 1 or len(values) < 3:
        return values
    return _sliding_mean(_sliding_mean(values, half), half)


def _sliding_mean(values: FloatArray, half: int) -> FloatArray:
    row = np.arange(len(values))
    reach = np.minimum(half, np.minimum(row, len(values) - 1 - row))
    there = np.isfinite(values)
    level = float(np.mean(values[there])) if there.any() else 0.0
    sums = np.concatenate([[0.0], np.cumsum(np.where(there, values - level, 0.0))])
    counts = np.concatenate([[0], np.cumsum(there)])
    number = counts[row + reach + 1] - counts[row - reach]
    total = sums[row + reach + 1] - sums[row - reach]
    return np.where(number > 0, level + total / np.maximum(number, 1), np.nan)

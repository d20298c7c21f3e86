# pyright: strict
"""Two clocks whose epochs have nothing to do with each other: how far the stand's is ahead, from the motion.

Coarse: the unit's rates (or specific forces, or field) and the stand's, both on one grid, are correlated at
every lag that leaves enough overlap; or their norms, which need no common axes (Faizullin et al., Sensors
21(1):68, 2021). The lag counts if it is clear: correlation above `LEAST_CORRELATION` and no other as good.
Fine: see `delay_fit`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray

ComplexArray = NDArray[np.complex128]

MAX_GRID_RATE_HZ = 100.0
MAX_GRID_ROWS = 400_000
LEAST_CORRELATION = 0.6
CLEAR_MARGIN = 0.02
"""The best correlation must exceed any other, a second away, by so much."""
APART_S = 1.0
LEAST_OVERLAP = 0.3
"""Of the shorter of the two."""


@dataclass(frozen=True)
class Motion:
    """Columns over time: (n,) s and (n, k) SI, NaN where unknown."""

    time_s: FloatArray
    columns: FloatArray

    @property
    def norm(self) -> "Motion":
        """Its length alone, k = 1."""
        return Motion(self.time_s, np.sqrt((self.columns**2).sum(axis=1, keepdims=True)))


@dataclass(frozen=True)
class CoarseLag:
    """`ahead_s`: stand's time less unit's time at one instant; how well and how clearly they agree."""

    ahead_s: float
    correlation: float
    is_clear: bool


def coarse_lag(unit: Motion, stand: Motion) -> CoarseLag | None:
    """The lag at which they agree best; None where one of them does not move or is too short."""
    step_s = max(1.0 / MAX_GRID_RATE_HZ, max(np.ptp(unit.time_s), np.ptp(stand.time_s)) / MAX_GRID_ROWS)
    one, other = _on_grid(unit, step_s), _on_grid(stand, step_s)
    if one is None or other is None:
        return None
    correlation, overlap = _correlations(one, other)
    least = LEAST_OVERLAP * min(np.count_nonzero(one[:, 0]), np.count_nonzero(other[:, 0]))
    correlation[overlap < least] = -1.0
    best = int(np.argmax(correlation))
    lags = np.arange(len(correlation)) - (len(one) - 1)
    others = np.abs(lags - lags[best]) * step_s > APART_S
    second = float(correlation[others].max()) if others.any() else -1.0
    top = float(correlation[best])
    ahead = float(stand.time_s[0] - unit.time_s[0] + lags[best] * step_s)
    return CoarseLag(ahead, top, top >= LEAST_CORRELATION and top - second > CLEAR_MARGIN)


def _on_grid(motion: Motion, step_s: float) -> FloatArray | None:
    """(m, k) deviation from the mean, block means at least; 0 where nothing is known."""
    there = np.isfinite(motion.columns).all(axis=1)
    if there.sum() < 16:
        return None
    time_s, columns = motion.time_s[there], motion.columns[there]
    index = np.rint((time_s - motion.time_s[0]) / step_s).astype(np.int64)
    rows = int(index[-1]) + 1
    count = np.bincount(index, minlength=rows)
    known = np.flatnonzero(count)
    grid = np.zeros((rows, columns.shape[1]))
    for number, column in enumerate(columns.T):
        sums = np.bincount(index, weights=column - column.mean(), minlength=rows)
        grid[known, number] = sums[known] / count[known]
        if len(known) < 0.5 * rows:  # rows come slower than the grid
            grid[:, number] = np.interp(np.arange(rows), known, grid[known, number])
    return grid if float(grid.std()) > 1e-12 * max(1.0, float(np.abs(columns).max())) else None


def _correlations(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pooled correlation of one[k] with other[k + lag], and rows of overlap, from lag = 1 − len(one) on."""
    size = 1 << (len(one) + len(other) - 1).bit_length()

    def lines(series: FloatArray) -> ComplexArray:
        return np.fft.rfft(series, size)

    def lagged(spectrum: ComplexArray) -> FloatArray:
        ring = np.fft.irfft(spectrum, size)
        return np.concatenate([ring[size - len(one) + 1 :], ring[: len(other)]])

    known_one, known_other = (lines((part != 0).any(axis=1).astype(np.float64)) for part in (one, other))
    overlap = np.rint(lagged(known_one.conj() * known_other))
    many = np.maximum(overlap, 1.0)
    cross, square_one, square_other = np.zeros((3, size // 2 + 1), dtype=np.complex128)
    means, mean_one, mean_other = np.zeros((3, len(overlap)))
    for a, b in zip(one.T, other.T, strict=True):
        of_a, of_b = lines(a).conj(), lines(b)
        cross += of_a * of_b
        square_one += lines(a**2).conj() * known_other
        square_other += known_one.conj() * lines(b**2)
        sum_a, sum_b = lagged(of_a * known_other), lagged(known_one.conj() * of_b)
        means += sum_a * sum_b / many
        mean_one += sum_a**2 / many
        mean_other += sum_b**2 / many
    pooled = lagged(cross) - means
    square_one, square_other = lagged(square_one) - mean_one, lagged(square_other) - mean_other
    floor = 1e-9 * max(float(square_one.max()), 1e-300) * max(float(square_other.max()), 1e-300)
    both = np.maximum(square_one, 0.0) * np.maximum(square_other, 0.0)
    return np.where(both > floor, pooled / np.sqrt(np.maximum(both, floor)), -1.0), overlap

# pyright: strict
"""How late a triad's samples are against the prediction: y(t) = ŷ(t − d(t)), d = Σ θ_k P_k(t).

Gauss–Newton on r = y − ŷ(t − d) = N β − Σ θ_k P_k ∂ŷ/∂t + n. N (bias, scale factors, misalignment of each
axis) is projected out axis by axis; θ is common to the three. The residual is whitened by an autoregression
of its own. The standard uncertainty is the larger of the least-squares one and the sandwich over blocks,
which also holds where the residual is no stationary noise (a reference in bursts, a lever arm).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.holes import MIXED_STEPS, covered

AR_ORDER = 8
MAX_MISSING_FOR_AR = 0.02
"""With more missing values than this, an autoregression would lose most rows: the sandwich does it alone."""
ITERATIONS = 8
SETTLED_S, SETTLED = 1e-8, 0.01
"""A step is the last one if it is below this, or below this share of the standard uncertainty."""
LEAST_ROWS = 100
LARGEST_STEP_S = 0.25
LEAST_BLOCKS, MAX_BLOCKS = 20, 100
BLOCK_S = 5.0
COLLINEAR = 1e-9
LEAST_SHARE_OF_AXIS = 0.05
"""Of what the three tell: an axis that tells less has no say in whether they agree."""


@dataclass(frozen=True)
class Triad:
    """Rows of one triad beside its prediction.

    Attributes:
        time_s: (n,).
        values, predicted: (n, 3) SI, NaN where missing.
        period_s: of the rows.
        piece: (n,) rows of one number follow each other.
    """

    time_s: FloatArray
    values: FloatArray
    predicted: FloatArray
    period_s: float
    piece: NDArray[np.int64]

    def moved(self, delay_s: FloatArray) -> FloatArray:
        """(n, 3) the prediction at t − d(t), linear between rows, NaN where that lies in a hole."""
        if not delay_s.any():
            return self.predicted
        known = np.isfinite(self.predicted).all(axis=1)
        at, out = self.time_s - delay_s, np.full(self.predicted.shape, np.nan)
        if known.any():
            seen = covered(at, self.time_s[known], MIXED_STEPS * self.period_s)
            for axis in range(3):
                out[seen, axis] = np.interp(at[seen], self.time_s[known], self.predicted[known, axis])
        return out

    def slope(self, predicted: FloatArray) -> FloatArray:
        """(n, 3) ∂ŷ/∂t, central; NaN at the ends of pieces."""
        out = np.full(predicted.shape, np.nan)
        inside = self.piece[2:] == self.piece[:-2]
        change = (predicted[2:] - predicted[:-2]) / (self.time_s[2:] - self.time_s[:-2])[:, np.newaxis]
        out[1:-1] = np.where(inside[:, np.newaxis], change, np.nan)
        return out


@dataclass(frozen=True)
class DelayFit:
    """What a fit came to.

    Attributes:
        values: (k,) θ.
        covariance: (k, k).
        left: (n, 3) whitened residual, NaN where nothing could be said; per axis in its own deviations.
        patterns: (n, 3, k) whitened regressors, nuisances projected out, in the same deviations.
        raw, slope: (n, 3) residual in SI, nuisances projected out, and ∂ŷ/∂t.
        rows: how many.
        moved_for_s: in so much time lie nine tenths of what tells of the delay.
        whitener: (3, p + 1) autoregression of the residual.
    """

    values: FloatArray
    covariance: FloatArray
    left: FloatArray
    patterns: FloatArray
    raw: FloatArray
    slope: FloatArray
    rows: int
    moved_for_s: float
    whitener: FloatArray

    @property
    def standard_uncertainties(self) -> FloatArray:
        """(k,)."""
        return np.sqrt(np.diag(self.covariance))


def fitted_delay(
    triad: Triad, patterns: Sequence[FloatArray], start: DelayFit | None = None, about_s: float = 0.0
) -> DelayFit | None:
    """θ with its covariance; None where the motion does not tell it.

    Args:
        triad: rows.
        patterns: k times (n,): the delay per unit of each parameter; the first is a constant delay.
        start: another fit of these rows; its first parameters are where this one starts.
        about_s: where the constant delay starts without it.
    """
    theta = np.zeros(len(patterns))
    theta[0] = about_s
    if start is not None:
        theta[: len(start.values)] = start.values
    scale = np.array([max(float(np.abs(pattern).max()), 1e-300) for pattern in patterns])
    weights = None if start is None else start.whitener
    outcome: DelayFit | None = None
    for iteration in range(ITERATIONS):
        delay_s = sum(
            (value * pattern for value, pattern in zip(theta, patterns, strict=True)),
            start=0.0 * triad.time_s,
        )
        outcome, weights_next = _one_step(triad, patterns, theta, delay_s, weights)
        if outcome is None:
            return None
        step = outcome.values - theta
        largest_s = float(np.abs(step * scale).max())
        if largest_s > LARGEST_STEP_S:
            step *= LARGEST_STEP_S / largest_s
        theta = theta + step
        settled = largest_s < max(SETTLED_S, SETTLED * float((outcome.standard_uncertainties * scale).min()))
        if iteration >= 1 and weights is None:
            weights = weights_next
        if settled and (iteration >= 2 or start is not None):
            break
    return outcome


def _one_step(
    triad: Triad,
    patterns: Sequence[FloatArray],
    theta: FloatArray,
    delay_s: FloatArray,
    whitener: FloatArray | None,
) -> tuple[DelayFit | None, FloatArray]:
    """A Gauss–Newton step; `values` of the outcome are θ after it. Also the residual's autoregression."""
    moved = triad.moved(delay_s)
    slope = triad.slope(moved)
    n, k = len(triad.time_s), len(patterns)
    left, shown = np.full((n, 3), np.nan), np.full((n, 3, k), np.nan)
    raw = np.full((n, 3), np.nan)
    for axis in range(3):
        rows = (
            np.isfinite(triad.values[:, axis]) & np.isfinite(moved).all(axis=1) & np.isfinite(slope[:, axis])
        )
        if rows.sum() < LEAST_ROWS or not slope[rows, axis].any():
            continue
        columns = np.empty((n, 5 + k))
        columns[:, 0] = triad.values[:, axis] - moved[:, axis]
        columns[:, 1] = 1.0
        columns[:, 2:5] = moved - np.nanmean(moved, axis=0)
        for index, pattern in enumerate(patterns):
            columns[:, 5 + index] = -slope[:, axis] * pattern
        columns[~rows] = np.nan
        cleared = _cleared(columns[rows], k)
        raw[rows, axis] = cleared[:, 0]
        if whitener is not None:
            columns = _whitened(columns, whitener[axis], triad.piece)
            rows = np.isfinite(columns[:, 0])
            if rows.sum() < LEAST_ROWS:
                continue
            cleared = _cleared(columns[rows], k)
        deviation = float(np.sqrt(np.mean(cleared[:, 0] ** 2)))
        if deviation <= 0:
            deviation = np.finfo(np.float64).tiny
        left[rows, axis] = cleared[:, 0] / deviation
        shown[rows, axis] = cleared[:, 1:] / deviation
    next_whitener = _autoregression(raw, triad.piece) if whitener is None else whitener
    return _solved(triad, theta, _Rows(left, shown, raw, slope, next_whitener)), next_whitener


def _cleared(columns: FloatArray, k: int) -> FloatArray:
    """(m, 1 + k) residual and patterns with the nuisances projected out."""
    last = columns.shape[1] - k
    nuisances = columns[:, 1:last]
    kept = np.concatenate([columns[:, :1], columns[:, last:]], axis=1)
    gram = nuisances.T @ nuisances
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=COLLINEAR, hermitian=True)
    share = inverse @ ((nuisances.T @ kept) / scale[:, np.newaxis])
    kept -= nuisances @ (share / scale[:, np.newaxis])
    return kept


@dataclass(frozen=True)
class _Rows:
    """Residual and patterns of a step, whitened; residual and slope as they are; the whitener."""

    left: FloatArray
    shown: FloatArray
    raw: FloatArray
    slope: FloatArray
    whitener: FloatArray


def _solved(triad: Triad, theta: FloatArray, step: _Rows) -> DelayFit | None:
    """Least squares over the three axes, with the sandwich over blocks."""
    left, shown = step.left, step.shown
    rows = np.isfinite(left).any(axis=1)
    if not rows.any():
        return None
    e, x = np.nan_to_num(left[rows]), np.nan_to_num(shown[rows])
    scale = np.sqrt((x**2).sum(axis=(0, 1)))
    if (scale <= 0).any():
        return None
    x = x / scale
    gram: FloatArray = np.einsum("nak,naj->kj", x, x)
    if np.linalg.cond(gram) > 1.0 / COLLINEAR:
        return None
    inverse = np.linalg.inv(gram).astype(np.float64)
    scores: FloatArray = np.einsum("nak,na->k", x, e)
    change = inverse @ scores
    final = e - x @ change
    count = int(np.isfinite(left).sum())
    plain = inverse * float((final**2).sum()) / max(count - len(theta), 1)
    robust = _sandwich(x, final, inverse, triad.time_s[rows])
    diagonal = np.maximum(np.diag(plain), np.diag(robust))
    stretch = np.sqrt(diagonal / np.diag(robust))
    covariance = robust * np.outer(stretch, stretch) * _disagreement(x[:, :, 0], final, triad.time_s[rows])
    whole = np.full(left.shape, np.nan)
    whole[rows] = np.where(np.isfinite(left[rows]), final, np.nan)
    information = (x[:, :, 0] ** 2).sum(axis=1)
    return DelayFit(
        values=theta + change / scale,
        covariance=covariance / np.outer(scale, scale),
        left=whole,
        patterns=shown,
        raw=step.raw,
        slope=step.slope,
        whitener=step.whitener,
        rows=count,
        moved_for_s=_spread_s(information, triad.time_s[rows]),
    )


def _disagreement(x: FloatArray, e: FloatArray, time_s: FloatArray) -> float:
    """χ² per degree of freedom of the axes' own delays about the common one; 1 at least."""
    chi2, axes = 0.0, 0
    for axis in range(x.shape[1]):
        telling = float((x[:, axis] ** 2).sum())
        if telling > LEAST_SHARE_OF_AXIS * float((x**2).sum()):
            alone, left = x[:, axis, np.newaxis, np.newaxis], e[:, axis, np.newaxis]
            variance = float(_sandwich(alone, left, np.array([[1.0 / telling]]), time_s)[0, 0])
            late = float((x[:, axis] * e[:, axis]).sum()) / telling
            chi2, axes = chi2 + late**2 / max(variance, 1.0 / telling), axes + 1
    return max(1.0, chi2 / (axes - 1)) if axes > 1 else 1.0


def _sandwich(x: FloatArray, e: FloatArray, inverse: FloatArray, time_s: FloatArray) -> FloatArray:
    """(k, k) from the scores of blocks of time."""
    span_s = float(time_s[-1] - time_s[0])
    blocks = int(np.clip(span_s / BLOCK_S, LEAST_BLOCKS, MAX_BLOCKS))
    number = np.minimum(((time_s - time_s[0]) / max(span_s, 1e-300) * blocks).astype(np.int64), blocks - 1)
    scores = np.einsum("nak,na->nk", x, e)
    sums = np.stack([np.bincount(number, weights=one, minlength=blocks) for one in scores.T], axis=1)
    telling = np.bincount(number, weights=(x**2).sum(axis=(1, 2)), minlength=blocks)
    effective = telling.sum() ** 2 / max(float((telling**2).sum()), 1e-300)
    few = max(effective / max(effective - 1.0, 0.5), 1.0)
    return inverse @ (sums.T @ sums) @ inverse * few + 1e-300 * np.eye(len(inverse))


def _spread_s(information: FloatArray, time_s: FloatArray) -> float:
    """The time in which the middle nine tenths of the information came."""
    share = np.cumsum(information) / information.sum()
    first, last = np.searchsorted(share, [0.05, 0.95])
    return float(time_s[min(int(last), len(time_s) - 1)] - time_s[int(first)])


def _autoregression(residual: FloatArray, piece: NDArray[np.int64]) -> FloatArray:
    """(3, p + 1) 1, −a_1 … −a_p of each axis by Yule–Walker; 1, 0 … where too much is missing."""
    whiteners = np.zeros((3, AR_ORDER + 1))
    whiteners[:, 0] = 1.0
    for axis in range(3):
        there = np.isfinite(residual[:, axis])
        if there.sum() < LEAST_ROWS:
            continue
        first, last = np.flatnonzero(there)[[0, -1]]
        values = residual[first : last + 1, axis]
        if np.mean(~there[first : last + 1] & _inside(piece[first : last + 1])) > MAX_MISSING_FOR_AR:
            continue
        level = values - np.nanmean(values)
        filled = np.nan_to_num(level)
        products = (filled[lag:] * filled[: len(filled) - lag] for lag in range(AR_ORDER + 1))
        lags = np.array([float(product.sum()) for product in products])  # no threads for so little
        lags[0] *= 1.0 + 1e-9
        toeplitz = lags[np.abs(np.subtract.outer(np.arange(AR_ORDER), np.arange(AR_ORDER)))]
        if lags[0] > 0:
            whiteners[axis, 1:] = -np.linalg.solve(toeplitz, lags[1:])
    return whiteners


def _inside(piece: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n,) rows of pieces that are longer than a few filters."""
    _, number, count = np.unique(piece, return_inverse=True, return_counts=True)
    return count[number] > 4 * AR_ORDER


def _whitened(columns: FloatArray, whitener: FloatArray, piece: NDArray[np.int64]) -> FloatArray:
    """(n, m) behind the filter; the first rows of a piece, where it is not full, are NaN."""
    if not whitener[1:].any():
        return columns
    out = columns.copy()
    order = len(whitener) - 1
    for lag, share in enumerate(whitener[1:].tolist(), 1):
        out[lag:] += share * columns[:-lag]
    out[:order] = np.nan
    out[order:][piece[order:] != piece[:-order]] = np.nan
    return out

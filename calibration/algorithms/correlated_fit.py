"""Least squares whose uncertainties hold where the noise has a memory.

    y = X beta + e,    Cov(e) = S / D + sum sigma^2 G(tau)

y: means over blocks of duration D, one column per channel. S is the white density; G is the covariance of a
Gauss-Markov term (`noise_covariance`). Three states of knowledge of the slow part (`known_slow`):

    a tuple of (sigma, tau)  stated beforehand; an infinite tau is constant over the record
    ()                       there is none
    None                     levels and times are weighed by their restricted likelihood with S
                             integrated out, a tenth of the prior on white noise alone. A wander slower than
                             the record looks like a bias, and the data bound it loosely: times of up to 16
                             records take part, so that intervals hold, and a constant costs several times
                             the uncertainty that white noise has. State the slow noise where it is known.

Restricted likelihood: Patterson & Thompson, Biometrika 58 (1971) 545. A variance from few degrees of freedom
is that of the t distribution (JCGM 101:2008, 6.4.9.2). All channels are solved at once, in the eigenvectors
of G.
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.noise_covariance import gauss_markov_covariance
from protocol.errors import CalibrationError, Fault

FloatArray = NDArray[np.float64]
SlowTerms = tuple[tuple[float, float], ...]

MAX_CONDITION = 1e3
"""Of the design with columns of length 1: beyond it two terms look alike."""
NAMED_PART = 0.3
MIN_DEGREES_OF_FREEDOM = 4
MAX_BLOCKS = 1200
MAX_CHI_SQUARE_SIGMAS = 3.0
"""Residuals further above the stated noise widen the covariance (Birge ratio)."""
LEVELS, TIMES = 12, 6
"""Of the slow noise, weighed where it is not known."""
LONGEST_SPANS, WHITE_PRIOR = 16.0, 0.1
CAUTIOUS_LEAST, CAUTIOUS_WHITE_PRIOR = 2.0, 0.05
_RELATIVE_FLOOR = 1e-12


@dataclass(frozen=True)
class Blocks:
    """Means over stretches of time.

    Attributes:
        middle_s, duration_s: shape (k,).
        means: shape (k, channels), SI.
    """

    middle_s: FloatArray
    duration_s: FloatArray
    means: FloatArray


@dataclass(frozen=True)
class CorrelatedFit:
    """A fit of m channels with p terms.

    Attributes:
        names: of the terms.
        values: shape (m, p).
        covariance: shape (m, p, p).
        residuals: shape (k, m).
        degrees_of_freedom: k - p.
        scatter_degrees_of_freedom: what the residuals' mean square is worth in independent values, (m,):
            fewer than k - p where the noise has a memory.
        condition: of the design with columns of length 1.
        noise: per channel, what was assumed, in words.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    degrees_of_freedom: int
    scatter_degrees_of_freedom: FloatArray
    condition: float
    noise: tuple[str, ...]

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Shape (m, p)."""
        return np.sqrt(np.einsum("mii->mi", self.covariance))

    def of(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Values and standard uncertainties of one term, shape (m,) each."""
        index = self.names.index(name)
        return self.values[:, index], self.standard_uncertainty[:, index]


@dataclass(frozen=True)
class _Hypotheses:
    """Estimates of h noise hypotheses for m channels."""

    values: FloatArray  # (h, m, p)
    covariance: FloatArray  # (h, m, p, p)
    log_weight: FloatArray  # (h, m)
    scatter_dof: FloatArray  # (h, m)
    words: tuple[str, ...]


def fit_correlated(
    design: FloatArray,
    blocks: Blocks,
    names: Sequence[str],
    where: str,
    known_slow: SlowTerms | None = None,
    systematic: FloatArray | None = None,
    *,
    cautious: bool = False,
) -> CorrelatedFit:
    """Fit all channels of `blocks` with one design.

    Args:
        design: X, shape (k, p).
        blocks: the observations.
        names: of the p terms, for errors.
        where: of the evaluation, for errors.
        known_slow: see the module.
        systematic: shape (k, s, m) or (k, s, 1): what each of s independent influences adds to the outputs
            when it is off by one standard uncertainty. They widen the covariance and leave the estimate.
        cautious: where the slow part is not known, weigh only levels of twice the white noise and more, by
            their root: for terms whose intervals would miss where the data hardly see the slow part.

    Raises:
        CalibrationError: too few or too many blocks, values that are not finite, or terms that these data
            cannot tell apart (they are named).
    """
    x, y = np.asarray(design, dtype=np.float64), np.asarray(blocks.means, dtype=np.float64)
    condition = check_rank(x, names, where)
    count, terms = x.shape
    if count - terms < MIN_DEGREES_OF_FREEDOM or count > MAX_BLOCKS or not np.isfinite(y).all():
        raise refused(
            f"{count} blocks for {terms} terms: at least {MIN_DEGREES_OF_FREEDOM} more blocks than terms are "
            f"needed, at most {MAX_BLOCKS} are taken, all of them finite.",
            where,
            "record longer, or choose another length of the blocks.",
        )
    root = np.sqrt(blocks.duration_s)[:, None]
    white_x, white_y = x * root, y * root
    if known_slow is None:
        found = _weighed(white_x, white_y, blocks, cautious)
    else:
        found = _stated(white_x, white_y, blocks, known_slow)
    weight, values, covariance = _averaged(found)
    if systematic is not None:
        operator = _pseudo_inverse(white_x) * root.T
        moved = np.einsum("pk,ksm->mps", operator, systematic)
        covariance = covariance + np.einsum("mps,mqs->mpq", moved, moved)
    return CorrelatedFit(
        names=tuple(names),
        values=values,
        covariance=covariance,
        residuals=y - x @ values.T,
        degrees_of_freedom=count - terms,
        scatter_degrees_of_freedom=1.0 / np.einsum("hm,hm->m", weight, 1.0 / found.scatter_dof),
        condition=condition,
        noise=_likeliest(found, weight),
    )


def _averaged(found: _Hypotheses) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (h, m), and the mean over the hypotheses with its covariance: (m, p), (m, p, p)."""
    weight = np.exp(found.log_weight - found.log_weight.max(axis=0))
    weight /= weight.sum(axis=0)
    values = np.einsum("hm,hmp->mp", weight, found.values)
    spread = found.values - values
    covariance = np.einsum("hm,hmpq->mpq", weight, found.covariance)
    covariance += np.einsum("hm,hmp,hmq->mpq", weight, spread, spread)
    return weight, values, covariance


def _likeliest(found: _Hypotheses, weight: FloatArray) -> tuple[str, ...]:
    """Of each channel, with its weight where there are others."""
    best: list[int] = np.argmax(weight, axis=0).tolist()
    if len(found.words) == 1:
        return found.words * len(best)
    return tuple(f"{found.words[h]} (posterior {weight[h, m]:.2f})" for m, h in enumerate(best))


def check_rank(design: FloatArray, names: Sequence[str], where: str) -> float:
    """Condition of a design with columns of length 1.

    Raises:
        CalibrationError: an input is missing, or inputs cannot be told apart; they are named.
    """
    if design.ndim != 2 or len(design) == 0 or not np.isfinite(design).all():
        raise refused("The inputs are missing or not finite.", where, "look at the stand's recording.")
    length = np.linalg.norm(design, axis=0)
    absent = [name for name, one in zip(names, length, strict=True) if one <= _RELATIVE_FLOOR * length.max()]
    if absent:
        rank = f"rank {design.shape[1] - len(absent)} of {design.shape[1]}"
        raise refused(
            f"Nothing excites {', '.join(absent)}: {rank}.",
            where,
            "add a motion that does, or leave these terms out.",
        )
    _, strengths, directions = np.linalg.svd(design / length, full_matrices=False)
    short = len(design) < design.shape[1]
    condition = float("inf") if short or strengths[-1] == 0.0 else float(strengths[0] / strengths[-1])
    if condition > MAX_CONDITION:
        alike = [name for name, part in zip(names, directions[-1], strict=True) if abs(part) > NAMED_PART]
        rank = int((strengths > strengths[0] / MAX_CONDITION).sum())
        raise refused(
            f"These data cannot tell {', '.join(alike)} apart: rank {rank} of {len(names)}, "
            f"condition {condition:.2g} (bound {MAX_CONDITION:g}).",
            where,
            "add a motion that separates them, or leave one of these terms out.",
        )
    return condition


def white_density(white_x: FloatArray, white_y: FloatArray, duration_s: FloatArray) -> FloatArray:
    """S of each channel, (m,), SI^2 s, from differences of neighbouring residuals, exact for white noise.

    Slower noise cancels in the differences; what the fit takes away is accounted for.
    """
    keep = np.eye(len(white_x)) - white_x @ _pseudo_inverse(white_x)
    step = np.diff(keep / np.sqrt(duration_s)[:, None], axis=0)
    step /= np.sqrt(1.0 / duration_s[1:] + 1.0 / duration_s[:-1])[:, None]
    quadratic = step.T @ step
    expected = float(np.trace(quadratic))
    freedom = expected**2 / float((quadratic**2).sum())
    density = ((step @ white_y) ** 2).sum(axis=0) / expected
    floor = (_RELATIVE_FLOOR * np.abs(white_y).max(initial=1e-300)) ** 2
    return np.maximum(density * freedom / max(freedom - 2.0, 1.0), floor)


def _stated(x: FloatArray, y: FloatArray, blocks: Blocks, terms: SlowTerms) -> _Hypotheses:
    """The one hypothesis of known slow noise."""
    density = white_density(x, y, blocks.duration_s)
    slow = _slow_covariance(blocks, terms)
    eigenvalues, vectors = np.linalg.eigh(slow)
    weights = 1.0 / (density[:, None] + np.maximum(eigenvalues, 0.0))
    values, covariance, squares = _solve(vectors.T @ x, vectors.T @ y, weights[None])
    freedom = len(x) - x.shape[1]
    ratio = squares / freedom
    excess = np.where(ratio > 1.0 + MAX_CHI_SQUARE_SIGMAS * np.sqrt(2.0 / freedom), ratio, 1.0)
    trace, square = _left_in_residuals(x, slow)
    dof = (density * freedom + trace) ** 2 / (density**2 * freedom + 2.0 * density * trace + square)
    told = " and ".join(f"{level:.2g} with {time_s:.3g} s" for level, time_s in terms)
    told = told.replace("with inf s", "throughout")
    words = f"bias instability {told}, in SI units, as stated" if terms else "white noise, as stated"
    return _Hypotheses(
        values, covariance * excess[..., None, None], np.zeros(squares.shape), dof[None], (words,)
    )


def _weighed(x: FloatArray, y: FloatArray, blocks: Blocks, cautious: bool) -> _Hypotheses:
    """White noise alone, and levels and correlation times of a slow part."""
    count = len(x)
    total_s = float(blocks.duration_s.sum())
    span_s = max(float(np.ptp(blocks.middle_s)), total_s)
    times = np.geomspace(2.0 * float(np.median(blocks.duration_s)), LONGEST_SPANS * span_s, TIMES)
    largest = 8.0 * float(count) ** 0.5
    least, white_prior = (CAUTIOUS_LEAST, CAUTIOUS_WHITE_PRIOR) if cautious else (0.25, WHITE_PRIOR)
    levels = np.asarray(np.geomspace(least, largest, LEVELS), dtype=np.float64)
    squared_levels = levels**2 / total_s
    share = np.sqrt(levels) if cautious else np.ones(LEVELS)
    prior = ((1.0 - white_prior) / TIMES * share / share.sum())[:, None]
    parts = [_hypotheses(x, y, np.zeros((count, count)), np.zeros(1), np.full((1, 1), white_prior))]
    words = ["white noise"]
    for time_s in times:
        shape = _slow_covariance(blocks, ((1.0, float(time_s)),))
        parts.append(_hypotheses(x, y, shape, squared_levels, prior))
        words += [
            f"bias instability of {np.sqrt(level * total_s):.2g} times the white noise, {time_s:.3g} s"
            for level in squared_levels.tolist()
        ]
    return _Hypotheses(
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.log_weight for part in parts]),
        np.concatenate([part.scatter_dof for part in parts]),
        tuple(words),
    )


def _hypotheses(
    x: FloatArray, y: FloatArray, shape: FloatArray, levels: FloatArray, prior: FloatArray
) -> _Hypotheses:
    """Cov = S (1 + level * shape) for each level; S from the data."""
    if levels.any():
        eigenvalues, vectors = np.linalg.eigh(shape)
        x_own, y_own = vectors.T @ x, vectors.T @ y
        trace, square = _left_in_residuals(x, shape)
    else:
        eigenvalues, x_own, y_own = np.zeros(len(x)), x, y
        trace = square = 0.0
    relative = 1.0 + levels[:, None] * np.maximum(eigenvalues, 0.0)
    values, inverse, squares = _solve(x_own, y_own, 1.0 / relative[:, None, :])
    freedom = len(x) - x.shape[1]
    floor = (_RELATIVE_FLOOR * np.abs(y).max(initial=1e-300)) ** 2
    squares = np.maximum(squares, floor)
    _, log_determinant = np.linalg.slogdet(inverse)
    log_likelihood = (
        -0.5 * np.log(relative).sum(axis=1)[:, None] + 0.5 * log_determinant - 0.5 * freedom * np.log(squares)
    )
    covariance = inverse * (squares / (freedom - 2.0))[..., None, None]
    dof = (freedom + levels * trace) ** 2 / (freedom + 2.0 * levels * trace + levels**2 * square)
    if trace > 0.0:
        # The slow level rests on the few independent values that residuals have of it: variance of the t
        # distribution, as far as the slow part makes up the residuals.
        share = levels * trace / (freedom + levels * trace)
        widened = 1.0 + share * 2.0 / max(trace**2 / square - 2.0, 1.0)
        covariance = covariance * widened[:, None, None, None]
    return _Hypotheses(
        values, covariance, log_likelihood + np.log(prior), np.repeat(dof[:, None], y.shape[1], axis=1), ()
    )


def _solve(x: FloatArray, y: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (h, m or 1, k) → estimates (h, m, p), inverses (h, m, p, p), sums of squares (h, m)."""
    scale = np.linalg.norm(x, axis=0)
    x = x / scale
    normal = np.einsum("hmk,kp,kq->hmpq", weights, x, x, optimize=True)
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    right = np.einsum("hmk,kp,km->hmp", np.broadcast_to(weights, (len(weights), y.shape[1], len(x))), x, y)
    values = np.einsum("hmpq,hmp->hmq", np.broadcast_to(inverse, (*right.shape, len(scale))), right)
    residuals = y.T - values @ x.T
    squares = (weights * residuals**2).sum(axis=2)
    inverse = np.broadcast_to(inverse / np.outer(scale, scale), (*right.shape, len(scale)))
    return values / scale, inverse, squares


def _slow_covariance(blocks: Blocks, terms: SlowTerms) -> FloatArray:
    """Of the blocks' means times the roots of their durations, (k, k)."""
    root = np.sqrt(blocks.duration_s)
    total = np.zeros((len(root), len(root)))
    for level, time_s in terms:
        total += level**2 * gauss_markov_covariance(blocks.middle_s, blocks.duration_s, time_s)
    return total * root[:, None] * root[None, :]


def _left_in_residuals(x: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Trace of P G P and of its square: of a covariance, what a least-squares fit leaves."""
    basis, _ = np.linalg.qr(x)
    left = covariance - basis @ (basis.T @ covariance)
    left = left - (left @ basis) @ basis.T
    return float(np.trace(left)), float((left**2).sum())


def _pseudo_inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(matrix), dtype=np.float64)


def refused(what: str, where: str, remedy: str) -> CalibrationError:
    """The data cannot carry what is asked for."""
    return CalibrationError(what, where=where, fault=Fault.DATA, remedy=remedy)

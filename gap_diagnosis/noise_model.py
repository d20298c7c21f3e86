"""The noise of a channel as the evidence sees it: white of a known level, and slow noise of an unknown one.

Slow noise s is a process on knots with piecewise linear values between them: C_λ = σ² I + λ² B S Bᵀ, B the
hat functions, S the covariance of the knots at the believed shape. Its level λ is a nuisance with a
log-normal prior over units (recording.md, `unit_spread`) that is summed over, never fixed. Levels beyond
what the belief allows are kept apart: they make the evidence for too much slow noise.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse  # pyright: ignore[reportMissingTypeStubs]

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.observation import NoiseBelief

LEVEL_SIGMAS = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
"""Nodes of the log-normal prior of the slow level, in its standard deviations."""
EXCESS_FACTORS = (1.5, 2.8, 5.5, 11.0, 25.0)
"""Levels above the highest believed node, as shares of it."""
QUICKER, SLOWER = 0.2, 20.0
"""Correlation times of noise beyond the belief: of the believed one, and of the longest record."""
UNKNOWN_RATIOS = tuple(float(ratio) for ratio in np.geomspace(1e-4, 1.0, len(LEVEL_SIGMAS)))
"""Where nothing is believed of slow noise: its level as shares of the white noise of one row."""
BELIEVED_TIMES, BELIEVED_SHARES = (1 / 2.2, 1.0, 2.2), (0.12, 0.76, 0.12)
"""'One term or a few about that time' (recording.md): a mixture that is right enough for both."""
KNOTS_PER_TIME = 4.0
MAX_KNOTS = 240
FLICKER_RATIO = 4.0
MIN_KNOT_STEP_S = 1.0


@dataclass(frozen=True)
class SlowShape:
    """Unit-level autocovariance: Σ_k v_k exp(−|Δt| / τ_k).

    `level_si`: the believed level; None where nothing is believed.
    """

    variances: tuple[float, ...]
    correlation_times_s: tuple[float, ...]
    level_si: float | None
    spread: float

    def covariance(self, time_s: FloatArray) -> FloatArray:
        """(k, k) of the knots at level 1."""
        apart = np.abs(time_s[:, np.newaxis] - time_s)
        total = np.zeros_like(apart)
        for variance, tau in zip(self.variances, self.correlation_times_s, strict=True):
            total += variance * np.exp(-apart / tau)
        return total


def slow_shape(belief: NoiseBelief, longest_s: float, row_s: float) -> SlowShape:
    """The shape for one triad over records of at most `longest_s`.

    A coefficient B of IEEE 952 becomes a sum of Gauss–Markov terms: two-sided density B² / (2π f) is one of
    variance B² / π per unit of ln τ. Where nothing is believed the shape is the same.
    """
    if belief.slow_deviation_si is not None and belief.slow_correlation_time_s:
        times = tuple(belief.slow_correlation_time_s * ratio for ratio in BELIEVED_TIMES)
        return SlowShape(BELIEVED_SHARES, times, belief.slow_deviation_si, belief.slow_spread)
    shortest = max(MIN_KNOT_STEP_S, 4.0 * row_s)
    count = max(2, math.ceil(math.log(3.0 * longest_s / shortest) / math.log(FLICKER_RATIO)))
    times = tuple(shortest * FLICKER_RATIO**k for k in range(count))
    share = math.log(FLICKER_RATIO) / math.pi
    return SlowShape((share,) * count, times, belief.slow_coefficient_si, belief.slow_spread)


def shapes_for(belief: NoiseBelief, longest_s: float, row_s: float) -> tuple[SlowShape, ...]:
    """The believed shape; where there is a belief also a quicker noise and a random walk, to go beyond it.

    The random walk's level is such that it moves by the believed deviation in a believed correlation time.
    """
    believed = slow_shape(belief, longest_s, row_s)
    if believed.level_si is None:
        return (believed,)
    tau = belief.slow_correlation_time_s or 0.1 * longest_s
    walk_s = SLOWER * longest_s
    walk = SlowShape((0.5 * walk_s / tau,), (walk_s,), believed.level_si, believed.spread)
    quick = SlowShape((1.0,), (max(QUICKER * tau, 4.0 * row_s),), believed.level_si, believed.spread)
    return believed, walk, quick


@dataclass(frozen=True)
class Levels:
    """Levels λ of the slow noise with the logarithm of their prior weight.

    The first `believed` of them carry the belief and sum to one; the others are beyond it, and sum to one.
    `shape`: (h,) which of the shapes.
    """

    level_si: FloatArray
    shape: NDArray[np.int64]
    log_weight: FloatArray
    believed: int

    def __len__(self) -> int:
        return len(self.level_si)


def levels_of(shapes: tuple[SlowShape, ...], white_si: float) -> Levels:
    """Nodes for a channel whose rows have white noise `white_si`."""
    shape = shapes[0]
    if shape.level_si is None:
        nodes = np.array([ratio * white_si for ratio in UNKNOWN_RATIOS])
        alike = np.full(len(nodes), -math.log(len(nodes)))
        return Levels(nodes, np.zeros(len(nodes), dtype=np.int64), alike, len(nodes))
    sigmas = np.array(LEVEL_SIGMAS)
    believed = shape.level_si * np.exp(shape.spread * sigmas)
    log_weight = -0.5 * sigmas**2
    log_weight -= np.log(np.sum(np.exp(log_weight)))
    excess = np.tile(believed[-1] * np.array(EXCESS_FACTORS), len(shapes))
    numbers = np.repeat(np.arange(len(shapes)), len(EXCESS_FACTORS))
    return Levels(
        np.concatenate([believed, excess]),
        np.concatenate([np.zeros(len(believed), dtype=np.int64), numbers]),
        np.concatenate([log_weight, np.full(len(excess), -math.log(len(excess)))]),
        len(believed),
    )


@dataclass(frozen=True)
class Knots:
    """Slow noise of one channel of one recording.

    Attributes:
        hats: (n, k) sparse: each row's share of its two neighbouring knots.
        time_s: (k,).
        shapes: that the process may have.
    """

    hats: Any
    time_s: FloatArray
    shapes: tuple[SlowShape, ...]

    @cached_property
    def modes(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """For each shape: (k,) Λ, the eigenvalues of B S Bᵀ, largest last, and (k, k) the knots' values of
        each mode, of unit prior variance at level 1."""
        overlap = np.asarray((self.hats.T @ self.hats).toarray(), dtype=np.float64)
        found: list[tuple[FloatArray, FloatArray]] = []
        for shape in self.shapes:
            covariance = shape.covariance(self.time_s)
            root = np.linalg.cholesky(covariance + 1e-9 * covariance[0, 0] * np.eye(len(covariance)))
            values, vectors = np.linalg.eigh(root.T @ overlap @ root)
            found.append((np.maximum(values, 0.0), root @ vectors))
        return tuple(found)

    def summed(self, columns: FloatArray) -> FloatArray:
        """(k, p): Bᵀ X of columns (n, p)."""
        return np.asarray(self.hats.T @ columns, dtype=np.float64)


def knots_for(time_s: FloatArray, shapes: tuple[SlowShape, ...]) -> Knots:
    """Knots over the rows' times (n,), increasing."""
    first, last = float(time_s[0]), float(time_s[-1])
    span = max(last - first, 1e-9)
    quickest = min(min(shape.correlation_times_s) for shape in shapes)
    step = max(quickest / KNOTS_PER_TIME, MIN_KNOT_STEP_S, span / (MAX_KNOTS - 1))
    count = max(2, min(MAX_KNOTS, math.ceil(span / step) + 1))
    knots = np.linspace(first, last, count)
    place = (time_s - first) / (knots[1] - knots[0])
    left = np.clip(place.astype(np.int64), 0, count - 2)
    share = place - left
    rows = np.arange(len(time_s))
    values, columns = np.concatenate([1.0 - share, share]), np.concatenate([left, left + 1])
    hats: Any = sparse.csr_matrix((values, (np.tile(rows, 2), columns)), shape=(len(time_s), count))
    held = np.asarray(hats.sum(axis=0)).ravel() > 0
    return Knots(hats[:, held], knots[held], shapes)


def without_columns(residual: FloatArray, columns: FloatArray) -> FloatArray:
    """What columns (n, k) leave of a residual (n,), by plain least squares: enough to see row noise."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    inverse = np.asarray(np.linalg.pinv(scaled.T @ scaled, rcond=1e-9, hermitian=True), dtype=np.float64)
    return residual - scaled @ (inverse @ (scaled.T @ residual))


BLOCK_ROWS = 32


def white_noise_of_rows(residual: FloatArray) -> float:
    """Standard deviation of one row's white noise, from differences of neighbours in the quieter blocks.

    residual (n,), SI, in order. A moving stretch that the model misses lifts its own blocks alone.
    """
    steps = np.diff(residual)
    steps = steps[np.isfinite(steps)]
    if len(steps) < 2 * BLOCK_ROWS:
        return float(np.sqrt(np.mean(steps**2) / 2.0)) if len(steps) else 0.0
    whole = len(steps) // BLOCK_ROWS * BLOCK_ROWS
    blocks = np.mean(steps[:whole].reshape(-1, BLOCK_ROWS) ** 2, axis=1) / 2.0
    ordered = np.sort(blocks)
    kept = ordered[: max(1, math.ceil(0.75 * len(ordered)))]
    # the mean of the lower three quarters of scaled chi squares, brought back to that of all
    return float(np.sqrt(kept.mean() / _KEPT_SHARE))


def _kept_share() -> float:
    rng = np.random.default_rng(1)
    steps = np.diff(rng.standard_normal((4000, BLOCK_ROWS + 1)), axis=1)
    ordered = np.sort(np.mean(steps**2, axis=1) / 2.0)
    return float(ordered[: int(0.75 * len(ordered))].mean())


_KEPT_SHARE = _kept_share()

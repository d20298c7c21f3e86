"""The ellipse or ellipsoid that noisy points lie on: (v - o)^T Q (v - o) = 1.

Points are fitted by their distance from the surface to first order (Sampson, CGIP 18 (1982) 97), not by
the algebraic residual: that would weigh the long axes most. Noise in all directions lifts points off a
curved surface by s^2 kappa / 2 on the mean, kappa the sum of its principal curvatures; this is taken out.

Points beyond `OUTLIER_DEVIATIONS` robust standard deviations are left out, counted and named; too many
are refused. White noise of equal size on all channels is assumed; residuals that stay together in
time (field of the hall, motion) widen the covariance by what their block means show.

How it is fast: what is robust and goes round is done on at most `SAMPLE` of the points; a step or two
on sums over all points, by `surface_distance`, then gives what all of them tell.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.allan_variance import FloatArray
from calibration.algorithms.surface_distance import (
    BLOCKS,
    FLOOR,
    ScaledPoints,
    Start,
    Sums,
    distances,
    sums_over,
    unpack,
    upper,
)
from protocol.errors import CalibrationError, Fault

OUTLIER_DEVIATIONS = 4.5
MAX_OUTLIER_PART = 0.2
MAX_NOISE_PART = 0.2
"""Of the smallest radius: points that scatter more lie on no surface, and have no distance to first order."""
MAX_ROUNDS = 60
ROBUST_ROUNDS = 12
SAMPLE = 2048
"""Points that the start is fitted to."""
FULL_ROUNDS = 12
FULL_SETTLED = 2e-2
"""What a further step could move, in standard uncertainties, at which the steps on all points end."""
SETTLED = 1e-10
START_SETTLED = 1e-3
"""The start of the fit only has to be near."""
MAX_CONDITION = 1e6
"""Of the scaled normal matrix: beyond it the points do not go around far enough."""
MAX_START_CONDITION = 1e12
BLOCKS_JOINED = (1, 2, 4)
MIN_BLOCK = 8
MAX_BLOCK_SIGMAS = 3.0
_MAD = 1.4826
_HUBER = 1.345
_GOLDEN = 0.6180339887498949
_STEP_DEVIATIONS = 1e-2
_STEP_PART = 1e-7

Derived = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class EllipsoidFit:
    """A fitted ellipse (d = 2) or ellipsoid (d = 3), in the unit of the points.

    Attributes:
        centre: o, shape (d,).
        shape: Q, shape (d, d), symmetric, positive definite, 1 / unit^2.
        covariance: of (o, Q row by row from its diagonal on), shape (p, p).
        distance_rms: of the points used from the surface.
        used: which points, shape (n,).
        widened: factor by which slow residuals widened the covariance; 1: none.
    """

    centre: FloatArray
    shape: FloatArray
    covariance: FloatArray
    distance_rms: float
    used: NDArray[np.bool_]
    widened: float

    @property
    def parameters(self) -> FloatArray:
        """(o, Q row by row from its diagonal on), shape (p,)."""
        return np.concatenate([self.centre, self.shape[upper(len(self.centre))]])

    @property
    def outliers(self) -> int:
        """Points left out."""
        return int((~self.used).sum())


def fit_ellipsoid(points: FloatArray, where: str) -> EllipsoidFit:
    """Fit points of two or three channels.

    Args:
        points: shape (n, d), d = 2 or 3, in time order, any unit.
        where: names the data in errors.

    Raises:
        CalibrationError: missing values, too few points, points that do not go around, too many outliers,
            or a surface that is not closed.
    """
    values = np.asarray(points, dtype=np.float64)
    dimension = values.shape[1] if values.ndim == 2 else 0
    if dimension not in (2, 3):
        raise _refused(
            f"Points of shape {values.shape} have not two or three channels.", where, "give x, y (and z)"
        )
    count = dimension + dimension * (dimension + 1) // 2
    if len(values) < 4 * count:
        raise _refused(f"{len(values)} points do not carry {count} parameters.", where, "record longer")
    if not np.isfinite(values.sum()):
        missing = int((~np.isfinite(values).all(axis=1)).sum())
        raise _refused(f"{missing} of {len(values)} points are missing (NaN).", where, "leave them out")
    chosen = _spread(len(values))
    origin = np.median(values[chosen], axis=0)
    scale = float(np.sqrt(((values[chosen] - origin) ** 2).mean()))
    if scale == 0.0:
        raise _refused("All points are the same.", where, "turn the unit, and look for a stuck output")
    points_of = ScaledPoints(values, origin, scale)
    sample = points_of.rows(chosen)
    start = _robust(sample, _algebraic(sample, where), where)
    parameters, sums = _on_all(points_of, start, where)
    freedom = int(sums.used.sum()) - count
    variance = sums.squares / freedom
    widened = _widening(sums, variance)
    covariance = np.asarray(np.linalg.inv(sums.normal), dtype=np.float64) * variance * widened
    unit = np.concatenate([np.full(dimension, scale), np.full(count - dimension, scale**-2.0)])
    centre, shape = unpack(parameters, dimension)
    return EllipsoidFit(
        origin + scale * centre,
        shape / scale**2,
        covariance * np.outer(unit, unit),
        scale * float(np.sqrt(variance)),
        sums.used,
        widened,
    )


def propagate(fit: EllipsoidFit, derived: Derived) -> tuple[FloatArray, FloatArray]:
    """A function of (o, Q) at the fit, shape (k,), and its covariance, shape (k, k), to first order."""
    dimension = len(fit.centre)
    values, deviations = fit.parameters, np.sqrt(np.diag(fit.covariance))
    sizes = np.repeat(
        [np.abs(values[:dimension]).max(), np.abs(values[dimension:]).max()],
        [dimension, len(values) - dimension],
    )
    at_fit = derived(*unpack(values, dimension))
    jacobian = np.empty((len(at_fit), len(values)))
    for column in range(len(values)):
        step = np.zeros(len(values))
        # Small against curvature, large against rounding, even for a fit that leaves no residuals.
        step[column] = max(_STEP_DEVIATIONS * deviations[column], _STEP_PART * sizes[column])
        above = derived(*unpack(values + step, dimension))
        jacobian[:, column] = (above - derived(*unpack(values - step, dimension))) / (2.0 * step[column])
    return at_fit, jacobian @ fit.covariance @ jacobian.T


def _spread(count: int) -> NDArray[np.intp]:
    """At most `SAMPLE` rows out of `count`, in no step with any period of the data: frac(k^2 phi)."""
    if count <= SAMPLE:
        return np.arange(count)
    k = np.arange(SAMPLE, dtype=np.float64)
    return np.unique((count * ((k * k * _GOLDEN) % 1.0)).astype(np.intp))


def _algebraic(points: FloatArray, where: str) -> FloatArray:
    """(o, Q) of v^T A v + 2 b^T v = 1, weighed anew so that far points lose their pull (Huber)."""
    dimension = len(points)
    rows, columns = upper(dimension)
    twice = np.where(rows == columns, 1.0, 2.0)
    design = np.vstack([points[rows] * points[columns] * twice[:, None], 2.0 * points])
    weights = np.ones(points.shape[1])
    solution = np.zeros(len(design))
    for _ in range(ROBUST_ROUNDS):
        normal = _checked_normal((design * weights) @ design.T, where, MAX_START_CONDITION)
        before, solution = solution, np.asarray(np.linalg.solve(normal, design @ weights), dtype=np.float64)
        if np.abs(solution - before).max() <= START_SETTLED * np.abs(solution).max():
            break
        residual = np.abs(solution @ design - 1.0)
        limit = max(_HUBER * _MAD * float(np.median(residual)), FLOOR)
        weights = limit / np.maximum(residual, limit)
    _, matrix = unpack(np.concatenate([np.zeros(dimension), solution[: len(rows)]]), dimension)
    if np.linalg.cond(matrix) > 1.0 / FLOOR:
        raise _not_around(where)
    centre = -np.asarray(np.linalg.solve(matrix, solution[len(rows) :]), dtype=np.float64)
    matrix = matrix / (1.0 + centre @ matrix @ centre)
    return _checked(np.concatenate([centre, matrix[rows, columns]]), dimension, where)


def _robust(points: FloatArray, parameters: FloatArray, where: str) -> Start:
    """Parameters fitted to those of the points (d, n) that belong."""
    count = points.shape[1]
    used = np.zeros(count, dtype=np.bool_)
    noise, limit = 0.0, 0.0
    for _ in range(ROBUST_ROUNDS):
        distance, _ = distances(points, parameters, 0.0)
        noise = _MAD * float(np.median(np.abs(distance)))
        distance, _ = distances(points, parameters, noise**2)
        limit = OUTLIER_DEVIATIONS * max(_MAD * float(np.median(np.abs(distance))), FLOOR)
        belongs = np.abs(distance) <= limit
        _check_outliers(int((~belongs).sum()), count, where)
        if (belongs == used).all():
            break
        used = belongs
        parameters = _gauss_newton(points[:, used], parameters, noise**2, where)
    _, shape = unpack(parameters, len(points))
    if noise * float(np.sqrt(np.linalg.eigvalsh(shape)[-1])) > MAX_NOISE_PART:
        raise _far_from_any("The points lie far from any one ellipse or ellipsoid.", where)
    return Start(parameters, noise**2, limit)


def _gauss_newton(
    points: FloatArray, parameters: FloatArray, noise_variance: float, where: str
) -> FloatArray:
    for _ in range(MAX_ROUNDS):
        distance, jacobian = distances(points, parameters, noise_variance)
        normal = _checked_normal(jacobian @ jacobian.T, where)
        step = np.asarray(np.linalg.solve(normal, -jacobian @ distance), dtype=np.float64)
        parameters = _checked(parameters + step, len(points), where)
        if np.abs(step).max() <= SETTLED * np.abs(parameters).max():
            return parameters
    raise _far_from_any(
        f"The points lie far from any one ellipse or ellipsoid: no fit within {MAX_ROUNDS} rounds.", where
    )


def _on_all(points: ScaledPoints, start: Start, where: str) -> tuple[FloatArray, Sums]:
    """Gauss-Newton on all points; distances after the last step are those of its linear model."""
    number = len(points.values)
    parameters = start.parameters
    for _ in range(FULL_ROUNDS):
        jacobian_sums, normal, gradient, sums = sums_over(points, parameters, start)
        _check_outliers(number - int(sums.used.sum()), number, where)
        _checked_normal(normal, where)
        step = np.asarray(np.linalg.solve(normal, -gradient), dtype=np.float64)
        parameters = _checked(parameters + step, points.values.shape[1], where)
        variance = max(sums.squares / int(sums.used.sum()), FLOOR**2)
        squares = sums.squares + float(gradient @ step)
        block_sums = sums.block_sums + jacobian_sums @ step
        # What a next step would do is of second order: this one, times its part of the parameters.
        moved = float(np.sqrt(step @ normal @ step / variance))
        if moved * float(np.abs(step).max()) <= FULL_SETTLED * float(np.abs(parameters).max()):
            return parameters, Sums(normal, max(squares, 0.0), block_sums, sums.block_counts, sums.used)
    raise _far_from_any(
        f"The points lie far from any one ellipse or ellipsoid: no fit within {FULL_ROUNDS} rounds.", where
    )


def _widening(sums: Sums, variance: float) -> float:
    """Variance of block means over that of white noise: the largest that is significantly more, of blocks
    of three lengths, for what is slow may outlast the shortest."""
    widest = 1.0
    for joined in BLOCKS_JOINED:
        edges = np.arange(0, len(sums.block_sums), joined)
        counts = np.add.reduceat(sums.block_counts, edges)
        whole = counts >= MIN_BLOCK
        if whole.sum() < BLOCKS // (2 * joined) or variance <= 0.0:
            continue
        scaled = np.add.reduceat(sums.block_sums, edges)[whole] / np.sqrt(counts[whole] * variance)
        ratio = float(scaled.var(ddof=1))
        if ratio > 1.0 + MAX_BLOCK_SIGMAS * np.sqrt(2.0 / (whole.sum() - 1)):
            widest = max(widest, ratio)
    return widest


def _check_outliers(outside: int, count: int, where: str) -> None:
    if outside > MAX_OUTLIER_PART * count:
        raise _far_from_any(f"{outside} of {count} points lie far from any one ellipse or ellipsoid.", where)


def _checked_normal(normal: FloatArray, where: str, most: float = MAX_CONDITION) -> FloatArray:
    size = np.sqrt(np.diag(normal))
    if size.min() <= 0.0 or np.linalg.cond(normal / np.outer(size, size)) > most:
        raise _not_around(where)
    return normal


def _checked(parameters: FloatArray, dimension: int, where: str) -> FloatArray:
    _, shape = unpack(parameters, dimension)
    if not np.isfinite(parameters).all() or float(np.linalg.eigvalsh(shape)[0]) <= 0.0:
        raise _not_around(where)
    return parameters


def _not_around(where: str) -> CalibrationError:
    return _refused(
        "The points lie on no closed ellipse or ellipsoid: the unit has not pointed enough ways round.",
        where,
        "turn it through all directions (in a spin: more than half a turn at unequal phases)",
    )


def _far_from_any(what: str, where: str) -> CalibrationError:
    return _refused(what, where, "keep iron and currents away while the unit turns")


def _refused(what: str, where: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where=where, fault=Fault.DATA, remedy=remedy + ".")

"""The ellipse or ellipsoid that noisy points lie on: (v - o)^T Q (v - o) = 1.

Points are fitted by their distance from the surface to first order (Sampson, CGIP 18 (1982) 97), not by
the algebraic residual: that would weigh the long axes most. Noise in all directions lifts points off a
curved surface by s^2 kappa / 2 on the mean, kappa the sum of its principal curvatures; this is taken out.

Points beyond `OUTLIER_DEVIATIONS` robust standard deviations are left out, counted and named; too many
are refused. White noise of equal size on all channels is assumed; residuals that stay together in
time (field of the hall, motion) widen the covariance by what their block means show.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.allan_variance import FloatArray
from protocol.errors import CalibrationError, Fault

OUTLIER_DEVIATIONS = 4.5
MAX_OUTLIER_PART = 0.2
MAX_ROUNDS = 60
ROBUST_ROUNDS = 12
SETTLED = 1e-10
START_SETTLED = 1e-3
"""The start of the fit only has to be near."""
MAX_CONDITION = 1e6
"""Of the scaled normal matrix: beyond it the points do not go around far enough."""
BLOCKS = 64
MIN_BLOCK = 8
MAX_BLOCK_SIGMAS = 3.0
_MAD = 1.4826
_HUBER = 1.345
_FLOOR = 1e-12
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
        return np.concatenate([self.centre, self.shape[_upper(len(self.centre))]])

    @property
    def outliers(self) -> int:
        """Points left out."""
        return int((~self.used).sum())


def unpack(parameters: FloatArray, dimension: int) -> tuple[FloatArray, FloatArray]:
    """o (d,) and Q (d, d) of the parameters of a fit."""
    shape = np.zeros((dimension, dimension))
    shape[_upper(dimension)] = parameters[dimension:]
    return parameters[:dimension], shape + np.triu(shape, 1).T


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
    missing = int((~np.isfinite(values).all(axis=1)).sum())
    if missing:
        raise _refused(f"{missing} of {len(values)} points are missing (NaN).", where, "leave them out")
    origin = np.median(values, axis=0)
    scale = float(np.sqrt(((values - origin) ** 2).mean()))
    if scale == 0.0:
        raise _refused("All points are the same.", where, "turn the unit, and look for a stuck output")
    scaled = (values - origin) / scale
    start = _algebraic(scaled, where)
    used, parameters = _robust(scaled, start, where)
    distance, jacobian = _distances(scaled[used], parameters)
    freedom = len(distance) - count
    variance = float((distance**2).sum() / freedom)
    widened = _widening(distance)
    normal = _checked_normal(jacobian, where)
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64) * variance * widened
    unit = np.concatenate([np.full(dimension, scale), np.full(count - dimension, scale**-2.0)])
    centre, shape = unpack(parameters, dimension)
    return EllipsoidFit(
        origin + scale * centre,
        shape / scale**2,
        covariance * np.outer(unit, unit),
        scale * float(np.sqrt(variance)),
        used,
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


def _upper(dimension: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows, columns = np.triu_indices(dimension)
    return rows, columns


def _algebraic(points: FloatArray, where: str) -> FloatArray:
    """(o, Q) of v^T A v + 2 b^T v = 1, weighed anew so that far points lose their pull (Huber)."""
    dimension = points.shape[1]
    rows, columns = _upper(dimension)
    twice = np.where(rows == columns, 1.0, 2.0)
    design = np.column_stack([points[:, rows] * points[:, columns] * twice, 2.0 * points])
    weights = np.ones(len(points))
    solution = np.zeros(design.shape[1])
    for _ in range(ROBUST_ROUNDS):
        root = np.sqrt(weights)
        found, _, rank, _ = np.linalg.lstsq(design * root[:, None], root, rcond=1e-9)
        if rank < design.shape[1]:
            raise _not_around(where)
        before, solution = solution, np.asarray(found, dtype=np.float64)
        if np.abs(solution - before).max() <= START_SETTLED * np.abs(solution).max():
            break
        residual = np.abs(design @ solution - 1.0)
        limit = max(_HUBER * _MAD * float(np.median(residual)), _FLOOR)
        weights = limit / np.maximum(residual, limit)
    _, matrix = unpack(np.concatenate([np.zeros(dimension), solution[: len(rows)]]), dimension)
    if np.linalg.cond(matrix) > 1.0 / _FLOOR:
        raise _not_around(where)
    centre = -np.asarray(np.linalg.solve(matrix, solution[len(rows) :]), dtype=np.float64)
    matrix = matrix / (1.0 + centre @ matrix @ centre)
    return _checked(np.concatenate([centre, matrix[rows, columns]]), dimension, where)


def _robust(points: FloatArray, start: FloatArray, where: str) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which points belong, and parameters fitted to them."""
    used, parameters = np.ones(len(points), dtype=np.bool_), start
    for _ in range(ROBUST_ROUNDS):
        distance, _ = _distances(points, parameters)
        limit = OUTLIER_DEVIATIONS * max(_MAD * float(np.median(np.abs(distance))), _FLOOR)
        belongs = np.abs(distance) <= limit
        if belongs.mean() < 1.0 - MAX_OUTLIER_PART:
            raise _refused(
                f"{(~belongs).sum()} of {len(points)} points lie far from any one ellipse or ellipsoid.",
                where,
                "keep iron and currents away while the unit turns",
            )
        if (belongs == used).all() and parameters is not start:
            break
        used = belongs
        parameters = _gauss_newton(points[used], parameters, where)
    return used, parameters


def _gauss_newton(points: FloatArray, parameters: FloatArray, where: str) -> FloatArray:
    for _ in range(MAX_ROUNDS):
        distance, jacobian = _distances(points, parameters)
        normal = _checked_normal(jacobian, where)
        step = np.asarray(np.linalg.solve(normal, -jacobian.T @ distance), dtype=np.float64)
        parameters = _checked(parameters + step, points.shape[1], where)
        if np.abs(step).max() <= SETTLED * np.abs(parameters).max():
            return parameters
    raise _refused(
        f"The points lie far from any one ellipse or ellipsoid: no fit within {MAX_ROUNDS} rounds.",
        where,
        "keep iron and currents away while the unit turns",
    )


def _distances(points: FloatArray, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of each point from the surface, less what noise lifts it, (n,); derivative (n, p)."""
    dimension = points.shape[1]
    centre, shape = unpack(parameters, dimension)
    rows, columns = _upper(dimension)
    radius_vector = points - centre
    image = radius_vector @ shape
    level = np.sqrt(np.maximum((radius_vector * image).sum(axis=1), _FLOOR))
    steepness = np.linalg.norm(image, axis=1) / level
    distance = (level - 1.0) / steepness
    normals = image / np.linalg.norm(image, axis=1, keepdims=True)
    curvature = (np.trace(shape) - ((normals @ shape) * normals).sum(axis=1)) / (steepness * level)
    noise_variance = (_MAD * float(np.median(np.abs(distance)))) ** 2
    # At the foot of each point: at the point itself the derivative would share its noise, and bias the fit.
    foot = radius_vector - distance[:, None] * normals
    foot_image = foot @ shape
    twice = np.where(rows == columns, 0.5, 1.0)
    derivative = np.column_stack([-foot_image, foot[:, rows] * foot[:, columns] * twice])
    jacobian = derivative / np.linalg.norm(foot_image, axis=1, keepdims=True)
    return distance - noise_variance * curvature / 2.0, jacobian


def _widening(distance: FloatArray) -> float:
    """Variance of block means over that of white noise, where it is significantly more."""
    block = len(distance) // BLOCKS
    if block < MIN_BLOCK:
        return 1.0
    means = distance[: block * BLOCKS].reshape(BLOCKS, block).mean(axis=1)
    white = float(distance.var()) / block
    ratio = float(means.var(ddof=1)) / white if white > 0.0 else 1.0
    return ratio if ratio > 1.0 + MAX_BLOCK_SIGMAS * np.sqrt(2.0 / (BLOCKS - 1)) else 1.0


def _checked_normal(jacobian: FloatArray, where: str) -> FloatArray:
    normal = jacobian.T @ jacobian
    size = np.sqrt(np.diag(normal))
    if size.min() <= 0.0 or np.linalg.cond(normal / np.outer(size, size)) > MAX_CONDITION:
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


def _refused(what: str, where: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where=where, fault=Fault.DATA, remedy=remedy + ".")

"""Distances of points from an ellipse or ellipsoid, and their sums over all points of a record.

To first order (Sampson, CGIP 18 (1982) 97), less what noise lifts points off a curved surface. Points are
taken in blocks that stay in the cache.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.allan_variance import FloatArray

BLOCKS = 64
"""Of consecutive points, whose sums tell slow residuals."""
CHUNK = 4096
FLOOR = 1e-12


@cache
def upper(dimension: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows, columns = np.triu_indices(dimension)
    return rows, columns


def unpack(parameters: FloatArray, dimension: int) -> tuple[FloatArray, FloatArray]:
    """o (d,) and Q (d, d) of the parameters of a fit."""
    rows, columns = upper(dimension)
    shape = np.empty((dimension, dimension))
    shape[rows, columns] = shape[columns, rows] = parameters[dimension:]
    return parameters[:dimension], shape


@dataclass(frozen=True)
class Start:
    """Parameters, and what tells an outlier: s and the distance from which a point is left out."""

    parameters: FloatArray
    noise_variance: float
    limit: float


@dataclass(frozen=True)
class Sums:
    """Over all points that belong, after a step: J^T J, d^T d; of blocks of points their d and number."""

    normal: FloatArray
    squares: float
    block_sums: FloatArray
    block_counts: FloatArray
    used: NDArray[np.bool_]


@dataclass(frozen=True)
class ScaledPoints:
    """All points, to be had in parts: shifted and scaled copies of all would cost as much as the fit."""

    values: FloatArray
    origin: FloatArray
    scale: float

    def rows(self, which: NDArray[np.intp] | slice) -> FloatArray:
        """Points of these rows, shape (d, k)."""
        part = self.values[which].T - self.origin[:, None]
        part *= 1.0 / self.scale
        return np.ascontiguousarray(part)


def sums_over(
    points: ScaledPoints, parameters: FloatArray, start: Start
) -> tuple[FloatArray, FloatArray, FloatArray, Sums]:
    """Sums of J by block (b, p), J^T J, J^T d, and the rest, at these parameters."""
    number, count = len(points.values), len(parameters)
    chunk = max(1, number // BLOCKS)
    chunk *= max(1, CHUNK // chunk)  # whole blocks, in the cache
    normal, gradient, squares = np.zeros((count, count)), np.zeros(count), 0.0
    used = np.empty(number, dtype=np.bool_)
    block = max(1, number // BLOCKS)
    jacobian_sums, block_sums, block_counts = [], [], []
    space = np.empty((count, chunk))
    for begin in range(0, number, chunk):
        part = points.rows(slice(begin, begin + chunk))
        distance, jacobian = distances(part, parameters, start.noise_variance, space)
        belongs = np.abs(distance) <= start.limit
        used[begin : begin + chunk] = belongs
        if not belongs.all():
            distance *= belongs
            jacobian *= belongs
        normal += jacobian @ jacobian.T
        gradient += jacobian @ distance
        squares += float(distance @ distance)
        edges = np.arange(0, len(distance), block)
        jacobian_sums.append(np.add.reduceat(jacobian, edges, axis=1).T)
        block_sums.append(np.add.reduceat(distance, edges))
        block_counts.append(np.add.reduceat(belongs, edges, dtype=np.float64))
    sums = Sums(normal, squares, np.concatenate(block_sums), np.concatenate(block_counts), used)
    return np.concatenate(jacobian_sums), normal, gradient, sums


def distances(
    points: FloatArray, parameters: FloatArray, noise_variance: float, space: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Distance of each point (d, n) from the surface, less what noise lifts it, (n,); derivative (p, n).

    `space`: where the derivative may be put, shape (p, at least n).
    """
    dimension = len(points)
    centre, shape = unpack(parameters, dimension)
    radius_vector = points - centre[:, None]
    image = shape @ radius_vector
    level = np.sqrt(np.maximum(np.einsum("in,in->n", radius_vector, image), FLOOR))
    square = np.einsum("in,in->n", image, image)
    steep = np.sqrt(square)
    distance = (level - 1.0) * level / steep
    # At the foot of each point: at the point itself the derivative would share its noise, and bias the fit.
    foot = radius_vector - image * (distance / steep)
    if space is None:
        space = np.empty((len(parameters), points.shape[1]))
    derivative = space[:, : points.shape[1]]
    foot_image = np.matmul(shape, foot, out=derivative[:dimension])
    inverse = 1.0 / np.sqrt(np.einsum("in,in->n", foot_image, foot_image))
    foot_image *= -inverse
    scaled = foot * inverse
    row = dimension
    for axis in range(dimension):
        others = slice(row, row + dimension - axis)
        np.multiply(foot[axis:], scaled[axis], out=derivative[others])
        derivative[row] *= 0.5
        row += dimension - axis
    if noise_variance > 0.0:
        along = np.einsum("in,in->n", image, shape @ image)
        # kappa s^2 / 2 with kappa = (tr Q - n^T Q n) / |Q r|
        distance -= (np.trace(shape) - along / square) * (0.5 * noise_variance / steep)
    return distance, derivative

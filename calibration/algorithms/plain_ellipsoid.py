# pyright: strict
"""The plain ellipsoid fit that most published magnetometer calibrations rest on, and what it is worth.

    v^T A v + 2 b^T v = 1        least squares in A and b, v the centred and scaled outputs

It minimises an algebraic distance, so that noise lengthens the short axes (Markovsky, Kukush and Van Huffel,
Consistent least squares fitting of ellipsoids, Numer. Math. 98 (2004)). A published figure states neither
this nor its scatter; both can be found from the same points.
"""

import numpy as np

from calibration.algorithms.coefficients import FloatArray

BLOCKS = 20
"""Stretches of time that the jackknife leaves out in turn: longer than hands repeat a turn."""
SIMULATED = 8
"""Repetitions of the simulated points: their mean knows the bias to a third of one fit's noise."""
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_SEED = 20


def plain_ellipsoid(points: FloatArray) -> FloatArray:
    """(9,): the upper triangle of K = K^T, row by row, |K (m - b)| = 1, then b. `points`: m, (n, 3)."""
    origin, size = points.mean(axis=0), float(points.std())
    x, y, z = ((points - origin) / size).T
    design = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z])
    v, *_ = np.linalg.lstsq(design, np.ones(len(points)), rcond=None)
    shape = np.array([[v[0], v[3], v[4]], [v[3], v[1], v[5]], [v[4], v[5], v[2]]])
    towards_centre = np.linalg.solve(shape, v[6:])
    values, vectors = np.linalg.eigh(shape / (1.0 + v[6:] @ towards_centre))
    root = (vectors * np.sqrt(values)) @ vectors.T / size
    return np.array([*(root[i, j] for i, j in UPPER), *(origin - size * towards_centre)])


def plain_ellipsoid_doubt(points: FloatArray, compensation: FloatArray, hard_iron: FloatArray) -> FloatArray:
    """Standard uncertainty (9,) of a plain fit of `points` (n, 3): its bias, uncorrected, and its scatter.

    The bias is that of plain fits to points simulated from K = `compensation` (3, 3) and b = `hard_iron` (3,)
    with the distances from it that the points have (robust); the scatter a jackknife over stretches of time.
    """
    turned = (points - hard_iron) @ compensation
    unit = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    distance = (np.linalg.norm(turned, axis=1) - 1.0) / np.linalg.norm(unit @ compensation, axis=1)
    deviation = 1.4826 * float(np.median(np.abs(distance - np.median(distance))))
    exact: FloatArray = unit @ np.linalg.inv(compensation) + hard_iron
    rng = np.random.default_rng(_SEED)
    noise = deviation * rng.standard_normal((SIMULATED, *exact.shape))
    simulated = [plain_ellipsoid(exact + one) for one in noise]
    truth = np.array([*(compensation[i, j] for i, j in UPPER), *hard_iron])
    bias = np.mean(simulated, axis=0) - truth
    stretch = np.arange(len(points)) * BLOCKS // len(points)
    without = np.array([plain_ellipsoid(points[stretch != block]) for block in range(BLOCKS)])
    scatter = np.sqrt((BLOCKS - 1) / BLOCKS * np.square(without - without.mean(axis=0)).sum(axis=0))
    return np.hypot(bias, scatter)

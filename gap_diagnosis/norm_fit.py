# pyright: strict
"""The constants of a triad from the norm of what it measures, where nobody knows how it was turned.

    y = M u + b,  |u| = B,  M = M₀ + S        M₀, b₀ as believed, S lower triangular

A norm is blind to a rotation of u, so nine numbers are told: b, and six of S; the strength B is only told
together with a common factor of M. The least of Σ ρ², ρ = |M⁻¹(y − b)| − B, is found by Gauss–Newton steps
from the belief or from the ellipsoid of least algebraic error; what lies far off is left out, by the median
of |ρ| (Huber, *Robust Statistics*, 1981, ch. 1).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.errors import DiagnosisError
from protocol.errors import Fault

STEPS, PLAIN_STEPS = 60, 8
LEAST_TO_LEAVE_OUT = 80
"""Of fewer points none can be called far off: each is needed to tell a constant."""
FAR_OFF = 4.685
"""In standard deviations, told by the median."""
MEDIAN_TO_DEVIATION = 1.4826
LEAST_FOR_ELLIPSOID = 10
WORST_CONDITION = 60.0
"""Of the columns, each of unit length: beyond it these attitudes do not tell the constants apart."""
SETTLED = 1e-10
Elements = tuple[tuple[int, int], ...]
LOWER: Elements = tuple((i, j) for i in range(3) for j in range(i + 1))
DIAGONAL: Elements = tuple((i, i) for i in range(3))


@dataclass(frozen=True)
class NormFit:
    """The constants that make the norms alike.

    Attributes:
        bias_si: (3,) b.
        matrix: (3, 3) M, such that its element of axis `reference` is the believed one.
        strength_si: B in that scale.
        reference: the axis whose scale factor error is the middle one.
        free: elements (i, j) of M that were fitted.
        input_si: (n, 3) u, of length B.
        along: (n, 3) M⁻ᵀ u / B: what an added output changes in the norm.
        residual_si: (n,) ρ.
        used: (n,) False for an outlier.
    """

    bias_si: FloatArray
    matrix: FloatArray
    strength_si: float
    reference: int
    free: Elements
    input_si: FloatArray
    along: FloatArray
    residual_si: FloatArray
    used: NDArray[np.bool_]

    @property
    def unknowns(self) -> int:
        """How many numbers were fitted."""
        return 3 + len(self.free)

    def columns(self) -> FloatArray:
        """(n, unknowns) derivatives of the norm: by b, then by the free elements of M."""
        return _columns(self.along, self.input_si, self.free)


def mean_radius(values_si: FloatArray) -> float | None:
    """Geometric mean of the semi-axes of the ellipsoid about (n, 3); None where they lie on none."""
    ellipsoid = _ellipsoid(values_si)
    return None if ellipsoid is None else float(np.linalg.det(ellipsoid[1]) ** (1.0 / 3.0))


def fit_norm(
    values_si: FloatArray,
    strength_si: float,
    believed: FloatArray,
    believed_bias_si: FloatArray,
    *,
    cross: bool = True,
    where: str = "",
) -> NormFit:
    """Fit the constants to outputs (n, 3) of a vector that was always `strength_si` long.

    cross: the elements off the diagonal too, which takes ten attitudes.

    Raises:
        DiagnosisError: the attitudes do not tell these numbers.
    """
    free = LOWER if cross else DIAGONAL
    bias, matrix = _start(values_si, strength_si, believed, believed_bias_si, free)
    is_robust = len(values_si) >= LEAST_TO_LEAVE_OUT
    used = np.ones(len(values_si), dtype=bool)
    for number in range(STEPS):
        u, along, residual = _seen(values_si, bias, matrix, strength_si)
        columns = _columns(along, u, free)
        if is_robust and number % PLAIN_STEPS == 0 and number:
            used = np.abs(residual) < FAR_OFF * _deviation(residual)
        step = np.linalg.lstsq(columns[used], residual[used], rcond=None)[0]
        bias = bias + step[:3]
        for (i, j), change in zip(free, step[3:], strict=True):
            matrix[i, j] += change
        if number > 2 * PLAIN_STEPS and float(np.max(np.abs(columns @ step))) < SETTLED * strength_si:
            break
    u, along, _ = _seen(values_si, bias, matrix, strength_si)
    _refuse_alike(_columns(along, u, free), where)
    ratio = np.diag(matrix) / np.diag(believed)
    reference = int(np.argsort(ratio)[1])
    factor = float(ratio[reference])
    strength_si, matrix = strength_si * factor, matrix / factor
    u, along, residual = _seen(values_si, bias, matrix, strength_si)
    return NormFit(bias, matrix, strength_si, reference, free, u, along, residual, used)


def _start(
    values: FloatArray, strength: float, believed: FloatArray, believed_bias: FloatArray, free: Elements
) -> tuple[FloatArray, FloatArray]:
    """The belief, or the ellipsoid if that lies nearer to most of the points."""
    matrix = believed.copy()
    ellipsoid = _ellipsoid(values) if free == LOWER else None
    if ellipsoid is None:
        return believed_bias.copy(), matrix
    centre, root = ellipsoid
    for i, j in free:
        matrix[i, j] = root[i, j] / strength
    near = [
        float(np.median(np.abs(_seen(values, *start, strength)[2])))
        for start in ((believed_bias, believed), (centre, matrix))
    ]
    return (centre, matrix) if near[1] < near[0] else (believed_bias.copy(), believed.copy())


def _refuse_alike(columns: FloatArray, where: str) -> None:
    size = np.sqrt(np.sum(columns**2, axis=0))
    if (size > 0).all() and np.linalg.cond(columns / size) < WORST_CONDITION:
        return
    raise DiagnosisError(
        "The attitudes are too few or too much alike: the norm tells no bias and scale factors.",
        where=where,
        fault=Fault.DATA,
        remedy="turn the unit all ways; for accelerometers, rest in ten attitudes or more.",
    )


def _seen(
    values: FloatArray, bias: FloatArray, matrix: FloatArray, strength: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    inverse = np.linalg.inv(matrix)
    back = (values - bias) @ inverse.T
    length = np.linalg.norm(back, axis=1)
    direction = back / np.maximum(length, 1e-300)[:, np.newaxis]
    return strength * direction, direction @ inverse, length - strength


def _columns(along: FloatArray, u: FloatArray, free: Elements) -> FloatArray:
    return np.column_stack([along, *(along[:, i] * u[:, j] for i, j in free)])


def _deviation(residual: FloatArray) -> float:
    return max(MEDIAN_TO_DEVIATION * float(np.median(np.abs(residual))), 1e-300)


def _ellipsoid(values: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Centre (3,) and lower root L (3, 3) of the surface |L⁻¹(y − c)| = 1 of least algebraic error."""
    if len(values) < LEAST_FOR_ELLIPSOID:
        return None
    middle, size = values.mean(axis=0), float(np.abs(values - values.mean(axis=0)).max())
    x, y, z = ((values - middle) / max(size, 1e-300)).T
    design = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z])
    p = np.asarray(np.linalg.lstsq(design, np.ones(len(values)), rcond=None)[0], dtype=np.float64)
    form = np.array([[p[0], p[3], p[4]], [p[3], p[1], p[5]], [p[4], p[5], p[2]]])
    try:
        centre = -0.5 * np.linalg.solve(form, p[6:])
        level = 1.0 + float(centre @ form @ centre)
        root = np.linalg.cholesky(np.linalg.inv(form / level))
    except np.linalg.LinAlgError:
        return None
    return np.asarray(middle + size * centre), np.asarray(size * root, dtype=np.float64)

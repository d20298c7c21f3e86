"""An accelerometer in many unknown attitudes: only the magnitude of gravity is known.

Model, with K upper triangular (Tedaldi, Pretto & Menegatti, ICRA 2014, eq (10)):

    | K (y - b) | = g        for each rest,  K = [[k_xx k_xy k_xz] [0 k_yy k_yz] [0 0 k_zz]]

Nine parameters. Attitudes that never tilt two axes together leave their non-orthogonality open: it is
then taken as 0 with a standard uncertainty of 0.02 rad, and said. Gravity's magnitude cannot tell how
the triad sits in its housing, so the body frame is the sensors' own: z along the input axis of sensor
z, y in the plane of the input axes y and z.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from protocol.errors import CalibrationError, Fault

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
PARAMETERS = (*(f"k_{'xyz'[i]}{'xyz'[j]}" for i, j in UPPER), "b_x", "b_y", "b_z")
OFF_DIAGONAL = ("k_xy", "k_xz", "k_yz")
MIN_RESTS = len(PARAMETERS)
MAX_ITERATIONS = 200
REWEIGHTINGS = 3
"""Weights hang on the residuals and hardly move after the first turn."""
MIN_EXCITATION = 0.02
"""Smallest singular value of the normalised Jacobian, per root rest, that carries nine parameters."""
NAMED_PART = 0.4
PRIOR_NONORTHOGONALITY_RAD = 0.02
"""Standard uncertainty of a non-orthogonality that the attitudes leave open: data sheets of MEMS
accelerometers give a cross-axis sensitivity of 1 to 2 %."""
MAX_START_ERROR = 0.5
"""Raw norms further than this from g (relative) are not an accelerometer in m/s^2."""


@dataclass(frozen=True)
class MultiPositionFit:
    """Coefficients with what is left of each rest.

    Attributes:
        coefficients: M = inv(K), b and their covariance.
        norm_residuals_m_s2: |K (y - b)| - g of each rest, shape (n,).
        between_rests_m_s2: standard deviation that the rests show beyond their own noise.
        condition: of the normalised Jacobian, open parameters left out.
        assumed: parameters that the attitudes leave open, taken as 0 with the stated uncertainty.
    """

    coefficients: TriadCoefficients
    norm_residuals_m_s2: FloatArray
    between_rests_m_s2: float
    condition: float
    assumed: tuple[str, ...]


def fit_multi_position(
    means: FloatArray, mean_variance: FloatArray, gravity_m_s2: float, where: str
) -> MultiPositionFit:
    """Scale factors, non-orthogonality and bias from the means of at least nine rests.

    Args:
        means: of each rest, shape (n, 3), m/s^2.
        mean_variance: of these means from the noise inside the rests, shape (n,), (m/s^2)^2.
        gravity_m_s2: magnitude of gravity at the site.
        where: names the data in errors.

    Raises:
        CalibrationError: too few rests, no accelerometer data, or attitudes that leave a parameter
            open (named).
    """
    if len(means) < MIN_RESTS:
        raise _refused(
            f"Nine parameters need at least {MIN_RESTS} rests; {len(means)} can be used.",
            where,
            f"record at least {MIN_RESTS} attitudes",
        )
    norms = np.linalg.norm(means, axis=1)
    if not np.isfinite(means).all() or abs(float(np.median(norms)) / gravity_m_s2 - 1.0) > MAX_START_ERROR:
        raise _refused(
            f"The rests' median norm is {float(np.median(norms)):.4g} m/s^2, far from {gravity_m_s2:.5g}.",
            where,
            "check the channels' unit of measure",
        )
    start = np.array([1.0, 0, 0, 1.0, 0, 1.0, 0, 0, 0])
    assumed, condition = check_attitudes(_jacobian(start, means), where)
    held = np.array([name in assumed for name in PARAMETERS])
    between = 0.0
    floor = (1e-9 * gravity_m_s2) ** 2
    weights = 1.0 / np.sqrt(mean_variance + floor)
    freedom = len(means) - len(PARAMETERS) + len(assumed)
    parameters = start
    residuals = _residuals(start, means, gravity_m_s2)
    for _ in range(REWEIGHTINGS):
        parameters = _solve(parameters, means, weights, gravity_m_s2, held, where)
        residuals = _residuals(parameters, means, gravity_m_s2)
        between = _between_rests(residuals, mean_variance + floor, freedom)
        weights = 1.0 / np.sqrt(mean_variance + between**2 + floor)
    # What was taken from the residuals has the variance of a t distribution (JCGM 101:2008, 6.4.9.2).
    spread = max(freedom, 3) / (max(freedom, 3) - 2)
    jacobian = _raw_jacobian(parameters, means)
    weighted = jacobian / (mean_variance + spread * between**2 + floor)[:, None]
    covariance: FloatArray = _inverse(jacobian.T @ weighted + np.diag(held / PRIOR_NONORTHOGONALITY_RAD**2))
    coefficients = _coefficients(parameters, covariance, residuals, freedom)
    return MultiPositionFit(coefficients, residuals, between, condition, assumed)


def check_attitudes(jacobian: FloatArray, where: str) -> tuple[tuple[str, ...], float]:
    """Non-orthogonalities that these attitudes leave open, and the condition of the rest.

    Args:
        jacobian: normalised, shape (n, 9).
        where: names the data in errors.

    Raises:
        CalibrationError: a scale factor or a bias is open: naming the parameters that these
            attitudes cannot tell apart.
    """
    kept = list(range(len(PARAMETERS)))
    singular = np.ones(1)
    for _ in range(4):  # three non-orthogonalities can be open, not more
        _, singular, directions = np.linalg.svd(jacobian[:, kept], full_matrices=False)
        smallest = float(singular[-1]) / np.sqrt(len(jacobian))
        if smallest >= MIN_EXCITATION:
            break
        open_ones = [PARAMETERS[kept[k]] for k in np.flatnonzero(np.abs(directions[-1]) > NAMED_PART)]
        if not open_ones or any(name not in OFF_DIAGONAL for name in open_ones):
            axes = sorted({name[2] for name in open_ones}) or ["x", "y", "z"]
            raise _refused(
                f"These attitudes leave {', '.join(open_ones) or 'a mixture of parameters'} open "
                f"(smallest singular value {smallest:.2g}, bound {MIN_EXCITATION:g}).",
                where,
                f"record attitudes with {' and '.join(axes)} up, down and level",
            )
        kept = [k for k in kept if PARAMETERS[k] not in open_ones]
    assumed = tuple(name for k, name in enumerate(PARAMETERS) if k not in kept)
    return assumed, float(singular[0] / singular[-1])


def _compensation(parameters: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(parameters[:6], UPPER, strict=True):
        matrix[i, j] = value
    return matrix


def _residuals(parameters: FloatArray, means: FloatArray, gravity: float) -> FloatArray:
    compensated = (means - parameters[6:]) @ _compensation(parameters).T
    return np.linalg.norm(compensated, axis=1) - gravity


def _jacobian(parameters: FloatArray, means: FloatArray) -> FloatArray:
    """d |K (y - b)| by the parameters, columns k scaled by |y - b|: all dimensionless, shape (n, 9)."""
    return _raw_jacobian(parameters, means) / _column_scale(means)


def _column_scale(means: FloatArray) -> FloatArray:
    scale = float(np.median(np.linalg.norm(means, axis=1)))
    return np.array([scale] * 6 + [1.0] * 3)


def _raw_jacobian(parameters: FloatArray, means: FloatArray) -> FloatArray:
    compensation = _compensation(parameters)
    centred = means - parameters[6:]
    compensated = centred @ compensation.T
    direction = compensated / np.linalg.norm(compensated, axis=1, keepdims=True)
    by_matrix = np.stack([direction[:, i] * centred[:, j] for i, j in UPPER], axis=1)
    return np.hstack([by_matrix, -direction @ compensation])


def _solve(
    start: FloatArray,
    means: FloatArray,
    weights: FloatArray,
    gravity: float,
    held: NDArray[np.bool_],
    where: str,
) -> FloatArray:
    prior = np.diag(held / PRIOR_NONORTHOGONALITY_RAD)[held]

    def jacobian(parameters: FloatArray) -> FloatArray:
        return np.vstack([_raw_jacobian(parameters, means) * weights[:, None], prior])

    found = least_squares(
        lambda p: np.concatenate([_residuals(p, means, gravity) * weights, prior @ p]),
        start,
        jac=jacobian,  # pyright: ignore[reportArgumentType]  # scipy takes a callable; its stub says str
        x_scale=1.0 / _column_scale(means),
        max_nfev=MAX_ITERATIONS,
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    if found.status == 0:
        raise _refused(
            f"The fit did not settle within {MAX_ITERATIONS} iterations.",
            where,
            "look for rests that were moved",
        )
    return np.asarray(found.x, dtype=np.float64)


def _between_rests(residuals: FloatArray, variance: FloatArray, freedom: int) -> float:
    """Standard deviation beyond the rests' own noise: sum r^2 / (v + tau^2) = nu (Paule & Mandel 1982)."""
    if freedom <= 0:
        return 0.0

    def excess(squared: float) -> float:
        return float((residuals**2 / (variance + squared)).sum()) - freedom

    tiny = 1e-20
    if excess(tiny) <= 0:
        return 0.0
    root = brentq(excess, tiny, float((residuals**2).sum()))
    return float(np.sqrt(np.float64(root)))  # pyright: ignore[reportArgumentType, reportCallIssue]


def _coefficients(
    parameters: FloatArray, parameter_covariance: FloatArray, residuals: FloatArray, freedom: int
) -> TriadCoefficients:
    matrix = _inverse(_compensation(parameters))
    placed = np.zeros((12, 9))  # parameters → (K row by row, b)
    for column, (i, j) in enumerate(UPPER):
        placed[3 * i + j, column] = 1.0
    placed[9:, 6:] = np.eye(3)
    to_forward = np.eye(12)
    to_forward[:9, :9] = -np.kron(matrix, matrix.T)  # dM = -M dK M
    jacobian = to_forward @ placed
    covariance = jacobian @ parameter_covariance @ jacobian.T
    return TriadCoefficients(
        quantity="acceleration",
        matrix=matrix,
        bias=parameters[6:],
        covariance=(covariance + covariance.T) / 2.0,
        residual_rms=float(np.sqrt((residuals**2).mean())),
        degrees_of_freedom=freedom,
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _refused(what: str, where: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where=where, fault=Fault.DATA, remedy=remedy + ".")

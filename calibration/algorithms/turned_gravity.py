"""Gyros from gravity turned between rests: no table, and no turn of known angle.

Between two rests the gyro tells how the body turned; at both the accelerometer tells where gravity is:

    d_b = C_ab(K, b)^T d_a,    dC/dt = C [w x],   w = K (y - b)

d: direction of the specific force at rest in the accelerometer's axes, C_ab: body at b to body at a.
Two equations a turn (that about gravity itself is not seen) for the nine elements of K = inv(M), which
holds the alignment to the accelerometer's axes too; the bias comes from the rests, and is fitted along.
Tedaldi, Pretto & Menegatti, ICRA 2014, eq (18), with a covariance: directions scatter from rest to rest
by what the residuals show (a hand is not still), and share what is uncertain of the accelerometer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.earth import EARTH_RATE_RAD_S
from protocol.errors import CalibrationError, Fault

MIN_TURNS = 9
"""Half of their equations are left to tell whether the turns agree."""
MIN_EXCITATION_RAD = 0.1
"""Smallest singular value of the turns' Jacobian, per root turn, that carries nine elements."""
NAMED_PART = 0.4
MAX_ROUNDS = 30
SETTLED = 1e-8
REWEIGHTINGS = 3
OUTLIER_CHANCE = 1e-3
"""A turn is left out that would disagree so with all others in fewer sessions than this."""
MAX_OUTLIER_PART = 0.2
BLOCK = 128
SMALLEST_DIRECTION_RAD = 1e-7


@dataclass(frozen=True)
class Turn:
    """Of two rests that follow each other, by their place in the list of rests."""

    before: int
    after: int


@dataclass(frozen=True)
class TurnedGravityFit:
    """Coefficients with what is left of each turn.

    Attributes:
        coefficients: M = inv(K), b and their covariance; input axes in the accelerometer's axes.
        turns: that were used.
        residuals_rad: angle between gravity as turned and as found, of each turn used, shape (t,).
        direction_rad: standard deviation of a rest's direction beyond what is known of its errors.
        condition: of the Jacobian of the nine elements.
        outliers: turns left out.
    """

    coefficients: TriadCoefficients
    turns: tuple[Turn, ...]
    residuals_rad: FloatArray
    direction_rad: float
    condition: float
    outliers: tuple[Turn, ...]


@dataclass(frozen=True)
class GravitySession:
    """A recording with its rests.

    Attributes:
        time_s: shape (n,).
        gyro_rad_s: outputs in nominal SI scaling, shape (n, 3).
        specific_force_m_s2: compensated, shape (n, 3); only looked at in the rests.
        rests: first and last-plus-one row of each.
        turns: to use, each free of holes and saturation.
        bias_rad_s, bias_deviation_rad_s: of the gyro's means at rest, shape (3,): their mean, and how far
            they lie from it. A bias may wander: the mean is not taken for better than that.
        white_density: of the gyro's white noise, (rad/s)^2 s.
        gravity_m_s2: at the site.
        acc: of the accelerometer: what is uncertain of it is common to all directions.
    """

    time_s: FloatArray
    gyro_rad_s: FloatArray
    specific_force_m_s2: FloatArray
    rests: tuple[tuple[int, int], ...]
    turns: tuple[Turn, ...]
    bias_rad_s: FloatArray
    bias_deviation_rad_s: FloatArray
    white_density: float
    gravity_m_s2: float
    acc: TriadCoefficients


def fit_turned_gravity(session: GravitySession, where: str) -> TurnedGravityFit:
    """K, b and their covariance from the turns between rests.

    Args:
        session: outputs, rests and what is known of them.
        where: names the data in errors.

    Raises:
        CalibrationError: too few turns, turns that leave an element open (axes named), a fit that does
            not settle.
    """
    turns, outliers = list(session.turns), list[Turn]()
    while True:
        if len(turns) < MIN_TURNS:
            raise _refused(
                f"Nine elements of the gyros need {MIN_TURNS} turns between rests; {len(turns)} can be used.",
                where,
                "record more rests with turns between them that the gyros can follow",
            )
        fit, chances = _fit(session, tuple(turns), where)
        worst = int(chances.argmin())
        if float(chances[worst]) * len(turns) >= OUTLIER_CHANCE:
            return replace(fit, outliers=tuple(outliers))
        if len(outliers) + 1 > MAX_OUTLIER_PART * len(session.turns):
            raise _refused(
                f"{len(outliers) + 1} of {len(session.turns)} turns disagree with the others.",
                where,
                "turn within the gyros' range, and hold the unit still at each rest",
            )
        outliers.append(turns.pop(worst))


def _fit(session: GravitySession, turns: tuple[Turn, ...], where: str) -> tuple[TurnedGravityFit, FloatArray]:
    """The fit, and for each turn the chance that it disagrees so with the others."""
    parameters = np.concatenate([np.eye(3).ravel(), session.bias_rad_s])
    prior = np.diag(session.bias_deviation_rad_s**-2.0)
    freedom = 2 * len(turns) + 3 - len(parameters)
    direction = 1e-3
    model = TurnedGravity(session, turns)
    condition = np.inf
    for _ in range(REWEIGHTINGS):
        for _ in range(MAX_ROUNDS):
            residual, jacobian, known, of_directions = model.at(parameters)
            weights = np.linalg.inv(known + direction**2 * of_directions)
            normal = jacobian.T @ weights @ jacobian
            normal[9:, 9:] += prior
            right = jacobian.T @ weights @ residual
            right[9:] += prior @ (session.bias_rad_s - parameters[9:])
            condition = _check_turns(jacobian[:, :9], where)
            step = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
            parameters = parameters + step
            if float(np.abs(step[:9]).max()) <= SETTLED:
                break
        else:
            raise _refused(
                f"The fit did not settle within {MAX_ROUNDS} rounds: gravity does not turn as the gyros say.",
                where,
                "check that accelerometer and gyros have the same axes, signs and times",
            )
        off = parameters[9:] - session.bias_rad_s
        direction = _direction_deviation(residual, known, of_directions, float(off @ prior @ off), freedom)
    residual, jacobian, known, of_directions = model.at(parameters)
    chances = _chances(residual, jacobian, known + direction**2 * of_directions, prior, freedom)
    # What was taken from the residuals has the variance of a t distribution (JCGM 101:2008, 6.4.9.2).
    spread = freedom / (freedom - 2)
    normal = jacobian.T @ np.linalg.solve(known + spread * direction**2 * of_directions, jacobian)
    normal[9:, 9:] += prior
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    angles = np.linalg.norm(residual.reshape(-1, 2), axis=1)
    coefficients = _coefficients(parameters, covariance, angles / model.durations_s(), freedom)
    return TurnedGravityFit(coefficients, turns, angles, direction, condition, ()), chances


def _chances(
    residual: FloatArray, jacobian: FloatArray, covariance: FloatArray, prior: FloatArray, freedom: int
) -> FloatArray:
    """Of each turn, that a shift of its own would take so much off chi-square: F with 2 and nu - 2.

    The mean-shift test of Cook & Weisberg, Residuals and Influence (1982), section 2.2, for pairs.
    """
    weights = np.linalg.inv(covariance)
    normal = jacobian.T @ weights @ jacobian
    normal[9:, 9:] += prior
    projected = weights - weights @ jacobian @ np.linalg.solve(normal, jacobian.T @ weights)
    whole = float(residual @ projected @ residual)
    pulled = (projected @ residual).reshape(-1, 2)
    taken = np.array(
        [
            pull @ np.linalg.solve(projected[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], pull)
            for k, pull in enumerate(pulled)
        ]
    )
    left = np.asarray(np.clip(1.0 - taken / whole, 0.0, 1.0), dtype=np.float64)
    return left ** ((freedom - 2) / 2)


class TurnedGravity:
    """Residuals of the turns and what they hang on."""

    def __init__(self, session: GravitySession, turns: tuple[Turn, ...]) -> None:
        self.session, self.turns = session, turns
        self.step_s = np.diff(session.time_s)
        self.mean_output = (session.gyro_rad_s[1:] + session.gyro_rad_s[:-1]) / 2.0
        # A turn that is not used may hold missing values: what is summed over it is taken away again.
        self.mean_output = np.where(np.isfinite(self.mean_output), self.mean_output, 0.0)
        self.centre = [(first + last) // 2 for first, last in session.rests]

    def at(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residuals and what they hang on.

        Returns:
            Residuals (2 t,), Jacobian of the turned direction (2 t, 12), covariance that is known and that
            of directions with unit variance, both (2 t, 2 t).
        """
        session, compensation, bias = self.session, parameters[:9].reshape(3, 3), parameters[9:]
        centred = self.mean_output - bias
        attitude = cumulative_attitude((centred @ compensation.T) * self.step_s[:, None])
        # Turning of the attitude per unit of K (3, 3, 3) and of b (3, 3), up to each row, in the first frame.
        timed = attitude[:-1] * self.step_s[:, None, None]
        by_matrix = _running(np.einsum("nai,nj->naij", timed, centred))
        by_bias = _running(-timed @ compensation)
        directions = [self._direction(attitude, k) for k in range(len(session.rests))]
        of_acc = [self._by_accelerometer(direction) for direction in directions]
        count = len(self.turns)
        residual, jacobian = np.empty((count, 2)), np.empty((count, 2, 12))
        shares = np.zeros((count, 2, len(session.rests), 3))
        by_acc = np.empty((count, 2, 12))
        white = np.empty(count)
        for row, turn in enumerate(self.turns):
            first, last = self.centre[turn.before], self.centre[turn.after]
            between = attitude[last].T @ attitude[first]
            turned = between @ directions[turn.before]
            across = _across(turned)
            residual[row] = across @ (directions[turn.after] - turned)
            # d(turned) = C_ab^T (d_a x theta), theta in the axes of the first rest
            to_turned = across @ between @ _cross(directions[turn.before]) @ attitude[first].T
            change = by_matrix[last] - by_matrix[first]
            jacobian[row, :, :9] = to_turned @ change.reshape(3, 9)
            jacobian[row, :, 9:] = to_turned @ (by_bias[last] - by_bias[first])
            shares[row, :, turn.after] = across
            shares[row, :, turn.before] = -across @ between
            by_acc[row] = across @ (of_acc[turn.after] - between @ of_acc[turn.before])
            duration = float(session.time_s[last] - session.time_s[first])
            # Earth rate in an unknown direction, and white noise of the rate.
            white[row] = session.white_density * duration + (EARTH_RATE_RAD_S * duration) ** 2 / 3.0
        flat = shares.reshape(2 * count, -1)
        acc = by_acc.reshape(2 * count, 12)
        known = np.diag(np.repeat(white, 2)) + acc @ session.acc.compensation_covariance() @ acc.T
        floor = SMALLEST_DIRECTION_RAD**2 * np.eye(2 * count)
        return residual.ravel(), jacobian.reshape(-1, 12), known + floor, flat @ flat.T

    def durations_s(self) -> FloatArray:
        """From the middle of one rest to that of the other, shape (t,)."""
        middle_s = self.session.time_s[self.centre]
        return np.array([middle_s[turn.after] - middle_s[turn.before] for turn in self.turns])

    def _direction(self, attitude: FloatArray, rest: int) -> FloatArray:
        """Of the specific force at the middle of a rest; what moved in it is taken back by the gyro."""
        first, last = self.session.rests[rest]
        forces = self.session.specific_force_m_s2[first:last]
        there = np.isfinite(forces).all(axis=1)
        mean = np.einsum("nij,nj->ni", attitude[first:last][there], forces[there]).mean(axis=0)
        direction = attitude[self.centre[rest]].T @ mean
        return direction / np.linalg.norm(direction)

    def _by_accelerometer(self, direction: FloatArray) -> FloatArray:
        """How the direction turns with (K row by row, b) of the accelerometer, shape (3, 12)."""
        acc = self.session.acc
        centred = acc.matrix @ direction
        change = np.hstack([np.kron(np.eye(3), centred), -acc.compensation / self.session.gravity_m_s2])
        return (np.eye(3) - np.outer(direction, direction)) @ change


def cumulative_attitude(angles_rad: FloatArray) -> FloatArray:
    """Products of small rotations: frame after each of n steps to the first frame, shape (n + 1, 3, 3).

    Args:
        angles_rad: rotation vectors in the frame that they begin in, shape (n, 3).
    """
    steps = _rotations(angles_rad)
    blocks = -(-len(steps) // BLOCK)
    padded = np.tile(np.eye(3), (blocks * BLOCK, 1, 1))
    padded[: len(steps)] = steps
    inside = padded.reshape(blocks, BLOCK, 3, 3)
    for k in range(1, BLOCK):
        inside[:, k] = inside[:, k - 1] @ inside[:, k]
    begun = np.eye(3)
    for block in range(blocks):
        inside[block] = begun @ inside[block]
        begun = inside[block, -1]
    return np.concatenate([np.eye(3)[None], padded[: len(steps)]])


def _rotations(angles_rad: FloatArray) -> FloatArray:
    """exp [phi x], shape (n, 3, 3)."""
    half = np.linalg.norm(angles_rad, axis=1) / 2.0
    scalar = np.cos(half)
    part = np.where(half > 1e-9, np.sin(half) / np.maximum(half, 1e-300), 1.0) / 2.0
    x, y, z = angles_rad.T * part  # with the scalar: the quaternion
    rotations: FloatArray = np.empty((len(half), 3, 3))
    rotations[:, 0] = np.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - scalar * z), 2 * (x * z + scalar * y)], axis=1
    )
    rotations[:, 1] = np.stack(
        [2 * (x * y + scalar * z), 1 - 2 * (x * x + z * z), 2 * (y * z - scalar * x)], axis=1
    )
    rotations[:, 2] = np.stack(
        [2 * (x * z - scalar * y), 2 * (y * z + scalar * x), 1 - 2 * (x * x + y * y)], axis=1
    )
    return rotations


def _cross(vector: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _running(values: FloatArray) -> FloatArray:
    """Sums up to each row, from 0, shape (n + 1, …)."""
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def _across(direction: FloatArray) -> FloatArray:
    """Two unit vectors across a direction, shape (2, 3)."""
    least = np.eye(3)[int(np.abs(direction).argmin())]
    first = np.cross(direction, least)
    first = first / np.linalg.norm(first)
    return np.asarray(np.array([first, np.cross(direction, first)]), dtype=np.float64)


def _check_turns(jacobian: FloatArray, where: str) -> float:
    """Condition of the nine elements' Jacobian; refuse what leaves one open, and name its axis."""
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    smallest = float(singular[-1]) / np.sqrt(len(jacobian) / 2)
    if smallest >= MIN_EXCITATION_RAD:
        return float(singular[0] / singular[-1])
    open_ones = np.flatnonzero(np.abs(directions[-1]) > NAMED_PART)
    axes = sorted({"xyz"[k % 3] for k in open_ones}) or ["x", "y", "z"]
    names = ", ".join(f"k_{'xyz'[k // 3]}{'xyz'[k % 3]}" for k in open_ones) or "a mixture of elements"
    raise _refused(
        f"The turns leave {names} of the gyros open "
        f"(smallest singular value {smallest:.2g} rad, bound {MIN_EXCITATION_RAD:g}).",
        where,
        f"turn about {' and '.join(axes)} by 90 deg or more, each held level",
    )


def _direction_deviation(
    residual: FloatArray, known: FloatArray, of_directions: FloatArray, off: float, freedom: int
) -> float:
    """Deviation of a direction that makes chi-square what it should be (Paule & Mandel 1982)."""

    def excess(deviation: float) -> float:
        covariance = known + deviation**2 * of_directions
        return float(residual @ np.linalg.solve(covariance, residual)) + off - freedom

    highest = 1.0
    if freedom <= 0 or excess(0.0) <= 0.0:
        return 0.0
    if excess(highest) >= 0.0:
        return highest
    root = brentq(excess, 0.0, highest)
    return float(np.float64(root))  # pyright: ignore[reportArgumentType]


def _coefficients(
    parameters: FloatArray, covariance: FloatArray, rates_rad_s: FloatArray, freedom: int
) -> TriadCoefficients:
    matrix = np.asarray(np.linalg.inv(parameters[:9].reshape(3, 3)), dtype=np.float64)
    to_forward = np.eye(12)
    to_forward[:9, :9] = -np.kron(matrix, matrix.T)  # dM = -M dK M
    forward = to_forward @ covariance @ to_forward.T
    return TriadCoefficients(
        quantity="angular_rate",
        matrix=matrix,
        bias=parameters[9:],
        covariance=(forward + forward.T) / 2.0,
        residual_rms=float(np.sqrt((rates_rad_s**2).mean())),
        degrees_of_freedom=freedom,
    )


def turns_between(count: int, usable: Sequence[bool] | NDArray[np.bool_]) -> tuple[Turn, ...]:
    """Turns from each of `count` rests to the next, where `usable`, shape (count - 1,), says so."""
    return tuple(Turn(k, k + 1) for k in range(count - 1) if usable[k])


def _refused(what: str, where: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where=where, fault=Fault.DATA, remedy=remedy + ".")

"""Q, N, B, K and R of IEEE 952 from overlapping Allan deviations, with uncertainties.

sigma^2(tau) is linear in the squares of the coefficients, so the fit is generalised least squares with
the covariance between taus of `allan_noise`: neighbouring taus see the same samples and are far from
independent. That covariance depends on the coefficients: start from a diagonal one, go round until it
settles. No square may be negative: a term whose square would be is absent (non-negative least squares).

Stated approximations: variances are taken as normal (taus with few degrees of freedom are left out),
the standard uncertainty of a coefficient is that of its square over twice itself, and intervals are
those of the square, cut at zero.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import nnls

from calibration.algorithms.allan_noise import (
    TERMS,
    NoiseModel,
    variance_covariance,
    variance_shapes,
)
from calibration.algorithms.allan_variance import AllanDeviation, FloatArray
from protocol.errors import CalibrationError, Fault

TAU_RATIO = 1.4
"""Least ratio of neighbouring taus that are fitted: closer ones tell the same twice."""
LONGEST_PART = 8
"""Taus beyond the record's length over this have too few degrees of freedom for normal statistics."""
MAX_ROUNDS = 60
SETTLED = 1e-3
"""Relative change of the modelled variance, anywhere on the plot, at which the rounds end."""
MAX_CHI_SQUARE_SIGMAS = 3.0
"""Residuals further above the model than this widen the uncertainties (Birge ratio)."""
DETERMINED_SIGMAS = 2.0


@dataclass(frozen=True)
class AllanFit:
    """Coefficients with what they are worth.

    Attributes:
        model: the coefficients; a term that the data do not carry is 0.
        squares: (Q^2, N^2, B^2, K^2, R^2), shape (5,).
        covariance: of the squares, shape (5, 5). Of a term that came out absent: what it would have
            had, so that its upper limit can be stated.
        tau_s: averaging times that were fitted.
        residuals: measured over modelled variance less 1, shape of `tau_s`.
        chi_square_ratio: chi-square per degree of freedom; far above 1 the five terms do not
            describe this unit (a vibration line, a Gauss-Markov bias, a step).
    """

    model: NoiseModel
    squares: FloatArray
    covariance: FloatArray
    tau_s: FloatArray
    residuals: FloatArray
    chi_square_ratio: float

    def standard_uncertainty(self, name: str) -> float:
        """u of a coefficient; infinite for one that came out absent: ask for its interval."""
        index = TERMS.index(name)
        value = np.sqrt(self.squares[index])
        spread = np.sqrt(self.covariance[index, index])
        return float(spread / (2.0 * value)) if value > 0 else float("inf")

    def interval(self, name: str, sigmas: float = 2.0) -> tuple[float, float]:
        """Lower and upper limit of a coefficient: those of its square, cut at 0."""
        index = TERMS.index(name)
        spread = sigmas * float(np.sqrt(self.covariance[index, index]))
        square = float(self.squares[index])
        return float(np.sqrt(max(square - spread, 0.0))), float(np.sqrt(square + spread))

    def determined(self, name: str) -> bool:
        """Whether a coefficient is there at all: its square is at least two standard uncertainties."""
        return self.interval(name, DETERMINED_SIGMAS)[0] > 0.0

    @property
    def described(self) -> bool:
        """Whether the five terms describe the plot, at three standard deviations of chi-square."""
        return self.chi_square_ratio <= _chi_square_bound(len(self.tau_s) - int((self.squares > 0).sum()))


def fit_allan_coefficients(measured: AllanDeviation, terms: tuple[str, ...] = TERMS) -> AllanFit:
    """Coefficients of the chosen terms.

    Args:
        measured: overlapping deviations, best logarithmically spaced from one sample on.
        terms: of `TERMS`, in any order; one that is left out is taken as absent.

    Raises:
        CalibrationError: modified deviations, a constant record, or too few usable taus for the terms.
    """
    if measured.kind != "overlapping":
        raise _refused("The fit is of overlapping deviations, not of modified ones.", "give overlapping ones")
    unknown = [name for name in terms if name not in TERMS]
    if unknown or not terms:
        raise _refused(f"There is no noise term '{', '.join(unknown)}'.", f"choose of {', '.join(TERMS)}")
    chosen = [index for index, name in enumerate(TERMS) if name in terms]
    rows = _usable(measured)
    if len(rows) < len(chosen) + 1:
        raise _refused(
            f"{len(rows)} averaging times, a ratio of {TAU_RATIO} apart and up to an eighth of the record, "
            f"do not carry {len(chosen)} coefficients.",
            "record longer, or fit fewer terms",
        )
    variance = measured.deviation[rows] ** 2
    if variance.min() <= 0.0:
        raise _refused(
            "The record is constant: its deviation is 0.", "see whether the unit's output is stuck"
        )
    factors = tuple(int(factor) for factor in measured.factors[rows])
    between = variance_covariance(factors, measured.sample_count, measured.rate_hz)
    shapes = variance_shapes(measured.tau_s[rows])
    return fit_squares(measured.tau_s[rows], variance, shapes, chosen, between)


class CovarianceOfVariances(Protocol):
    """What a fit asks of an estimate of variances."""

    def of(self, squares: FloatArray) -> FloatArray:
        """Covariance of the variances, shape (k, k), for (Q^2, N^2, B^2, K^2, R^2)."""
        ...


def fit_squares(
    tau_s: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    chosen: list[int],
    between: CovarianceOfVariances,
) -> AllanFit:
    """Fit variances of any kind that are linear in the squares.

    Args:
        tau_s: scales, shape (k,), s.
        variance: measured, shape (k,).
        shapes: variance per unit of each square, shape (k, 5).
        chosen: columns that are fitted.
        between: covariance of the variances.

    Raises:
        CalibrationError: the rounds do not settle.
    """
    squares = _settle(variance, shapes, chosen, between)
    return _with_uncertainty(tau_s, variance, shapes, chosen, between, squares)


def _usable(measured: AllanDeviation) -> list[int]:
    rows: list[int] = []
    for row, factor in enumerate(measured.factors):
        if factor * LONGEST_PART > measured.sample_count:
            break
        if not rows or factor >= TAU_RATIO * measured.factors[rows[-1]]:
            rows.append(row)
    return rows


def _settle(
    variance: FloatArray, shapes: FloatArray, chosen: list[int], between: CovarianceOfVariances
) -> FloatArray:
    """Squares (5,), by non-negative least squares under the covariance that they imply themselves."""
    implied = np.zeros(5)
    implied[chosen] = _non_negative(np.diag(variance), shapes[:, chosen], variance)  # relative errors alike
    squares = np.zeros(5)
    for _ in range(MAX_ROUNDS):
        expected = shapes @ implied
        squares[chosen] = _non_negative(_factor(between.of(implied), expected), shapes[:, chosen], variance)
        if float(np.abs(shapes @ squares / expected - 1.0).max()) <= SETTLED:
            return squares
        implied = (implied + squares) / 2.0  # half a step: terms at the edge of 0 would go to and fro
    raise _refused(
        f"The fit did not settle within {MAX_ROUNDS} rounds: the plot is not one of these noises.",
        "look at the plot, and fit fewer terms",
    )


def _non_negative(factor: FloatArray, shapes: FloatArray, variance: FloatArray) -> FloatArray:
    white = np.linalg.solve(factor, np.column_stack([shapes, variance]))
    scale = np.linalg.norm(white[:, :-1], axis=0)
    solution, _ = nnls(white[:, :-1] / scale, white[:, -1])
    return np.asarray(solution / scale, dtype=np.float64)


def _factor(covariance: FloatArray, expected: FloatArray) -> FloatArray:
    """Cholesky factor; scaled, for a plot spans many decades. A ramp alone has no covariance: a floor."""
    scaled = covariance / np.outer(expected, expected)
    floor = 1e-9 * max(float(np.trace(scaled)) / len(scaled), 1e-12)
    return np.asarray(np.linalg.cholesky(scaled + floor * np.eye(len(scaled)))) * expected[:, None]


def _with_uncertainty(
    tau_s: FloatArray,
    variance: FloatArray,
    shapes: FloatArray,
    chosen: list[int],
    between: CovarianceOfVariances,
    squares: FloatArray,
) -> AllanFit:
    expected = shapes @ squares
    factor = _factor(between.of(squares), expected)
    columns = np.column_stack([shapes, variance - expected])
    white = np.asarray(np.linalg.solve(factor, columns), dtype=np.float64)
    freedom = len(variance) - int((squares > 0).sum())
    ratio = float((white[:, -1] ** 2).sum() / freedom)
    covariance = np.zeros((5, 5))
    covariance[np.ix_(chosen, chosen)] = _inverse_normal(white[:, chosen])
    if ratio > _chi_square_bound(freedom):
        covariance *= ratio
    names = dict(zip(TERMS, (float(value) for value in np.sqrt(squares)), strict=True))
    return AllanFit(NoiseModel(**names), squares, covariance, tau_s, variance / expected - 1.0, ratio)


def _inverse_normal(white: FloatArray) -> FloatArray:
    """(A^T A)^-1 with columns scaled alike."""
    scale = np.linalg.norm(white, axis=0)
    normal = (white / scale).T @ (white / scale)
    return np.asarray(np.linalg.inv(normal), dtype=np.float64) / np.outer(scale, scale)


def _chi_square_bound(freedom: int) -> float:
    return 1.0 + MAX_CHI_SQUARE_SIGMAS * float(np.sqrt(2.0 / max(freedom, 1)))


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="Allan coefficients", fault=Fault.DATA, remedy=remedy + ".")

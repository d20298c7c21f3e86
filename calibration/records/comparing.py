# pyright: strict
"""Two records of one sensor side by side: what differs by more than their uncertainties allow.

    zeta = (a - b) / sqrt(u_a^2 + u_b^2)      E_n = (a - b) / sqrt(U_a^2 + U_b^2)      (ISO 13528)

|E_n| > 1 is the usual rule for one quantity. Of twelve, one is beyond its limits every second time: what
is called significant here has an adjusted probability below 5 % for the whole comparison (Holm). The
covariances count in the joint test: d^T (C_a + C_b)^-1 d is chi-squared.

Probabilities are of the t distribution with Welch and Satterthwaite's degrees of freedom. Both records
are taken as independent; recordings that both rest on are named.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, stdtr  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from calibration.algorithms.coefficients import FloatArray
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CalibratedQuantity
from protocol.errors import CalibrationError, Fault

SIGNIFICANT = 0.05
_RANK_TOLERANCE = 1e-10
_MANY = 1e9
"""Degrees of freedom that do not limit anything."""


@dataclass(frozen=True)
class QuantityComparison:
    """One quantity in both records, in the unit of the first.

    Attributes:
        difference: first less second.
        standard_uncertainty: of the difference.
        zeta, normalised_error: see the module; infinite for a difference of exact values.
        probability: of a larger difference by chance, for this quantity alone.
        adjusted_probability: for the whole comparison (Holm).
    """

    name: str
    symbol: str
    unit: str
    first: float
    second: float
    difference: float
    standard_uncertainty: float
    zeta: float
    normalised_error: float
    probability: float
    adjusted_probability: float

    @property
    def significant(self) -> bool:
        """Whether it differs, with all others in mind."""
        return self.adjusted_probability < SIGNIFICANT


@dataclass(frozen=True)
class RecordComparison:
    """What two records have in common.

    Attributes:
        quantities: in the order of the first record.
        chi_square, degrees_of_freedom, probability: of all of them together.
        not_compared: in one record only, known by an interval only, or exact in both.
        shared_recordings: that both rest on: their differences are smaller than stated.
        other_serial: they are of two units.
    """

    quantities: tuple[QuantityComparison, ...]
    chi_square: float
    degrees_of_freedom: int
    probability: float
    not_compared: tuple[str, ...]
    shared_recordings: tuple[str, ...]
    other_serial: bool

    @property
    def significant(self) -> tuple[str, ...]:
        """Names of what differs."""
        return tuple(one.name for one in self.quantities if one.significant)


def compare_records(first: CalibrationRecord, second: CalibrationRecord) -> RecordComparison:
    """Compare what two records have in common.

    Raises:
        CalibrationError: they are of different products or sensors, or have nothing in common.
        TestloomError: a quantity is not measured in the same kind of unit.
    """
    where = f"{first.title}; {second.title}"
    if (first.product, first.sensor) != (second.product, second.sensor):
        raise CalibrationError(
            f"One record is of {first.product} {first.sensor}, "
            f"the other of {second.product} {second.sensor}.",
            where=where,
            fault=Fault.OPERATOR,
            remedy="compare records of one sensor.",
        )
    theirs = {quantity.name: quantity for quantity in second.quantities}
    pairs = [
        (ours, theirs[ours.name])
        for ours in first.quantities
        if ours.name in theirs and _comparable(ours, theirs[ours.name])
    ]
    if not pairs:
        raise CalibrationError(
            "The two records have no quantity in common whose uncertainties are known.",
            where=where,
            fault=Fault.OPERATOR,
            remedy="compare records of one method, or of methods that yield the same coefficients.",
        )
    factors = np.array([derived_conversion_factor(b.unit, a.unit) for a, b in pairs], dtype=np.float64)
    probabilities = [_probability(a, b, float(f)) for (a, b), f in zip(pairs, factors, strict=True)]
    compared = tuple(
        _compared(a, b, float(factor), probability, adjusted)
        for (a, b), factor, probability, adjusted in zip(
            pairs, factors, probabilities, holm(probabilities), strict=True
        )
    )
    names = [a.name for a, _ in pairs]
    covariance = first.covariance_of(names) + second.covariance_of(names) * np.outer(factors, factors)
    chi_square, freedom = joint_chi_square(np.array([one.difference for one in compared]), covariance)
    everything = dict.fromkeys(q.name for record in (first, second) for q in record.quantities)
    hashes = {source.sha256 for source in second.recordings}
    return RecordComparison(
        compared,
        chi_square,
        freedom,
        float(chdtrc(freedom, chi_square)) if freedom else 1.0,  # pyright: ignore[reportUnknownArgumentType]
        tuple(name for name in everything if name not in names),
        tuple(source.recording_id for source in first.recordings if source.sha256 in hashes),
        first.serial != second.serial,
    )


def holm(probabilities: Sequence[float]) -> list[float]:
    """Probabilities adjusted for their number (Holm 1979): valid whatever they have to do with each other."""
    order = sorted(range(len(probabilities)), key=lambda k: probabilities[k])
    adjusted = [1.0] * len(probabilities)
    largest = 0.0
    for rank, index in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * probabilities[index]))
        adjusted[index] = largest
    return adjusted


def joint_chi_square(difference: FloatArray, covariance: FloatArray) -> tuple[float, int]:
    """d^T C^-1 d over the directions in which C is not zero, and their number.

    Args:
        difference: shape (n,).
        covariance: shape (n, n).
    """
    deviation = np.sqrt(np.diag(covariance))
    uncertain: NDArray[np.bool_] = deviation > 0
    if not uncertain.any():
        return 0.0, 0
    scaled = difference[uncertain] / deviation[uncertain]
    correlation = covariance[np.ix_(uncertain, uncertain)] / np.outer(
        deviation[uncertain], deviation[uncertain]
    )
    values, directions = np.linalg.eigh(correlation)
    kept = values > _RANK_TOLERANCE * float(values.max())
    along = directions[:, kept].T @ scaled
    return float((along**2 / values[kept]).sum()), int(kept.sum())


def two_sided(ratio: float, degrees_of_freedom: float) -> float:
    """Probability of |t| beyond |ratio|."""
    if math.isinf(ratio):
        return 0.0
    return 2.0 * float(stdtr(min(degrees_of_freedom, _MANY), -abs(ratio)))  # pyright: ignore[reportUnknownArgumentType]


def _comparable(a: CalibratedQuantity, b: CalibratedQuantity) -> bool:
    """Known by deviations, and not by definition in both: those would count among what is tested."""
    both = (a.standard_uncertainty, b.standard_uncertainty)
    return None not in both and (any(both) or a.value * derived_conversion_factor(a.unit, b.unit) != b.value)


def _ratio(difference: float, uncertainty: float) -> float:
    if uncertainty > 0:
        return difference / uncertainty
    return math.copysign(math.inf, difference) if difference else 0.0


def _probability(a: CalibratedQuantity, b: CalibratedQuantity, factor: float) -> float:
    u_a, u_b = a.standard_uncertainty or 0.0, factor * (b.standard_uncertainty or 0.0)
    variance = u_a**2 + u_b**2
    parts = sum(u**4 / nu for u, nu in ((u_a, a.degrees_of_freedom), (u_b, b.degrees_of_freedom)) if nu)
    freedom = variance**2 / parts if parts > 0 else _MANY
    return two_sided(_ratio(a.value - factor * b.value, math.sqrt(variance)), freedom)


def _compared(
    a: CalibratedQuantity, b: CalibratedQuantity, factor: float, probability: float, adjusted: float
) -> QuantityComparison:
    difference = a.value - factor * b.value
    uncertainty = math.hypot(a.standard_uncertainty or 0.0, factor * (b.standard_uncertainty or 0.0))
    expanded = math.hypot(a.expanded_uncertainty or 0.0, factor * (b.expanded_uncertainty or 0.0))
    return QuantityComparison(
        name=a.name,
        symbol=a.symbol,
        unit=a.unit,
        first=a.value,
        second=factor * b.value,
        difference=difference,
        standard_uncertainty=uncertainty,
        zeta=_ratio(difference, uncertainty),
        normalised_error=_ratio(difference, expanded),
        probability=probability,
        adjusted_probability=adjusted,
    )

# pyright: strict
"""Is a quantity within its tolerance, and is the measurement good enough to say so?

The decision rule (ILAC-G8:09/2019, 4.2; JCGM 106:2012): first U <= T / 3, T half of the tolerance interval,
else nothing is said. Then the guard band is U: a quantity conforms if all of value ± U is within the
limits, does not if all of it is beyond one, and is left open in between. Where only an interval of the
value is known, that interval takes the place of value ± U.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from calibration.algorithms.uncertainty_budget import LIMIT_FRACTION
from calibration.certificate.details import CertificateDetails, Tolerance
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CalibratedQuantity
from protocol.errors import CalibrationError, Fault, TestloomError

Verdict = Literal["conforms", "does_not_conform", "open", "not_good_enough"]


@dataclass(frozen=True)
class Judgement:
    """One quantity against its tolerance.

    Attributes:
        quantity: its name.
        unit: of everything here, the quantity's own.
        lower, upper: the tolerance's limits.
        low, high: value ± U, or the interval.
        half_width: T.
        verdict: after the decision rule.
        source: who set the limits.
    """

    quantity: str
    unit: str
    lower: float | None
    upper: float | None
    low: float
    high: float
    half_width: float
    verdict: Verdict
    source: str

    @property
    def ratio(self) -> float:
        """U / T."""
        return (self.high - self.low) / 2.0 / self.half_width


def judgements(record: CalibrationRecord, details: CertificateDetails) -> tuple[Judgement, ...]:
    """Every quantity that has a tolerance, in the record's order.

    Raises:
        CalibrationError: a tolerance is of a quantity that the record does not have, or in a unit that
            does not measure the same.
    """
    _refuse_unknown(record, details.tolerances)
    return tuple(
        judge(quantity, details.tolerances[quantity.name])
        for quantity in record.quantities
        if quantity.name in details.tolerances
    )


def judgements_together(
    records: Sequence[CalibrationRecord], details: CertificateDetails
) -> tuple[tuple[Judgement, ...], ...]:
    """Of each of several records of a unit. A tolerance is of every quantity of its name and kind of unit.

    So one of `bias_x` in mg is an accelerometer's, and one in °/h a gyro's.

    Raises:
        CalibrationError: a tolerance fits none of the records.
    """
    fitting = [
        {
            name: details.tolerances[name]
            for name, unit in {one.name: one.unit for one in record.quantities}.items()
            if name in details.tolerances and _same_kind(unit, details.tolerances[name].unit)
        }
        for record in records
    ]
    for name in details.tolerances:
        if not any(name in found for found in fitting):
            raise _refused(
                f"There is a tolerance of {name} in {details.tolerances[name].unit}, which none of the "
                "records has.",
                records[0].serial,
            )
    return tuple(
        judgements(record, details.model_copy(update={"tolerances": found}))
        for record, found in zip(records, fitting, strict=True)
    )


def _same_kind(unit: str, other: str) -> bool:
    try:
        derived_conversion_factor(unit, other)
    except TestloomError:
        return False
    return True


def judge(quantity: CalibratedQuantity, tolerance: Tolerance) -> Judgement:
    """See the module.

    Raises:
        CalibrationError: the tolerance is in a unit that does not measure the same.
    """
    try:
        factor = derived_conversion_factor(tolerance.unit, quantity.unit)
    except TestloomError as error:
        raise _refused(error.what, f"tolerance of {quantity.name}") from None
    lower = None if tolerance.lower is None else tolerance.lower * factor
    upper = None if tolerance.upper is None else tolerance.upper * factor
    half_width = tolerance.half_width * factor
    low, high = span(quantity)
    if (high - low) / 2.0 > LIMIT_FRACTION * half_width:
        verdict: Verdict = "not_good_enough"
    elif (lower is None or low >= lower) and (upper is None or high <= upper):
        verdict = "conforms"
    elif (lower is not None and high < lower) or (upper is not None and low > upper):
        verdict = "does_not_conform"
    else:
        verdict = "open"
    return Judgement(
        quantity.name, quantity.unit, lower, upper, low, high, half_width, verdict, tolerance.source
    )


def span(quantity: CalibratedQuantity) -> tuple[float, float]:
    """Value ± U; where no standard uncertainty is known, the interval."""
    expanded = quantity.expanded_uncertainty
    if expanded is not None:
        return quantity.value - expanded, quantity.value + expanded
    assert quantity.interval is not None  # the record refuses a quantity with neither
    return quantity.interval.lower, quantity.interval.upper


def _refuse_unknown(record: CalibrationRecord, tolerances: Mapping[str, Tolerance]) -> None:
    names = {quantity.name for quantity in record.quantities}
    for name in tolerances:
        if name not in names:
            raise _refused(f"There is a tolerance of {name}, which the record does not have.", record.title)


def _refused(what: str, where: str) -> CalibrationError:
    return CalibrationError(
        what, where=where, fault=Fault.OPERATOR, remedy="correct the tolerances in the details."
    )

"""Measurements: declared with name, unit and limits before they are taken."""

import math

from pydantic import Field, model_validator

from protocol.frozen_model import FrozenModel
from protocol.outcomes import MeasurementOutcome
from protocol.units_of_measure import is_known_unit

Value = float | int | bool | str


class MeasurementSpecification(FrozenModel):
    """A measurement that a plan declares.

    Limits are inclusive; a missing side is open. `equals` is for identities and pass/fail
    answers of a self-test. `standard_uncertainty` is that of the measurement process (VIM 4.24),
    in the measurement's own unit; it feeds the plan's stated risk, it moves no limit.
    """

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    unit: str = "1"
    low: float | None = None
    high: float | None = None
    equals: Value | None = None
    standard_uncertainty: float | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _check(self) -> "MeasurementSpecification":
        if not is_known_unit(self.unit):
            raise ValueError(f"measurement {self.name}: unit '{self.unit}' is not known")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(
                f"measurement {self.name}: the limits are crossed (low {self.low} > high {self.high})"
            )
        if self.equals is not None and (self.low is not None or self.high is not None):
            raise ValueError(f"measurement {self.name}: give limits or 'equals', not both")
        return self

    def judge(self, value: Value | None) -> MeasurementOutcome:
        """PASS or FAIL by the limits; UNSET for None; ERROR for a value that is not a number.

        `equals` compares numbers by their value (3 and 3.0 are the same), but a truth value or a
        text is never the same as a number.
        """
        if value is None:
            return MeasurementOutcome.UNSET
        if isinstance(value, float) and not math.isfinite(value):
            return MeasurementOutcome.ERROR
        if self.equals is not None:
            same = _kind(value) is _kind(self.equals) and value == self.equals
            return MeasurementOutcome.PASS if same else MeasurementOutcome.FAIL
        if self.low is None and self.high is None:
            return MeasurementOutcome.PASS
        if isinstance(value, (str, bool)):
            return MeasurementOutcome.ERROR
        inside = (self.low is None or value >= self.low) and (self.high is None or value <= self.high)
        return MeasurementOutcome.PASS if inside else MeasurementOutcome.FAIL


class Measurement(FrozenModel):
    """A measurement as taken: the specification it was judged by travels with it.

    A value that is not finite is stored as None with outcome ERROR and said in `message`.
    """

    specification: MeasurementSpecification
    value: Value | None = None
    outcome: MeasurementOutcome = MeasurementOutcome.UNSET
    message: str = ""


def _kind(value: Value) -> type:
    """bool, str, or float for any number."""
    return type(value) if isinstance(value, (bool, str)) else float

# pyright: strict
"""What a laboratory adds to a record before it goes to a customer: names, standards, tolerances.

Nothing here changes a result. Everything may be missing; what is missing is not printed, but for the
names that a reader would look for.
"""

import json
from datetime import date
from typing import Annotated

import yaml
from pydantic import Field, ValidationError, model_validator

from calibration.records.record_parts import Number, UnitOfMeasure, Word
from protocol.errors import CalibrationError, Fault
from protocol.frozen_model import FrozenModel, first_problem
from protocol.plan_yaml import load_plan_yaml

MAX_DETAILS_BYTES = 100_000
Line = Annotated[str, Field(max_length=200)]


class Party(FrozenModel):
    """The laboratory, or the customer."""

    name: Line = ""
    address: Line = ""
    reference: Line = ""
    """Of a laboratory: its accreditation. Of a customer: the order."""


class WorkingStandard(FrozenModel):
    """An instrument beside the stand: a multimeter, a thermometer, a level."""

    name: Line
    id: Line = ""
    certificate: Line = ""
    calibration_due: date | None = None
    accuracy: Line = ""


class Tolerance(FrozenModel):
    """Limits of one quantity. `nominal`: where a single limit is counted from; `source`: who set them."""

    unit: UnitOfMeasure
    lower: Number | None = None
    upper: Number | None = None
    nominal: Number = 0.0
    source: Line = ""

    @model_validator(mode="after")
    def _has_room(self) -> "Tolerance":
        if self.lower is None and self.upper is None:
            raise ValueError("a tolerance has neither a lower nor an upper limit")
        if not self.half_width > 0:
            raise ValueError("a tolerance leaves no room between its limits, or beyond its nominal value")
        return self

    @property
    def half_width(self) -> float:
        """Half of the interval; of a single limit, its distance from the nominal value. In `unit`."""
        if self.lower is not None and self.upper is not None:
            return (self.upper - self.lower) / 2.0
        if self.upper is not None:
            return self.upper - self.nominal
        return self.nominal - (self.lower or 0.0)


class CertificateDetails(FrozenModel):
    """See the module. `tolerances`: by the name of the quantity."""

    number: Line = ""
    received: date | None = None
    issued: date | None = None
    laboratory: Party = Party()
    customer: Party = Party()
    unit_type: Line = ""
    manufacturer: Line = ""
    operator: Line = ""
    checked_by: Line = ""
    approved_by: Line = ""
    standards: Annotated[tuple[WorkingStandard, ...], Field(max_length=20)] = ()
    relative_humidity: Line = ""
    tolerances: dict[Word, Tolerance] = Field(default_factory=dict[str, Tolerance])
    remarks: Annotated[tuple[Annotated[str, Field(max_length=1000)], ...], Field(max_length=20)] = ()


def parse_details(text: str, where: str) -> CertificateDetails:
    """The details that a YAML (or JSON) text holds.

    Args:
        text: a mapping with the fields of `CertificateDetails`.
        where: the file, for errors.

    Raises:
        CalibrationError: no YAML, or something in it is wrong (named).
    """
    if len(text.encode(errors="replace")) > MAX_DETAILS_BYTES:
        raise _refused(f"It is larger than {MAX_DETAILS_BYTES} bytes.", where)
    try:
        loaded = load_plan_yaml(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise _refused(f"This is not YAML: {' '.join(str(error).split())}.", where) from None
    if loaded is None:
        return CertificateDetails()
    try:
        return CertificateDetails.model_validate_json(json.dumps(loaded))
    except ValidationError as error:
        raise _refused(f"A detail is wrong {first_problem(error)}.", where) from None


def _refused(what: str, where: str) -> CalibrationError:
    return CalibrationError(
        what,
        where=where,
        fault=Fault.OPERATOR,
        remedy="correct the file; docs/certificates.md has one to copy.",
    )

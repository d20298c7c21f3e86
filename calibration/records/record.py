# pyright: strict
"""The calibration record: one form for every method, whatever it measures.

A record is of one sensor of one unit: named quantities with standard uncertainties, blocks of covariance
between them, and where wanted tables and budgets; beside them what they rest on (recordings by their
SHA-256, plan, stand, environment, code) and where they hold. Names are the field's terms (IEEE 528);
units those of `derived_units`.

Its canonical JSON (sorted keys, no white space, defaults left out, UTC) has one form for one content;
the SHA-256 of those bytes is the record's identity.
"""

import hashlib
import json
from collections.abc import Sequence
from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from calibration.records.record_parts import (
    MAX_QUANTITIES,
    CalibratedQuantity,
    CodeVersion,
    CovarianceBlock,
    Environment,
    Frame,
    Instant,
    LeftOut,
    Model,
    Number,
    RecordedBudget,
    RecordTable,
    SourceRecording,
    StandReference,
    TemperatureSpan,
    Word,
    refuse_repeated,
)
from protocol.errors import CalibrationError, Fault
from protocol.frozen_model import FrozenModel, first_problem
from protocol.plans import PlanReference

FORMAT = "testloom-calibration-record/1"
MAX_RECORD_BYTES = 4_000_000
COVERAGE_PROBABILITY = 0.9545
"""What k = 2 covers of a normal distribution."""
LINEAR_TRIAD = "linear_triad"
"""Model: y = M u + b, compensated by u = inv(M) (y - b)."""
LINEAR_TRIAD_TEMPERATURE = "linear_triad_temperature"
"""Model: the same at room temperature, and a table `nodes` of what is added at others (paper 2)."""
_VARIANCE_TOLERANCE = 1e-6


class CalibrationRecord(FrozenModel):
    """See the module. `measured_at`: start of the first recording; `created_at`: of the evaluation."""

    format: Literal["testloom-calibration-record/1"] = FORMAT
    serial: Annotated[str, Field(min_length=1, max_length=64)]
    product: Annotated[str, Field(min_length=1)]
    sensor: Word
    method: Word
    model: Model
    quantities: Annotated[tuple[CalibratedQuantity, ...], Field(min_length=1, max_length=MAX_QUANTITIES)]
    covariance: tuple[CovarianceBlock, ...] = ()
    coverage_probability: Annotated[Number, Field(gt=0, lt=1)] = COVERAGE_PROBABILITY
    tables: tuple[RecordTable, ...] = ()
    budgets: tuple[RecordedBudget, ...] = ()
    frames: tuple[Frame, ...] = ()
    recordings: Annotated[tuple[SourceRecording, ...], Field(min_length=1)]
    plan: PlanReference | None = None
    stand: StandReference | None = None
    environment: Environment = Environment()
    valid_temperature: TemperatureSpan | None = None
    assumptions: tuple[str, ...] = ()
    not_used: tuple[LeftOut, ...] = ()
    code: CodeVersion
    measured_at: Instant | None = None
    created_at: Instant

    @model_validator(mode="after")
    def _is_consistent(self) -> "CalibrationRecord":
        names = [quantity.name for quantity in self.quantities]
        refuse_repeated(names, "quantities")
        refuse_repeated((table.name for table in self.tables), "tables")
        refuse_repeated((frame.name for frame in self.frames), "frames")
        refuse_repeated((name for block in self.covariance for name in block.parameters), "covariances")
        by_name = {quantity.name: quantity for quantity in self.quantities}
        for block in self.covariance:
            for row, name in enumerate(block.parameters):
                if name not in by_name:
                    raise ValueError(f"a covariance is of {name}, which is no quantity of the record")
                uncertainty = by_name[name].standard_uncertainty
                variance = block.matrix[row][row]
                if uncertainty is None or abs(uncertainty**2 - variance) > _VARIANCE_TOLERANCE * variance:
                    raise ValueError(f"the covariance and the standard uncertainty of {name} disagree")
        for budget in self.budgets:
            if budget.result not in by_name:
                raise ValueError(f"a budget is of {budget.result}, which is no quantity of the record")
        return self

    def quantity(self, name: str) -> CalibratedQuantity:
        """A quantity by name.

        Raises:
            CalibrationError: there is none of that name.
        """
        for quantity in self.quantities:
            if quantity.name == name:
                return quantity
        raise CalibrationError(
            f"The calibration record has no quantity '{name}'.",
            where=self.title,
            fault=Fault.DATA,
            remedy="see with 'testloom calibrate show' what it holds.",
        )

    def covariance_of(self, names: Sequence[str]) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Covariance of some quantities, shape (n, n), in their units; NaN: only an interval is known."""
        by_name = {quantity.name: quantity.standard_uncertainty for quantity in self.quantities}
        deviations = [by_name[name] for name in names]
        matrix = np.diag([np.nan if u is None else u**2 for u in deviations])
        for block in self.covariance:
            inside = [
                (k, block.parameters.index(name)) for k, name in enumerate(names) if name in block.parameters
            ]
            for row, from_row in inside:
                for column, from_column in inside:
                    matrix[row, column] = block.matrix[from_row][from_column]
        return matrix

    @property
    def title(self) -> str:
        """For a person: which record this is."""
        return f"{self.serial} {self.sensor} {self.method} {self.sha256()[:12]}"

    @property
    def time(self) -> datetime:
        """When it was measured; when it was evaluated, where that is not known."""
        return self.measured_at or self.created_at

    @property
    def file_stem(self) -> str:
        """The serial number, as files' names can have it."""
        return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in self.serial)

    @property
    def file_name(self) -> str:
        """Of its file, by its identity."""
        return f"{self.file_stem}-{self.sensor}-{self.method}-{self.sha256()[:12]}.json"

    def canonical_json(self) -> str:
        """The one form that this content has."""
        content: dict[str, Any] = {"format": FORMAT, **self.model_dump(mode="json", exclude_defaults=True)}
        return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)

    def sha256(self) -> str:
        """Identity: of the canonical JSON, in hex."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()


def parse_record(text: str, where: str) -> CalibrationRecord:
    """The record that a JSON text holds.

    Args:
        text: JSON, canonical or laid out otherwise.
        where: the file, for errors.

    Raises:
        CalibrationError: no JSON, another format, or something in it is wrong (named).
    """
    if len(text.encode(errors="replace")) > MAX_RECORD_BYTES:
        raise refused(f"It is larger than {MAX_RECORD_BYTES} bytes.", where)
    try:
        loaded: object = json.loads(text, object_pairs_hook=_without_duplicates, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise refused(f"This is not the JSON of a calibration record: {error}.", where) from None
    found = loaded.get("format") if isinstance(loaded, dict) else None  # pyright: ignore[reportUnknownVariableType,reportUnknownMemberType]
    if found != FORMAT:
        raise refused(f"The format is {found!r}, not '{FORMAT}'.", where)
    try:
        return CalibrationRecord.model_validate_json(text)
    except ValidationError as error:
        raise refused(f"The calibration record is wrong {first_problem(error)}.", where) from None


def refused(what: str, where: str) -> CalibrationError:
    """The error of a file that is no sound record."""
    return CalibrationError(
        what,
        where=where,
        fault=Fault.DATA,
        remedy="restore the file, or make the record anew with 'testloom calibrate FOLDER --record DIR'.",
    )


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    refuse_repeated((key for key, _ in pairs), "keys")
    return dict(pairs)


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")

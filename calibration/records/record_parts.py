# pyright: strict
"""What a calibration record is put together from: quantities, covariances, tables, origins.

Frozen and strict: what is not finite, not known or does not fit together is refused when it is made.
"""

import math
from collections.abc import Iterable
from datetime import UTC, date
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, AwareDatetime, Field, model_validator

from calibration.records.derived_units import derived_unit
from protocol.errors import TestloomError
from protocol.frozen_model import FrozenModel

MAX_QUANTITIES = 1000
MAX_TABLE_ROWS = 10_000
_SYMMETRY_TOLERANCE = 1e-9
_EIGENVALUE_TOLERANCE = 1e-8


def _known(unit: str) -> str:
    try:
        derived_unit(unit)
    except TestloomError as error:
        raise ValueError(error.what.removesuffix(".")) from None
    return unit


Number = Annotated[float, AfterValidator(lambda value: value + 0.0)]
"""Finite; -0.0 becomes 0.0, so that equal contents are equal bytes."""
NotNegative = Annotated[Number, Field(ge=0)]
Word = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,79}$")]
UnitOfMeasure = Annotated[str, AfterValidator(_known)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Instant = Annotated[AwareDatetime, AfterValidator(lambda time: time.astimezone(UTC))]


def refuse_repeated(names: Iterable[str], what: str) -> None:
    """Raise ValueError if a name is there twice: validators turn it into a sentence."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f"two {what} are named {name}")
        seen.add(name)


class Interval(FrozenModel):
    """Where a value lies with `probability`; 1: for certain."""

    lower: Number
    upper: Number
    probability: Annotated[Number, Field(gt=0, le=1)]

    @model_validator(mode="after")
    def _in_order(self) -> "Interval":
        if self.lower > self.upper:
            raise ValueError("the lower limit is above the upper one")
        return self


class CalibratedQuantity(FrozenModel):
    """One value and how well it is known.

    Attributes:
        name: the field's term, with axes last: scale_factor_x, cross_axis_sensitivity_xy, bias_z.
        symbol: as the method's equations have it: m_xx, K_2x.
        unit: of value, uncertainty and interval.
        standard_uncertainty: standard deviation of what is known of the value; that of the t
            distribution where few readings carry it (JCGM 101:2008, 6.4.9.2). 0: exact by definition.
            None: only the interval is known.
        degrees_of_freedom: of the standard uncertainty; None: not limited, or not known.
        coverage_factor: expanded over standard uncertainty, at the record's coverage probability.
        interval: where limits and not a deviation were measured (pure lag, an Allan term that is absent).
    """

    name: Word
    symbol: Annotated[str, Field(max_length=40)] = ""
    value: Number
    unit: UnitOfMeasure
    standard_uncertainty: NotNegative | None = None
    degrees_of_freedom: Annotated[Number, Field(gt=0)] | None = None
    coverage_factor: Annotated[Number, Field(gt=0)] = 2.0
    interval: Interval | None = None

    @model_validator(mode="after")
    def _is_known_somehow(self) -> "CalibratedQuantity":
        if self.standard_uncertainty is None and self.interval is None:
            raise ValueError(f"{self.name} has neither a standard uncertainty nor an interval")
        return self

    @property
    def expanded_uncertainty(self) -> float | None:
        """U = k u, in `unit`."""
        return None if self.standard_uncertainty is None else self.coverage_factor * self.standard_uncertainty


class CovarianceBlock(FrozenModel):
    """Covariance of some quantities, rows and columns in the order of `parameters`, in their units."""

    parameters: Annotated[tuple[Word, ...], Field(min_length=1, max_length=MAX_QUANTITIES)]
    matrix: tuple[tuple[Number, ...], ...]

    @model_validator(mode="after")
    def _is_a_covariance(self) -> "CovarianceBlock":
        count = len(self.parameters)
        if len(set(self.parameters)) < count:
            raise ValueError("a covariance names a parameter twice")
        if len(self.matrix) != count or any(len(row) != count for row in self.matrix):
            raise ValueError(f"a covariance of {count} parameters is not {count} by {count}")
        matrix = np.array(self.matrix, dtype=np.float64)
        variance = np.diag(matrix)
        if variance.min() < 0:
            raise ValueError("a covariance has a negative variance")
        scale = np.sqrt(np.outer(variance, variance))
        if (np.abs(matrix - matrix.T) > _SYMMETRY_TOLERANCE * scale).any():
            raise ValueError("a covariance is not symmetric")
        if (matrix[scale == 0] != 0).any():
            raise ValueError("a covariance ties something to a quantity that is exact")
        correlation = np.divide(matrix, scale, out=np.eye(count), where=scale > 0)
        if float(np.linalg.eigvalsh(correlation).min()) < -_EIGENVALUE_TOLERANCE * count:
            raise ValueError("a covariance is not that of real quantities: it has a negative eigenvalue")
        return self


class TableColumn(FrozenModel):
    """Numbers of one unit, one for each row of the table."""

    name: Word
    unit: UnitOfMeasure
    values: Annotated[tuple[Number, ...], Field(max_length=MAX_TABLE_ROWS)]


class RecordTable(FrozenModel):
    """Nodes over temperature, readings of a line fit, residuals, an Allan plot."""

    name: Word
    row_names: Annotated[tuple[str, ...], Field(max_length=MAX_TABLE_ROWS)] = ()
    columns: Annotated[tuple[TableColumn, ...], Field(min_length=1, max_length=100)]
    note: str = ""

    @model_validator(mode="after")
    def _is_rectangular(self) -> "RecordTable":
        lengths = {len(column.values) for column in self.columns} | (
            {len(self.row_names)} if self.row_names else set[int]()
        )
        if len(lengths) > 1:
            raise ValueError(f"the columns of the table {self.name} differ in length")
        refuse_repeated((column.name for column in self.columns), f"columns of the table {self.name}")
        return self


class RecordedBudgetRow(FrozenModel):
    """One contribution (GUM): see `calibration.algorithms.uncertainty_budget`."""

    quantity: Annotated[str, Field(min_length=1)]
    estimate: Number
    unit: UnitOfMeasure
    standard_uncertainty: NotNegative
    distribution: Literal["normal", "t", "uniform"]
    sensitivity: Number
    degrees_of_freedom: Annotated[Number, Field(gt=0)] | None = None

    @property
    def contribution(self) -> float:
        """c_i u_i with its sign, in the unit of the result."""
        return self.sensitivity * self.standard_uncertainty


class RecordedBudget(FrozenModel):
    """What contributes how much to the uncertainty of one quantity, named by `result`."""

    result: Word
    rows: Annotated[tuple[RecordedBudgetRow, ...], Field(min_length=1, max_length=100)]
    note: str = ""

    @property
    def standard_uncertainty(self) -> float:
        """Root of the sum of squares, in the unit of the result."""
        return math.sqrt(math.fsum(row.contribution**2 for row in self.rows))


class Frame(FrozenModel):
    """A frame of reference and how it is tied to the unit."""

    name: Word
    definition: Annotated[str, Field(min_length=1)]


class Model(FrozenModel):
    """What the quantities are coefficients of. `name`: known to programs; `equation`: for people."""

    name: Word
    equation: str = ""


class SourceRecording(FrozenModel):
    """A recording that the coefficients rest on.

    `sha256`: of the file's bytes (mcap); for a folder, of the text that `sha256sum` prints for
    recording.json and the files that it names, sorted by name.
    """

    recording_id: Annotated[str, Field(min_length=1)]
    sha256: Sha256
    form: Literal["mcap", "folder"]


class StandReference(FrozenModel):
    """The stand and its own calibration. `calibration_overdue`: at the time of the measurement.

    `emulated`: it was an emulated unit on an emulated stand, so nothing here is a real unit's.
    """

    id: str
    kind: str
    calibration_due: date | None = None
    calibration_overdue: bool = False
    emulated: bool = False


class TemperatureSpan(FrozenModel):
    """Lowest and highest temperature, degC."""

    low_c: Number
    high_c: Number

    @model_validator(mode="after")
    def _in_order(self) -> "TemperatureSpan":
        if self.low_c > self.high_c:
            raise ValueError("the lower temperature is above the higher one")
        return self


class Environment(FrozenModel):
    """Where it was measured. `unit_temperature`: as its own sensors say; `stand_temperature`: around it."""

    unit_temperature: TemperatureSpan | None = None
    stand_temperature: TemperatureSpan | None = None
    latitude_deg: Annotated[Number, Field(ge=-90, le=90)] | None = None
    gravity_m_s2: Annotated[Number, Field(gt=0)] | None = None


class CodeVersion(FrozenModel):
    """The program that evaluated. `commit`: as `git describe` has it, where that is known."""

    package: Annotated[str, Field(min_length=1)]
    commit: str | None = None


class LeftOut(FrozenModel):
    """Something in the data that no coefficient rests on: what, how many samples, why."""

    what: str
    count: Annotated[int, Field(ge=0)]
    why: str

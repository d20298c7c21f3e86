# pyright: strict
"""What makers of record contents share: a quantity, a table."""

import math
from collections.abc import Sequence

from calibration.algorithms.coefficients import FloatArray
from calibration.records.making import coverage_factor
from calibration.records.record_parts import CalibratedQuantity, Interval, RecordTable, TableColumn


def quantity(
    name: str,
    symbol: str,
    value: float,
    unit: str,
    uncertainty: float | None,
    freedom: float | None = None,
    interval: Interval | None = None,
) -> CalibratedQuantity:
    """A quantity with the coverage factor of its degrees of freedom (None: not limited)."""
    return CalibratedQuantity(
        name=name,
        symbol=symbol,
        value=value,
        unit=unit,
        standard_uncertainty=uncertainty,
        degrees_of_freedom=freedom,
        coverage_factor=coverage_factor(freedom),
        interval=interval,
    )


def limited(degrees_of_freedom: float) -> float | None:
    """None for endless ones."""
    return None if math.isinf(degrees_of_freedom) else float(degrees_of_freedom)


def record_table(
    name: str,
    *columns: tuple[str, str, FloatArray | Sequence[float]],
    rows: Sequence[str] = (),
    note: str = "",
) -> RecordTable:
    """A table of (name, unit, values) columns."""
    return RecordTable(
        name=name,
        row_names=tuple(rows),
        columns=tuple(
            TableColumn(name=column, unit=unit, values=tuple(float(value) for value in values))
            for column, unit, values in columns
        ),
        note=note,
    )

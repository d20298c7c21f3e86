# pyright: strict
"""Which drawings a record gets: from the shape of its tables and covariances."""

from collections.abc import Iterator

import numpy as np

from calibration.certificate.charts import Curve, curves_chart
from calibration.certificate.document import Correlations, Say
from calibration.certificate.sections import axis_label, shown_column
from calibration.certificate.wording import UNCERTAINTY_OF, capital, quantity_words, symbol_cell, unit_words
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CovarianceBlock, RecordTable

MOST_CORRELATED = 15
"""Parameters whose correlations a page can show."""
LEAST_CORRELATION = 0.005
"""What two digits show."""
MOST_CURVES = 8
MOST_FIGURES = 8


def table_figures(table: RecordTable, say: Say) -> Iterator[str]:
    """A chart for each unit of measure in a table.

    Uncertainties are printed and not drawn. The first column is the abscissa; where rows have names,
    their number is, and points are not joined.
    """
    columns = [one for one in table.columns if not one.name.startswith(UNCERTAINTY_OF)]
    rows = len(columns[0].values)
    if rows < 2:
        return
    if table.row_names:
        x_label, x = say("Number of the row"), tuple(float(k + 1) for k in range(rows))
    else:
        first = columns.pop(0)
        unit, x = shown_column(first)
        x_label = axis_label(first.name, unit, say)
    groups: dict[tuple[str, bool], list[Curve]] = {}
    for one in columns:
        unit, values = shown_column(one)
        label = quantity_words(one.name, say)
        groups.setdefault((unit, "residual" in one.name), []).append(Curve(label, x, values))
    for (unit, _), curves in list(groups.items())[:MOST_FIGURES]:
        for start in range(0, len(curves), MOST_CURVES):
            part = curves[start : start + MOST_CURVES]
            words = part[0].label if len(part) == 1 else ""
            y_unit = "" if unit == "1" else unit_words(unit)
            yield curves_chart(part, x_label, capital(words), y_unit, by_row=bool(table.row_names))


def correlations(block: CovarianceBlock, record: CalibrationRecord, caption: str) -> Correlations | None:
    """The lower triangle; None where it says nothing or does not fit."""
    count = len(block.parameters)
    if not 2 <= count <= MOST_CORRELATED:
        return None
    matrix = np.array(block.matrix, dtype=np.float64)
    deviation = np.sqrt(np.diag(matrix))
    scale = np.outer(deviation, deviation)
    correlation = np.divide(matrix, scale, out=np.eye(count), where=scale > 0)
    if np.abs(correlation - np.eye(count)).max() < LEAST_CORRELATION:
        return None
    symbols = tuple(
        symbol_cell(record.quantity(name).symbol or str(k))
        for k, name in enumerate(block.parameters, start=1)
    )
    rows = tuple(
        tuple(f"{round(float(value), 2) + 0.0:.2f}" for value in row[: k + 1])
        for k, row in enumerate(correlation)
    )
    return Correlations(symbols, rows, caption)

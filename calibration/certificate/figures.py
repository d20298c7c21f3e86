# pyright: strict
"""Which drawings a record gets: from the shape of its tables and covariances."""

from collections.abc import Iterator
from itertools import takewhile

import numpy as np

from calibration.certificate.charts import Curve, curves_chart
from calibration.certificate.document import Correlations, Say
from calibration.certificate.result_tables import axis_label, shown_values, table_units, uncertainty_column
from calibration.certificate.wording import UNCERTAINTY_OF, capital, quantity_words, symbol_cell, unit_words
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CovarianceBlock, RecordTable, TableColumn

MOST_CORRELATED = 15
"""Parameters whose correlations a page can show."""
LEAST_CORRELATION = 0.005
"""What two digits show."""
MOST_CURVES = 8
MOST_FIGURES = 8
COUNTERS = ("phase_number", "independent_samples", "degrees_of_freedom")
"""Columns that no curve tells more of than the numbers do."""
SPECTRAL = "deviation"
"""In the name of an Allan or wavelet plot: its ordinate is read in decades too."""
TIME = "time"
"""An abscissa over which people look for a settled value, not for decades."""
LOGARITHMIC = ("frequency", "averaging_time", "scale", "tau")
"""Abscissas that people read in decades."""
LINE, RESIDUAL = "mean_output", "residual"
"""Columns of a line's readings: their difference is the line."""


def table_figures(table: RecordTable, say: Say) -> Iterator[tuple[str, str]]:
    """A chart for each unit of measure in a table, with its caption.

    Uncertainties are bars, two standard ones to each side. The first column is the abscissa; where rows
    have names, their number is, and points are not joined. Readings of a line are drawn as what they
    deviate from it: drawn as they are, all of them lie on each other.
    """
    columns = [
        one for one in table.columns if not one.name.startswith(UNCERTAINTY_OF) and one.name not in COUNTERS
    ]
    rows = len(table.columns[0].values)
    if rows < 2:
        return
    name, units = capital(quantity_words(table.name, say)), table_units(table)
    title = name
    if table.row_names:
        x_label, x = say("Number of the row"), tuple(float(k + 1) for k in range(rows))
        title = say("{table}; rows as in the original record", table=title)
    else:
        first = columns.pop(0)
        x = shown_values(first, units[first.name])
        x_label = axis_label(first.name, units[first.name], say)
    if {LINE, RESIDUAL} <= {one.name for one in columns}:
        columns = _deviations(columns)
        title = say("{table}: deviation from the line", table=title)
    decades = "" if table.row_names or table.columns[0].name not in LOGARITHMIC else "x"
    decades += "y" if decades and SPECTRAL in table.name else ""
    over_time = not table.row_names and table.columns[0].name == TIME
    groups: dict[tuple[str, bool], list[Curve]] = {}
    for one in columns:
        curve = _curve(one, table, units, x, say)
        groups.setdefault((units[one.name], RESIDUAL in one.name), []).append(curve)
    for (unit, _), curves in list(groups.items())[:MOST_FIGURES]:
        y_unit = "" if unit == "1" else unit_words(unit)
        bars = any(curve.bars for curve in curves)
        caption = say("{table}; bars: ± 2 u", table=title) if bars else title
        for start in range(0, len(curves), MOST_CURVES):
            part = curves[start : start + MOST_CURVES]
            words = part[0].label if len(part) == 1 else _common_words(part) or name
            drawn = curves_chart(
                part,
                x_label,
                capital(words),
                y_unit,
                by_row=bool(table.row_names),
                decades=decades,
                linear=over_time,
            )
            yield drawn, caption


def _curve(
    one: TableColumn, table: RecordTable, units: dict[str, str], x: tuple[float, ...], say: Say
) -> Curve:
    doubt = uncertainty_column(table, one.name)
    fits = doubt is not None and doubt.unit == one.unit
    bars = tuple(2.0 * u for u in shown_values(doubt, units[one.name])) if doubt and fits else ()
    return Curve(quantity_words(one.name, say), x, shown_values(one, units[one.name]), bars)


def _deviations(columns: list[TableColumn]) -> list[TableColumn]:
    """Each stroke less the line, which is the mean less the residual; in the strokes' unit."""
    by_name = {one.name: one for one in columns}
    line = np.subtract(by_name[LINE].values, by_name[RESIDUAL].values)
    return [
        one.model_copy(update={"values": tuple(map(float, np.subtract(one.values, line)))})
        for one in columns
        if one.name != RESIDUAL and one.unit == by_name[LINE].unit
    ]


def _common_words(curves: list[Curve]) -> str:
    """Words that all labels begin with: 'residual' of 'residual x', 'residual y'."""
    labels = [curve.label.split() for curve in curves]
    alike = takewhile(lambda words: len(set(words)) == 1, zip(*labels, strict=False))
    return " ".join(words[0] for words in alike).removesuffix(" of")


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

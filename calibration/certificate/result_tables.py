# pyright: strict
"""Results and tables of a record as grids: units of the field, digits as far as they are known."""

import math

from calibration.certificate.conformity import span
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import Grid, Say
from calibration.certificate.rounding import (
    column,
    interval,
    plain,
    power_of_ten,
    significant_digits,
    with_uncertainty,
)
from calibration.certificate.units_on_paper import Size, common_size, shown_unit
from calibration.certificate.wording import (
    UNCERTAINTY_OF,
    capital,
    quantity_words,
    stem_of,
    symbol_cell,
    unit_words,
)
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CalibratedQuantity, RecordTable, TableColumn
from protocol.language import translated

RESULT_DIGITS = 5
READING_DIGITS = 7
MOST_COLUMNS = 9
"""Wider tables are printed in parts, each with the first column."""


def results_grid(record: CalibrationRecord, details: CertificateDetails, say: Say) -> Grid:
    """Every quantity of the record: value, expanded uncertainty or interval, k, degrees of freedom.

    Raises:
        TestloomError: a tolerance is in a unit that does not measure the same.
    """
    headings = (
        say("Quantity"),
        say("Symbol"),
        say("Value"),
        say("Expanded uncertainty U"),
        say("Interval"),
        say("Unit of measure"),
        "$k",
        say("Degrees of freedom"),
    )
    units = printed_units(record, details)
    known = [quantity.interval.probability for quantity in record.quantities if quantity.interval]
    common = known[0] if known and len(set(known)) == 1 else None
    if common is not None:
        headings = (*headings[:4], f"{headings[4]}, p = {_percent(common)}", *headings[5:])
    rows = tuple(
        _result(quantity, units[quantity.name], common is None, say) for quantity in record.quantities
    )
    return without_empty_columns(Grid("", headings, rows, "lcrrrlrr", coverage_note(record, say)))


def printed_units(record: CalibrationRecord, details: CertificateDetails) -> dict[str, str]:
    """By quantity: the unit of its tolerance, which is the customer's; else the field's usual one.

    Axes of one quantity share a unit.
    """
    kinds: dict[tuple[str, str], list[CalibratedQuantity]] = {}
    for quantity in record.quantities:
        kinds.setdefault((stem_of(quantity.name), quantity.unit), []).append(quantity)
    units: dict[str, str] = {}
    for (stem, unit), alike in kinds.items():
        size = Size(
            max(abs(edge) for quantity in alike for edge in span(quantity)),
            max(quantity.expanded_uncertainty or 0.0 for quantity in alike),
        )
        units |= {quantity.name: shown_unit(unit, size, stem) for quantity in alike}
    return units | {name: tolerance.unit for name, tolerance in details.tolerances.items() if name in units}


def coverage_note(record: CalibrationRecord, say: Say) -> str:
    """What U and the intervals mean."""
    words = [
        say(
            "U is the standard uncertainty times the coverage factor k of its row. With the degrees of "
            "freedom stated (t distribution; ∞: normal), it covers about {probability} %. Evaluated after "
            "JCGM 100:2008 (GUM).",
            probability=plain(100.0 * record.coverage_probability, 4),
        )
    ]
    if any(quantity.interval is not None for quantity in record.quantities):
        words.append(say("An interval holds with the probability p."))
    if any(quantity.standard_uncertainty == 0.0 for quantity in record.quantities):
        words.append(say("Exact: by definition of the frame of reference."))
    return " ".join(words)


def _percent(probability: float) -> str:
    return f"{plain(100.0 * probability, 4)} %"


def _result(quantity: CalibratedQuantity, unit: str, says_p: bool, say: Say) -> tuple[str, ...]:
    factor = derived_conversion_factor(quantity.unit, unit)
    value, expanded, bounds, k, freedom = quantity.value * factor, "", "", "", ""
    text = ""
    if quantity.interval is not None:
        known = quantity.interval
        lower, upper, text = interval(known.lower * factor, known.upper * factor, value)
        bounds = f"[{lower}, {upper}]" + (f", p = {_percent(known.probability)}" if says_p else "")
    if quantity.standard_uncertainty == 0.0:
        text, expanded = plain(value, READING_DIGITS), say("exact")
    elif quantity.expanded_uncertainty is not None:
        text, expanded = with_uncertainty(value, quantity.expanded_uncertainty * factor)
        k = f"{quantity.coverage_factor:.2f}"
        freedom = "∞" if quantity.degrees_of_freedom is None else plain(quantity.degrees_of_freedom, 3)
    name = capital(quantity_words(quantity.name, say))
    return (name, symbol_cell(quantity.symbol), text, expanded, bounds, unit_words(unit), k, freedom)


def table_grids(table: RecordTable, digits: int, say: Say, language: str) -> tuple[Grid, ...]:
    """A table of the record, in parts that fit the page."""
    places, units = _places(table), table_units(table)
    cells = [_printed(one, units[one.name], digits, places.get(one.name), say) for one in table.columns]
    title = capital(quantity_words(table.name, say))
    note = translated(table.note, language)
    if table.row_names:
        first, align = (say("Row"), tuple(translated(name, language) for name in table.row_names)), "l"
    else:
        first, align = cells.pop(0), "r"
    most = math.ceil(len(cells) / max(1, math.ceil(len(cells) / (MOST_COLUMNS - 1)))) or 1
    parts = [cells[start : start + most] for start in range(0, len(cells), most)] or [[]]
    return tuple(
        Grid(
            title if len(parts) == 1 else f"{title} ({number}/{len(parts)})",
            (first[0], *(heading for heading, _ in part)),
            tuple(zip(first[1], *(values for _, values in part), strict=True)),
            align + "r" * len(part),
            note if number == len(parts) else "",
        )
        for number, part in enumerate(parts, start=1)
    )


def table_units(table: RecordTable) -> dict[str, str]:
    """By column: the unit that it is printed in. Columns that measure the same share it, but for times."""
    kinds: dict[tuple[str, str], list[TableColumn]] = {}
    for one in table.columns:
        name = one.name.removeprefix(UNCERTAINTY_OF)
        kinds.setdefault((one.unit, stem_of(name) if one.unit in ("s", "1") else ""), []).append(one)
    units: dict[str, str] = {}
    for (unit, stem), alike in kinds.items():
        size = common_size([value for one in alike for value in one.values])
        units |= {one.name: shown_unit(unit, size, stem) for one in alike}
    return units


def shown_values(one: TableColumn, unit: str) -> tuple[float, ...]:
    """A column's numbers in the unit that they are printed in."""
    factor = derived_conversion_factor(one.unit, unit)
    if factor == 1.0:
        return one.values
    return tuple(float(f"{value * factor:.12g}") for value in one.values)


def uncertainty_column(table: RecordTable, name: str) -> TableColumn | None:
    """Standard uncertainties of a column: `u_gain_x` or `u_gain` of `gain_x`."""
    wanted = (f"{UNCERTAINTY_OF}{name}", f"{UNCERTAINTY_OF}{stem_of(name)}")
    return next((one for one in table.columns if one.name in wanted), None)


def _places(table: RecordTable) -> dict[str, float]:
    """By column: the uncertainty whose second digit ends its numbers, in the column's own unit.

    The median one, and smaller where the smallest would vanish; so value and uncertainty end alike.
    """
    places: dict[str, float] = {}
    for one in table.columns:
        doubt = uncertainty_column(table, one.name)
        known = sorted(value for value in doubt.values if value > 0) if doubt else []
        if doubt is not None and known and doubt.unit == one.unit:
            middle = known[len(known) // 2]
            places[one.name] = places[doubt.name] = max(middle / 10.0, min(middle, known[0]))
    return places


def axis_label(name: str, unit: str, say: Say) -> str:
    """'rate, °/s'."""
    words = capital(quantity_words(name, say))
    return words if unit == "1" else f"{words}, {unit_words(unit)}"


def _printed(
    one: TableColumn, unit: str, digits: int, doubt: float | None, say: Say
) -> tuple[str, tuple[str, ...]]:
    values = shown_values(one, unit)
    if doubt is not None:
        digits = significant_digits(values, doubt * derived_conversion_factor(one.unit, unit), digits)
    texts, exponent = column(values, digits)
    label = axis_label(one.name, unit, say)
    if exponent:
        scale = power_of_ten(exponent) if unit == "1" else f"{power_of_ten(exponent)} {unit_words(unit)}"
        label = f"{capital(quantity_words(one.name, say))}, {scale}"
    return label, texts


def without_empty_columns(grid: Grid) -> Grid:
    """The table without columns that hold nothing."""
    kept = [k for k in range(len(grid.headings)) if any(row[k] for row in grid.rows)]

    def choose(cells: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(cells[k] for k in kept)

    rows = tuple(choose(row) for row in grid.rows)
    return Grid(grid.title, choose(grid.headings), rows, "".join(grid.align[k] for k in kept), grid.note)

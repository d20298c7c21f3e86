# pyright: strict
"""Sections that a certificate and an original record share: what, for whom, where, with what, from what."""

import math
from collections.abc import Iterator
from datetime import datetime

from calibration.certificate.conformity import span
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import Block, Facts, Grid, Paragraph, Say, Section, facts
from calibration.certificate.methods import method_words
from calibration.certificate.rounding import column, interval, plain, power_of_ten, with_uncertainty
from calibration.certificate.wording import capital, quantity_words, shown_unit, symbol_cell, unit_words
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import CalibratedQuantity, RecordTable, TableColumn, TemperatureSpan
from protocol.language import translated

MOST_COLUMNS = 9
"""Wider tables are printed in parts, each with the first column."""
SENSORS = {"acc": "Accelerometer", "gyro": "Gyro", "mag": "Magnetometer"}


def day(time: datetime) -> str:
    """Date and time, UTC."""
    return f"{time:%Y-%m-%d %H:%M} UTC"


def item_section(record: CalibrationRecord, details: CertificateDetails, say: Say) -> Section:
    """The unit, its owner and the dates."""
    customer = details.customer
    rows = [
        (say("Customer"), customer.name or say("not stated")),
        (say("Address"), customer.address),
        (say("Order"), customer.reference),
        (say("Product"), record.product),
        (say("Type"), details.unit_type),
        (say("Manufacturer"), details.manufacturer),
        (say("Serial number"), record.serial),
        (say("Sensor"), sensor_words(record.sensor, say)),
        (say("Measured"), day(record.measured_at) if record.measured_at else say("not stated")),
        (say("Evaluated"), day(record.created_at)),
        (say("Issued"), details.issued.isoformat() if details.issued else ""),
    ]
    return Section(say("Item calibrated"), (facts(rows),))


def sensor_words(sensor: str, say: Say) -> str:
    """The sensor's name for people."""
    kind, _, axis = sensor.partition("_")
    if kind not in SENSORS:
        return capital(quantity_words(sensor, say))
    return f"{say(SENSORS[kind])} {axis}".strip()


def method_section(record: CalibrationRecord, say: Say, language: str) -> Section:
    """Method, its source and what is corrected in it, model, frames, where the result holds."""
    words = method_words(record.method, record.model.name, say)
    rows = [
        (say("Method"), capital(words.title)),
        (say("Source"), words.source),
        *(("" if k else say("Corrected form"), capital(one)) for k, one in enumerate(words.corrections)),
        (say("Model"), record.model.equation or quantity_words(record.model.name, say)),
        *(
            (
                say("Frame of reference, {name}", name=quantity_words(frame.name, say)),
                translated(frame.definition, language),
            )
            for frame in record.frames
        ),
        (say("Valid at"), _temperatures(record.valid_temperature)),
    ]
    if record.plan is not None:
        plan = record.plan
        rows.append(
            (say("Test plan"), f"{plan.name} {plan.version}, {plan.operation}, SHA-256 {plan.sha256}")
        )
    return Section(say("Method"), (facts(rows),))


def traceability_section(record: CalibrationRecord, details: CertificateDetails, say: Say) -> Section:
    """Stand and instruments with their due dates, recordings and software."""
    return Section(say("Standards and traceability"), tuple(_traceability(record, details, say)))


def _traceability(record: CalibrationRecord, details: CertificateDetails, say: Say) -> Iterator[Block]:
    standards: list[tuple[str, ...]] = []
    if record.stand is not None:
        stand = record.stand
        due = stand.calibration_due.isoformat() if stand.calibration_due else say("not stated")
        kind = capital(quantity_words(stand.kind, say))
        standards.append((kind, stand.id, "", "", due))
    standards += [
        (
            one.name,
            one.id,
            one.accuracy,
            one.certificate,
            one.calibration_due.isoformat() if one.calibration_due else say("not stated"),
        )
        for one in details.standards
    ]
    if standards:
        headings = (
            say("Standard"),
            say("Number"),
            say("Accuracy"),
            say("Certificate"),
            say("Calibration due"),
        )
        yield _without_empty_columns(Grid("", headings, tuple(standards), "lllll"))
    else:
        yield Paragraph(say("The recordings name no stand: the result is traceable to what they state only."))
    if record.stand is not None and record.stand.emulated:
        yield Paragraph(
            say("Unit and stand were emulated by software: this certifies nothing about a real unit."),
            "warning",
        )
    if record.stand is not None and record.stand.calibration_overdue:
        yield Paragraph(
            say("The calibration of the stand was overdue at the time of the measurement."), "warning"
        )
    day_of_use = record.time.date()
    late = [one.name for one in details.standards if one.calibration_due and one.calibration_due < day_of_use]
    if late:
        names = ", ".join(late)
        yield Paragraph(say("Overdue at the time of the measurement: {names}.", names=names), "warning")
    recordings = tuple((one.recording_id, one.form, one.sha256) for one in record.recordings)
    yield Grid("", (say("Recording"), say("Form"), say("SHA-256 of the recording")), recordings, "lll")
    commit = f", {record.code.commit}" if record.code.commit else ""
    yield Facts(((say("Software"), record.code.package + commit),))


def _without_empty_columns(grid: Grid) -> Grid:
    kept = [k for k in range(len(grid.headings)) if any(row[k] for row in grid.rows)]

    def choose(cells: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(cells[k] for k in kept)

    rows = tuple(choose(row) for row in grid.rows)
    return Grid(grid.title, choose(grid.headings), rows, "".join(grid.align[k] for k in kept), grid.note)


def environment_section(record: CalibrationRecord, details: CertificateDetails, say: Say) -> Section:
    """Temperatures, place, gravity."""
    where = record.environment
    gravity, latitude = where.gravity_m_s2, where.latitude_deg
    block = facts(
        [
            (say("Temperature of the unit"), _temperatures(where.unit_temperature)),
            (say("Temperature around it"), _temperatures(where.stand_temperature)),
            (say("Relative humidity"), details.relative_humidity),
            (say("Latitude"), "" if latitude is None else f"{plain(latitude, 7)}°"),
            (say("Gravity"), "" if gravity is None else f"{plain(gravity, 8)} m/s²"),
        ]
    )
    block = block if block.rows else Facts(((say("Environment"), say("not stated")),))
    return Section(say("Environment"), (block,))


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
    rows = tuple(_result(quantity, printed_unit(quantity, details), say) for quantity in record.quantities)
    return _without_empty_columns(Grid("", headings, rows, "lcrrrlrr"))


def printed_unit(quantity: CalibratedQuantity, details: CertificateDetails) -> str:
    """That of its tolerance, which is the customer's; else the field's usual one."""
    tolerance = details.tolerances.get(quantity.name)
    return tolerance.unit if tolerance else shown_unit(quantity.unit, max(map(abs, span(quantity))))


def _result(quantity: CalibratedQuantity, unit: str, say: Say) -> tuple[str, ...]:
    factor = derived_conversion_factor(quantity.unit, unit)
    value, expanded, bounds, k, freedom = quantity.value * factor, "", "", "", ""
    text = ""
    if quantity.interval is not None:
        known = quantity.interval
        lower, upper, text = interval(known.lower * factor, known.upper * factor, value)
        bounds = f"[{lower}, {upper}], p = {plain(100.0 * known.probability, 4)} %"
    if quantity.expanded_uncertainty is not None:
        text, expanded = with_uncertainty(value, quantity.expanded_uncertainty * factor)
        k = f"{quantity.coverage_factor:.2f}"
        freedom = "∞" if quantity.degrees_of_freedom is None else plain(quantity.degrees_of_freedom, 3)
    name = capital(quantity_words(quantity.name, say))
    return (name, symbol_cell(quantity.symbol), text, expanded, bounds, unit_words(unit), k, freedom)


def table_grids(table: RecordTable, digits: int, say: Say, language: str) -> tuple[Grid, ...]:
    """A table of the record, in parts that fit the page."""
    cells = [_printed(one, digits, say) for one in table.columns]
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


def shown_column(one: TableColumn) -> tuple[str, tuple[float, ...]]:
    """The unit that a column is printed in, and its numbers in it."""
    unit = shown_unit(one.unit, max((abs(value) for value in one.values), default=0.0))
    factor = derived_conversion_factor(one.unit, unit)
    if factor == 1.0:
        return unit, one.values
    return unit, tuple(float(f"{value * factor:.12g}") for value in one.values)


def axis_label(name: str, unit: str, say: Say) -> str:
    """'rate, °/s'."""
    words = capital(quantity_words(name, say))
    return words if unit == "1" else f"{words}, {unit_words(unit)}"


def _printed(one: TableColumn, digits: int, say: Say) -> tuple[str, tuple[str, ...]]:
    unit, values = shown_column(one)
    texts, exponent = column(values, digits)
    label = axis_label(one.name, unit, say)
    if exponent:
        scale = power_of_ten(exponent) if unit == "1" else f"{power_of_ten(exponent)} {unit_words(unit)}"
        label = f"{capital(quantity_words(one.name, say))}, {scale}"
    return label, texts


def left_out_blocks(record: CalibrationRecord, say: Say, language: str) -> tuple[Block, ...]:
    """What no coefficient rests on, and why."""
    if not record.not_used:
        return (Paragraph(say("Everything in the data was used.")),)
    rows = tuple(
        (translated(one.what, language), str(one.count), translated(one.why, language))
        for one in record.not_used
    )
    return (Grid("", (say("What"), say("Samples"), say("Why")), rows, "lrl"),)


def _temperatures(span: TemperatureSpan | None) -> str:
    if span is None:
        return ""
    low, high = (f"{one:.1f}".replace("-", "−") for one in (span.low_c + 0.0, span.high_c + 0.0))
    return f"{low} °C" if low == high else f"{low} °C … {high} °C"

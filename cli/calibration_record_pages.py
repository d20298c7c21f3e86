"""What people see of calibration records: values with uncertainties, provenance, comparison, history."""

from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from calibration.records.comparing import RecordComparison
from calibration.records.derived_units import written_unit
from calibration.records.history import QuantityHistory
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import RecordedBudget, StandReference, TemperatureSpan
from cli.uncertain_numbers import gum, plain, two_digits
from protocol.language import say, translated

UNKNOWN = "–"


def show_record(console: Console, record: CalibrationRecord) -> None:
    """Values, budgets and provenance of one record."""
    console.rule(Text(record.title))
    console.print(
        say("Unit {serial} ({product})", serial=record.serial, product=record.product), style="bold"
    )
    console.print(
        say("Sensor {sensor}, method {method}", sensor=record.sensor, method=record.method)
        + (f": {record.model.equation}" if record.model.equation else "")
    )
    console.print(_values(record))
    for budget in record.budgets:
        console.print(_budget(record, budget))
    for table in record.tables:
        shown = Table(header_style="bold", title=table.name, caption=table.note or None)
        if table.row_names:
            shown.add_column("")
        for column in table.columns:
            shown.add_column(f"{column.name}, {written_unit(column.unit)}", justify="right")
        for row in range(len(table.columns[0].values)):
            name = [table.row_names[row]] if table.row_names else []
            shown.add_row(*name, *(f"{column.values[row]:.6g}" for column in table.columns))
        console.print(shown)
    for label, words in _provenance(record):
        console.print(f"{label}: {words}", soft_wrap=True)


def _values(record: CalibrationRecord) -> Table:
    probability = f"{100 * record.coverage_probability:.4g}"
    table = Table(
        header_style="bold",
        caption=say("± standard uncertainty; U = k u covers {probability} %", probability=probability),
    )
    for heading in ("Quantity", "Symbol", "Value", "U", "k", "Degrees of freedom", "Unit"):
        table.add_column(say(heading), overflow="fold")
    for one in record.quantities:
        value = plain(one.value, 6)
        if one.standard_uncertainty is not None:
            value = gum(one.value, one.standard_uncertainty)
        if one.interval is not None:
            value += f" [{plain(one.interval.lower, 6)} … {plain(one.interval.upper, 6)}]"
        expanded = one.expanded_uncertainty
        table.add_row(
            one.name,
            one.symbol,
            value,
            UNKNOWN if expanded is None else two_digits(expanded),
            UNKNOWN if expanded is None else f"{one.coverage_factor:.2f}",
            "∞" if one.degrees_of_freedom is None else f"{one.degrees_of_freedom:.4g}",
            written_unit(one.unit),
        )
    return table


def _budget(record: CalibrationRecord, budget: RecordedBudget) -> Table:
    unit = record.quantity(budget.result).unit
    combined = two_digits(budget.standard_uncertainty)
    table = Table(
        header_style="bold",
        title=say("Uncertainty budget of {quantity}", quantity=budget.result),
        caption=say("combined standard uncertainty {value} {unit}", value=combined, unit=unit)
        + (f"; {budget.note}" if budget.note else ""),
    )
    for heading in ("Contribution from", "Estimate", "u", "Unit", "Distribution", "Sensitivity", "c u"):
        table.add_column(say(heading), overflow="fold")
    for row in budget.rows:
        table.add_row(
            row.quantity,
            f"{row.estimate:.6g}",
            two_digits(row.standard_uncertainty),
            written_unit(row.unit),
            say(row.distribution),
            f"{row.sensitivity:.4g}",
            f"{row.contribution:.2e}",
        )
    return table


def _stand_words(stand: StandReference) -> str:
    words = [f"{stand.id} ({stand.kind})"]
    if stand.calibration_due is not None:
        words.append(say("calibration due {date}", date=stand.calibration_due.isoformat()))
    if stand.emulated:
        words.append(say("EMULATED"))
    if stand.calibration_overdue:
        words.append(say("OVERDUE when it was measured"))
    return ", ".join(words)


def _provenance(record: CalibrationRecord) -> Iterator[tuple[str, str]]:
    yield "SHA-256", record.sha256()
    yield say("Measured"), record.measured_at.isoformat() if record.measured_at else say("not known")
    code = " ".join(filter(None, (record.code.package, record.code.commit)))
    yield say("Evaluated"), f"{record.created_at.isoformat()}, {code}"
    for frame in record.frames:
        yield say("Frame {name}", name=frame.name), translated(frame.definition)
    for source in record.recordings:
        yield say("Recording"), f"{source.recording_id} ({source.form}, SHA-256 {source.sha256})"
    if record.plan is not None:
        yield say("Plan"), f"{record.plan.name} {record.plan.version} (SHA-256 {record.plan.sha256})"
    if record.stand is not None:
        yield say("Stand"), _stand_words(record.stand)
    around = record.environment
    for label, span in (
        (say("Temperature of the unit"), around.unit_temperature),
        (say("Temperature at the stand"), around.stand_temperature),
        (say("Valid"), record.valid_temperature),
    ):
        yield label, _span(span)
    if around.latitude_deg is not None:
        yield say("Latitude"), f"{around.latitude_deg:g}°"
    if around.gravity_m_s2 is not None:
        yield say("Gravity"), f"{around.gravity_m_s2:g} m/s^2"
    for sentence in record.assumptions:
        yield say("Assumed"), translated(sentence)
    for one in record.not_used:
        yield say("Not used"), f"{translated(one.what)} ({one.count}): {translated(one.why)}"


def _span(span: TemperatureSpan | None) -> str:
    return say("not known") if span is None else f"{span.low_c:.1f} … {span.high_c:.1f} °C"


def show_comparison(
    console: Console, first: CalibrationRecord, second: CalibrationRecord, found: RecordComparison
) -> None:
    """All common quantities, and which differ."""
    table = Table(
        header_style="bold",
        title=Text(f"{first.title}\n{second.title}"),
        caption=say("p: probability by chance, adjusted for {count} quantities", count=len(found.quantities)),
    )
    for heading in ("Quantity", "First", "Second", "Difference", "zeta", "E_n", "p", "Unit"):
        table.add_column(say(heading), overflow="fold")
    for one in found.quantities:
        table.add_row(
            one.name,
            plain(one.first, 6),
            plain(one.second, 6),
            gum(one.difference, one.standard_uncertainty),
            f"{one.zeta:+.2f}",
            f"{one.normalised_error:+.2f}",
            f"{one.adjusted_probability:.2g}",
            written_unit(one.unit),
            style="bold red" if one.significant else None,
        )
    console.print(table)
    together = {
        "chi": f"{found.chi_square:.1f}",
        "freedom": found.degrees_of_freedom,
        "p": f"{found.probability:.2g}",
    }
    console.print(
        say("all together: chi-squared {chi} with {freedom} degrees of freedom, p = {p}", **together)
    )
    if found.significant:
        console.print(say("differ significantly: {names}", names=", ".join(found.significant)), style="bold")
    else:
        console.print(say("no single quantity differs significantly"), style="bold")
    for sentence in comparison_remarks(found):
        console.print(f"  · {sentence}", soft_wrap=True)


def comparison_remarks(found: RecordComparison) -> list[str]:
    """What a person has to know beside the numbers."""
    remarks: list[str] = []
    if found.other_serial:
        remarks.append(say("the records are of two different units"))
    if found.shared_recordings:
        names = ", ".join(found.shared_recordings)
        remarks.append(say("both rest on {names}: their differences are not independent", names=names))
    if found.not_compared:
        names = ", ".join(found.not_compared)
        remarks.append(say("not compared, in one record only, without u or exact: {names}", names=names))
    return remarks


NAME_WIDTH = 18
"""Least columns of a quantity's name: eight of them one below the other are no name."""


def show_history(console: Console, histories: Sequence[QuantityHistory]) -> None:
    """A table for each sensor of each unit."""
    groups: dict[tuple[str, str, str], list[QuantityHistory]] = {}
    for history in histories:
        groups.setdefault((history.product, history.serial, history.sensor), []).append(history)
    for (product, serial, sensor), quantities in groups.items():
        table = Table(
            header_style="bold",
            title=Text(f"{serial} ({product}), {sensor}"),
            caption=say("drift: weighted least squares; bold: differs from 0 (5 %, each by itself)"),
        )
        table.add_column(say("Quantity, unit"), overflow="fold", min_width=NAME_WIDTH)
        for heading in ("First, last", "Drift per year"):  # never broken: a torn number misleads
            table.add_column(say(heading), no_wrap=True)
        table.add_column(say("Records, Birge ratio"), max_width=8)
        for one in quantities:
            trend, ends = one.trend, (one.points[0], one.points[-1])
            drift = UNKNOWN
            if trend.drift_per_year is not None and trend.drift_standard_uncertainty is not None:
                drift = gum(trend.drift_per_year, trend.drift_standard_uncertainty)
            birge = UNKNOWN if trend.birge_ratio is None else f"{trend.birge_ratio:.2f}"
            table.add_row(
                f"{one.name}\n{written_unit(one.unit)}",
                "\n".join(gum(point.value, point.standard_uncertainty) for point in ends),
                Text(drift, style="bold" if trend.drifts else ""),
                f"{len(one.points)}\n{birge}",
            )
        console.print(table)
        for one in quantities:
            for point in one.points:
                if point.outlier:
                    day, name = point.time.date().isoformat(), point.record_sha256[:8]
                    words = say("outlier: {quantity} of {day}, {name}", quantity=one.name, day=day, name=name)
                    console.print(words, style="red", soft_wrap=True)
        first, last = quantities[0].points[0].time, quantities[0].points[-1].time
        console.print(
            say("from {first} to {last}", first=first.date().isoformat(), last=last.date().isoformat())
        )

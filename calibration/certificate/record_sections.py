# pyright: strict
"""What a certificate says of one record beyond its results: conformity, budget, tables and plots."""

from collections.abc import Iterator

from calibration.certificate.conformity import Judgement
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import Block, Bullets, Grid, Paragraph, Picture, Say, Section
from calibration.certificate.figures import correlations, table_figures
from calibration.certificate.result_tables import RESULT_DIGITS, printed_units, table_grids
from calibration.certificate.rounding import plain
from calibration.certificate.sections import left_out_blocks
from calibration.certificate.uncertainty_statements import uncertainty_statement
from calibration.certificate.units_on_paper import Size, shown_unit
from calibration.certificate.wording import capital, quantity_words, sentence_words, unit_words
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import RecordedBudget, RecordedBudgetRow
from protocol.language import translated

MOST_ROWS_ON_A_CERTIFICATE = 40
"""A longer table is drawn on the certificate and printed in the original record."""
RAW_TABLES = ("reading", "residual", "sample", "correlation", "shots", "distance", "wavelet")
"""Stems of tables that belong into the original record."""
CORRELATIONS = "correlation"
"""Stem of tables that are not drawn."""


def conformity_section(
    judged: tuple[Judgement, ...], details: CertificateDetails, say: Say
) -> Iterator[Section]:
    """Each quantity with a tolerance, and the decision rule; nothing where none has."""
    if not judged:
        return
    words = {
        "conforms": f"good|{say('conforms')}",
        "does_not_conform": f"bad|{say('does not conform')}",
        "open": f"open|{say('open: within U of a limit')}",
        "not_good_enough": f"open|{say('not judged: U > T/3')}",
    }
    rows: list[tuple[str, ...]] = []
    for one in judged:
        unit = details.tolerances[one.quantity].unit
        factor = derived_conversion_factor(one.unit, unit)
        low, high = (
            "" if edge is None else plain(float(f"{edge * factor:.12g}"), 7)
            for edge in (one.lower, one.upper)
        )
        limits = f"{low} … {high}" if low and high else f"≥ {low}" if low else f"≤ {high}"
        name = capital(quantity_words(one.quantity, say))
        rows.append((name, limits, unit_words(unit), f"{one.ratio:.2f}", one.source, words[one.verdict]))
    headings = (
        say("Quantity"),
        say("Limits"),
        say("Unit of measure"),
        "U/T",
        say("Limits set by"),
        say("Verdict"),
    )
    grid = Grid("", headings, tuple(rows), "lrlrll")
    if not any(one.source for one in judged):
        kept = [0, 1, 2, 3, 5]
        grid = Grid(
            "", tuple(headings[k] for k in kept), tuple(tuple(row[k] for k in kept) for row in rows), "lrlrl"
        )
    rule = say(
        "Decision rule (ILAC-G8:09/2019, JCGM 106:2012): the measurement is good enough if U ≤ T/3, T half "
        "of the tolerance interval. The guard band is U: a quantity conforms if all of value ± U is within "
        "the limits, does not if all of it is beyond one, and is left open in between."
    )
    yield Section(say("Conformity"), (grid, Paragraph(rule, "note")))


def budget_section(
    record: CalibrationRecord, details: CertificateDetails, say: Say, language: str
) -> Iterator[Section]:
    """Budgets row by row, or where the uncertainties come from; correlations of the results."""
    units = printed_units(record, details)
    blocks: list[Block] = [
        _budget_grid(budget, record.quantity(budget.result).unit, units[budget.result], say, language)
        for budget in record.budgets
    ]
    if {budget.result for budget in record.budgets} != {one.name for one in record.quantities}:
        statement = uncertainty_statement(record.method, record.model.name, say)
        blocks.append(Paragraph(f"{say('Further results')}: {statement}" if blocks else statement))
    caption = say("Correlation coefficients of the results; the covariance is in the record")
    blocks += filter(None, (correlations(block, record, caption) for block in record.covariance))
    yield Section(say("Uncertainty budget") if record.budgets else say("Uncertainty"), tuple(blocks))


def _budget_grid(budget: RecordedBudget, unit: str, printed: str, say: Say, language: str) -> Grid:
    """`unit`: of the result in the record; `printed`: on the page."""
    to_printed = derived_conversion_factor(unit, printed)
    variance = budget.standard_uncertainty**2
    total = (say("combined"), *[""] * 5, _number(budget.standard_uncertainty * to_printed, 3), "", "")
    rows = tuple(_budget_row(row, variance, unit, printed, say, language) for row in budget.rows)
    headings = (
        say("Contribution"),
        say("Estimate"),
        say("Unit of measure"),
        "$u_i",
        say("Distribution"),
        "$c_i",
        f"|c u|, {unit_words(printed)}" if printed != "1" else "|c u|",
        "ν",
        say("Part, %"),
    )
    title = capital(quantity_words(budget.result, say))
    return Grid(title, headings, (*rows, total), "lrlrlrrrl", translated(budget.note, language))


def _budget_row(
    row: RecordedBudgetRow, variance: float, result_unit: str, printed: str, say: Say, language: str
) -> tuple[str, ...]:
    to_printed = derived_conversion_factor(result_unit, printed)
    size = Size(abs(row.estimate) + row.standard_uncertainty)
    unit = printed if row.unit == result_unit else shown_unit(row.unit, size)
    factor = derived_conversion_factor(row.unit, unit)
    return (
        f"eq|{translated(row.quantity, language)}",
        _number(row.estimate * factor, 5),
        unit_words(unit),
        _number(row.standard_uncertainty * factor, 3),
        say(row.distribution),
        _number(row.sensitivity * to_printed / factor, 4),
        _number(abs(row.contribution) * to_printed, 3),
        "∞" if row.degrees_of_freedom is None else plain(row.degrees_of_freedom, 3),
        f"part|{100.0 * row.contribution**2 / variance if variance else 0.0:.1f}",
    )


def _number(value: float, digits: int) -> str:
    """Without the last bits that a change of units leaves."""
    return plain(float(f"{value:.12g}"), digits)


def tables_section(
    record: CalibrationRecord, say: Say, language: str, pictures: dict[str, str], prefix: str = ""
) -> Iterator[Section]:
    """Tables that are no raw readings, and a drawing of each that tells more drawn.

    The drawings go into `pictures`, their names beginning with `prefix`.
    """
    blocks: list[Block] = []
    for number, table in enumerate(record.tables, start=1):
        raw = any(stem in table.name for stem in RAW_TABLES)
        printed = not raw and len(table.columns[0].values) <= MOST_ROWS_ON_A_CERTIFICATE
        if printed:
            blocks += table_grids(table, RESULT_DIGITS, say, language)
        if CORRELATIONS in table.name or (printed and table.row_names):
            continue  # numbers for programs, or rows without an order: no curve
        for part, (drawn, caption) in enumerate(table_figures(table, say), start=1):
            name = f"{prefix}table-{number}-{part}.svg"
            pictures[name] = drawn
            blocks.append(Picture(name, caption, 0.95))
    if blocks:
        yield Section(say("Tables and plots"), tuple(blocks))


def assumptions_section(record: CalibrationRecord, say: Say, language: str) -> Section:
    """What was taken as given, and what no result rests on."""
    sentences = tuple(capital(sentence_words(translated(one, language))) for one in record.assumptions)
    given = (Bullets(sentences),) if sentences else ()
    return Section(say("Assumptions and data not used"), (*given, *left_out_blocks(record, say, language)))

# pyright: strict
"""Certificate and original record (原始记录) of one calibration, as documents.

A certificate gives results, their uncertainty and what they are traceable to; the original record gives
every table as it was read. One layout for every product and method: it follows the record's own shape.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict

from calibration.certificate.conformity import Judgement, judgements
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import (
    Block,
    Bullets,
    Document,
    Grid,
    Paragraph,
    Picture,
    Say,
    Section,
    Signatures,
    speaker,
)
from calibration.certificate.figures import correlations, table_figures
from calibration.certificate.rounding import plain
from calibration.certificate.sections import (
    environment_section,
    item_section,
    left_out_blocks,
    method_section,
    results_grid,
    table_grids,
    traceability_section,
)
from calibration.certificate.wording import capital, quantity_words, unit_words
from calibration.records.derived_units import derived_conversion_factor
from calibration.records.record import CalibrationRecord
from calibration.records.record_parts import RecordedBudget
from protocol.language import translated

FORMAT = "testloom-certificate/1"
RESULT_DIGITS = 5
READING_DIGITS = 7
MOST_ROWS_ON_A_CERTIFICATE = 40
"""A longer table is drawn on the certificate and printed in the original record."""
RAW_TABLES = ("reading", "residual", "sample", "correlation")
"""Stems of tables that belong into the original record."""
CORRELATIONS = "correlation"
"""Stem of tables that are not drawn."""


def certificate(record: CalibrationRecord, details: CertificateDetails, language: str) -> Document:
    """The calibration certificate.

    Raises:
        CalibrationError: a tolerance does not fit the record.
    """
    say = speaker(language)
    judged = judgements(record, details)
    pictures: dict[str, str] = {}
    sections = (
        item_section(record, details, say),
        method_section(record, say, language),
        traceability_section(record, details, say),
        environment_section(record, details, say),
        Section(say("Results"), (results_grid(record, details, say), _coverage(record, say))),
        *_conformity(judged, details, say),
        *_budgets(record, say, language),
        *_tables_with_figures(record, say, language, pictures),
        Section(
            say("Assumptions and data not used"),
            (
                *((Bullets(_sentences(record, language)),) if record.assumptions else ()),
                *left_out_blocks(record, say, language),
            ),
        ),
        *_remarks(details, say),
        _signatures(details, say),
    )
    return _document(say("Calibration certificate"), record, details, language, sections, pictures)


def original_record(record: CalibrationRecord, details: CertificateDetails, language: str) -> Document:
    """The sheet of raw readings: all tables in full, who took them, on what, where."""
    say = speaker(language)
    grids = tuple(
        grid for table in record.tables for grid in table_grids(table, READING_DIGITS, say, language)
    )
    nothing = Paragraph(
        say("The calibration keeps no table: its readings are in the recordings named above.")
    )
    sections = (
        item_section(record, details, say),
        traceability_section(record, details, say),
        environment_section(record, details, say),
        Section(say("Readings and tables"), grids or (nothing,)),
        Section(say("Data not used"), left_out_blocks(record, say, language)),
        Section(say("Result of the evaluation"), (results_grid(record, details, say),)),
        *_remarks(details, say),
        _signatures(details, say),
    )
    return _document(say("Original record of a calibration"), record, details, language, sections, {})


def document_json(document: Document, record: CalibrationRecord, details: CertificateDetails) -> str:
    """What the pages say, with the record and the details that they were made from, for programs."""
    content = {
        "format": FORMAT,
        "record_sha256": record.sha256(),
        "record": json.loads(record.canonical_json()),
        "details": details.model_dump(mode="json", exclude_defaults=True),
        "judgements": [asdict(one) for one in judgements(record, details)],
        "document": document.as_json(),
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, sort_keys=True, indent=1) + "\n"


def qr_payload(record: CalibrationRecord) -> str:
    """What the QR code says: which record this is, so that whoever holds both can compare."""
    return f"testloom:calibration-record:sha256:{record.sha256()}"


def number_of(record: CalibrationRecord, details: CertificateDetails) -> str:
    """The laboratory's number, or one from the record's identity."""
    return details.number or f"TL-{record.sha256()[:12].upper()}"


def _document(
    title: str,
    record: CalibrationRecord,
    details: CertificateDetails,
    language: str,
    sections: tuple[Section, ...],
    pictures: dict[str, str],
) -> Document:
    say = speaker(language)
    house = details.laboratory
    accreditation = say("Accreditation: {number}", number=house.reference) if house.reference else ""
    made = record.created_at
    return Document(
        title=title,
        subtitle=f"{record.product} · {record.serial}",
        number=number_of(record, details),
        language=language,
        laboratory=tuple(filter(None, (house.name, house.address, accreditation))),
        identity=record.sha256(),
        qr_payload=qr_payload(record),
        qr_caption=say("record"),
        footer=say("Record SHA-256 {sha256}", sha256=record.sha256()),
        page_words=say("Page {page} of {pages}"),
        number_word=say("No."),
        created=(made.year, made.month, made.day),
        end_words=say(
            "End of the document. It relates to this unit only, and is copied in full or not at all."
        ),
        sections=sections,
        pictures=pictures,
    )


def _coverage(record: CalibrationRecord, say: Say) -> Paragraph:
    words = [
        say(
            "U is the standard uncertainty times the coverage factor k of its row. With the degrees of "
            "freedom stated (t distribution; ∞: normal), it covers about {probability} %. Evaluated after "
            "JCGM 100:2008 (GUM).",
            probability=plain(100.0 * record.coverage_probability, 4),
        )
    ]
    if any(quantity.interval is not None for quantity in record.quantities):
        words.append(say("An interval holds with the probability p beside it."))
    return Paragraph(" ".join(words), "note")


def _conformity(judged: tuple[Judgement, ...], details: CertificateDetails, say: Say) -> Iterator[Section]:
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


def _budgets(record: CalibrationRecord, say: Say, language: str) -> Iterator[Section]:
    blocks: list[Block] = [_budget_grid(budget, record, say, language) for budget in record.budgets]
    caption = say("Correlation coefficients of the results; the covariance is in the record")
    blocks += filter(None, (correlations(block, record, caption) for block in record.covariance))
    if blocks:
        yield Section(say("Uncertainty budget"), tuple(blocks))


def _budget_grid(budget: RecordedBudget, record: CalibrationRecord, say: Say, language: str) -> Grid:
    unit = record.quantity(budget.result).unit
    variance = budget.standard_uncertainty**2
    rows = tuple(
        (
            translated(row.quantity, language),
            plain(row.estimate, 5),
            unit_words(row.unit),
            plain(row.standard_uncertainty, 3),
            say(row.distribution),
            plain(row.sensitivity, 4),
            plain(abs(row.contribution), 3),
            "∞" if row.degrees_of_freedom is None else plain(row.degrees_of_freedom, 3),
            f"part|{100.0 * row.contribution**2 / variance if variance else 0.0:.1f}",
        )
        for row in budget.rows
    )
    total = (say("combined"), *[""] * 5, plain(budget.standard_uncertainty, 3), "", "")
    headings = (
        say("Contribution"),
        say("Estimate"),
        say("Unit of measure"),
        "$u_i",
        say("Distribution"),
        "$c_i",
        f"|c u|, {unit_words(unit)}" if unit != "1" else "|c u|",
        "ν",
        say("Part, %"),
    )
    title = capital(quantity_words(budget.result, say))
    return Grid(title, headings, (*rows, total), "lrlrlrrrl", translated(budget.note, language))


def _tables_with_figures(
    record: CalibrationRecord, say: Say, language: str, pictures: dict[str, str]
) -> Iterator[Section]:
    blocks: list[Block] = []
    for number, table in enumerate(record.tables, start=1):
        raw = any(stem in table.name for stem in RAW_TABLES)
        if not raw and len(table.columns[0].values) <= MOST_ROWS_ON_A_CERTIFICATE:
            blocks += table_grids(table, RESULT_DIGITS, say, language)
        title = capital(quantity_words(table.name, say))
        if CORRELATIONS in table.name:
            continue  # numbers for programs: no curve
        for part, drawn in enumerate(table_figures(table, say), start=1):
            name = f"table-{number}-{part}.svg"
            pictures[name] = drawn
            blocks.append(Picture(name, title, 0.95))
    if blocks:
        yield Section(say("Tables and plots"), tuple(blocks))


def _sentences(record: CalibrationRecord, language: str) -> tuple[str, ...]:
    return tuple(capital(translated(one, language)) for one in record.assumptions)


def _remarks(details: CertificateDetails, say: Say) -> Iterator[Section]:
    if details.remarks:
        yield Section(say("Remarks"), (Bullets(details.remarks),))


def _signatures(details: CertificateDetails, say: Say) -> Section:
    rows = (
        (say("Calibrated by"), details.operator),
        (say("Checked by"), details.checked_by),
        (say("Approved by"), details.approved_by),
    )
    return Section("", (Signatures(rows, say("Date")),))

# pyright: strict
"""Certificate and original record (原始记录) of one calibration, as documents.

A certificate gives results, their uncertainty and what they are traceable to; the original record gives
every table as it was read. One layout for every product and method: it follows the record's own shape.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import timedelta

from calibration.certificate.conformity import judgements
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import (
    Bullets,
    Document,
    Paragraph,
    Say,
    Section,
    Signatures,
    speaker,
)
from calibration.certificate.record_sections import (
    assumptions_section,
    budget_section,
    conformity_section,
    tables_section,
)
from calibration.certificate.result_tables import READING_DIGITS, results_grid, table_grids
from calibration.certificate.sections import (
    environment_section,
    item_section,
    left_out_blocks,
    method_section,
    notices,
    product_words,
    traceability_section,
)
from calibration.records.record import CalibrationRecord
from protocol.errors import CalibrationError, Fault

FORMAT = "testloom-certificate/1"
ONE_DAY = timedelta(days=1)
"""A laboratory's day may begin before or after that of UTC."""


def certificate(record: CalibrationRecord, details: CertificateDetails, language: str) -> Document:
    """The calibration certificate.

    Raises:
        CalibrationError: a tolerance does not fit the record.
    """
    say = speaker(language)
    judged = judgements(record, details)
    pictures: dict[str, str] = {}
    sections = (
        *notices([record], say),
        item_section([record], details, say),
        method_section(record, say, language),
        traceability_section([record], details, say),
        environment_section([record], details, say),
        Section(say("Results"), (results_grid(record, details, say),)),
        *conformity_section(judged, details, say),
        *budget_section(record, details, say, language),
        *tables_section(record, say, language, pictures),
        assumptions_section(record, say, language),
        *closing_sections(details, say),
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
        *notices([record], say),
        item_section([record], details, say),
        traceability_section([record], details, say),
        environment_section([record], details, say),
        Section(say("Readings and tables"), grids or (nothing,)),
        Section(say("Data not used"), left_out_blocks(record, say, language)),
        Section(say("Result of the evaluation"), (results_grid(record, details, say),)),
        *closing_sections(details, say),
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


def number_of(identity: str, details: CertificateDetails) -> str:
    """The laboratory's number, or one from the identity."""
    return details.number or f"TL-{identity[:12].upper()}"


def _document(
    title: str,
    record: CalibrationRecord,
    details: CertificateDetails,
    language: str,
    sections: tuple[Section, ...],
    pictures: dict[str, str],
) -> Document:
    say = speaker(language)
    return document_of(
        title,
        [record],
        details,
        language,
        sections,
        pictures,
        identity=record.sha256(),
        qr_payload=qr_payload(record),
        qr_caption=say("record"),
        footer=say("Record SHA-256 {sha256}", sha256=record.sha256()),
    )


def document_of(
    title: str,
    records: Sequence[CalibrationRecord],
    details: CertificateDetails,
    language: str,
    sections: tuple[Section, ...],
    pictures: dict[str, str],
    **identified: str,
) -> Document:
    """Head and foot around the sections. `identified`: the fields of `Document` that say by what.

    Raises:
        CalibrationError: it was issued before it was evaluated.
    """
    say = speaker(language)
    house = details.laboratory
    accreditation = say("Accreditation: {number}", number=house.reference) if house.reference else ""
    made = max(record.created_at for record in records)
    if details.issued is not None and details.issued < made.date() - ONE_DAY:
        raise CalibrationError(
            f"It was issued on {details.issued} and evaluated on {made.date()}, which is later.",
            where=records[0].title,
            fault=Fault.OPERATOR,
            remedy="correct the date of issue in the details.",
        )
    return Document(
        title=title,
        subtitle=f"{product_words(records[0].product, say)} · {records[0].serial}",
        number=number_of(identified["identity"], details),
        language=language,
        laboratory=tuple(filter(None, (house.name, house.address, accreditation))),
        page_words=say("Page {page} of {pages}"),
        number_word=say("No."),
        created=(made.year, made.month, made.day),
        end_words=say(
            "End of the document. It relates to this unit only, and is copied in full or not at all."
        ),
        sections=sections,
        pictures=pictures,
        **identified,
    )


def closing_sections(details: CertificateDetails, say: Say) -> Iterator[Section]:
    """Remarks and signatures."""
    if details.remarks:
        yield Section(say("Remarks"), (Bullets(details.remarks),))
    rows = (
        (say("Calibrated by"), details.operator),
        (say("Checked by"), details.checked_by),
        (say("Approved by"), details.approved_by),
    )
    yield Section("", (Signatures(rows, say("Date")),))

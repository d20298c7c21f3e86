# pyright: strict
"""Several records of one unit in one certificate: a part for each sensor and method, one identity for all.

The identity is the SHA-256 of what `sha256sum` prints for the records' files, sorted by name: whoever has
the pages takes the files out of them and finds it again.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

from calibration.certificate.composing import closing_sections, document_of
from calibration.certificate.conformity import judgements_together
from calibration.certificate.details import CertificateDetails
from calibration.certificate.document import Contents, Document, Say, Section, speaker
from calibration.certificate.methods import method_name
from calibration.certificate.record_sections import (
    assumptions_section,
    budget_section,
    conformity_section,
    tables_section,
)
from calibration.certificate.result_tables import READING_DIGITS, results_grid, table_grids
from calibration.certificate.sections import (
    day,
    environment_section,
    item_section,
    left_out_blocks,
    method_section,
    notices,
    sensor_words,
    temperatures,
    traceability_section,
)
from calibration.certificate.wording import capital, quantity_words
from calibration.records.record import CalibrationRecord
from protocol.errors import CalibrationError, Fault

FORMAT = "testloom-unit-certificate/1"
MOST_RECORDS = 100


def in_order(records: Sequence[CalibrationRecord]) -> tuple[CalibrationRecord, ...]:
    """By sensor, method and time, whatever order they were named in.

    Raises:
        CalibrationError: they are of different units, or too many.
    """
    units = dict.fromkeys(f"{record.product} {record.serial}" for record in records)
    if len(units) != 1:
        raise CalibrationError(
            f"The records are of {len(units)} units: {', '.join(list(units)[:5])}.",
            where="--together",
            fault=Fault.OPERATOR,
            remedy="name the records of one unit, or leave --together out: each then has its own.",
        )
    if len(records) > MOST_RECORDS:
        raise CalibrationError(
            f"{len(records)} records are more than {MOST_RECORDS}.",
            where="--together",
            fault=Fault.OPERATOR,
            remedy="name those that the customer ordered.",
        )
    return tuple(sorted(records, key=lambda one: (one.sensor, one.method, one.time, one.sha256())))


def identity_of(records: Sequence[CalibrationRecord]) -> str:
    """See the module."""
    lines = sorted((record.file_name, record.sha256()) for record in records)
    return hashlib.sha256("".join(f"{sha}  {name}\n" for name, sha in lines).encode()).hexdigest()


def unit_certificate(
    records: Sequence[CalibrationRecord], details: CertificateDetails, language: str
) -> Document:
    """The calibration certificate of a unit. `records`: `in_order`.

    Raises:
        CalibrationError: a tolerance fits none of the records.
    """
    say = speaker(language)
    judged = judgements_together(records, details)
    pictures: dict[str, str] = {}
    parts: list[Section] = []
    for number, (record, title) in enumerate(zip(records, _titles(records, say), strict=True), start=1):
        mine = replace_tolerances(details, {one.quantity for one in judged[number - 1]})
        inside = (
            method_section(record, say, language, before=_facts_of(record, say)),
            Section(say("Results"), (results_grid(record, mine, say),)),
            *conformity_section(judged[number - 1], mine, say),
            *budget_section(record, mine, say, language),
            *tables_section(record, say, language, pictures, prefix=f"part-{number}-"),
            assumptions_section(record, say, language),
        )
        parts += [Section(title, ()), *(replace(section, level=2) for section in inside)]
    return _document(say("Calibration certificate"), records, details, language, parts, pictures)


def unit_original_record(
    records: Sequence[CalibrationRecord], details: CertificateDetails, language: str
) -> Document:
    """Every table of every record in full. `records`: `in_order`."""
    say = speaker(language)
    parts: list[Section] = []
    for record, title in zip(records, _titles(records, say), strict=True):
        grids = tuple(
            grid for table in record.tables for grid in table_grids(table, READING_DIGITS, say, language)
        )
        inside = (
            method_section(record, say, language, before=_facts_of(record, say)),
            *([Section(say("Readings and tables"), grids)] if grids else []),
            Section(say("Data not used"), left_out_blocks(record, say, language)),
            Section(say("Result of the evaluation"), (results_grid(record, CertificateDetails(), say),)),
        )
        parts += [Section(title, ()), *(replace(section, level=2) for section in inside)]
    return _document(say("Original record of a calibration"), records, details, language, parts, {})


def unit_document_json(
    document: Document, records: Sequence[CalibrationRecord], details: CertificateDetails
) -> str:
    """What the pages say, with the records and details that they were made from, for programs."""
    content = {
        "format": FORMAT,
        "records_sha256": identity_of(records),
        "records": [json.loads(record.canonical_json()) for record in records],
        "details": details.model_dump(mode="json", exclude_defaults=True),
        "judgements": [
            {"record_sha256": record.sha256(), **asdict(one)}
            for record, found in zip(records, judgements_together(records, details), strict=True)
            for one in found
        ],
        "document": document.as_json(),
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, sort_keys=True, indent=1) + "\n"


def replace_tolerances(details: CertificateDetails, names: set[str]) -> CertificateDetails:
    """Only the tolerances that one record's quantities are judged by."""
    kept = {name: one for name, one in details.tolerances.items() if name in names}
    return details.model_copy(update={"tolerances": kept})


def _document(
    title: str,
    records: Sequence[CalibrationRecord],
    details: CertificateDetails,
    language: str,
    parts: Sequence[Section],
    pictures: dict[str, str],
) -> Document:
    say = speaker(language)
    identity = identity_of(records)
    sections = (
        *notices(records, say),
        item_section(records, details, say),
        Section(say("Contents"), (_contents(records, say),)),
        traceability_section(records, details, say),
        environment_section(records, details, say),
        *parts,
        *closing_sections(details, say),
    )
    return document_of(
        title,
        records,
        details,
        language,
        sections,
        pictures,
        identity=identity,
        qr_payload=f"testloom:calibration-records:sha256:{identity}",
        qr_caption=say("records"),
        footer=say("Records SHA-256 {sha256}", sha256=identity),
    )


def _titles(records: Sequence[CalibrationRecord], say: Say) -> Iterator[str]:
    for number, record in enumerate(records, start=1):
        method = method_name(record.method, record.model.name, say)
        yield f"{number}  {sensor_words(record.sensor, say)}: {method}"


def _contents(records: Sequence[CalibrationRecord], say: Say) -> Contents:
    rows = tuple(
        (title, day(record.time), record.sha256()[:12])
        for title, record in zip(_titles(records, say), records, strict=True)
    )
    return Contents((say("Part"), say("Measured"), capital(say("record")), say("Page")), rows)


def _facts_of(record: CalibrationRecord, say: Say) -> tuple[tuple[str, str], ...]:
    stand = record.stand
    return (
        (say("Measured"), day(record.measured_at) if record.measured_at else say("not stated")),
        (say("Stand"), f"{capital(quantity_words(stand.kind, say))} {stand.id}" if stand else ""),
        (say("Recording"), ", ".join(one.recording_id for one in record.recordings)),
        (say("Temperature of the unit"), temperatures([record.environment.unit_temperature])),
        (say("Record SHA-256"), record.sha256()),
    )

"""`testloom certificate`: certificate and original record of calibrations, as PDF and JSON."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protocol.language import chosen_language, say

if TYPE_CHECKING:
    from calibration.certificate.details import CertificateDetails
    from calibration.records.record import CalibrationRecord

MAX_CERTIFICATES = 1000


def certificate(
    records: Annotated[list[Path], typer.Argument(help=say("Calibration records, or folders of them."))],
    out: Annotated[Path, typer.Option("--out", help=say("The folder for the documents."))],
    details: Annotated[
        Path | None,
        typer.Option("--details", help=say("YAML with customer, laboratory, standards and tolerances.")),
    ] = None,
    together: Annotated[
        bool, typer.Option("--together", help=say("One certificate for all records of one unit."))
    ] = False,
) -> None:
    from protocol.errors import Fault, TestloomError

    found = _records(records)
    added = _details(details)
    if added.number and len(found) > 1 and not together:
        raise TestloomError(
            f"The details have one number, and there are {len(found)} calibration records.",
            where=str(details),
            fault=Fault.OPERATOR,
            remedy="make each certificate with details of its own, leave the number out, or make one "
            "certificate of a unit with --together.",
        )
    documents: dict[str, bytes] = {}
    if together:
        documents = _unit_documents(found, added)
    else:
        for record in found:
            documents |= _documents(record, added)
    for name, content in documents.items():
        _refuse_other(out / name, content)
    for name, content in documents.items():
        _write(out / name, content)
        typer.echo(str(out / name))


certificate.__doc__ = say(
    "Make certificate and original record of calibrations, as PDF with the record in it, and as JSON."
)


def _records(paths: list[Path]) -> "list[CalibrationRecord]":
    from calibration.records.record import CalibrationRecord
    from cli.calibration_record_files import records_below
    from protocol.errors import Fault, TestloomError

    found: dict[str, CalibrationRecord] = {}
    for one in records_below(paths):
        if not isinstance(one, CalibrationRecord):
            raise one
        found[one.sha256()] = one
    if not 1 <= len(found) <= MAX_CERTIFICATES:
        raise TestloomError(
            f"There are {len(found)} calibration records here, not between 1 and {MAX_CERTIFICATES}.",
            where=", ".join(map(str, paths)),
            fault=Fault.OPERATOR,
            remedy="make some with 'testloom calibrate FOLDER --record DIR', or name fewer.",
        )
    return list(found.values())


def _details(path: Path | None) -> "CertificateDetails":
    from calibration.certificate.details import CertificateDetails, parse_details
    from protocol.errors import Fault, TestloomError

    if path is None:
        return CertificateDetails()
    try:
        return parse_details(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise TestloomError(
            f"The details cannot be read: {error}.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="name a YAML file; docs/certificates.md has one to copy.",
        ) from error


def _documents(record: "CalibrationRecord", details: "CertificateDetails") -> dict[str, bytes]:
    """File name → content: two documents, each as PDF and JSON."""
    from calibration.certificate.composing import certificate as composed
    from calibration.certificate.composing import document_json, original_record
    from calibration.certificate.printing import printed

    language = chosen_language()
    stem = record.file_name.removesuffix(".json")
    files: dict[str, bytes] = {}
    for kind, compose in (("certificate", composed), ("original-record", original_record)):
        document = compose(record, details, language)
        name = f"{stem}-{kind}-{language}"
        files[f"{name}.pdf"] = printed(document, record.canonical_json())
        files[f"{name}.json"] = document_json(document, record, details).encode()
    return files


def _unit_documents(found: "list[CalibrationRecord]", details: "CertificateDetails") -> dict[str, bytes]:
    """As `_documents`, of all records of one unit at once."""
    from calibration.certificate import unit_certificate as unit
    from calibration.certificate.printing import printed

    language = chosen_language()
    records = unit.in_order(found)
    attached = {record.file_name: record.canonical_json() for record in records}
    stem = f"{records[0].file_stem}-{unit.identity_of(records)[:12]}"
    files: dict[str, bytes] = {}
    for kind, compose in (
        ("certificate", unit.unit_certificate),
        ("original-record", unit.unit_original_record),
    ):
        document = compose(records, details, language)
        files[f"{stem}-{kind}-{language}.pdf"] = printed(document, attached)
        content = unit.unit_document_json(document, records, details)
        files[f"{stem}-{kind}-{language}.json"] = content.encode()
    return files


def _refuse_other(path: Path, content: bytes) -> None:
    """What was made once is not replaced by something else: a customer may have it."""
    from protocol.errors import Fault, TestloomError

    if path.exists() and (not path.is_file() or path.read_bytes() != content):
        raise TestloomError(
            "There is another document of this name.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="name another folder, or move that document away.",
        )


def _write(path: Path, content: bytes) -> None:
    from protocol.durable_files import storage_error, sync

    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_bytes(content)
        sync(unfinished)
        unfinished.replace(path)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise storage_error(error, path, "document") from error

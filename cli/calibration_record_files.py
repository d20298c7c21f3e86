"""Calibration records on disk, and what they are made with: hashes of recordings, version of the code."""

import hashlib
import json
import os
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib import metadata
from itertools import islice
from pathlib import Path

from calibration.records.record import FORMAT, MAX_RECORD_BYTES, CalibrationRecord, parse_record, refused
from calibration.records.record_parts import CodeVersion, SourceRecording
from calibration.rest_segments import SECTIONS_FILE, STATIC_INTERVALS_FILE
from protocol.adapters.recording_forms import form_of
from protocol.durable_files import storage_error, sync
from protocol.errors import CalibrationError, Fault, RecordingError, TestloomError
from protocol.recording_document import DOCUMENT_NAME

MAX_RECORDS = 10_000
GIT_TIMEOUT_S = 5.0
TABLES_BESIDE = (SECTIONS_FILE, STATIC_INTERVALS_FILE)
"""What an evaluation reads beside a recording's own files."""


def read_record(path: Path) -> CalibrationRecord:
    """The record in a file.

    Raises:
        CalibrationError: there is none, or it is damaged.
    """
    if not path.is_file():
        raise CalibrationError(
            "There is no such calibration record.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="name the .json file of a calibration record.",
        )
    return parse_record(_text(path), str(path))


def write_record(record: CalibrationRecord, folder: Path) -> Path:
    """Write a record's canonical JSON under its own name, whole or not at all.

    Raises:
        RecordingError: the disk refuses.
    """
    path = folder / record.file_name
    unfinished = path.with_suffix(f".json.{os.getpid()}.part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished.write_bytes(record.canonical_json().encode())
        sync(unfinished)
        unfinished.replace(path)
        sync(folder)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise storage_error(error, path) from error
    return path


def records_below(paths: list[Path]) -> Iterator[CalibrationRecord | TestloomError]:
    """All records in files and folders; what is damaged as the error that says so.

    JSON files of other formats (recording.json) are passed over where a folder was named.
    """
    for path in paths:
        if not path.is_dir():
            yield _record_or_error(path)
            continue
        found = list(islice(sorted(path.rglob("*.json")), MAX_RECORDS + 1))
        if len(found) > MAX_RECORDS:
            yield CalibrationError(
                f"There are more than {MAX_RECORDS} JSON files.",
                where=str(path),
                fault=Fault.OPERATOR,
                remedy="name smaller folders.",
            )
            continue
        yield from (_record_or_error(file) for file in found if not _of_another_format(file))


def source_of(recording_id: str, path: Path) -> SourceRecording:
    """The recording's identity by the SHA-256 of its file, or of what `sha256sum` prints for its files.

    Raises:
        RecordingError: it cannot be read.
    """
    try:
        if path.name == DOCUMENT_NAME:
            path = path.parent
        if form_of(path) == "mcap" and path.is_file():
            return SourceRecording(recording_id=recording_id, sha256=_sha256(path), form="mcap")
        described = json.loads((path / DOCUMENT_NAME).read_text(encoding="utf-8"))
        names = {DOCUMENT_NAME, *(stream["file"] for stream in described["streams"])}
        names |= {name for name in TABLES_BESIDE if (path / name).is_file()}
        listing = "".join(f"{_sha256(path / name)}  {name}\n" for name in sorted(names))
    except OSError as error:
        raise RecordingError(
            f"The recording cannot be read: {error.strerror or error}.",
            where=str(path),
            fault=Fault.STATION,
            remedy="look at the disk, then calibrate again.",
        ) from error
    sha256 = hashlib.sha256(listing.encode()).hexdigest()
    return SourceRecording(recording_id=recording_id, sha256=sha256, form="folder")


def code_version() -> CodeVersion:
    """The installed package, and the commit where it runs out of its own repository."""
    root = Path(__file__).resolve().parents[1]
    return CodeVersion(package=f"testloom {metadata.version('testloom')}", commit=_commit(root))


def now() -> datetime:
    """To the second, UTC."""
    return datetime.now(UTC).replace(microsecond=0)


def _commit(root: Path) -> str | None:
    if not (root / ".git").exists():
        return None
    try:
        described = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty", "--tags", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=GIT_TIMEOUT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip() or None


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _record_or_error(path: Path) -> CalibrationRecord | TestloomError:
    try:
        return read_record(path)
    except TestloomError as error:
        return error


def _of_another_format(path: Path) -> bool:
    """Whether a JSON file says that it is something else; what says nothing may be a damaged record."""
    try:
        found = json.loads(_text(path)).get("format")
    except (TestloomError, ValueError, AttributeError, RecursionError):
        return False
    family = FORMAT.partition("/")[0]
    return isinstance(found, str) and found.partition("/")[0] != family


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_RECORD_BYTES:
            raise refused(f"It is larger than {MAX_RECORD_BYTES} bytes.", str(path))
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise refused(f"The file cannot be read: {error}.", str(path)) from error

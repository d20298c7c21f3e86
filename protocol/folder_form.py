"""The folder form of a recording: a folder with `recording.json` and a file for each stream.

Reading is strict: what cannot be trusted is an error that names file, column and row; nothing is
repaired, filled or guessed. Writing is all or nothing: a folder appears whole or not at all.
"""

import json
import shutil
import tempfile
from pathlib import Path

from protocol.durable_files import storage_error, sync
from protocol.errors import Fault, RecordingError
from protocol.recording_checks import Findings, check_stream
from protocol.recording_document import (
    DOCUMENT_NAME,
    MAX_DOCUMENT_BYTES,
    StreamDescription,
    document_of,
    parse_document,
    types_of,
)
from protocol.recordings import Recording, Stream
from protocol.stream_files import StreamFormat, read_columns, write_columns


def read_folder(path: Path | str) -> Recording:
    """The recording in a folder.

    Raises:
        RecordingError: it is damaged, cut short or does not say what its columns are; the error
            names the first thing found, its story the others.
    """
    findings = Findings()
    recording = examine_folder(Path(path), findings)
    findings.raise_first()
    assert recording is not None
    return recording


def examine_folder(path: Path, findings: Findings) -> Recording | None:
    """Read a folder and report everything that is wrong with it; None if it cannot be used."""
    where = path / DOCUMENT_NAME
    try:
        if where.stat().st_size > MAX_DOCUMENT_BYTES:
            findings.add(
                f"The file is larger than {MAX_DOCUMENT_BYTES} bytes.",
                str(where),
                "keep samples in stream files.",
            )
            return None
        text = where.read_text(encoding="utf-8")
    except FileNotFoundError:
        remedy = "name a recording's folder, or copy it whole."
        findings.add(f"There is no {DOCUMENT_NAME}.", str(where), remedy, Fault.OPERATOR)
        return None
    except (OSError, UnicodeDecodeError) as error:
        findings.add(f"The file cannot be read: {error}.", str(where), "correct or restore the file.")
        return None
    document = parse_document(text, str(where), findings)
    if document is None:
        return None
    read = [(described.name, _read_stream(path, described, findings)) for described in document.streams]
    if findings.errors:
        return None
    return document.recording({name: stream for name, stream in read if stream is not None})


def _read_stream(folder: Path, described: StreamDescription, findings: Findings) -> Stream | None:
    if not described.file:
        findings.add("The stream names no file.", f"{folder}, stream {described.name}", "name its file.")
        return None
    path = folder / described.file
    own = Findings(notes=findings.notes)
    columns = read_columns(path, {name: described.types.get(name, "") for name in described.units}, own)
    if columns is not None and not own.errors:
        check_stream(columns, described.units, described.time, str(path), own)
        rows = len(columns[described.time])
        if described.rows is not None and rows != described.rows:
            own.add(
                f"The file has {rows} of the {described.rows} rows that {DOCUMENT_NAME} names.",
                f"{path}, row {rows + 1}",
                "copy the file again: it was cut short, or rows were added.",
            )
        if rows == 0:
            own.notes.append(f"{path}: the stream has no samples.")
    findings.errors += own.errors
    if columns is None or own.errors:
        return None
    native = {
        name: samples.astype(samples.dtype.newbyteorder("="), copy=False) for name, samples in columns.items()
    }
    return Stream(described.name, described.clock, described.time, described.units, native, described.extra)


def write_folder(recording: Recording, path: Path | str, stream_format: StreamFormat = "npz") -> None:
    """Write a recording as a new folder.

    Raises:
        RecordingError: the recording is not sound, the folder exists already, or the disk is full
            or cannot be written; no half recording is left.
    """
    target = Path(path)
    if target.exists():
        raise RecordingError(
            "There is something of this name already.",
            where=str(target),
            fault=Fault.OPERATOR,
            remedy="choose another name, or move it away.",
        )
    findings = Findings()
    for name, stream in recording.streams.items():
        check_stream(
            stream.columns, stream.units, stream.time, f"{recording.recording_id}, stream {name}", findings
        )
    findings.raise_first()
    unfinished: Path | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
        _write_into(unfinished, recording, stream_format)
        unfinished.chmod(0o755)
        unfinished.rename(target)
        sync(target.parent)
    except OSError as error:
        raise storage_error(error, target) from error
    finally:
        if unfinished is not None and unfinished.exists():
            shutil.rmtree(unfinished, ignore_errors=True)


def _write_into(folder: Path, recording: Recording, stream_format: StreamFormat) -> None:
    described = {}
    for name, stream in recording.streams.items():
        described[name] = {"file": f"{name}.{stream_format}", "rows": len(stream)}
        if stream_format == "csv":
            described[name]["types"] = types_of(stream)
        file = folder / f"{name}.{stream_format}"
        write_columns(file, {column: stream.columns[column] for column in stream.units})
        sync(file)
    document = folder / DOCUMENT_NAME
    text = json.dumps(document_of(recording, described), indent=1, ensure_ascii=False)
    document.write_text(text + "\n", encoding="utf-8")
    sync(document)
    sync(folder)

# pyright: strict
"""`recording.json`: what a recording says of itself, to and from the model in memory.

Both forms carry this document: the folder form as a file that names the stream files, MCAP as an
attachment. Two optional keys of a stream are ours: `types` (column → type of its samples, where a
text file would lose it) and `rows` (how many samples there are: a file cut short is noticed).
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from protocol.recording_checks import SAMPLE_TYPES, Findings, duplicates
from protocol.recordings import FORMAT, Recording, Stream
from protocol.units_of_measure import KNOWN_UNITS, is_known_unit, quantity_of

DOCUMENT_NAME = "recording.json"
MAX_DOCUMENT_BYTES = 16_000_000
MAX_COLUMNS = 1000

_NAME = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
_MAPPINGS = ("unit", "test", "stand", "site", "believed")
_DOCUMENT_KEYS = {"format", "recording_id", "streams", *_MAPPINGS}
_STREAM_KEYS = {"name", "file", "clock", "time", "columns", "types", "rows"}


@dataclass(frozen=True)
class StreamDescription:
    """A stream as the document describes it.

    Attributes:
        file: its file in the folder form, else empty.
        units: column → unit, in the order of the columns.
        types: column → type of its samples, as far as said.
        rows: number of samples, if said.
        extra: keys that the format does not name.
    """

    name: str
    file: str
    clock: str
    time: str
    units: dict[str, str]
    types: dict[str, str]
    rows: int | None
    extra: dict[str, Any]


@dataclass(frozen=True)
class RecordingDocument:
    """The whole document, checked."""

    recording_id: str
    mappings: dict[str, dict[str, Any]]
    extra: dict[str, Any]
    streams: tuple[StreamDescription, ...]

    def recording(self, streams: Mapping[str, Stream]) -> Recording:
        """The recording with these streams."""
        return Recording(
            recording_id=self.recording_id, streams=dict(streams), extra=self.extra, **self.mappings
        )


def parse_document(text: str, where: str, findings: Findings) -> RecordingDocument | None:
    """The checked document; None, and the reasons in `findings`, if it cannot be used.

    Args:
        text: JSON.
        where: the file, for errors.
        findings: gets what is wrong.
    """
    try:
        loaded: object = json.loads(text, object_pairs_hook=_object_without_duplicates)
        json.dumps(loaded, ensure_ascii=False).encode()  # half a surrogate pair could never be written again
    except (ValueError, RecursionError) as error:
        findings.add(f"This is not JSON: {error}.", where, "correct or restore the file.")
        return None
    if not isinstance(loaded, dict):
        findings.add("This is not a JSON object.", where, "see docs/recordings.md.")
        return None
    document = cast(dict[str, Any], loaded)
    if document.get("format") != FORMAT:
        findings.add(
            f"The format is {document.get('format')!r}, not '{FORMAT}'.",
            f"{where}, key format",
            "convert the recording with the version that wrote it.",
        )
        return None
    before = len(findings.errors)
    recording_id = document.get("recording_id")
    if not isinstance(recording_id, str) or not recording_id:
        findings.add("The recording has no id.", f"{where}, key recording_id", "give it a name.")
    for key in _MAPPINGS:
        if not isinstance(document.get(key, {}), dict) or (key in ("unit", "test") and key not in document):
            findings.add(
                f"'{key}' is missing or no JSON object.", f"{where}, key {key}", "write it as an object."
            )
    streams = _streams(document.get("streams"), where, findings)
    if len(findings.errors) > before:
        return None
    return RecordingDocument(
        recording_id=cast(str, recording_id),
        mappings={key: cast(dict[str, Any], document.get(key, {})) for key in _MAPPINGS},
        extra={key: value for key, value in document.items() if key not in _DOCUMENT_KEYS},
        streams=streams,
    )


def document_of(recording: Recording, described: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """`recording.json` of a recording.

    Args:
        recording: what to write.
        described: stream → what this form adds to its description (file, types, rows).
    """
    streams = [
        {
            "name": stream.name,
            "clock": stream.clock,
            "time": stream.time,
            "columns": dict(stream.units),
            **described[name],
            **stream.extra,
        }
        for name, stream in recording.streams.items()
    ]
    mappings = {key: dict(getattr(recording, key)) for key in _MAPPINGS}
    return {
        "format": FORMAT,
        "recording_id": recording.recording_id,
        **{key: value for key, value in mappings.items() if value or key in ("unit", "test")},
        "streams": streams,
        **recording.extra,
    }


def types_of(stream: Stream) -> dict[str, str]:
    """Column → type of its samples, as the document spells it."""
    return {name: stream.columns[name].dtype.newbyteorder("=").name for name in stream.units}


def _object_without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    twice = duplicates([key for key, _ in pairs])
    if twice:
        raise ValueError(f"the key '{twice[0]}' stands twice in one object")
    return dict(pairs)


def _streams(value: object, where: str, findings: Findings) -> tuple[StreamDescription, ...]:
    if not isinstance(value, list) or not value:
        findings.add(
            "No stream is described.", f"{where}, key streams", "describe each stream's file and columns."
        )
        return ()
    described = [
        _stream(entry, f"{where}, stream {number}", findings)
        for number, entry in enumerate(cast(list[Any], value), 1)
    ]
    streams = tuple(stream for stream in described if stream is not None)
    for name in duplicates([stream.name for stream in streams]):
        findings.add(f"Two streams are named '{name}'.", f"{where}, key streams", "rename one of them.")
    return streams


def _stream(entry: object, where: str, findings: Findings) -> StreamDescription | None:
    if not isinstance(entry, dict):
        findings.add("The description of a stream is no JSON object.", where, "write it as an object.")
        return None
    stream = cast(dict[str, Any], entry)
    before = len(findings.errors)
    for key in ("name", "clock", "time"):
        if not isinstance(stream.get(key), str) or not stream[key]:
            findings.add(f"The stream has no '{key}'.", f"{where}, key {key}", "write it as a text.")
    if len(findings.errors) > before:
        return None
    name, time, file = str(stream["name"]), str(stream["time"]), stream.get("file", "")
    where = f"{where} ({name})"
    if not _NAME.match(name):
        findings.add(
            f"'{name}' cannot be the name of a stream.", where, "use letters, digits, '_', '.' and '-'."
        )
    if not isinstance(file, str) or (file and not _NAME.match(file)):
        findings.add(
            f"{file!r} cannot be the file of a stream.",
            f"{where}, key file",
            "name a file inside the folder.",
        )
    units = _units(stream.get("columns"), time, where, findings)
    types, rows = stream.get("types", {}), stream.get("rows")
    if not isinstance(types, dict) or not all(
        column in units and isinstance(kind, str) and kind in SAMPLE_TYPES
        for column, kind in cast(dict[str, Any], types).items()
    ):
        findings.add(
            "'types' does not say types of samples.",
            f"{where}, key types",
            f"for each column use one of: {', '.join(sorted(SAMPLE_TYPES))}.",
        )
    if rows is not None and (not isinstance(rows, int) or rows < 0):
        findings.add("'rows' is no number of samples.", f"{where}, key rows", "correct it, or leave it out.")
    if len(findings.errors) > before:
        return None
    extra = {key: value for key, value in stream.items() if key not in _STREAM_KEYS}
    return StreamDescription(
        name, str(file), str(stream["clock"]), time, units, cast(dict[str, str], types), rows, extra
    )


def _units(value: object, time: str, where: str, findings: Findings) -> dict[str, str]:
    if not isinstance(value, dict) or not 0 < len(cast(dict[str, Any], value)) <= MAX_COLUMNS:
        findings.add(
            f"The stream does not name its columns (1 to {MAX_COLUMNS}).",
            f"{where}, key columns",
            "write column and unit of each.",
        )
        return {}
    units = cast(dict[str, Any], value)
    for column, unit in units.items():
        if not isinstance(unit, str) or not is_known_unit(unit):
            findings.add(
                f"The unit {unit!r} is not known.",
                f"{where}, column {column}",
                f"use one of: {', '.join(KNOWN_UNITS)}.",
            )
    if time not in units:
        findings.add(
            f"The time column '{time}' is not among the columns.",
            f"{where}, key time",
            "name one of the columns.",
        )
    elif isinstance(units[time], str) and is_known_unit(units[time]) and quantity_of(units[time]) != "time":
        findings.add(
            f"The time column is in '{units[time]}', which is no unit of time.",
            f"{where}, column {time}",
            "use s, ms or us.",
        )
    return cast(dict[str, str], units)

"""Recordings into MCAP files, in bounded memory, hashed while they are written.

The file: header, the attachment `recording.json`, a metadata record with the main facts, schema and
channel of each stream, then chunks of one stream each with their message index, and a summary that
finds everything (`mcap_file`).
"""

import contextlib
import json
import os
import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Metadata, Schema
from numpy.typing import NDArray

from protocol.adapters.mcap_file import McapFile
from protocol.adapters.sample_messages import SampleLayout, log_times_ns
from protocol.attempts import RecordingReference
from protocol.durable_files import WholeOrNothing, sync
from protocol.recording_checks import Findings, check_stream, checked_columns
from protocol.recording_document import DOCUMENT_NAME, document_of, types_of
from protocol.recordings import FORMAT, Recording
from protocol.units_of_measure import factor_to_si

METADATA_NAME = "testloom"
MESSAGE_ENCODING = SCHEMA_ENCODING = "protobuf"
CHUNK_BYTES = 2 << 20
"""Size of a chunk before compression: what is held in memory for each stream, and what a damaged byte
costs at most."""


class McapRecordingWriter(WholeOrNothing):
    """Writes one recording while it is being made.

        empty = Recording(…, streams={"dut": Stream(…, columns={"t": np.empty(0), …})})
        with McapRecordingWriter(path, empty) as writer:
            writer.append("dut", {"t": …, "gyro_x": …})
        reference = writer.reference

    The file appears under its name when it is closed, whole; until then it is `<name>.….part`, where
    two that write at once are not in each other's way. Leaving the `with` block by an exception
    discards it. Samples are written as they come: what is wrong with their times is found when the
    recording is read.
    """

    def __init__(self, path: Path | str, description: Recording) -> None:
        """Open the file.

        Args:
            path: the file to write; replaced if it exists.
            description: the recording with streams that have no samples yet (any that are there are
                ignored): their arrays give the types.

        Raises:
            RecordingError: a stream has a type or unit that cannot be kept, or the disk refuses.
        """
        self._path = Path(path)
        self._unfinished = self._path.with_name(f"{self._path.name}.{secrets.token_hex(4)}.part")
        self._layouts = _layouts(description)
        self._time_units = {
            name: (stream.time, factor_to_si(stream.units[stream.time]))
            for name, stream in description.streams.items()
        }
        self._epoch_ns = _epoch_ns(description)
        self._pending: dict[str, list[NDArray[np.void]]] = {name: [] for name in self._layouts}
        self._counts = dict.fromkeys(self._layouts, 0)
        self._reference: RecordingReference | None = None
        self._file: BufferedWriter | None = None
        with self._discarded_if_refused():
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._unfinished.open("wb")
            self._mcap = self._begin(description)

    def append(self, stream: str, columns: Mapping[str, NDArray[Any]]) -> None:
        """Add samples to a stream: every column, shape (n,).

        Raises:
            RecordingError: the columns are not those declared, or the disk refuses; the file is
                discarded in the second case.
        """
        layout = self._layouts[stream]
        count = checked_columns(stream, layout.types, columns)
        time, unit_s = self._time_units[stream]
        per_chunk = max(1, CHUNK_BYTES // layout.record.itemsize)
        for start in range(0, count, per_chunk):
            piece = {name: columns[name][start : start + per_chunk] for name in layout.types}
            log_times = log_times_ns(piece[time], unit_s, self._epoch_ns)
            self._pending[stream].append(layout.encode(piece, self._counts[stream], log_times))
            self._counts[stream] += len(log_times)
            if sum(map(len, self._pending[stream])) >= per_chunk:
                with self._discarded_if_refused():
                    self._flush(stream)

    def close(self) -> RecordingReference:
        """Finish the file and give it its name; what it is, by its SHA-256.

        Raises:
            RecordingError: the disk refuses; nothing is left of the file.
        """
        if self._reference is not None:
            return self._reference
        assert self._file is not None, "the recording was discarded"
        with self._discarded_if_refused():
            for stream in self._pending:
                self._flush(stream)
            self._mcap.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._unfinished.replace(self._path)
            sync(self._path.parent)
        self._reference = RecordingReference(
            sha256=self._mcap.sha256,
            path=str(self._path),
            size_bytes=self._mcap.size_bytes,
            sample_count=sum(self._counts.values()),
        )
        return self._reference

    def discard(self) -> None:
        """Stop, and leave no file."""
        if self._file is not None and self._reference is None:
            with contextlib.suppress(OSError):  # a full disk refuses the last buffer once more
                self._file.close()
            self._unfinished.unlink(missing_ok=True)
            self._file = None

    @property
    def reference(self) -> RecordingReference:
        """What was written, once it is closed."""
        assert self._reference is not None, "the recording is not closed"
        return self._reference

    def _begin(self, description: Recording) -> McapFile:
        types = {name: {"types": types_of(stream)} for name, stream in description.streams.items()}
        document = json.dumps(document_of(description, types), ensure_ascii=False, indent=1).encode()
        assert self._file is not None
        mcap = McapFile(self._file)
        mcap.add_attachment(
            Attachment(self._epoch_ns, self._epoch_ns, DOCUMENT_NAME, "application/json", document)
        )
        mcap.add_metadata(Metadata(METADATA_NAME, _main_facts(description)))
        for layout in self._layouts.values():
            schema = Schema(
                id=layout.channel_id, name=layout.schema_name, encoding=SCHEMA_ENCODING, data=layout.schema()
            )
            mcap.add_channel(schema, _channel(layout, description))
        return mcap

    def _flush(self, stream: str) -> None:
        """Write the pending samples of a stream as one chunk."""
        pending = self._pending[stream]
        self._pending[stream] = []
        if pending:
            rows = pending[0] if len(pending) == 1 else np.concatenate(pending)
            self._mcap.add_chunk(self._layouts[stream].channel_id, rows)


def write_mcap(recording: Recording, path: Path | str) -> RecordingReference:
    """Write a whole recording; what was written, by its SHA-256.

    Raises:
        RecordingError: the recording is not sound, or the disk refuses; no half file is left.
    """
    findings = Findings()
    for name, stream in recording.streams.items():
        where = f"{recording.recording_id}, stream {name}"
        check_stream(stream.columns, stream.units, stream.time, where, findings)
    findings.raise_first()
    with McapRecordingWriter(path, recording) as writer:
        for name, stream in recording.streams.items():
            writer.append(name, {column: stream.columns[column] for column in stream.units})
    return writer.reference


def topic_of(stream: str) -> str:
    """The MCAP topic of a stream."""
    return f"/{stream}"


def _layouts(description: Recording) -> dict[str, SampleLayout]:
    findings = Findings()
    for name, stream in description.streams.items():
        empty = {column: stream.columns[column][:0] for column in stream.units}
        check_stream(empty, stream.units, stream.time, f"{description.recording_id}, stream {name}", findings)
    findings.raise_first()
    return {
        name: SampleLayout(name, number, types_of(stream), dict(stream.units))
        for number, (name, stream) in enumerate(description.streams.items(), 1)
    }


def _channel(layout: SampleLayout, description: Recording) -> Channel:
    stream = description.streams[layout.stream]
    metadata = {"clock": stream.clock, "time": stream.time}
    metadata |= {f"unit of {column}": unit for column, unit in layout.units.items()}
    return Channel(
        id=layout.channel_id,
        topic=topic_of(layout.stream),
        message_encoding=MESSAGE_ENCODING,
        metadata=metadata,
        schema_id=layout.channel_id,
    )


def _main_facts(description: Recording) -> dict[str, str]:
    """What `mcap info` and Foxglove show of a recording; the whole is in the attachment."""
    facts = {"format": FORMAT, "recording_id": description.recording_id}
    for prefix, mapping in (
        ("unit", description.unit),
        ("test", description.test),
        ("stand", description.stand),
    ):
        facts |= {f"{prefix}.{key}": str(value) for key, value in mapping.items()}
    return facts


def _epoch_ns(description: Recording) -> int:
    """When the test began, for showing its samples at their date; the year 1970 if it is not said."""
    started_at = description.test.get("started_at")
    if not isinstance(started_at, str):
        return 0
    try:
        started = datetime.fromisoformat(started_at)
    except ValueError:
        return 0
    started = started if started.tzinfo else started.replace(tzinfo=UTC)
    return max(0, int(started.timestamp() * 1e6) * 1000)

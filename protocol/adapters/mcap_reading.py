"""Recordings out of MCAP files: summary → chunk index → decompress → CRC → arrays.

Every byte of a file is covered by a CRC or compared: a damaged or truncated file is an error that
names the chunk, its rows and its bytes. Files that other tools have rewritten (chunks of several
channels, other compression) are read too, as long as the attachment `recording.json` is kept.
"""

import mmap
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from protocol.adapters.mcap_file import FOOTER_CONTENT_BYTES
from protocol.adapters.mcap_writing import topic_of
from protocol.adapters.sample_messages import MESSAGE_HEAD_BYTES, MESSAGE_OPCODE, SampleLayout
from protocol.recording_checks import Findings, check_stream
from protocol.recording_document import DOCUMENT_NAME, RecordingDocument, StreamDescription, parse_document
from protocol.recordings import Recording, Stream

MAX_CHUNK_BYTES = 1 << 28
"""A chunk that says it is larger, decompressed, is damaged or was not made for streaming."""

_MAGIC_BYTES = len(MCAP0_MAGIC)
_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_CHUNK_HEAD = struct.Struct("<QQQI")
_RESTORE = "copy it again from the station that recorded it."

R = TypeVar("R")


class _DamagedError(Exception):
    """What is wrong and in which bytes, on the way to the findings."""

    def __init__(self, what: str, where: str) -> None:
        super().__init__(what)
        self.what = what
        self.where = where


def read_mcap(path: Path | str) -> Recording:
    """The recording in an MCAP file.

    Raises:
        RecordingError: it is damaged, cut short or no recording of ours; the error names the first
            thing found, its story the others.
    """
    findings = Findings()
    recording = examine_mcap(Path(path), findings)
    findings.raise_first()
    assert recording is not None
    return recording


def examine_mcap(path: Path, findings: Findings) -> Recording | None:
    """Read a file and report everything that is wrong with it; None if it cannot be used."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            if size < len(MCAP0_MAGIC):
                findings.add("The file is empty or cut short.", f"{path}, byte {size}", _RESTORE)
                return None
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped, memoryview(mapped) as data:
                return _examine(data, str(path), findings)
    except OSError as error:
        findings.add(f"The file cannot be read: {error.strerror or error}.", str(path), "check its name.")
        return None


def _examine(data: memoryview, where: str, findings: Findings) -> Recording | None:
    try:
        summary = _read_summary(data)
        text = _document_text(data, summary)
    except _DamagedError as damage:
        findings.add(damage.what, f"{where}, {damage.where}", _RESTORE)
        return None
    document = parse_document(text, f"{where}, attachment {DOCUMENT_NAME}", findings)
    if document is None:
        return None
    columns = _read_samples(data, summary, document, where, findings)
    has_crc = summary.data_crc != 0  # other tools may leave it out
    if not findings.errors and has_crc and zlib.crc32(data[: summary.data_end]) != summary.data_crc:
        findings.add(
            "The file is damaged outside its samples: the CRC of the data section is wrong.",
            f"{where}, bytes 0 to {summary.data_end}",
            _RESTORE,
        )
    if findings.errors:
        return None
    streams = {
        described.name: _checked_stream(described, columns[described.name], where, findings)
        for described in document.streams
    }
    return None if findings.errors else document.recording(streams)


@dataclass(frozen=True)
class _Summary:
    """What the end of a file says about the rest of it."""

    channels: dict[int, Channel]
    chunks: list[ChunkIndex]
    attachments: list[AttachmentIndex]
    statistics: Statistics | None
    data_end: int
    data_crc: int


def _read_summary(data: memoryview) -> _Summary:
    """The summary, whose CRC is right."""
    end = len(data)
    if data[:_MAGIC_BYTES] != MCAP0_MAGIC:
        raise _DamagedError("This is no MCAP file, or its beginning is damaged.", "byte 0")
    footer_at = end - _MAGIC_BYTES - _FOOTER.size
    if footer_at < _MAGIC_BYTES or data[end - _MAGIC_BYTES :] != MCAP0_MAGIC:
        raise _cut_short(data)
    opcode, length, start, _, crc = _FOOTER.unpack_from(data, footer_at)
    sound = opcode == Opcode.FOOTER and length == FOOTER_CONTENT_BYTES
    if not sound or not _MAGIC_BYTES + _DATA_END.size <= start <= footer_at:
        raise _DamagedError("The footer is damaged.", f"bytes {footer_at} to {end}")
    if crc and zlib.crc32(data[start : end - _MAGIC_BYTES - 4]) != crc:
        raise _DamagedError("The summary is damaged: its CRC is wrong.", f"bytes {start} to {end}")
    opcode, length, data_crc = _DATA_END.unpack_from(data, start - _DATA_END.size)
    if opcode != Opcode.DATA_END or length != 4:
        raise _DamagedError("The end of the data is damaged.", f"bytes {start - _DATA_END.size} to {start}")
    found: dict[int, list[Any]] = {code: [] for code in (4, 8, 10, 11)}
    readers: dict[int, Callable[[ReadDataStream], Any]] = {
        Opcode.CHANNEL: Channel.read,
        Opcode.CHUNK_INDEX: ChunkIndex.read,
        Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
        Opcode.STATISTICS: Statistics.read,
    }
    for at, opcode, content in _records(data[start:footer_at]):
        if opcode in readers:
            found[opcode].append(_parsed(readers[opcode], content, f"byte {start + at}"))
    return _Summary(
        channels={channel.id: channel for channel in found[Opcode.CHANNEL]},
        chunks=sorted(found[Opcode.CHUNK_INDEX], key=lambda chunk: chunk.chunk_start_offset),
        attachments=found[Opcode.ATTACHMENT_INDEX],
        statistics=found[Opcode.STATISTICS][0] if found[Opcode.STATISTICS] else None,
        data_end=start - _DATA_END.size,
        data_crc=data_crc,
    )


def _records(data: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Offset, opcode and content of each whole record."""
    at = 0
    while at + _RECORD_HEAD.size <= len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        end = at + _RECORD_HEAD.size + length
        if end > len(data):
            return
        yield at, opcode, data[at + _RECORD_HEAD.size : end]
        at = end


def _parsed(read: Callable[[ReadDataStream], R], content: memoryview, where: str) -> R:
    try:
        return read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise _DamagedError(f"A record is damaged: {error or type(error).__name__}.", where) from None


def _cut_short(data: memoryview) -> _DamagedError:
    """The error for a file without its end: how far it can be followed."""
    last, chunks = _MAGIC_BYTES, 0
    for at, opcode, content in _records(data[_MAGIC_BYTES:]):
        last = _MAGIC_BYTES + at + _RECORD_HEAD.size + len(content)
        chunks += opcode == Opcode.CHUNK
    return _DamagedError(
        f"The file is cut short or was never closed: its end is missing ({chunks} whole chunks are there).",
        f"byte {len(data)}; its last whole record ends at byte {last}",
    )


def _document_text(data: memoryview, summary: _Summary) -> str:
    """The attachment `recording.json`, whose CRC is right."""
    index = next((index for index in summary.attachments if index.name == DOCUMENT_NAME), None)
    if index is None:
        raise _DamagedError(
            f"The file has no attachment {DOCUMENT_NAME}: it is no recording of ours.", "summary"
        )
    end = index.offset + index.length
    where = f"bytes {index.offset} to {end}, attachment {DOCUMENT_NAME}"
    content = data[index.offset + _RECORD_HEAD.size : end - 4]
    if end > summary.data_end or len(content) < index.data_size:
        raise _DamagedError("The attachment lies outside the file.", where)
    if zlib.crc32(content) != int.from_bytes(data[end - 4 : end], "little"):
        raise _DamagedError("The attachment is damaged: its CRC is wrong.", where)
    try:
        return bytes(content[len(content) - index.data_size :]).decode()
    except UnicodeDecodeError as error:
        raise _DamagedError(f"The attachment is no text: {error}.", where) from None


def _layouts(
    summary: _Summary, document: RecordingDocument, where: str, findings: Findings
) -> dict[int, SampleLayout]:
    """Channel id → layout, for each stream of the document."""
    by_topic = {channel.topic: channel.id for channel in summary.channels.values()}
    layouts: dict[int, SampleLayout] = {}
    for stream in document.streams:
        channel_id = by_topic.get(topic_of(stream.name))
        untyped = [column for column in stream.units if column not in stream.types]
        if channel_id is None or untyped:
            what = f"no type for {untyped[0]}" if untyped else f"no channel {topic_of(stream.name)}"
            findings.add(
                f"The stream '{stream.name}' cannot be read: there is {what}.", f"{where}, summary", _RESTORE
            )
            continue
        types = {column: stream.types[column] for column in stream.units}
        layouts[channel_id] = SampleLayout(stream.name, channel_id, types, stream.units)
    return layouts


def _read_samples(
    data: memoryview, summary: _Summary, document: RecordingDocument, where: str, findings: Findings
) -> dict[str, Mapping[str, NDArray[Any]]]:
    """Stream → columns; every damaged chunk is in the findings."""
    layouts = _layouts(summary, document, where, findings)
    statistics = summary.statistics
    expected = statistics.channel_message_counts if statistics is not None else {}
    columns = {
        layout.stream: {
            # what the samples say is decoded into; the size is bounded by the file, not by its claims
            column: np.empty(_claimed(expected.get(channel_id, 0), layout, summary), dtype=kind)
            for column, kind in layout.types.items()
        }
        for channel_id, layout in layouts.items()
    }
    filled = dict.fromkeys(layouts, 0)
    for number, chunk in enumerate(summary.chunks, 1):
        here = f"chunk {number} of {len(summary.chunks)}"
        try:
            content = _chunk_content(data, chunk, here)
            for channel_id, rows in _rows_of(content, layouts, here):
                layout = layouts[channel_id]
                start = filled[channel_id]
                filled[channel_id] += len(rows)
                if filled[channel_id] <= expected.get(channel_id, 0):
                    layout.decode_into(rows, columns[layout.stream], start)
        except _DamagedError as damage:
            place = _lost_rows(chunk, layouts, filled)
            findings.add(damage.what, f"{where}, {damage.where}, {place}", _RESTORE)
    for channel_id, layout in layouts.items():
        if not findings.errors and filled[channel_id] != expected.get(channel_id, 0):
            findings.add(
                f"The file has {filled[channel_id]} of {expected.get(channel_id, 0)} samples.",
                f"{where}, stream {layout.stream}, row {filled[channel_id] + 1}",
                _RESTORE,
            )
    return dict(columns)


def _lost_rows(chunk: ChunkIndex, layouts: Mapping[int, SampleLayout], filled: dict[int, int]) -> str:
    """Stream and rows of a chunk that cannot be read; counts them, so that later rows keep their numbers."""
    held = [layouts[channel_id] for channel_id in chunk.message_index_offsets if channel_id in layouts]
    if len(held) != 1:
        return f"streams {', '.join(layout.stream for layout in held) or 'unknown'}"
    (layout,) = held
    first = filled[layout.channel_id] + 1
    filled[layout.channel_id] += chunk.uncompressed_size // layout.record.itemsize
    return f"stream {layout.stream}, rows {first} to {filled[layout.channel_id]}"


def _claimed(count: int, layout: SampleLayout, summary: _Summary) -> int:
    """Samples that the statistics claim, unless the chunks cannot hold so many."""
    room = sum(chunk.uncompressed_size for chunk in summary.chunks) // layout.record.itemsize
    return min(count, room)


def _chunk_content(data: memoryview, chunk: ChunkIndex, here: str) -> bytes | memoryview:
    """The decompressed records of a chunk, whose CRC is right."""
    at, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
    here = f"{here}, bytes {at} to {end}"
    head = at + _RECORD_HEAD.size
    compression = chunk.compression.encode()
    body = head + _CHUNK_HEAD.size + 4 + len(compression) + 8
    if end > len(data) or body + chunk.compressed_size != end or chunk.uncompressed_size > MAX_CHUNK_BYTES:
        raise _DamagedError("The chunk does not fit its index.", here)
    _, _, size, crc = _CHUNK_HEAD.unpack_from(data, head)
    if size != chunk.uncompressed_size:
        raise _DamagedError("The chunk does not fit its index.", here)
    try:
        content = _decompressed(data[body:end], chunk.compression, size)
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError) as error:
        raise _DamagedError(f"The chunk is damaged: it cannot be decompressed ({error}).", here) from None
    if len(content) != size or (crc and zlib.crc32(content) != crc):
        raise _DamagedError("The chunk is damaged: its CRC is wrong.", here)
    return content


def _decompressed(content: memoryview, compression: str, size: int) -> bytes | memoryview:
    """At most about `size` bytes, whatever the content itself claims to hold."""
    if compression == "zstd":
        claimed = zstandard.frame_content_size(content)
        if claimed > size:
            raise ValueError(f"its content would be {claimed} bytes, not {size}")
        return zstandard.ZstdDecompressor().decompress(content, max_output_size=size)
    if compression == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor().decompress(content, max_length=size)
    if compression == "":
        return content
    raise ValueError(f"the compression '{compression}' is not known")


def _rows_of(
    content: bytes | memoryview, layouts: Mapping[int, SampleLayout], here: str
) -> Iterator[tuple[int, NDArray[np.void]]]:
    """Channel id and message records of each channel in a chunk."""
    if len(content) > MESSAGE_HEAD_BYTES + 2 and content[0] == MESSAGE_OPCODE:
        layout = layouts.get(int.from_bytes(content[9:11], "little"))
        if layout is not None and len(content) % layout.record.itemsize == 0:
            rows = np.frombuffer(content, dtype=layout.record)
            if layout.fits(rows):
                yield layout.channel_id, rows
                return
    # written by another tool: sort the records of the chunk by channel
    pieces: dict[int, list[memoryview]] = {}
    view = memoryview(content)
    for at, opcode, message in _records(view):
        if opcode == MESSAGE_OPCODE:
            record = view[at : at + MESSAGE_HEAD_BYTES + len(message)]
            pieces.setdefault(int.from_bytes(message[:2], "little"), []).append(record)
    for channel_id, records in pieces.items():
        layout = layouts.get(channel_id)
        if layout is None:
            continue
        if any(len(record) != layout.record.itemsize for record in records):
            raise _DamagedError("Messages do not have the length of their schema.", here)
        rows = np.frombuffer(b"".join(records), dtype=layout.record)
        if not layout.fits(rows):
            raise _DamagedError("Messages do not have the fields of their schema.", here)
        yield channel_id, rows


def _checked_stream(
    described: StreamDescription, columns: Mapping[str, NDArray[Any]], where: str, findings: Findings
) -> Stream:
    own = Findings(notes=findings.notes)
    place = f"{where}, stream {described.name}"
    check_stream(columns, described.units, described.time, place, own)
    if not own.errors and not len(columns[described.time]):
        own.notes.append(f"{place}: the stream has no samples.")
    findings.errors += own.errors
    return Stream(described.name, described.clock, described.time, described.units, columns, described.extra)

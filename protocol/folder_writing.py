"""Recordings into the folder form while they are made, in bounded memory.

The counterpart of `McapRecordingWriter`, with its interface. Samples are written as they come: what is wrong
with their times is found when the recording is read.
"""

import contextlib
import json
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.durable_files import WholeOrNothing, sync
from protocol.errors import Fault, RecordingError
from protocol.recording_checks import Findings, check_stream, checked_columns
from protocol.recording_document import DOCUMENT_NAME, document_of, types_of
from protocol.recordings import Recording
from protocol.stream_files import StreamFormat, for_arrow

ROWS_PER_WRITE = 65_536
"""So many samples of a stream are gathered before they go to the disk: a row group of Parquet."""
COPY_BYTES = 1 << 20
ZIP_LEVEL = 1
"""Samples are mostly noise: more effort takes several times as long for some percent of the size."""

Columns = Mapping[str, NDArray[Any]]


class FolderRecordingWriter(WholeOrNothing):
    """Writes one recording while it is being made.

        empty = Recording(…, streams={"dut": Stream(…, columns={"t": np.empty(0), …})})
        with FolderRecordingWriter(path, empty, "parquet") as writer:
            writer.append("dut", {"t": …, "gyro_x": …})

    The folder appears under its name when it is closed, whole; until then it is hidden beside it. Leaving
    the `with` block by an exception discards it.
    """

    def __init__(self, path: Path | str, description: Recording, stream_format: StreamFormat = "npz") -> None:
        """Open the folder.

        Args:
            path: the folder to write; must not exist.
            description: the recording with streams that have no samples yet (any that are there are
                ignored): their arrays give the types.
            stream_format: of the streams' files.

        Raises:
            RecordingError: the folder exists, a stream has a type or unit that cannot be kept, or the
                disk refuses.
        """
        self._path = Path(path)
        self._description = description
        self._format: StreamFormat = stream_format
        self._types = {name: types_of(stream) for name, stream in description.streams.items()}
        if self._path.exists():
            raise RecordingError(
                "There is something of this name already.",
                where=str(self._path),
                fault=Fault.OPERATOR,
                remedy="choose another name, or move it away.",
            )
        _check_declared(description)
        self._pending: dict[str, list[Columns]] = {name: [] for name in self._types}
        self._rows = dict.fromkeys(self._types, 0)
        self._written = dict.fromkeys(self._types, 0)
        self._unfinished: Path | None = None
        self._files: dict[str, _StreamFile] = {}
        with self._discarded_if_refused():
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._unfinished = Path(
                tempfile.mkdtemp(prefix=f".{self._path.name}.", suffix=".part", dir=self._path.parent)
            )
            for name, types in self._types.items():
                file = self._unfinished / f"{name}.{stream_format}"
                self._files[name] = _KINDS[stream_format](file, types)

    def append(self, stream: str, columns: Columns) -> None:
        """Add samples to a stream: every column, shape (n,).

        Raises:
            RecordingError: the columns are not those declared, or the disk refuses; the folder is
                discarded in the second case.
        """
        types = self._types[stream]
        count = checked_columns(stream, types, columns)
        self._pending[stream].append(
            {name: columns[name].astype(kind, copy=True) for name, kind in types.items()}
        )
        self._rows[stream] += count
        if self._rows[stream] - self._written[stream] >= ROWS_PER_WRITE:
            with self._discarded_if_refused():
                self._flush(stream)

    def close(self) -> None:
        """Finish the folder and give it its name.

        Raises:
            RecordingError: the disk refuses; nothing is left of the folder.
        """
        if self._unfinished is None:
            return
        with self._discarded_if_refused():
            for name, file in self._files.items():
                self._flush(name)
                file.finish()
                sync(self._unfinished / f"{name}.{self._format}")
            self._write_document(self._unfinished / DOCUMENT_NAME)
            sync(self._unfinished)
            self._unfinished.chmod(0o755)
            self._unfinished.rename(self._path)
            self._unfinished = None
            sync(self._path.parent)

    def discard(self) -> None:
        """Stop, and leave no folder."""
        for file in self._files.values():
            with contextlib.suppress(OSError):  # a full disk refuses the last buffer once more
                file.abandon()
        if self._unfinished is not None:
            shutil.rmtree(self._unfinished, ignore_errors=True)
            self._unfinished = None

    def _flush(self, stream: str) -> None:
        pending = self._pending[stream]
        self._pending[stream] = []
        if pending:
            joined = {name: np.concatenate([piece[name] for piece in pending]) for name in pending[0]}
            self._files[stream].write(joined)
            self._written[stream] = self._rows[stream]

    def _write_document(self, path: Path) -> None:
        described = {}
        for name, rows in self._rows.items():
            described[name] = {"file": f"{name}.{self._format}", "rows": rows}
            if self._format == "csv":
                described[name]["types"] = self._types[name]
        text = json.dumps(document_of(self._description, described), indent=1, ensure_ascii=False)
        path.write_text(text + "\n", encoding="utf-8")
        sync(path)


class _StreamFile(Protocol):
    """The file of a stream, written piece by piece."""

    def write(self, columns: Columns) -> None:
        """Add rows."""
        ...

    def finish(self) -> None:
        """Make it whole."""
        ...

    def abandon(self) -> None:
        """Let it go, as it is."""
        ...


class _NpzFile:
    """Columns go into raw files; an .npz member begins with its number of rows, which the end tells."""

    def __init__(self, path: Path, types: Mapping[str, str]) -> None:
        self._path = path
        self._types = types
        self._raw = {name: path.with_suffix(f".{number}.raw") for number, name in enumerate(types)}
        for raw in self._raw.values():
            raw.touch(exist_ok=False)

    def write(self, columns: Columns) -> None:
        for name, raw in self._raw.items():
            with raw.open("ab") as file:
                file.write(np.ascontiguousarray(columns[name]).data)

    def finish(self) -> None:
        with zipfile.ZipFile(self._path, "x", zipfile.ZIP_DEFLATED, compresslevel=ZIP_LEVEL) as archive:
            for name, raw in self._raw.items():
                kind = np.dtype(self._types[name])
                header = {
                    "descr": np.lib.format.dtype_to_descr(kind),
                    "fortran_order": False,
                    "shape": (raw.stat().st_size // kind.itemsize,),
                }
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member, raw.open("rb") as file:
                    np.lib.format.write_array_header_1_0(member, header)
                    shutil.copyfileobj(file, member, COPY_BYTES)
                raw.unlink()

    def abandon(self) -> None:
        pass


class _ArrowFile:
    """A table of CSV or Parquet; see `stream_files.write_columns` for the types."""

    def __init__(self, path: Path, types: Mapping[str, str]) -> None:
        import pyarrow as pa

        self._suffix = path.suffix
        empty = {name: np.empty(0, dtype=kind) for name, kind in types.items()}
        self._schema = self._table(empty).schema
        self._sink = pa.OSFile(str(path), "wb")
        if self._suffix == ".csv":
            import pyarrow.csv

            self._writer: Any = pyarrow.csv.CSVWriter(self._sink, self._schema)
        else:
            import pyarrow.parquet

            self._writer = pyarrow.parquet.ParquetWriter(
                self._sink, self._schema, compression="zstd", write_page_checksum=True
            )

    def write(self, columns: Columns) -> None:
        self._writer.write_table(self._table(columns))

    def finish(self) -> None:
        self._writer.close()
        self._sink.close()

    def abandon(self) -> None:
        try:
            self._writer.close()
        finally:
            self._sink.close()

    def _table(self, columns: Columns) -> Any:
        import pyarrow as pa

        return pa.table({name: pa.array(for_arrow(column, self._suffix)) for name, column in columns.items()})


_KINDS: dict[StreamFormat, type[_NpzFile] | type[_ArrowFile]] = {
    "npz": _NpzFile,
    "csv": _ArrowFile,
    "parquet": _ArrowFile,
}


def _check_declared(description: Recording) -> None:
    """Types and units, before the first sample."""
    findings = Findings()
    for name, stream in description.streams.items():
        empty = {column: stream.columns[column][:0] for column in stream.units}
        check_stream(empty, stream.units, stream.time, f"{description.recording_id}, stream {name}", findings)
    findings.raise_first()

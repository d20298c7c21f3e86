"""The files that hold a stream's columns in the folder form: .npz, .csv and .parquet.

Each reader takes damaged files, missing and undeclared columns for what they are and says where;
what the numbers mean is checked elsewhere (`recording_checks`).
"""

import csv
import io
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from protocol.recording_checks import Findings, duplicates

StreamFormat = Literal["npz", "csv", "parquet"]
STREAM_FORMATS: tuple[StreamFormat, ...] = ("npz", "csv", "parquet")

MISSING_IN_TEXT = ("", "nan", "NaN", "NAN")
"""How a text file may write a missing value. No other word is one."""

MAX_BAD_CELLS = 20
"""After so many unreadable cells the rest of a text file is not searched for more."""

_EXPORT_AGAIN = "export or copy the file again: it is damaged or cut short."

Columns = dict[str, NDArray[Any]]


def read_columns(path: Path, declared: Mapping[str, str], findings: Findings) -> Columns | None:
    """The columns of a stream's file; None, and the reasons in `findings`, if they cannot be had.

    Args:
        path: the file; its suffix says what it is.
        declared: column → type of its samples where the document says it, else "".
        findings: gets what is wrong.
    """
    readers = {".npz": _read_npz, ".csv": _read_csv, ".parquet": _read_parquet}
    reader = readers.get(path.suffix)
    if reader is None:
        findings.add(
            f"A stream cannot be read from a file of the kind '{path.suffix}'.",
            str(path),
            f"use one of: {', '.join(readers)}.",
        )
        return None
    try:
        return reader(path, declared, findings)
    except FileNotFoundError:
        findings.add("The file of the stream is missing.", str(path), "copy the whole folder again.")
    except OSError as error:
        findings.add(
            f"The file cannot be read: {error.strerror or error}.", str(path), "check disk and rights."
        )
    return None


def write_columns(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write the columns into a new file; its suffix says what it is.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    if path.suffix == ".npz":
        with path.open("xb") as file:
            np.savez_compressed(file, allow_pickle=False, **columns)
        return
    import pyarrow as pa

    table = pa.table({name: pa.array(for_arrow(column, path.suffix)) for name, column in columns.items()})
    if path.suffix == ".csv":
        import pyarrow.csv

        pyarrow.csv.write_csv(table, path)
        return
    import pyarrow.parquet

    pyarrow.parquet.write_table(table, path, compression="zstd", write_page_checksum=True)


def for_arrow(column: NDArray[Any], suffix: str) -> NDArray[Any]:
    """A column as arrow writes it: native byte order; for text, float32 by its exact value as float64 and
    truth values as 0 and 1.
    """
    native = column.astype(column.dtype.newbyteorder("="), copy=False)
    if suffix == ".csv" and native.dtype == np.float32:
        return native.astype(np.float64)
    if suffix == ".csv" and native.dtype == np.bool_:
        return native.astype(np.uint8)
    return native


def _check_names(found: list[str], declared: Iterable[str], path: Path, findings: Findings) -> bool:
    """True if the file has the declared columns, each once, and no other."""
    wanted = list(declared)
    for name in duplicates(found):
        findings.add("The column stands twice in the file.", f"{path}, column {name}", "rename one of them.")
    for name in wanted:
        if name not in found:
            findings.add(
                "The column is missing.",
                f"{path}, column {name}; the file has: {', '.join(found) or 'none'}",
                "export the file with this column, or take it out of recording.json.",
            )
    for name in found:
        if name not in wanted:
            findings.add(
                "The column is not described in recording.json: its unit is not known.",
                f"{path}, column {name}",
                "add it with its unit to the stream's columns, or leave it out of the file.",
            )
    return set(found) == set(wanted) and len(found) == len(wanted)


def _read_npz(path: Path, declared: Mapping[str, str], findings: Findings) -> Columns | None:
    try:
        with zipfile.ZipFile(path) as archive:
            members = {name.removesuffix(".npy"): name for name in archive.namelist()}
            if not _check_names(list(members), declared, path, findings):
                return None
            return {name: _npy(archive, members[name], path, findings) for name in declared}
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
        findings.add(f"The file is no whole .npz file: {error}.", str(path), _EXPORT_AGAIN)
    return None


def _npy(archive: zipfile.ZipFile, member: str, path: Path, findings: Findings) -> NDArray[Any]:
    import zlib

    try:
        content = archive.read(member)  # the whole of it: only then does zipfile compare the CRC
        return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, OSError, MemoryError) as error:
        column = member.removesuffix(".npy")
        findings.add(f"The column is damaged: {error}.", f"{path}, column {column}", _EXPORT_AGAIN)
        return np.empty(0)


def _read_parquet(path: Path, declared: Mapping[str, str], findings: Findings) -> Columns | None:
    import pyarrow as pa
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(path, page_checksum_verification=True) as file:
            if not _check_names(list(file.schema_arrow.names), declared, path, findings):
                return None
            table = file.read(use_threads=False)
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        findings.add(f"The file is no whole Parquet file: {_one_line(error)}.", str(path), _EXPORT_AGAIN)
        return None
    return {name: table.column(name).to_numpy() for name in declared}


def _read_csv(path: Path, declared: Mapping[str, str], findings: Findings) -> Columns | None:
    import pyarrow as pa
    import pyarrow.csv

    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header = next(csv.reader(file), [])
    except (UnicodeDecodeError, csv.Error) as error:
        findings.add(f"The file is no text with columns: {error}.", str(path), _EXPORT_AGAIN)
        return None
    if not _check_names(header, declared, path, findings):
        return None
    as_said = {name: _arrow_type(kind) for name, kind in declared.items() if kind}
    try:
        table = pyarrow.csv.read_csv(
            path,
            read_options=pyarrow.csv.ReadOptions(use_threads=False),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=as_said, null_values=list(MISSING_IN_TEXT), strings_can_be_null=False
            ),
        )
    except (pa.ArrowException, UnicodeDecodeError) as error:
        _find_bad_cells(path, header, findings, _one_line(error))
        return None
    numeric = all(
        pa.types.is_integer(field.type) or pa.types.is_floating(field.type) or pa.types.is_null(field.type)
        for field in table.schema
    )
    if not numeric:
        _find_bad_cells(path, header, findings, "a column holds other things than numbers")
        return None
    if not _ends_with_newline(path):
        findings.notes.append(f"{path}: the last row has no end of line: it may have been cut short.")
    return {name: _from_text(table.column(name), declared[name]) for name in declared}


def _arrow_type(kind: str) -> Any:
    """How a text column of this type is parsed."""
    import pyarrow as pa

    return pa.from_numpy_dtype({"float32": "float64", "bool": "uint8"}.get(kind, kind))


def _from_text(column: Any, kind: str) -> NDArray[Any]:
    """A parsed text column as array: missing values are NaN, where the type has one."""
    import pyarrow as pa

    samples = column.cast(pa.float64()).to_numpy() if column.null_count else column.to_numpy()
    fits = kind.startswith("float") or not column.null_count  # an integer cannot be missing
    return samples.astype(kind) if kind and fits else samples


def _find_bad_cells(path: Path, header: list[str], findings: Findings, otherwise: str) -> None:
    """Name the cells that hold no number, or say `otherwise` where none is to be found."""
    bad = 0
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.reader(file)
        next(rows, None)
        for number, cells in enumerate((row for row in rows if row), 1):
            for name, what in _bad_cells(header, cells):
                where = f"{path}, column {name}, row {number} (line {rows.line_num})"
                findings.add(what, where, "write numbers with a decimal point, a missing value as nan.")
                bad += 1
            if bad >= MAX_BAD_CELLS:
                return
    if not bad:
        findings.add(f"The file cannot be read: {otherwise}.", str(path), _EXPORT_AGAIN)


def _bad_cells(header: list[str], cells: list[str]) -> list[tuple[str, str]]:
    """Column and fault of each cell of a row that is missing or no number."""
    if len(cells) != len(header):
        last = header[min(len(cells), len(header)) - 1]
        return [(last, f"The row has {len(cells)} of {len(header)} values: it was cut short or split.")]
    return [
        (name, f"{cell[:40]!r} is no number.")
        for name, cell in zip(header, cells, strict=True)
        if not _is_number(cell)
    ]


def _is_number(cell: str) -> bool:
    if cell in MISSING_IN_TEXT:
        return True
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell


def _ends_with_newline(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, io.SEEK_END)
        return file.read(1) == b"\n"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".")

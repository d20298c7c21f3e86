"""Where in a recording the unit was at rest or turned: by table, by stand, or by its own quiet.

A table beside the recording (`sections.csv`, `static_intervals.csv`) is what its maker marked. Rows
of a stand stop where the reference stops; a hole in them is never bridged. Only without both is
the rest looked for in the unit's own data.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.static_intervals import detect_rests
from protocol.errors import CalibrationError, Fault
from protocol.language import say
from protocol.recordings import Recording, Stream

FloatArray = NDArray[np.float64]

SECTIONS_FILE = "sections.csv"
STATIC_INTERVALS_FILE = "static_intervals.csv"
MAX_TABLE_BYTES = 1_000_000
MAX_STAND_ROW_GAP = 3.5
"""A hole in the stand's rows, in median row spacings, from which the reference counts as lost."""
REST_RATE_RAD_S = 1e-4
"""A stand's rate up to which it says 'at rest' (20 deg/h: Earth rate is not in it)."""


@dataclass(frozen=True)
class Segment:
    """Rows first … last - 1 of the unit's stream."""

    name: str
    first: int
    last: int


@dataclass(frozen=True)
class Segmentation:
    """Rests (or named parts) with how they were found, in words for people."""

    segments: tuple[Segment, ...]
    source: str


def named_sections(recording: Recording, folder: Path | None) -> Segmentation | None:
    """The parts that `sections.csv` beside the recording names; None without such a table.

    Raises:
        CalibrationError: the table is damaged or lies outside the recording's time.
    """
    path = None if folder is None else folder / SECTIONS_FILE
    if path is None or not path.is_file():
        return None
    time_s = recording.stream("dut").time_s()
    segments: list[Segment] = []
    for row, fields in enumerate(_rows(path), start=1):
        if row == 1 and [field.strip() for field in fields] == ["section", "start_s", "end_s"]:
            continue
        try:
            name, start_s, end_s = fields[0].strip(), float(fields[1]), float(fields[2])
        except (IndexError, ValueError):
            raise _damaged(path, row, "a section's name, start and end in seconds") from None
        first, last = np.searchsorted(time_s, [start_s, end_s], side="left").tolist()
        if not start_s < end_s or last <= first:
            raise _damaged(path, row, "a section inside the recording's time")
        segments.append(Segment(name, first, last))
    return Segmentation(tuple(segments), say("sections named in {file}", file=SECTIONS_FILE))


def rests(recording: Recording, folder: Path | None) -> Segmentation:
    """The rests of a session: by table, else by the stand's rows, else by the data themselves.

    Raises:
        CalibrationError: the table beside the recording is damaged.
    """
    stream = recording.stream("dut")
    if recording.test.get("profile") == "multi_position" and folder is not None:
        for path in (folder / STATIC_INTERVALS_FILE, folder.parent / STATIC_INTERVALS_FILE):
            if path.is_file():
                found = _intervals_by_row(path, len(stream))
                return Segmentation(found, say("rests named in {file}", file=STATIC_INTERVALS_FILE))
    if "stand" in recording.streams and recording.streams["stand"].has("rate_x", "rate_y", "rate_z"):
        found = _rests_of_stand(recording.streams["stand"], stream.time_s())
        if found:
            return Segmentation(found, say("rests where the stand says rate 0"))
    sensors = tuple(
        stream.si(*(f"{kind}_{axis}" for axis in "xyz"))
        for kind in ("acc", "gyro")
        if stream.has(*(f"{kind}_{axis}" for axis in "xyz"))
    )
    pairs = detect_rests(stream.time_s(), sensors)
    found = tuple(Segment(f"rest {k}", first, last) for k, (first, last) in enumerate(pairs, start=1))
    return Segmentation(found, say("rests found by the variance of the data"))


def _rests_of_stand(stand: Stream, time_s: FloatArray) -> tuple[Segment, ...]:
    """Stretches of stand rows without a hole in which every row says rate 0."""
    stand_time_s = stand.time_s()
    if len(stand_time_s) < 2:
        return ()
    spacing = np.diff(stand_time_s)
    rates = np.abs(stand.si("rate_x", "rate_y", "rate_z"))
    still: NDArray[np.bool_] = np.asarray(np.all(rates <= REST_RATE_RAD_S, axis=1), dtype=np.bool_)
    linked = still[1:] & still[:-1] & (spacing <= MAX_STAND_ROW_GAP * float(np.median(spacing)))
    edges = np.diff(np.concatenate([[False], linked, [False]]).astype(np.int8))
    segments: list[Segment] = []
    for start, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        first = int(np.searchsorted(time_s, stand_time_s[start], side="left"))
        last = int(np.searchsorted(time_s, stand_time_s[end], side="right"))
        if last > first:
            segments.append(Segment(f"rest {len(segments) + 1}", first, last))
    return tuple(segments)


def _intervals_by_row(path: Path, count: int) -> tuple[Segment, ...]:
    """First and last row of each rest: two lines of equal length."""
    lines = _rows(path)
    if len(lines) != 2 or len(lines[0]) != len(lines[1]):
        raise _damaged(path, len(lines), "two lines of equal length: first and last row of each rest")
    segments: list[Segment] = []
    for column, (first, last) in enumerate(zip(*lines, strict=True), start=1):
        try:
            bounds = int(float(first)), int(float(last)) + 1
        except ValueError:
            raise _damaged(path, 1, f"row numbers (column {column})") from None
        if not 0 <= bounds[0] < bounds[1] <= count:
            raise _damaged(path, 1, f"rows inside the recording (column {column})")
        segments.append(Segment(f"rest {column}", *bounds))
    return tuple(segments)


def _rows(path: Path) -> list[list[str]]:
    if path.stat().st_size > MAX_TABLE_BYTES:
        raise _damaged(path, 0, f"at most {MAX_TABLE_BYTES} bytes")
    with path.open(encoding="utf-8", newline="") as file:
        return [row for row in csv.reader(file) if row]


def _damaged(path: Path, row: int, expected: str) -> CalibrationError:
    return CalibrationError(
        f"The table {path.name} does not hold {expected}.",
        where=f"{path}, row {row}",
        fault=Fault.DATA,
        remedy="correct the table, or take it away and let the rests be found from the data.",
    )

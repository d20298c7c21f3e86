# pyright: strict
"""What can be wrong with the samples of a recording, said with file, column and row.

Rows are samples, counted from 1. Nothing is repaired here and nothing is guessed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, RecordingError
from protocol.recordings import Recording, Stream

SAMPLE_TYPES = frozenset(
    {"bool", "float32", "float64"} | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
"""The types a column may have: those that every form keeps without loss."""


@dataclass
class Findings:
    """What was found while reading: errors make a recording unusable, notes do not."""

    errors: list[RecordingError] = field(default_factory=list[RecordingError])
    notes: list[str] = field(default_factory=list[str])

    def add(self, what: str, where: str, remedy: str, fault: Fault = Fault.DATA) -> None:
        """One more thing that is wrong."""
        self.errors.append(RecordingError(what, where=where, fault=fault, remedy=remedy))

    def raise_first(self) -> None:
        """Raise the first error, which carries the others as its story; nothing if there is none."""
        if self.errors:
            first = self.errors[0]
            first.story = tuple(f"{error.what} ({error.where})" for error in self.errors[1:])
            raise first


def check_stream(
    columns: Mapping[str, NDArray[Any]], units: Mapping[str, str], time: str, where: str, findings: Findings
) -> None:
    """Check types, lengths, time and finiteness of a stream's columns.

    Args:
        columns: as read; must hold every column of `units` (the reader has seen to that).
        units: column → unit, the declared columns.
        time: name of the time column.
        where: the file, for errors.
        findings: gets what is wrong.
    """
    for name in units:
        column = columns[name]
        place = f"{where}, column {name}"
        if column.ndim != 1:
            findings.add(
                f"The column has the shape {column.shape}, not that of a list of samples.",
                place,
                "write one number per sample and column.",
            )
        elif column.dtype.newbyteorder("=").name not in SAMPLE_TYPES:
            findings.add(
                f"The column holds '{column.dtype}', which is no type for samples.",
                place,
                f"write it as one of: {', '.join(sorted(SAMPLE_TYPES))}.",
            )
        elif len(column) != len(columns[time]):
            findings.add(
                f"The column has {len(column)} samples, the time column {len(columns[time])}.",
                f"{place}, row {min(len(column), len(columns[time])) + 1}",
                "export the file again: every column must have a value for every time.",
            )
    if findings.errors:
        return
    _check_time(columns[time], f"{where}, column {time}", findings)
    for name in units:
        if name != time:
            _check_finite(columns[name], f"{where}, column {name}", findings)


def _check_time(samples: NDArray[Any], where: str, findings: Findings) -> None:
    if samples.dtype.kind == "b":
        findings.add("The time column holds truth values.", where, "write times as numbers.")
        return
    if samples.dtype.kind == "f":
        for what, wrong in (("missing (NaN)", np.isnan(samples)), ("infinite", np.isinf(samples))):
            if wrong.any():
                findings.add(
                    f"The time is {what} in {int(wrong.sum())} rows.",
                    f"{where}, row {int(wrong.argmax()) + 1}",
                    "leave out rows without a time, or export the file again.",
                )
    backwards = samples[1:] < samples[:-1]
    if backwards.any():
        at = int(backwards.argmax()) + 1
        findings.add(
            f"The time steps backwards from {samples[at - 1]} to {samples[at]} "
            f"({int(backwards.sum())} such steps).",
            f"{where}, row {at + 1}",
            "split the recording where the clock was set, or export it in the order of time.",
        )


def _check_finite(samples: NDArray[Any], where: str, findings: Findings) -> None:
    if samples.dtype.kind != "f":
        return
    infinite = np.isinf(samples)
    if infinite.any():
        findings.add(
            f"The value is infinite in {int(infinite.sum())} rows.",
            f"{where}, row {int(infinite.argmax()) + 1}",
            "write a value that was not measured as NaN.",
        )


def checked_columns(stream: str, types: Mapping[str, str], columns: Mapping[str, NDArray[Any]]) -> int:
    """How many samples these columns have, if they can be appended to a stream.

    Args:
        stream: its name, for errors.
        types: column → type, as declared when the recording was opened.
        columns: what is to be appended.

    Raises:
        RecordingError: a column is missing, not declared, of another length, or of a type that
            cannot be kept without loss.
    """
    where = f"stream {stream}"
    remedy = "append what was declared when the recording was opened."
    if set(columns) != set(types):
        odd = ", ".join(sorted(set(columns) ^ set(types)))
        raise RecordingError(
            f"The columns are not those declared: {odd}.", where=where, fault=Fault.TESTLOOM, remedy=remedy
        )
    shapes = {column.shape for column in columns.values()}
    if len(shapes) > 1 or len(next(iter(shapes))) != 1:
        raise RecordingError(
            "The columns have different lengths.", where=where, fault=Fault.TESTLOOM, remedy=remedy
        )
    for name, column in columns.items():
        if not np.can_cast(column.dtype, types[name], "safe"):
            raise RecordingError(
                f"'{column.dtype}' cannot be kept as '{types[name]}' without loss.",
                where=f"{where}, column {name}",
                fault=Fault.TESTLOOM,
                remedy=remedy,
            )
    return next(iter(shapes))[0]


def missing_values(stream: Stream) -> dict[str, int]:
    """Column → how many of its values are missing (NaN); columns without any are left out."""
    counts = {
        name: int(np.isnan(column).sum())
        for name, column in stream.columns.items()
        if column.dtype.kind == "f"
    }
    return {name: count for name, count in counts.items() if count}


def equal_recordings(one: Recording, other: Recording) -> bool:
    """True if both say the same: documents, order and types of columns, every sample (NaN is NaN)."""
    documents = ("recording_id", "unit", "test", "stand", "site", "believed", "extra")
    if any(getattr(one, name) != getattr(other, name) for name in documents):
        return False
    return list(one.streams) == list(other.streams) and all(
        _equal_streams(stream, other.streams[name]) for name, stream in one.streams.items()
    )


def _equal_streams(one: Stream, other: Stream) -> bool:
    said = (one.name, one.clock, one.time, list(one.units.items()), one.extra)
    if said != (other.name, other.clock, other.time, list(other.units.items()), other.extra):
        return False
    return all(_same_samples(one.columns[name], other.columns[name]) for name in one.units)


def _same_samples(one: NDArray[Any], other: NDArray[Any]) -> bool:
    if one.dtype.newbyteorder("=") != other.dtype.newbyteorder("=") or one.shape != other.shape:
        return False
    return bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))


def duplicates(names: Sequence[str]) -> list[str]:
    """Names that occur more than once."""
    return sorted({name for name in names if names.count(name) > 1})

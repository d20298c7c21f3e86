# pyright: strict
"""Keeping recordings on disk for good, and what a disk that refuses means for a person."""

import contextlib
import errno
import os
from collections.abc import Generator
from pathlib import Path
from types import TracebackType
from typing import Self

from protocol.errors import Fault, RecordingError

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class WholeOrNothing:
    """The base of writers of recordings: closed at the end of a `with` block, discarded by an exception."""

    _path: Path

    def close(self) -> object:
        """Finish, and give it its name."""
        raise NotImplementedError

    def discard(self) -> None:
        """Stop, and leave nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    @contextlib.contextmanager
    def _discarded_if_refused(self) -> Generator[None]:
        """What the disk refuses ends the recording."""
        try:
            yield
        except OSError as error:
            self.discard()
            raise storage_error(error, self._path) from error


def storage_error(error: OSError, path: Path, what: str = "recording") -> RecordingError:
    """The error to raise when writing a recording (or `what`) to `path` failed. Nothing was left there."""
    full = error.errno in NO_ROOM
    reason = error.strerror or str(error)
    return RecordingError(
        f"The {what} could not be written: {reason}." + (" The disk is full." if full else ""),
        where=str(path),
        fault=Fault.STATION,
        remedy="make room on this disk, then write it again."
        if full
        else "check that the folder exists and may be written, then write it again.",
    )


def write_whole(path: Path, text: str) -> None:
    """Write a text file: all of it, or nothing is there.

    Raises:
        RecordingError: the disk refuses.
    """
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            unfinished.write_text(text, encoding="utf-8")
            sync(unfinished)
            unfinished.replace(path)
        except BaseException:
            unfinished.unlink(missing_ok=True)
            raise
        sync(path.parent)
    except OSError as error:
        raise storage_error(error, path, "file") from error


def sync(path: Path) -> None:
    """Have the disk keep a file or a folder's entries: a power cut after a rename leaves it empty else.

    Raises:
        OSError: the disk refuses.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

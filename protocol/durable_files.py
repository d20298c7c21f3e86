# pyright: strict
"""Keeping recordings on disk for good, and what a disk that refuses means for a person."""

import errno
import os
from pathlib import Path

from protocol.errors import Fault, RecordingError

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def storage_error(error: OSError, path: Path) -> RecordingError:
    """The error to raise when writing a recording to `path` failed. Nothing was left there."""
    full = error.errno in NO_ROOM
    reason = error.strerror or str(error)
    return RecordingError(
        f"The recording could not be written: {reason}." + (" The disk is full." if full else ""),
        where=str(path),
        fault=Fault.STATION,
        remedy="make room on this disk, then write it again."
        if full
        else "check that the folder exists and may be written, then write it again.",
    )


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

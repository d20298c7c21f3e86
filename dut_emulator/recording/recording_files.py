"""A session into files: both forms at once, streamed, each whole or not there at all."""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

from dut_emulator.recording.recorder import CHUNK_SAMPLES, RecordingSession, RecordingWriter, record_to
from protocol.adapters.mcap_form import McapRecordingWriter
from protocol.durable_files import write_whole
from protocol.errors import Fault, RecordingError
from protocol.folder_writing import FolderRecordingWriter
from protocol.stream_files import StreamFormat

RecordingForm = Literal["folder", "mcap"]
RECORDING_FORMS: tuple[RecordingForm, ...] = ("folder", "mcap")


def write_recording(
    session: RecordingSession,
    directory: Path,
    forms: Sequence[RecordingForm] = RECORDING_FORMS,
    *,
    stream_format: StreamFormat = "npz",
    truth: Path | None = None,
    progress: Callable[[float], None] | None = None,
    chunk_samples: int = CHUNK_SAMPLES,
) -> list[Path]:
    """Carry out a session into files of `directory`, named by the recording's id.

    Args:
        session: what to record.
        directory: made if it is not there.
        forms: of the recording; both by default.
        stream_format: of the folder's streams.
        truth: where that goes which the recording does not tell; None for nowhere.
        progress: told the bench time that is reached.
        chunk_samples: the bound of what is in memory at once.

    Returns:
        What was written, in the order of `forms`, and the truth.

    Raises:
        RecordingError: something of such a name is there already, or the disk refuses: nothing is left.
    """
    name = session.description.recording_id
    paths = {form: directory / (f"{name}.mcap" if form == "mcap" else name) for form in forms}
    for path in paths.values():
        refuse_existing(path)
        if truth is not None and truth.resolve().is_relative_to(path.resolve()):
            raise RecordingError(
                "The truth cannot be a part of the recording: who reads that may not know it.",
                where=str(truth),
                fault=Fault.OPERATOR,
                remedy="choose a file outside the recording.",
            )
    with ExitStack() as open_forms:
        if truth is not None:
            open_forms.enter_context(_truth_written(session, truth))
        writers: list[RecordingWriter] = []
        for form, path in paths.items():
            writer = (
                McapRecordingWriter(path, session.description)
                if form == "mcap"
                else FolderRecordingWriter(path, session.description, stream_format)
            )
            writers.append(open_forms.enter_context(writer))
        record_to(session, writers, progress, chunk_samples)
        for path in paths.values():
            refuse_existing(path)  # somebody else may have been quicker: two halves would be one recording
    return [*paths.values(), *([truth] if truth is not None else [])]


@contextmanager
def _truth_written(session: RecordingSession, path: Path) -> Iterator[None]:
    """What the recording does not tell, into a file of its own; it goes again if the recording fails."""
    refuse_existing(path)
    write_whole(path, json.dumps(session.truth(), indent=1, ensure_ascii=False) + "\n")
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def refuse_existing(path: Path) -> None:
    """Nothing is written over.

    Raises:
        RecordingError: there is something of this name.
    """
    if path.exists():
        raise RecordingError(
            "There is something of this name already.",
            where=str(path),
            fault=Fault.OPERATOR,
            remedy="choose another name, or move it away.",
        )

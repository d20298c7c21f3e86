"""A session into files: both forms at once, streamed, each whole or not there at all."""

import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from dut_emulator.recording.recorder import CHUNK_SAMPLES, RecordingSession, RecordingWriter, record_to
from protocol.adapters.mcap_form import McapRecordingWriter
from protocol.durable_files import storage_error
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
    progress: Callable[[float], None] | None = None,
    chunk_samples: int = CHUNK_SAMPLES,
) -> list[Path]:
    """Carry out a session into files of `directory`, named by the recording's id.

    Args:
        session: what to record.
        directory: made if it is not there.
        forms: of the recording; both by default.
        stream_format: of the folder's streams.
        progress: told the bench time that is reached.
        chunk_samples: the bound of what is in memory at once.

    Returns:
        What was written, in the order of `forms`.

    Raises:
        RecordingError: something of such a name is there already, or the disk refuses.
    """
    name = session.description.recording_id
    paths = {form: directory / (f"{name}.mcap" if form == "mcap" else name) for form in forms}
    for path in paths.values():
        refuse_existing(path)
    with ExitStack() as open_forms:
        writers: list[RecordingWriter] = []
        for form, path in paths.items():
            writer = (
                McapRecordingWriter(path, session.description)
                if form == "mcap"
                else FolderRecordingWriter(path, session.description, stream_format)
            )
            writers.append(open_forms.enter_context(writer))
        record_to(session, writers, progress, chunk_samples)
    return list(paths.values())


def write_truth(session: RecordingSession, path: Path) -> None:
    """What the recording does not tell, into a file beside it.

    Raises:
        RecordingError: there is something of this name, or the disk refuses.
    """
    refuse_existing(path)
    text = json.dumps(session.truth(), indent=1, ensure_ascii=False) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        path.unlink(missing_ok=True)
        raise storage_error(error, path) from error


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

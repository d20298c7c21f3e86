"""Raw data of a station: MCAP files that stay where they were made, named by their SHA-256."""

from pathlib import Path

from protocol.adapters.mcap_form import McapRecordingWriter
from protocol.attempts import RecordingReference
from protocol.durable_files import storage_error, sync
from protocol.recordings import Recording

UNNAMED_FOLDER = "incoming"
"""Where a file is until its hash is known; what an agent that died left there is not a recording."""


def keep_recording(recording: Recording, folder: Path, description: str) -> RecordingReference:
    """Write a recording to `<sha256>.mcap` in a folder, durably and all or nothing.

    Args:
        recording: with all its samples.
        folder: of the station's recordings; made if it is not there.
        description: for the record that will name it.

    Raises:
        RecordingError: the disk is full or refuses, by the station's fault; nothing is left.
    """
    unnamed = folder / UNNAMED_FOLDER / f"{recording.recording_id}.mcap"
    with McapRecordingWriter(unnamed, recording) as writer:
        for name, stream in recording.streams.items():
            writer.append(name, stream.columns)
    reference = writer.reference
    path = folder / f"{reference.sha256}.mcap"
    try:
        unnamed.replace(path)
        sync(folder)
    except OSError as error:
        raise storage_error(error, path) from None
    return reference.model_copy(update={"path": str(path), "description": description})

"""The folder form written while it is made: the same as written at once, and never half."""

import dataclasses
import errno

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from protocol import folder_writing
from protocol.errors import RecordingError
from protocol.folder_form import read_folder
from protocol.folder_writing import FolderRecordingWriter
from protocol.recording_checks import equal_recordings
from protocol.recordings import Recording
from protocol.stream_files import STREAM_FORMATS
from tests.protocol.recording_samples import recordings, sample_recording


def without_samples(recording: Recording) -> Recording:
    streams = {
        name: dataclasses.replace(stream, columns={key: col[:0] for key, col in stream.columns.items()})
        for name, stream in recording.streams.items()
    }
    return dataclasses.replace(recording, streams=streams)


def append_in_pieces(writer: FolderRecordingWriter, recording: Recording, length: int) -> None:
    for name, stream in recording.streams.items():
        for start in range(0, len(stream), length):
            columns = {column: stream.columns[column][start : start + length] for column in stream.units}
            writer.append(name, columns)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
@given(recording=recordings(), stream_format=st.sampled_from(STREAM_FORMATS), length=st.integers(1, 5))
def test_pieces_of_any_length_make_the_whole(tmp_path_factory, monkeypatch, recording, stream_format, length):
    monkeypatch.setattr(folder_writing, "ROWS_PER_WRITE", 4)
    folder = tmp_path_factory.mktemp("recording") / "r"
    with FolderRecordingWriter(folder, without_samples(recording), stream_format) as writer:
        append_in_pieces(writer, recording, length)
    assert equal_recordings(read_folder(folder), recording)
    assert sorted(path.suffix for path in folder.iterdir()) == sorted(
        [".json", *[f".{stream_format}"] * len(recording.streams)]
    )


@pytest.mark.parametrize("stream_format", STREAM_FORMATS)
def test_what_is_given_up_leaves_nothing(tmp_path, stream_format):
    recording = sample_recording()
    writer = FolderRecordingWriter(tmp_path / "r", without_samples(recording), stream_format)
    append_in_pieces(writer, recording, 20)
    writer.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("stream_format", STREAM_FORMATS)
def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch, stream_format):
    recording = sample_recording()

    def refuse(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    kind = type(folder_writing._KINDS[stream_format].__name__, (folder_writing._KINDS[stream_format],), {})
    kind.write = refuse
    monkeypatch.setitem(folder_writing._KINDS, stream_format, kind)
    writer = FolderRecordingWriter(tmp_path / "r", without_samples(recording), stream_format)
    append_in_pieces(writer, recording, 20)
    with pytest.raises(RecordingError, match="The disk is full"):
        writer.close()
    assert list(tmp_path.iterdir()) == []


def test_what_was_not_declared_is_refused(tmp_path):
    recording = sample_recording()
    with FolderRecordingWriter(tmp_path / "r", without_samples(recording)) as writer:
        with pytest.raises(RecordingError, match="cannot be kept as 'uint8'"):
            writer.append("dut", dict(recording.streams["dut"].columns) | {"counter": np.zeros(50)})
        with pytest.raises(RecordingError, match="not those declared: t"):
            writer.append(
                "stand", {"time_us": np.zeros(1, np.int64), "rate_x": np.zeros(1), "t": np.zeros(1)}
            )
    assert len(read_folder(tmp_path / "r").streams["dut"]) == 0
    with pytest.raises(RecordingError, match="something of this name already"):
        FolderRecordingWriter(tmp_path / "r", without_samples(recording))

"""The folder form: nothing is lost on the way, and nothing wrong is taken for data."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from protocol.errors import Fault, RecordingError
from protocol.folder_form import examine_folder, read_folder, write_folder
from protocol.recording_checks import Findings, equal_recordings, missing_values
from protocol.recordings import Recording
from protocol.stream_files import STREAM_FORMATS
from tests.protocol.recording_samples import recordings, sample_recording

IN_TMP_PATH = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)


@IN_TMP_PATH
@given(recording=recordings(), stream_format=st.sampled_from(STREAM_FORMATS))
def test_what_is_written_is_read(tmp_path_factory, recording, stream_format):
    folder = tmp_path_factory.mktemp("recording") / "r"
    write_folder(recording, folder, stream_format)
    assert equal_recordings(read_folder(folder), recording)


def test_missing_values_are_counted_and_kept(tmp_path):
    recording = sample_recording()
    write_folder(recording, tmp_path / "r", "csv")
    stream = read_folder(tmp_path / "r").streams["dut"]
    assert missing_values(stream) == {"gyro_x": 7}
    assert np.isnan(stream.columns["gyro_x"][3::7]).all()
    assert stream.extra == {"filter": [1, 2]}


def minimal(folder: Path, rows: str, /, **stream: object) -> Path:
    """A folder as someone writes it by hand: `t` and `gyro_x` in a CSV file."""
    folder.mkdir()
    described = {
        "name": "dut",
        "file": "dut.csv",
        "clock": "dut",
        "time": "t",
        "columns": {"t": "s", "gyro_x": "deg/s"},
        **stream,
    }
    document = {
        "format": "testloom-recording/1",
        "recording_id": "hand-made",
        "unit": {"serial": "U-1", "product": "mems_imu"},
        "test": {"profile": "static"},
        "streams": [described],
    }
    (folder / "recording.json").write_text(json.dumps(document))
    (folder / "dut.csv").write_text(rows)
    return folder


def test_a_folder_made_by_hand_is_read(tmp_path):
    folder = minimal(tmp_path / "r", "gyro_x,t\n1,0\n,0.5\nnan,0.5\n-2.5e-1,1\n")
    stream = read_folder(folder).streams["dut"]
    np.testing.assert_array_equal(stream.columns["t"], [0, 0.5, 0.5, 1])
    np.testing.assert_array_equal(stream.columns["gyro_x"], [1, np.nan, np.nan, -0.25])
    assert list(stream.units) == ["t", "gyro_x"]


@pytest.mark.parametrize(
    ("rows", "says", "where"),
    [
        ("t,gyro_x\n0,1\n1,2\n0.5,3\n", "steps backwards from 1.0 to 0.5", "dut.csv, column t, row 3"),
        ("t,gyro_x\n0,1\nnan,2\n1,3\n", "time is missing", "dut.csv, column t, row 2"),
        ("t,gyro_x\n0,1\n,2\n1,3\n", "time is missing", "dut.csv, column t, row 2"),
        ("t,gyro_x\n0,1\ninf,2\n", "time is infinite", "dut.csv, column t, row 2"),
        ("t,gyro_x\n0,1\n1,-inf\n", "value is infinite", "dut.csv, column gyro_x, row 2"),
        ("t,gyro_x\n0,1\n1,\n2", "1 of 2 values", "dut.csv, column t, row 3 (line 4)"),
        ("t,gyro_x\n0,1\n1,2,3\n", "3 of 2 values", "dut.csv, column gyro_x, row 2 (line 3)"),
        ("t,gyro_x\n0,1\n1,fast\n", "'fast' is no number", "dut.csv, column gyro_x, row 2 (line 3)"),
        ("t,gyro_x\n0,1\n1,1_000\n", "'1_000' is no number", "dut.csv, column gyro_x, row 2 (line 3)"),
        ("t,gyro_x\n0,true\n", "'true' is no number", "dut.csv, column gyro_x, row 1 (line 2)"),
        ("t,gyro_x\n0,2026-01-01\n", "is no number", "dut.csv, column gyro_x, row 1 (line 2)"),
        ("t\n0\n", "column is missing", "dut.csv, column gyro_x"),
        ("t,gyro_x,x\n0,1,1\n", "not described", "dut.csv, column x"),
        ("t,gyro_x,t\n0,1,1\n", "stands twice", "dut.csv, column t"),
        ("", "column is missing", "dut.csv, column t"),
    ],
)
def test_wrong_rows_are_named(tmp_path, rows, says, where):
    with pytest.raises(RecordingError) as caught:
        read_folder(minimal(tmp_path / "r", rows))
    assert says in caught.value.what
    assert where in caught.value.where
    assert caught.value.fault is Fault.DATA
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("stream", "says", "where"),
    [
        ({"columns": {"t": "s", "gyro_x": "furlong"}}, "unit 'furlong' is not known", "column gyro_x"),
        ({"columns": {"t": "deg", "gyro_x": "deg"}}, "no unit of time", "column t"),
        ({"columns": {"t": 1, "gyro_x": "deg"}}, "unit 1 is not known", "column t"),
        ({"columns": {"gyro_x": "deg"}}, "time column 't'", "key time"),
        ({"columns": []}, "does not name its columns", "key columns"),
        ({"file": "../dut.csv"}, "cannot be the file", "key file"),
        ({"file": "gone.csv"}, "file of the stream is missing", "gone.csv"),
        ({"file": "dut.xlsx"}, "kind '.xlsx'", "dut.xlsx"),
        ({"name": "a/b"}, "cannot be the name", "stream 1"),
        ({"rows": 7}, "2 of the 7 rows", "dut.csv, row 3"),
        ({"types": {"gyro_x": "complex"}}, "types", "key types"),
        ({"types": {"gyro_x": {}}}, "types", "key types"),
    ],
)
def test_wrong_descriptions_are_named(tmp_path, stream, says, where):
    with pytest.raises(RecordingError) as caught:
        read_folder(minimal(tmp_path / "r", "t,gyro_x\n0,1\n1,2\n", **stream))
    assert says in caught.value.what
    assert where in caught.value.where


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not JSON"),
        ("[1]", "not a JSON object"),
        ('{"recording_id": "\\ud800"}', "not JSON"),
        ('{"format": "testloom-recording/2"}', "'testloom-recording/2'"),
        ('{"format": "x", "format": "testloom-recording/1"}', "stands twice"),
        ('{"format": "testloom-recording/1", "unit": {}, "test": {}, "streams": [1]}', "has no id"),
    ],
)
def test_wrong_documents_are_named(tmp_path, text, says):
    folder = minimal(tmp_path / "r", "t,gyro_x\n0,1\n")
    (folder / "recording.json").write_text(text)
    with pytest.raises(RecordingError, match=says) as caught:
        read_folder(folder)
    assert "recording.json" in caught.value.where


def test_all_that_is_wrong_is_told(tmp_path):
    folder = minimal(tmp_path / "r", "t,gyro_x\n0,1\nx,1\n1,y\n")
    with pytest.raises(RecordingError) as caught:
        read_folder(folder)
    assert "row 2" in caught.value.where
    assert len(caught.value.story) == 1
    assert "row 3" in caught.value.story[0]


def test_columns_of_different_length_are_named(tmp_path):
    folder = minimal(tmp_path / "r", "", file="dut.npz")
    np.savez(folder / "dut.npz", t=np.arange(5.0), gyro_x=np.arange(4.0))
    with pytest.raises(RecordingError, match="4 samples, the time column 5") as caught:
        read_folder(folder)
    assert "column gyro_x, row 5" in caught.value.where


@pytest.mark.parametrize(
    "column", [np.arange(4.0).reshape(2, 2), np.array(["a", "b"]), np.array([1j, 2j]), np.array([{}, {}])]
)
def test_what_is_no_column_of_numbers_is_refused(tmp_path, column):
    folder = minimal(tmp_path / "r", "", file="dut.npz")
    np.savez(folder / "dut.npz", t=np.arange(2.0), gyro_x=column)
    with pytest.raises(RecordingError) as caught:
        read_folder(folder)
    assert "column gyro_x" in caught.value.where


@pytest.mark.parametrize("stream_format", ["npz", "parquet"])
def test_damage_of_a_stream_file_is_noticed(tmp_path, stream_format):
    write_folder(sample_recording(400), tmp_path / "r", stream_format)
    file = tmp_path / "r" / f"dut.{stream_format}"
    sound = file.read_bytes()
    reference = read_folder(tmp_path / "r")
    for place in range(0, len(sound), max(1, len(sound) // 60)):
        file.write_bytes(sound[:place])
        with pytest.raises(RecordingError, match="no whole"):
            read_folder(tmp_path / "r")
        damaged = bytearray(sound)
        damaged[place] ^= 0x10
        file.write_bytes(damaged)
        findings = Findings()
        read = examine_folder(tmp_path / "r", findings)
        if read is None:
            assert file.name in findings.errors[0].where
        else:  # a bit of padding or of a file's date changes nothing
            assert equal_recordings(read, reference)


def test_a_csv_file_without_its_last_rows_is_noticed(tmp_path):
    write_folder(sample_recording(), tmp_path / "r", "csv")
    file = tmp_path / "r" / "dut.csv"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-4]))
    with pytest.raises(RecordingError, match="46 of the 50 rows"):
        read_folder(tmp_path / "r")


def test_a_full_disk_leaves_nothing(tmp_path, fill_disk):
    fill_disk(2000)
    with pytest.raises(RecordingError, match="disk is full") as caught:
        write_folder(sample_recording(5000), tmp_path / "deep" / "r", "csv")
    assert caught.value.fault is Fault.STATION
    assert os.listdir(tmp_path / "deep") == []


def test_an_existing_folder_is_not_touched(tmp_path):
    write_folder(sample_recording(), tmp_path / "r")
    with pytest.raises(RecordingError, match="already") as caught:
        write_folder(sample_recording(20), tmp_path / "r")
    assert caught.value.fault is Fault.OPERATOR
    assert equal_recordings(read_folder(tmp_path / "r"), sample_recording())


def test_an_unsound_recording_is_not_written(tmp_path):
    sound = sample_recording()
    sound.streams["dut"].columns["t"][9] = -1.0  # pyright: ignore[reportIndexIssue]
    with pytest.raises(RecordingError, match="steps backwards"):
        write_folder(sound, tmp_path / "r")
    assert os.listdir(tmp_path) == []


@pytest.mark.recorded
def test_recordings_of_real_sensors_are_read(recorded_data):
    folders = [file.parent for file in sorted(recorded_data.rglob("recording.json"))]
    assert len(folders) >= 50
    for folder in folders:
        recording = read_folder(folder)
        assert isinstance(recording, Recording)
        for stream in recording.streams.values():
            with np.load(next(folder.glob(f"{stream.name}.npz"))) as arrays:
                for name in stream.units:
                    np.testing.assert_array_equal(stream.columns[name], arrays[name])

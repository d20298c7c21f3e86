"""`testloom recording` as a person and a script use it."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from protocol.adapters.recording_forms import read_recording
from protocol.folder_form import write_folder
from protocol.recording_checks import equal_recordings
from tests.protocol.recording_samples import sample_recording


@pytest.fixture
def folder(tmp_path):
    """A sound recording in the folder form."""
    write_folder(sample_recording(), tmp_path / "sound", "csv")
    return tmp_path


def damage(folder):
    """Break two cells of a second recording."""
    write_folder(sample_recording(), folder / "broken", "csv")
    file = folder / "broken" / "dut.csv"
    lines = file.read_text().splitlines(keepends=True)
    lines[3], lines[5] = lines[3].replace(lines[3].split(",")[0], "then", 1), "1\n"
    file.write_text("".join(lines))


def test_convert_there_and_back(folder, capsys):
    assert main(["recording", "convert", str(folder / "sound"), str(folder / "r.mcap"), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert written["samples"] == 75
    assert len(written["sha256"]) == 64
    back = ["recording", "convert", str(folder / "r.mcap"), str(folder / "b"), "--stream-format", "parquet"]
    assert main(back) == 0
    assert "75 samples written" in capsys.readouterr().out
    assert equal_recordings(read_recording(folder / "b"), sample_recording())


def test_convert_says_what_stops_it(folder, capsys):
    assert main(["recording", "convert", str(folder / "sound"), str(folder / "sound")]) == 1
    shown = capsys.readouterr().err
    assert "something of this name already" in shown
    assert "What to do" in shown
    assert "Traceback" not in shown


def test_info_shows_streams_in_numbers(folder, capsys):
    assert main(["recording", "info", str(folder / "sound"), "--json"]) == 0
    (facts,) = json.loads(capsys.readouterr().out)
    assert facts["unit"]["serial"] == "U-1"
    dut = facts["streams"]["dut"]
    assert (dut["samples"], dut["missing"], dut["holes"]) == (50, {"gyro_x": 7}, 0)
    assert dut["rate_hz"] == pytest.approx(200)
    assert dut["duration_s"] == pytest.approx(49 / 200)
    assert main(["recording", "info", str(folder / "sound")]) == 0
    assert "gyro_x [deg/s]" in capsys.readouterr().out


def test_holes_are_counted(tmp_path, capsys):
    recording = sample_recording()
    np.asarray(recording.streams["dut"].columns["t"])[30:] += 2.0
    write_folder(recording, tmp_path / "r")
    assert main(["recording", "info", str(tmp_path / "r"), "--json"]) == 0
    dut = json.loads(capsys.readouterr().out)[0]["streams"]["dut"]
    assert dut["holes"] == 1
    assert dut["longest_pause_s"] == pytest.approx(2.005)


def test_check_lists_everything_and_fails(folder, capsys):
    damage(folder)
    assert main(["recording", "check", str(folder), "--json"]) == 1
    broken, sound = json.loads(capsys.readouterr().out)
    assert sound["sound"]
    assert ["7 of 50 values are missing" in note for note in sound["notes"]] == [True]
    assert [error["where"].rsplit("row ")[1] for error in broken["errors"]] == ["3 (line 4)", "5 (line 6)"]
    assert all(error["what"] and error["fault"] == "data" and error["remedy"] for error in broken["errors"])

    assert main(["recording", "check", str(folder)]) == 1
    shown = capsys.readouterr().out
    assert "2 recordings, 1 cannot be used" in shown
    assert shown.count("What to do") == 2

    assert main(["recording", "check", str(folder / "sound")]) == 0


def test_check_speaks_chinese(folder, capsys, monkeypatch):
    monkeypatch.setattr("protocol.language._chosen", [])
    damage(folder)
    assert main(["recording", "check", str(folder), "--lang", "zh"]) == 1
    shown = capsys.readouterr().out
    assert "1 个无法使用" in shown
    assert "处理办法" in shown


def test_what_is_wrong_at_many_places_is_said_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = {
        "format": "testloom-recording/1",
        "recording_id": "r",
        "streams": [
            {
                "name": "dut",
                "file": "dut.csv",
                "clock": "dut",
                "time": "t",
                "columns": {"t": "s", "x": "furlong", "y": "furlong"},
            }
        ],
    }
    (tmp_path / "recording.json").write_text(json.dumps(document))
    (tmp_path / "dut.csv").write_text("t,x,y\n0,1,2\n1,1,2\n")
    assert main(["recording", "check", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert said.count("The unit 'furlong' is not known.") == 1
    assert "column x" in said
    assert "column y" in said

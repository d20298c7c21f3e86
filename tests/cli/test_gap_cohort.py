"""`testloom gap cohort`: many recordings, bad ones among them, and what is finished is not done again."""

import dataclasses
import json

import pytest

from cli.main import main
from protocol.language import choose_language
from tests.gap_diagnosis.imagined_reports import report

RECORD = ["emulator", "record", "rate_gyro_triad", "static", "--set", "duration_s=1s", "--form", "folder"]


@pytest.fixture(autouse=True)
def _english_again():
    yield
    choose_language("en")


@pytest.fixture
def diagnosed(monkeypatch):
    """Serial numbers in the order in which they were diagnosed; what is found is imagined."""
    asked = []

    def diagnose(recordings, **_):
        asked.append(recordings[0].unit["serial"])
        whole = report("attributed")
        return dataclasses.replace(whole, series=(), spectra=())

    monkeypatch.setattr("gap_diagnosis.diagnosis.diagnose", diagnose)
    return asked


def recorded(folder, serial, run=1):
    assert main([*RECORD, "--serial", serial, "--run", str(run), "--out", str(folder)]) == 0


def test_finished_units_are_kept_until_their_recordings_change(diagnosed, tmp_path, capsys):
    runs, out = tmp_path / "runs", tmp_path / "cohort"
    recorded(runs, "U-0001")
    recorded(runs, "U-0002")
    (runs / "torn").mkdir()
    (runs / "torn" / "recording.json").write_text("{", encoding="utf-8")
    command = ["gap", "cohort", str(runs), "--out", str(out), "--workers", "1"]
    assert main(command) == 0
    assert sorted(diagnosed) == ["U-0001", "U-0002"]
    written = json.loads((out / "cohort.json").read_text(encoding="utf-8"))
    assert [one["serial"] for one in written["units"]] == ["U-0001", "U-0002"]
    assert [one["what"] for one in written["left_out"]] == [str(runs / "torn")]
    assert (out / "cohort.html").is_file()
    capsys.readouterr()
    first = (out / "cohort.json").read_bytes()
    assert main(command) == 0
    assert "2 reports were there already" in " ".join(capsys.readouterr().out.split())
    assert len(diagnosed) == 2
    assert (out / "cohort.json").read_bytes() == first
    recorded(runs, "U-0002", run=2)
    assert main(command) == 0
    assert diagnosed[2:] == ["U-0002"]


@pytest.mark.parametrize("address", ["tcp://10.0.0.7:8786", "scheduler.example:8786"])
def test_recordings_do_not_leave_this_machine(address, tmp_path, capsys):
    recorded(tmp_path, "U-0001")
    command = ["gap", "cohort", str(tmp_path), "--out", str(tmp_path / "out"), "--scheduler", address]
    assert main(command) != 0
    assert "is not on this machine" in " ".join(capsys.readouterr().err.split())

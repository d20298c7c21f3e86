"""`testloom calibrate` with records, as a person and a script use it."""

import hashlib
import json
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calibration.records.record_parts import (
    RecordedBudget,
    RecordedBudgetRow,
    StandReference,
    TemperatureSpan,
)
from cli.calibration_record_files import write_record
from cli.main import main
from protocol.adapters.mcap_form import write_mcap
from protocol.adapters.recording_forms import read_recording
from protocol.folder_form import write_folder
from protocol.language import choose_language
from stations.sequencing.step_registry import bundled_plans
from tests.calibration.calibration_records import quantity, record_of, triad_record, unit_recording
from tests.calibration.conftest import SyntheticImu
from tests.calibration.test_calibrate_command import station_recording


@pytest.fixture(autouse=True)
def _wide_and_english(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "200")
    yield
    choose_language("en")


def test_recordings_become_records_that_compensate_them(tmp_path: Path, capsys) -> None:
    recording = station_recording(*SyntheticImu().session(31), started_at="2026-03-01T00:00:00Z")
    write_mcap(recording, tmp_path / "session-1.mcap")
    write_folder(recording, tmp_path / "session-1", "csv")
    assert (
        main(
            ["--lang", "zh", "calibrate", str(tmp_path / "session-1.mcap"), "--record", str(tmp_path / "zh")]
        )
        == 0
    )
    assert "档案 U-0007 acc" in capsys.readouterr().out
    words = ["--record", str(tmp_path / "en"), "--json", "--valid-temperature", "15", "35"]
    assert main(["--lang", "en", "calibrate", str(tmp_path / "session-1.mcap"), *words]) == 0
    acc, gyro = json.loads(capsys.readouterr().out)["results"][0]["records"]
    path = Path(acc["path"])
    record = json.loads(path.read_bytes())
    assert hashlib.sha256(path.read_bytes()).hexdigest() == acc["sha256"]
    assert path.name == f"U-0007-acc-imu_calibration-{acc['sha256'][:12]}.json"
    assert record["valid_temperature"] == {"low_c": 15.0, "high_c": 35.0}
    whole = hashlib.sha256((tmp_path / "session-1.mcap").read_bytes()).hexdigest()
    assert record["recordings"] == [{"form": "mcap", "recording_id": "session-1", "sha256": whole}]
    (in_chinese,) = (tmp_path / "zh").glob("*-acc-*")
    assert json.loads(in_chinese.read_bytes())["assumptions"] == record["assumptions"]

    # a second record on top, one for each sensor; each only once
    once, twice = tmp_path / "once.mcap", tmp_path / "twice"
    assert main(["calibrate", "apply", acc["path"], str(tmp_path / "session-1"), "--out", str(once)]) == 0
    assert main(["calibrate", "apply", gyro["path"], str(once), "--out", str(twice), "--json"]) == 0
    marks = read_recording(twice).extra["compensated"]
    assert [mark["record_sha256"] for mark in marks] == [acc["sha256"], gyro["sha256"]]
    capsys.readouterr()
    assert main(["calibrate", "apply", acc["path"], str(twice), "--out", str(tmp_path / "x")]) == 1
    assert "compensated already" in capsys.readouterr().err
    # a folder that holds one recording's folder stands for it; of two, one has to be named
    shelf = tmp_path / "shelf"
    shutil.copytree(tmp_path / "session-1", shelf / "session-1")
    assert main(["calibrate", "apply", acc["path"], str(shelf), "--out", str(tmp_path / "third")]) == 0
    shutil.copytree(tmp_path / "session-1", shelf / "again")
    assert main(["calibrate", "apply", acc["path"], str(shelf), "--out", str(tmp_path / "fourth")]) == 1
    assert "2 recordings lie in this folder" in " ".join(capsys.readouterr().err.split())
    assert main(["calibrate", "apply", acc["path"], str(once), "--out", str(once)]) == 1
    assert "something of this name" in capsys.readouterr().err

    # what is compensated makes no record: it would be applied to what is not
    assert main(["calibrate", str(twice), "--record", str(tmp_path / "left")]) == 1
    assert "would say what remains" in capsys.readouterr().err
    assert not (tmp_path / "left").exists()

    # compensated, the session calibrates to the identity
    assert main(["calibrate", str(twice), "--json"]) == 0
    (again,) = json.loads(capsys.readouterr().out)["results"]
    np.testing.assert_allclose(again["acc"]["matrix"], np.eye(3), atol=1e-9)
    np.testing.assert_allclose(again["gyro"]["bias"], 0, atol=1e-9)


def test_the_plan_is_named_with_its_hash(tmp_path: Path, capsys) -> None:
    write_mcap(station_recording(*SyntheticImu().session(33)), tmp_path / "s.mcap")
    words = ["calibrate", str(tmp_path / "s.mcap"), "--record", str(tmp_path / "r"), "--json", "--plan"]
    assert main([*words, "imu_calibration"]) == 0
    path = json.loads(capsys.readouterr().out)["results"][0]["records"][0]["path"]
    plan = bundled_plans()["imu_calibration"]
    assert json.loads(Path(path).read_bytes())["plan"] == plan.reference().model_dump()
    assert main([*words, str(tmp_path / "none.yaml")]) == 1
    assert "The plan cannot be read" in capsys.readouterr().out


def test_a_folders_hash_is_what_sha256sum_prints(tmp_path: Path, capsys) -> None:
    recording = station_recording(*SyntheticImu().session(32))
    folder = tmp_path / "session-1"
    write_folder(recording, folder, "csv")
    (folder / "plot.png").write_bytes(b"no part of it")
    assert main(["calibrate", str(folder), "--record", str(tmp_path / "records"), "--json"]) == 0
    path = json.loads(capsys.readouterr().out)["results"][0]["records"][0]["path"]
    printed = subprocess.run(
        ["sha256sum", "dut.csv", "recording.json"], cwd=folder, capture_output=True, check=True
    ).stdout
    (source,) = json.loads(Path(path).read_bytes())["recordings"]
    assert source["sha256"] == hashlib.sha256(printed).hexdigest()
    assert source["form"] == "folder"


def test_a_record_is_shown_whole(tmp_path: Path, capsys) -> None:
    row = RecordedBudgetRow(
        quantity="table rate", estimate=1.0, unit="rad/s", standard_uncertainty=0.01,
        distribution="uniform", sensitivity=1.0,
    )  # fmt: skip
    shown = record_of(
        quantity("bias_x", 0.2, 0.01, "m/s^2", degrees_of_freedom=10.0, coverage_factor=2.28),
        budgets=(RecordedBudget(result="bias_x", rows=(row,)),),
        stand=StandReference(id="tt-1", kind="table", calibration_overdue=True),
    )
    path = str(write_record(shown, tmp_path))
    assert main(["calibrate", "show", path]) == 0
    page = capsys.readouterr().out
    for words in (
        "0.200 ± 0.010",
        "0.023",
        "2.28",
        "table rate",
        "uniform",
        "OVERDUE",
        shown.sha256(),
        "a" * 64,
    ):
        assert words in page
    assert main(["--lang", "zh", "calibrate", "show", path]) == 0
    assert "测量时已过期" in capsys.readouterr().out
    assert main(["calibrate", "show", path, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["sha256"] == shown.sha256()
    assert content["record"]["quantities"][0]["value"] == 0.2


def test_apply_warns_of_temperature_and_refuses_another_unit(tmp_path: Path, capsys) -> None:
    write_folder(unit_recording(np.zeros((4, 3)), [10.0, 25.0, 25.0, 50.0]), tmp_path / "r")
    valid = {"valid_temperature": TemperatureSpan(low_c=20.0, high_c=30.0)}
    path = str(write_record(triad_record(**valid), tmp_path))
    assert (
        main(["calibrate", "apply", path, str(tmp_path / "r"), "--out", str(tmp_path / "sub" / "a.mcap")])
        == 0
    )
    told = capsys.readouterr()
    assert "4 samples of acc compensated" in told.out
    assert "2 of 4 samples lie outside the record's valid range of 20.0 to 30.0 °C" in told.err
    other = str(write_record(triad_record(serial="U-0008"), tmp_path))
    assert (
        main(["--lang", "zh", "calibrate", "apply", other, str(tmp_path / "r"), "--out", str(tmp_path / "b")])
        == 1
    )
    assert "U-0008" in (told := capsys.readouterr().err)
    assert "请取该产品的档案" in told
    assert not (tmp_path / "b").exists()


def test_two_records_are_compared(tmp_path: Path, capsys) -> None:
    records = [
        record_of(quantity("bias_x", value, 0.1), quantity("bias_y", 0.0, 0.1)) for value in (0.0, 1.0)
    ]
    paths = [str(write_record(record, tmp_path)) for record in records]
    assert main(["calibrate", "compare", *paths]) == 0
    page = capsys.readouterr().out
    assert "differ significantly: bias_x\n" in page
    assert "-7.07" in page  # 1 / (0.1 sqrt 2)
    assert "both rest on s-1" in page
    assert main(["calibrate", "compare", *paths, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["significant"] == ["bias_x"]
    assert found["quantities"][0]["normalised_error"] == pytest.approx(-5 / 2**0.5)


def test_a_history_can_be_read_at_80_columns(tmp_path: Path, capsys, monkeypatch) -> None:
    """Long names, numbers and all; the record that lies off is named below the table."""
    monkeypatch.setenv("COLUMNS", "80")
    for day, value in enumerate((1.0, 1.01, 9.0, 0.99, 1.0, 1.02), start=1):
        time = datetime(2026, 1, day, tzinfo=UTC)
        named = quantity("turn_on_bias_repeatability_x", value * 1e-3, 2e-5, "m/s^2")
        write_record(record_of(named, measured_at=time), tmp_path / str(day))
    assert main(["calibrate", "history", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines if not line.startswith("outlier")) <= 80
    assert len(lines) < 15
    assert any("turn_on_bias_repe" in line and "0.001000 ± 0.000020" in line for line in lines)
    assert any(line.startswith("outlier: turn_on_bias_repeatability_x of 2026-01-03") for line in lines)


def test_a_units_life_is_a_table_and_a_picture(tmp_path: Path, capsys) -> None:
    for year, value in ((2020, 1.0), (2021, 1.5), (2022, 2.0)):
        time = datetime(year, 1, 1, tzinfo=UTC)
        write_record(
            record_of(quantity("bias_x", value, 0.1, "m/s^2"), measured_at=time), tmp_path / str(year)
        )
    (tmp_path / "recording.json").write_text('{"format": "testloom-recording/1"}')
    picture = tmp_path / "plots" / "life.png"
    assert main(["calibrate", "history", str(tmp_path), "--plot", str(picture)]) == 0
    page = capsys.readouterr().out
    assert "0.500 ± 0.071" in page  # 0.1 / sqrt 2 years
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["calibrate", "history", str(tmp_path), "--json"]) == 0
    (history,) = json.loads(capsys.readouterr().out)["histories"]
    assert history["trend"]["drift_per_year"] == pytest.approx(0.5, abs=1e-3)
    assert history["trend"]["drifts"]
    (tmp_path / "2020" / "cut.json").write_text('{"format": "testloom-calibration-rec')
    assert main(["calibrate", "history", str(tmp_path)]) == 1  # told, and the others shown
    told = capsys.readouterr()
    assert "cut.json" in told.err
    assert "bias_x" in told.out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["show", "{dir}/none.json"], "There is no such calibration record."),
        (["show", "{dir}"], "There is no such calibration record."),
        (["show", "{dir}/binary.json"], "The file cannot be read"),
        (["show", "{dir}/list.json"], "The format is None"),
        (["history", "{dir}/empty"], "There is no calibration record here."),
        (["compare", "{dir}/list.json", "{dir}/list.json"], "The format is None"),
        (["apply", "{dir}/list.json", "{dir}", "--out", "{dir}/o"], "The format is None"),
        (["{dir}/empty", "--valid-temperature", "30", "20"], "ends below its beginning"),
    ],
)
def test_what_a_user_can_get_wrong(words: list[str], what: str, tmp_path: Path, capsys) -> None:
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "empty").mkdir()
    assert main(["calibrate", *(word.format(dir=tmp_path) for word in words)]) == 1
    told = capsys.readouterr().err
    assert what in told
    assert "What to do" in told
    assert "Traceback" not in told


def test_a_folder_named_like_a_command_is_reached_by_its_path(tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_folder(unit_recording(np.zeros((4, 3)), [25.0] * 4), tmp_path / "show")
    assert main(["calibrate", "./show", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["results"][0]["recordings"] == ["r-1"]

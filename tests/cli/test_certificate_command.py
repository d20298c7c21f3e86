"""`testloom certificate`: files for a customer, and what a user can get wrong."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.records.record import CalibrationRecord
from cli.calibration_record_files import write_record
from cli.main import main
from protocol.language import choose_language
from tests.calibration.certificate_samples import fog, rate_gyro_triad

DETAILS = """
number: CAL-2026-0117
issued: 2026-03-06
customer: {name: Aerostar, order: x}
"""


@pytest.fixture(autouse=True)
def _english_again():
    yield
    choose_language("en")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for record in (fog(), rate_gyro_triad()):
        write_record(record, tmp_path / "records")
    return tmp_path


def names(record: CalibrationRecord, language: str) -> set[str]:
    stem = record.file_name.removesuffix(".json")
    kinds = ("certificate", "original-record")
    return {f"{stem}-{kind}-{language}.{form}" for kind in kinds for form in ("pdf", "json")}


def test_each_record_gets_two_documents_in_the_language_asked_for(folder: Path, capsys) -> None:
    assert main(["certificate", str(folder / "records"), "--out", str(folder / "out")]) == 0
    assert main(["certificate", str(folder / "records"), "--out", str(folder / "out"), "--lang", "zh"]) == 0
    written = {path.name for path in (folder / "out").iterdir()}
    wanted = [names(record, language) for record in (fog(), rate_gyro_triad()) for language in ("en", "zh")]
    assert written == set().union(*wanted)
    assert {Path(line).name for line in capsys.readouterr().out.split()} == written
    stem = fog().file_name.removesuffix(".json")
    content = json.loads((folder / "out" / f"{stem}-certificate-zh.json").read_text(encoding="utf-8"))
    assert content["format"] == "testloom-certificate/1"
    assert content["document"]["title"] == "校准证书"


def test_another_process_makes_the_same_bytes_and_another_content_is_not_written_over_it(
    folder: Path, capsys
) -> None:
    write_record(fog(), folder / "one")
    arguments = ["certificate", str(folder / "one"), "--out", str(folder / "out")]
    assert main(arguments) == 0
    before = {path.name: path.read_bytes() for path in (folder / "out").iterdir()}
    elsewhere = [*arguments[:3], str(folder / "again")]
    environment = {**os.environ, "PYTHONHASHSEED": "77", "TZ": "Asia/Shanghai", "LC_ALL": "C"}
    program = f"from cli.main import main; raise SystemExit(main({elsewhere}))"
    subprocess.run([sys.executable, "-c", program], env=environment, check=True, capture_output=True)
    assert {path.name: path.read_bytes() for path in (folder / "again").iterdir()} == before
    details = folder / "details.yaml"
    details.write_text("number: CAL-1\n", encoding="utf-8")
    assert main([*arguments, "--details", str(details)]) == 1
    assert "There is another document of this name." in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in (folder / "out").iterdir()} == before


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_damaged_record_is_named_and_nothing_is_written(folder: Path, capsys, language: str) -> None:
    damaged = folder / "records" / fog().file_name
    damaged.write_text(damaged.read_text(encoding="utf-8")[:300], encoding="utf-8")
    arguments = ["certificate", str(folder / "records"), "--out", str(folder / "out"), "--lang", language]
    assert main(arguments) == 1
    said = capsys.readouterr().err
    assert fog().file_name in said.replace("\n", "")
    assert ("What to do" in said) is (language == "en")
    assert not (folder / "out").exists()


def test_details_are_refused_where_they_do_not_fit(folder: Path, capsys) -> None:
    details, records = folder / "details.yaml", folder / "records"
    arguments = ["certificate", str(records), "--out", str(folder / "out"), "--details", str(details)]
    for text, said in (
        (None, "cannot be read"),
        (DETAILS, "customer.order"),
        (DETAILS.replace("order", "reference"), "one number, and there are 2"),
        ("tolerances: {linearity_y: {unit: '%', upper: 0.2}}", "linearity_y"),
    ):
        if text is not None:
            details.write_text(text, encoding="utf-8")
        assert main(arguments) == 1
        assert said in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_records_of_a_unit_together_are_one_certificate(folder: Path, capsys) -> None:
    arguments = ["certificate", str(folder / "records"), "--out", str(folder / "out"), "--together"]
    assert main(arguments) == 1
    assert "of 2 units" in capsys.readouterr().err
    assert not (folder / "out").exists()
    first = rate_gyro_triad().model_copy(update={"budgets": (), "tables": (), "covariance": ()})
    other = first.model_copy(update={"sensor": "gyro_y"})
    for record in (first, other):
        write_record(record, folder / "unit")
    details = folder / "details.yaml"
    details.write_text("number: CAL-2026-0117\n", encoding="utf-8")  # one number for one certificate
    arguments[1] = str(folder / "unit")
    assert main([*arguments, "--details", str(details)]) == 0
    written = [Path(line).name for line in capsys.readouterr().out.split()]
    assert [name.rpartition("-en.")[2] for name in written] == ["pdf", "json"] * 2
    content = json.loads((folder / "out" / written[1]).read_text(encoding="utf-8"))
    assert {one["sensor"] for one in content["records"]} == {first.sensor, "gyro_y"}
    assert content["document"]["number"] == "CAL-2026-0117"


def test_without_a_record_it_says_how_to_make_one(tmp_path: Path, capsys) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["certificate", str(tmp_path / "empty"), "--out", str(tmp_path / "out")]) == 1
    assert "--record DIR" in capsys.readouterr().err

"""`testloom gap` as a person and a script use it: diagnose, apply, verify, next."""

import dataclasses
import json
import subprocess

import pytest

from cli.gap_orders import ways_to_test
from cli.main import main
from dut_emulator.twin import read_twin
from gap_diagnosis.report_document import NextTestEntry, parse_report, read_report, report_text
from protocol.language import choose_language
from tests.gap_diagnosis.imagined_reports import document, parsed, report

RECORD = ["emulator", "record", "rate_gyro_triad", "static", "--set", "duration_s=1s", "--form", "folder"]


@pytest.fixture(autouse=True)
def _english_again():
    yield
    choose_language("en")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two short runs in one folder, and a third elsewhere."""
    folder = tmp_path_factory.mktemp("gap")
    for run, place in ((1, "runs"), (2, "runs"), (3, "new")):
        assert main([*RECORD, "--run", str(run), "--out", str(folder / place)]) == 0
    return folder


@pytest.fixture
def asked(monkeypatch):
    """A diagnosis that finds what is imagined, and tells what it was asked."""
    told = {}

    def diagnose(recordings, *, without=frozenset(), progress=None):
        told["ids"] = [one.recording_id for one in recordings]
        told["without"] = without
        progress("which", 0.5)
        whole = report("attributed")
        return told.get("report") or dataclasses.replace(whole, series=whole.series[:1])

    monkeypatch.setattr("gap_diagnosis.diagnosis.diagnose", diagnose)
    return told


def written(path, verdict, **changes):
    path.write_text(report_text(document(verdict) | changes), encoding="utf-8")
    return str(path)


def test_a_folder_of_recordings_becomes_report_page_and_plots(runs, asked, tmp_path, capsys):
    out = tmp_path / "gap"
    command = ["gap", "diagnose", str(runs / "runs"), "--out", str(out)]
    assert main([*command, "--without", "gyro.warm_up"]) == 0
    shown = capsys.readouterr().out
    assert "one cause explains it: gyro: g-sensitivity (on gyro x)" in " ".join(shown.split())
    assert "acc_xy = 0.00402 ± 0.00031 °/s per g" in shown
    assert str(out / "report.html") in shown.replace("\n", "")
    assert asked["ids"] == [f"rate_gyro_triad-U-0001-static-m1-r{run}" for run in (1, 2)]
    assert asked["without"] == {"gyro.warm_up"}
    found = read_report(out)
    assert [one.recording_id for one in found.recordings] == asked["ids"]
    listing = runs / "runs" / asked["ids"][0]
    sums = subprocess.run(
        "sha256sum dut.npz recording.json stand.npz | sha256sum",
        shell=True, cwd=listing, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert found.recordings[0].sha256 == sums.stdout.split()[0]
    page = (out / "report.html").read_text(encoding="utf-8")
    plots = sorted((out / "plots").iterdir())
    assert plots
    assert all(path.read_text(encoding="utf-8").strip() in page for path in plots)
    assert main(command) == 1
    assert "something of this name already" in capsys.readouterr().err


def test_json_and_chinese(runs, asked, tmp_path, capsys):
    asked["report"] = report("unattributed").__class__(document("unattributed"))
    arguments = ["gap", "diagnose", str(runs / "new"), "--out"]
    assert main([*arguments, str(tmp_path / "a"), "--json"]) == 0
    shown = capsys.readouterr().out
    assert shown == (tmp_path / "a" / "report.json").read_text(encoding="utf-8")
    assert main([*arguments, str(tmp_path / "b"), "--lang", "zh"]) == 0  # a gap without a cause is no failure
    assert "没有已知效应可以解释" in capsys.readouterr().out
    assert '<html lang="zh">' in (tmp_path / "b" / "report.html").read_text(encoding="utf-8")


def test_what_cannot_be_diagnosed_leaves_nothing(runs, asked, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    one = str(next((runs / "runs").iterdir()))
    for arguments, said in (
        ([one, str(runs / "runs")], "is given twice"),
        ([str(tmp_path / "nothing")], "no such file or folder"),
        ([one, "--without", "gyro.humidity"], "no effect 'gyro.humidity'"),
    ):
        assert main(["gap", "diagnose", *arguments, *out]) == 1
        assert said in capsys.readouterr().err.lower().replace("\n", " ")
    assert not (tmp_path / "out").exists()


def test_the_effects_go_into_a_new_twin_file(tmp_path, capsys):
    twin = tmp_path / "unit.json"
    assert main(["emulator", "show", "mems_ahrs", "--out", str(twin)]) == 0
    before = read_twin(twin)
    capsys.readouterr()
    assert main(["gap", "apply", written(tmp_path / "r.json", "attributed"), "--twin", str(twin)]) == 0
    shown = capsys.readouterr().out
    assert "0.00402 °/s per g" in shown
    after = read_twin(tmp_path / "unit-with-gap.json")
    assert read_twin(twin) == before
    changed = [one for one in after.effects if one not in before.effects]
    assert [one.word for one in changed] == ["g_sensitivity"]
    arguments = ["gap", "apply", written(tmp_path / "c.json", "confusable"), "--twin", str(twin)]
    assert main([*arguments, "--out", str(tmp_path / "second.json"), "--rank", "2"]) == 0
    assert "could not tell these apart" in capsys.readouterr().err
    assert any(one.word == "even_nonlinearity" for one in read_twin(tmp_path / "second.json").effects)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"verdict": "no_gap"}, "found no gap"),
        ({"product": "fog"}, "about a fog"),
        ({"format": "testloom-gap-report/9"}, "testloom-gap-report/1"),
    ],
)
def test_what_cannot_be_applied_is_refused(changes, said, tmp_path, capsys):
    twin = tmp_path / "unit.json"
    assert main(["emulator", "show", "mems_ahrs", "--out", str(twin)]) == 0
    broken = tmp_path / "r.json"
    broken.write_text(json.dumps(document("attributed") | changes), encoding="utf-8")
    assert main(["gap", "apply", str(broken), "--twin", str(twin)]) == 1
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert list(tmp_path.glob("unit-*")) == []


def test_a_gap_is_verified_on_recordings_that_were_not_used(runs, tmp_path, capsys, monkeypatch):
    told = {}

    def verify(observations, effects):
        told["ids"] = [one.recording_id for one in observations]
        told["effects"] = effects
        return document("attributed")["shrinkage"]

    monkeypatch.setattr("gap_diagnosis.verification.verify", verify)
    used = [{"recording_id": "rate_gyro_triad-U-0001-static-m1-r1", "sha256": "0" * 64}]
    path = written(tmp_path / "r.json", "attributed", recordings=used)
    assert main(["gap", "verify", path, str(runs / "runs")]) == 1
    assert "was made from the recording" in capsys.readouterr().err
    assert main(["gap", "verify", path, str(runs / "new")]) == 0
    shown = capsys.readouterr().out
    assert "99.6 % (95 %: 99.1 % to 99.8 %)" in shown
    assert "0.0142" in shown
    assert told["ids"] == ["rate_gyro_triad-U-0001-static-m1-r3"]
    assert [effect.word for effect in told["effects"]] == ["g_sensitivity"]
    assert main(["gap", "verify", path, str(runs / "new"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fraction_closed"] == 0.9962


def test_the_next_test_comes_with_the_command_that_makes_it(tmp_path, capsys):
    assert main(["gap", "next", written(tmp_path / "r.json", "attributed")]) == 0
    shown = capsys.readouterr().out
    assert "tumble, 2.1 min" in shown
    assert "No plan of a line does this test yet" in shown
    assert "testloom emulator record mems_ahrs tumble --set spin_deg_s=100 --serial U-0007" in shown
    assert main(["gap", "next", written(tmp_path / "n.json", "no_gap")]) == 0
    assert "No test" in capsys.readouterr().out
    ordered = parse_report(report_text(document("attributed") | {"product": "gnc_module"}))
    lines = list(ways_to_test(ordered, NextTestEntry(profile="rotation", minutes=1.5, expected_bits=0.5)))
    assert "imu_calibration" in lines[0]
    assert "three_axis_turntable" in lines[0]
    assert lines[1].strip() == "testloom order --route gnc_module --serials U-0007"
    assert parsed("attributed").next_test is not None


NOISE = {
    "gyro.angle_random_walk": ("density_si_per_sqrt_hz", 0.2, "deg/sqrt(h)"),
    "gyro.bias_instability": ("standard_deviation_si", 5.0, "deg/h"),
    "acc.velocity_random_walk": ("density_si_per_sqrt_hz", 0.3, "m/s/sqrt(h)"),
    "acc.bias_instability": ("standard_deviation_si", 0.3, "mg"),
}


@pytest.mark.slow
def test_a_withheld_effect_is_found_put_into_the_twin_and_verified(tmp_path, capsys):
    """All of it on emulated recordings: an effect that the belief has not, three runs, one kept back."""
    twin, with_effect = tmp_path / "unit.json", tmp_path / "true.json"
    effects = [
        {"effect": name, "parameters": {f"{field}_{axis}": {"value": value, "unit": unit} for axis in "xyz"}}
        for name, (field, value, unit) in NOISE.items()
    ]
    document = {"format": "testloom-twin/1", "product": "mems_ahrs", "effects": effects}
    twin.write_text(json.dumps(document), encoding="utf-8")
    added = ["gyro.g_sensitivity", "acc_xy=0.01deg/s/g"]
    assert main(["emulator", "with", str(twin), *added, "--out", str(with_effect)]) == 0
    for run, place in ((1, "seen"), (2, "seen"), (3, "kept")):
        record = ["emulator", "record", "mems_ahrs", "multi_position", "--set", "dwell_s=20"]
        place = ["--form", "folder", "--run", str(run), "--out", str(tmp_path / place)]
        assert main([*record, "--twin", str(with_effect), *place]) == 0
    out = tmp_path / "gap"
    assert main(["gap", "diagnose", str(tmp_path / "seen"), "--out", str(out)]) == 0
    found = read_report(out)
    assert found.verdict == "attributed"
    assert found.sets[0].effects == ("gyro.g_sensitivity",)
    assert main(["gap", "apply", str(out), "--twin", str(twin), "--out", str(tmp_path / "new.json")]) == 0
    (effect,) = [one for one in read_twin(tmp_path / "new.json").effects if one.word == "g_sensitivity"]
    (truth,) = [one for one in read_twin(with_effect).effects if one.word == "g_sensitivity"]
    assert effect.acc[0][1] == pytest.approx(truth.acc[0][1], rel=0.15)  # four standard uncertainties
    capsys.readouterr()
    assert main(["gap", "verify", str(out), str(tmp_path / "kept"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fraction_closed"] > 0.8
    assert main(["gap", "verify", str(out), str(tmp_path / "seen")]) == 1

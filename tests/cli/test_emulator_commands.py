"""`testloom emulator` as a person and a script use it."""

import json
import re

import numpy as np
import pytest

from cli.main import main
from dut_emulator.motion.profile_catalogue import PROFILES
from dut_emulator.recording import recording_files
from dut_emulator.twin import read_twin
from protocol import durable_files
from protocol.adapters.recording_forms import read_recording
from protocol.language import choose_language, say
from protocol.recording_checks import equal_recordings

RECORD = ["emulator", "record", "rate_gyro_triad", "static"]
SHORT = ["--set", "duration_s=2000ms"]


def test_a_recording_in_both_forms_with_its_truth(tmp_path, capsys):
    out = tmp_path / "out"
    truth = tmp_path / "truth.json"
    arguments = [
        *RECORD,
        *SHORT,
        "--out",
        str(out),
        "--truth",
        str(truth),
        "--serial",
        "U-0007",
        "--run",
        "2",
    ]
    assert main(arguments) == 0
    name = "rate_gyro_triad-U-0007-static-m1-r2"
    shown = capsys.readouterr().out
    assert f"{name}: 2 s recorded" in shown
    folder, mcap = read_recording(out / name), read_recording(out / f"{name}.mcap")
    assert equal_recordings(folder, mcap)
    assert folder.test["values"]["duration_s"] == 2.0  # given in ms
    assert json.loads(truth.read_text())["unit"]["product"] == "rate_gyro_triad"
    assert main(arguments) == 1
    assert "something of this name already" in capsys.readouterr().err


def test_the_same_order_gives_the_same_samples_and_another_seed_others(tmp_path):
    taken = []
    for name, more in (("a", []), ("b", []), ("c", ["--seed", "2"])):
        arguments = [*RECORD, *SHORT, "--form", "mcap", "--out", str(tmp_path / name), *more]
        assert main(arguments) == 0
        (path,) = (tmp_path / name).iterdir()
        taken.append(read_recording(path).streams["dut"].columns["volt_x"])
    np.testing.assert_array_equal(taken[0], taken[1])
    assert not np.array_equal(taken[0], taken[2])


def test_an_effect_put_into_a_twin_is_seen_in_the_recording(tmp_path, capsys):
    twins = [tmp_path / "unit.json", tmp_path / "shifted.json"]
    assert main(["emulator", "show", "rate_gyro_triad", "--out", str(twins[0])]) == 0
    shift = ["gyro.bias", "bias_si_x=5deg/s"]
    assert main(["emulator", "with", str(twins[0]), *shift, "--out", str(twins[1])]) == 0
    before, after = (read_twin(path) for path in twins)
    (bias,) = [effect for effect in after.effects if effect.word == "bias"]
    assert bias.bias_si[0] == pytest.approx(np.radians(5.0))
    assert len(after.effects) == len(before.effects)
    means = []
    for path in twins:
        out = tmp_path / path.stem
        assert main([*RECORD, *SHORT, "--twin", str(path), "--form", "folder", "--out", str(out)]) == 0
        (folder,) = out.iterdir()
        means.append(read_recording(folder).streams["dut"].columns["volt_x"].mean())
    (old,) = [effect.bias_si[0] for effect in before.effects if effect.word == "bias"]
    # paper 4: 0.050698 V/(°/s), within the lot's spread of some percent
    assert means[1] - means[0] == pytest.approx(0.050698 * (5.0 - np.degrees(old)), rel=0.05)
    capsys.readouterr()


def test_a_unit_of_one_more_effect_says_its_units(tmp_path, capsys):
    twin = tmp_path / "t.json"
    given = ["gyro.g_sensitivity", "acc_xy=0.004deg/s/g", "acc_zz=1e-6"]
    assert main(["emulator", "with", "rate_gyro_triad", *given, "--out", str(twin)]) == 0
    (effect,) = [one for one in read_twin(twin).effects if one.word == "g_sensitivity"]
    assert effect.acc[0][1] == pytest.approx(np.radians(0.004) / 9.80665)
    assert effect.acc[2][2] == 1e-6
    assert "deg/s per g" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([*RECORD[:2], "rocket", "static"], "There is no product 'rocket'"),
        ([*RECORD[:3], "swing"], "A rate_gyro_triad cannot undergo the profile 'swing'"),
        ([*RECORD[:3], "dance"], "There is no profile 'dance'"),
        ([*RECORD, "--set", "duration_s=2deg"], "'deg' does not measure what 's' measures"),
        ([*RECORD, "--set", "duration_s"], "'duration_s' is no value"),
        ([*RECORD, "--set", "duration_s=1", "--set", "duration_s=2"], "duration_s is given twice"),
        ([*RECORD, "--set", "duration_s=-1"], "duration_s cannot be -1 s"),
        ([*RECORD, "--twin", "nowhere.json"], "There is no such twin file"),
        (
            ["emulator", "record", "gnc_module", "rate_staircase", "--set", "max_rate_deg_s=9000"],
            "above its limit",
        ),
        ([*RECORD, "--set", "duration_s=1e400"], "'duration_s=1e400' is no value"),
        ([*RECORD, "--latitude", "91"], "There is no such site"),
        ([*RECORD, *SHORT, "--truth", "{a file}/truth.json"], "The file could not be written"),
        (["emulator", "show", "fog", "--seed", "-1"], "seed cannot be '-1'"),
        (["emulator", "with", "fog", "gyro.bias", "bias_si_x=1e400"], "is no value"),
        (["emulator", "show", "rocket"], "'rocket' is neither a product nor a twin file"),
        (["emulator", "plot", "{no product}"], "There is no product ''"),
        (["emulator", "with", "fog", "acc.bias", "bias_si_x=1mg"], "an effect of a sensor 'acc'"),
        (["emulator", "with", "rate_gyro_triad", "gyro.charm", "x=1"], "There is no effect 'gyro.charm'"),
        (["emulator", "with", "rate_gyro_triad", "stand.wobble", "x=1"], "not on a triad left open"),
        (["emulator", "with", "rate_gyro_triad", "gyro.bias"], "'gyro.bias' without parameters"),
        (["emulator", "with", "rate_gyro_triad", "gyro.bias", "x=1"], "has no parameter 'x'"),
        (["emulator", "with", "rate_gyro_triad", "gyro.bias", "bias_si_x=1g"], "'g' does not measure"),
        (["emulator", "with", "rate_gyro_triad", "gyro.bias", "bias_si_x=1e9"], "lies outside"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(tmp_path, capsys, arguments, says):
    nobodys = tmp_path / "nobodys.json"
    nobodys.write_text('{"format": "testloom-twin/1", "effects": []}')
    named = {"{no product}": str(nobodys), "{a file}/truth.json": str(nobodys / "truth.json")}
    given = [named.get(word, word) for word in arguments]
    assert main([*given, "--out", str(tmp_path / "out")]) == 1
    shown = capsys.readouterr().err
    assert says in shown
    assert "What to do" in shown
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (
            ["gyro.g_sensitivity", "acc_xy=1deg/s"],
            ["'deg/s' does not", "gyro.g_sensitivity, acc_xy", "operator"],
        ),
        (["gyro.bais", "bias_si_x=1deg/h"], ["gyro.bias,", "'testloom emulator effects' lists", "operator"]),
        (["acc.bias", "bias_si_x=1e9"], ["lies outside", "command line, acc.bias", "operator"]),
        (["gyro.bias", "bias_si_x=1m"], ["command line, gyro.bias, bias_si_x", "operator"]),
    ],
)
def test_what_is_wrong_on_the_command_line_is_looked_for_there(tmp_path, capsys, given, says):
    assert main(["emulator", "with", "mems_ahrs", *given, "--out", str(tmp_path / "unit.json")]) == 1
    shown = capsys.readouterr().err
    assert [words for words in says if words not in shown] == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "given",
    [
        ["with", "fog", "gyro.bias"],
        ["with", "fog", "gyro.bias", "bias_si_x=1m"],
        ["with", "fog", "gyro.charm", "x=1"],
        ["with", "fog", "gyro.bias", "bias_si_x=1e9"],
        ["record", "gnc_module", "rotation", "--set", "ramp_s=2.4"],
        ["record", "gnc_module", "rotation", "--set", "axis=9"],
        ["record", "fog", "static", "--serial", "../x"],
        ["record", "fog", "static", "--set", "duration_s=2 deg"],
    ],
)
def test_a_refusal_is_wholly_chinese(tmp_path, capsys, given):
    assert main(["--lang", "zh", "emulator", *given, "--out", str(tmp_path / "out")]) == 1
    what, _, _, remedy = capsys.readouterr().err.splitlines()
    assert choose_language("en") is None
    for sentence in (what, remedy):
        assert re.search("[\u4e00-\u9fff]", sentence)
        assert not re.search(r"\b(give|use|does|cannot|the|outside)\b", sentence), sentence


def test_units_are_found_however_they_are_spaced_and_the_others_are_named(tmp_path, capsys):
    for name, value in (("a", "1 deg / h"), ("b", "1deg/h")):
        given = ["gyro.bias", f"bias_si_x={value}"]
        assert main(["emulator", "with", "fog", *given, "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text()
    assert main([*RECORD, "--set", "duration_s=1 day", "--out", str(tmp_path / "out")]) == 1
    assert "s, ms, us, min, h." in capsys.readouterr().err
    (tmp_path / "marked.json").write_text((tmp_path / "a").read_text(), encoding="utf-8-sig")
    assert read_twin(tmp_path / "marked.json") == read_twin(tmp_path / "a")


def test_a_full_disk_leaves_no_half_recording(tmp_path, capsys, monkeypatch):
    class FullDisk(recording_files.FolderRecordingWriter):
        def _flush(self, stream):
            with self._discarded_if_refused():
                raise OSError(28, "No space left on device")

    monkeypatch.setattr(recording_files, "FolderRecordingWriter", FullDisk)
    truth = tmp_path / "truth.json"
    assert (
        main([*RECORD, *SHORT, "--form", "folder", "--out", str(tmp_path / "out"), "--truth", str(truth)])
        == 1
    )
    assert "The disk is full" in capsys.readouterr().err
    assert list((tmp_path / "out").iterdir()) == []
    assert not truth.exists()


def test_a_full_disk_leaves_no_half_twin(tmp_path, capsys, monkeypatch):
    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(durable_files, "sync", full)
    assert main(["emulator", "show", "fog", "--out", str(tmp_path / "unit.json")]) == 1
    assert "The file could not be written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_script_gets_json(tmp_path, capsys):
    assert main([*RECORD, *SHORT, "--form", "mcap", "--out", str(tmp_path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    (path,) = facts["written"]
    assert read_recording(path).recording_id == facts["recording_id"]
    assert main(["emulator", "products", "--json"]) == 0
    pairs = json.loads(capsys.readouterr().out)
    assert pairs["rate_gyro_triad"]["static"]["stand"] == "rate_table"
    assert main(["emulator", "products", "static", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["parameters"][0]["name"] == "duration_s"


def test_the_lists_name_what_there_is(capsys):
    assert main(["emulator", "effects"]) == 0
    assert "gyro.g_sensitivity" in capsys.readouterr().out
    assert main(["emulator", "effects", "stand.wobble"]) == 0
    assert "gyro, acc, mag" in capsys.readouterr().out
    assert main(["emulator", "products", "eleven_point"]) == 0
    assert "dwell_s" in capsys.readouterr().out
    assert main(["emulator", "products"]) == 0
    assert "sinusoidal_overload_rig" in capsys.readouterr().out
    assert main(["emulator", "show", "rate_gyro_triad"]) == 0
    assert "gyro.bandwidth" in capsys.readouterr().out


def test_a_late_calibration_is_told_in_chinese_too(tmp_path, capsys):
    late = ["--started-at", "2040-01-01", "--form", "mcap", "--out", str(tmp_path)]
    assert main(["--lang", "zh", *RECORD, *SHORT, *late]) == 0
    said = capsys.readouterr()
    assert "的校准已于" in said.err
    assert "已记录 2 秒" in said.out
    assert main(["--lang", "en", "emulator", "--help"]) == 0


def test_what_a_profile_is_for_is_said_in_chinese():
    texts = {kind.reveals for kind in PROFILES.values()}
    texts |= {parameter.meaning for kind in PROFILES.values() for parameter in kind.parameters}
    assert [text for text in sorted(texts) if say(text, language="zh") == text] == []


def test_pictures_of_a_unit(tmp_path, monkeypatch, capsys):
    from cli import emulator_plots

    monkeypatch.setattr(emulator_plots, "REST_S", 60.0)
    assert main(["emulator", "plot", "rate_gyro_triad", "--out", str(tmp_path)]) == 0
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [f"rate_gyro_triad-U-0001-{word}.png" for word in ("allan", "step", "temperature")]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in tmp_path.iterdir())
    assert len(capsys.readouterr().out.split()) == 3
    assert main(["emulator", "plot", "rate_gyro_triad", "--seed", "2", "--out", str(tmp_path)]) == 1
    assert "something of this name already" in capsys.readouterr().err


def test_nothing_is_drawn_to_answer_before_its_step():
    from cli.emulator_plots import _until_the_step

    times_s, answer = _until_the_step(np.array([-0.5, 0.0, 0.5]), np.array([[0.0], [1.0], [1.0]]))
    assert np.interp([-1e-9, 1e-9], times_s, answer[:, 0]).tolist() == pytest.approx([0.0, 1.0])

"""`testloom calibrate`: a station's own recording in either form, JSON, and what a user can get wrong."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.imu_session import SlowNoise
from calibration.recorded import Source, evaluate, sensor_range
from calibration.sensor_knowledge import slow_noise
from cli.main import main
from cli.uncertain_numbers import gum, plain, two_digits
from protocol.adapters.recording_forms import convert
from protocol.folder_form import write_folder
from protocol.language import choose_language
from protocol.recordings import Recording, Stream


@pytest.fixture(autouse=True)
def _english():
    yield
    choose_language("en")


def station_recording(poses, rotations, **test: object) -> Recording:
    """All captures on one clock, with the segments that say what each was."""
    segments = []
    blocks = []
    for pose in poses:
        segments.append(
            {
                "name": pose.name,
                "kind": "static",
                "start_s": float(pose.time_s[0]),
                "end_s": float(pose.time_s[-1]) + 0.01,
                "specific_force_body_m_s2": pose.specific_force_body_m_s2.tolist(),
                "earth_rate_body_rad_s": pose.earth_rate_body_rad_s.tolist(),
            }
        )
        blocks.append((pose.time_s, pose.gyro_rad_s, pose.acc_m_s2))
    for run in rotations:
        segments.append(
            {
                "name": run.name,
                "kind": "rotation",
                "start_s": float(run.time_s[0]),
                "end_s": float(run.time_s[-1]) + 0.01,
                "rotation_body_rad": run.rotation_body_rad.tolist(),
                "earth_rotation_body_rad": run.earth_rotation_body_rad.tolist(),
            }
        )
        blocks.append((run.time_s, run.gyro_rad_s, np.full_like(run.gyro_rad_s, np.nan)))
    time_s, gyro, acc = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    units = {"t": "s"} | {f"gyro_{a}": "deg/s" for a in "xyz"} | {f"acc_{a}": "m/s^2" for a in "xyz"}
    columns = {"t": time_s}
    columns |= {f"gyro_{a}": np.degrees(gyro[:, k]) for k, a in enumerate("xyz")}
    columns |= {f"acc_{a}": acc[:, k] for k, a in enumerate("xyz")}
    believed = {"gyro": {"unit": "deg/s", "range": 400}, "acc": {"unit": "g", "range": 50}}
    return Recording(
        "session-1",
        {"serial": "U-0007", "product": "gnc_module"},
        {"profile": "imu_calibration", "segments": segments} | test,
        {"dut": Stream("dut", "dut", "t", units, columns)},
        believed=believed,
    )


def test_a_stations_recording_gives_its_coefficients_back(synthetic_imu, tmp_path: Path, capsys) -> None:
    """Paper 1's 1080 deg within 5 s would peak above the range; the synthetic turn takes 6 s at 360 deg/s."""
    recording = station_recording(*synthetic_imu.session(11))
    write_folder(recording, tmp_path / "session-1")
    convert(tmp_path / "session-1", tmp_path / "session-1.mcap")
    documents = []
    for path in (tmp_path / "session-1", tmp_path / "session-1.mcap"):
        assert main(["calibrate", str(path), "--json"]) == 0
        documents.append(json.loads(capsys.readouterr().out))
    assert documents[0] == documents[1]
    assert documents[0]["format"] == "testloom-calibration/1"
    (result,) = documents[0]["results"]
    assert result["method"] == "imu_calibration"
    assert result["unit"] == {"serial": "U-0007", "product": "gnc_module"}
    for kind, matrix, bias in (
        ("gyro", synthetic_imu.gyro_m, synthetic_imu.gyro_b),
        ("acc", synthetic_imu.acc_m, synthetic_imu.acc_b),
    ):
        triad = result[kind]
        pull = (np.array(triad["matrix"]) - matrix) / triad["matrix_standard_uncertainty"]
        assert np.abs(pull).max() < 3.5
        assert np.abs((np.array(triad["bias"]) - bias) / triad["bias_standard_uncertainty"]).max() < 3.5
        np.testing.assert_allclose(np.array(triad["compensation"]) @ triad["matrix"], np.eye(3), atol=1e-12)
        assert np.array(triad["covariance"]).shape == (12, 12)
    assert result["published"] is None


def test_stated_bias_instability_is_taken_from_the_recording(synthetic_imu) -> None:
    recording = station_recording(*synthetic_imu.session(12))
    stated = {"value": 5, "unit": "deg/h", "correlation_time_s": 300}
    believed = {"gyro": {"unit": "deg/s", "range": 400, "bias_instability": stated}}
    known = Recording(
        recording.recording_id, recording.unit, recording.test, recording.streams, believed=believed
    )
    found = evaluate([Source(known)])
    assert any("as stated" in sentence for sentence in found.assumptions)
    assert found.gyro is not None
    assert slow_noise(known, "gyro") == (SlowNoise(pytest.approx(math.radians(5 / 3600)), 300.0),)
    stated["unit_spread"] = 0.5
    believed["gyro"]["turn_on_repeatability"] = {"value": 3, "unit": "deg/h"}
    assert slow_noise(known, "gyro") == (
        SlowNoise(pytest.approx(math.radians(5 / 3600) * math.exp(0.25)), 300.0),
        SlowNoise(pytest.approx(math.radians(3 / 3600)), math.inf),
    )
    # 5 deg/h that wander with 300 s stay in the bias, however long the poses are.
    assert found.gyro.bias_standard_uncertainty()[0] > 0.6 * math.radians(5 / 3600)
    assert sensor_range(known, "gyro") == pytest.approx(math.radians(399.2))
    assert sensor_range(known, "acc") is None


def test_the_printed_page_names_unit_coefficients_and_what_was_not_used(
    synthetic_imu, tmp_path: Path, capsys, monkeypatch
) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    poses, rotations = synthetic_imu.session(13)
    acc = poses[0].acc_m_s2
    acc[3] = np.nan
    write_folder(station_recording(poses, rotations), tmp_path / "session-1")
    assert main(["calibrate", str(tmp_path)]) == 0  # a folder of recordings
    page = capsys.readouterr().out
    for words in (
        "Unit U-0007 (gnc_module)",
        "y = M u + b",
        "±",
        "missing values (NaN)",
        "x_up (accelerometer)",
    ):
        assert words in page
    assert main(["--lang", "zh", "calibrate", str(tmp_path)]) == 0
    assert "加速度计" in capsys.readouterr().out


def test_one_bad_recording_does_not_hide_the_others(synthetic_imu, tmp_path: Path, capsys) -> None:
    good = station_recording(*synthetic_imu.session(14))
    write_folder(good, tmp_path / "a")
    broken = dict(good.test["segments"][0])
    del broken["specific_force_body_m_s2"]
    write_folder(
        Recording("b", good.unit, {"profile": "imu_calibration", "segments": [broken]}, good.streams),
        tmp_path / "b",
    )
    (tmp_path / "c").mkdir()
    paths = [str(tmp_path / name) for name in "abc"]
    assert main(["calibrate", *paths, "--json"]) == 1
    results = json.loads(capsys.readouterr().out)["results"]
    errors = [result["error"] for result in results if "error" in result]
    assert len(results) == 3
    assert len(errors) == 2
    assert sorted(error["fault"] for error in errors) == ["data", "operator"]
    assert any("specific_force_body_m_s2" in error["what"] for error in errors)
    assert any("test.segments[1]" in error["where"] for error in errors)
    assert main(["calibrate", *paths]) == 1
    captured = capsys.readouterr()
    assert "specific_force_body_m_s2" in captured.err
    assert "Traceback" not in captured.err


def test_the_same_recording_twice_is_refused(synthetic_imu, tmp_path: Path, capsys) -> None:
    session = station_recording(*synthetic_imu.session(14))
    for name in "ab":
        write_folder(session, tmp_path / name)
    for again in ("a", "b", "."):
        assert main(["calibrate", str(tmp_path / "a"), str(tmp_path / again)]) == 1
        assert "named twice" in capsys.readouterr().err


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e3))
def test_uncertainty_is_printed_with_two_digits_and_the_value_to_the_same_place(
    value: float, u: float
) -> None:
    numbers, _, power = gum(value, u).removeprefix("(").partition(")e")
    printed_value, printed_u = numbers.split(" ± ")
    value, u = value / 10.0 ** int(power or 0), u / 10.0 ** int(power or 0)
    assert not power or max(abs(value), u) < 1000.0
    assert float(printed_u) == pytest.approx(u, rel=0.051)
    assert len(printed_u.replace(".", "").lstrip("0").rstrip("0") or "0") <= max(2, len(str(int(u))))
    assert abs(float(printed_value) - value) <= u * 0.051 + abs(value) * 1e-15
    assert printed_value.partition(".")[2].__len__() == printed_u.partition(".")[2].__len__()


def test_gum_examples() -> None:
    assert gum(1.01687, 0.00278) == "1.0169 ± 0.0028"
    assert gum(-0.5, 0.0999) == "-0.50 ± 0.10"
    assert gum(1234.5, 120.0) == "1230 ± 120"
    assert gum(0.25, 0.0) == "0.25"
    assert gum(-2.3681e-6, 1.04e-8) == "(-2.368 ± 0.010)e-06"
    assert gum(1.2e-7, 1.94e-6) == "(0.1 ± 1.9)e-06"
    assert two_digits(6.432e-4) == "640e-06"
    assert plain(-9.99996e-4, 3) == "-1000e-06"

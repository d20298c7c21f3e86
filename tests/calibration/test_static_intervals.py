"""Rests found in data, named by a table, or said by a stand."""

from pathlib import Path

import numpy as np
import pytest

from calibration.algorithms.static_intervals import detect_rests
from calibration.rest_segments import named_sections, rests
from protocol.errors import CalibrationError
from protocol.recordings import Recording, Stream

DT = 0.01


def hand_session(seed: int) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """Five rests of 3 s, and 1 s of shaking after each."""
    rng = np.random.default_rng(seed)
    acc = rng.normal(size=(2000, 3)) * 0.02 + [0, 0, 9.8]
    truth = []
    for k in range(5):
        truth.append((400 * k, 400 * k + 300))
        moving = slice(400 * k + 300, 400 * k + 400)
        acc[moving] += 2.0 * np.sin(np.linspace(0, 20, 100))[:, None] * rng.normal(size=3)
    return np.arange(2000) * DT, acc, truth


@pytest.mark.parametrize("seed", range(5))
def test_rests_are_found_and_hold_no_motion(seed: int) -> None:
    time_s, acc, truth = hand_session(seed)
    found = detect_rests(time_s, (acc,))
    assert len(found) == 5
    for (first, last), (begin, end) in zip(found, truth, strict=True):
        assert begin <= first
        assert last <= end
        assert last - first > 0.7 * (end - begin)


def test_a_missing_sample_ends_a_rest_and_is_in_none() -> None:
    time_s, acc, _ = hand_session(0)
    acc[150, 1] = np.nan
    found = detect_rests(time_s, (acc,))
    assert all(not first <= 150 < last for first, last in found)
    assert len(found) == 6


def test_a_session_without_rest_or_without_data_has_none() -> None:
    time_s = np.arange(1000) * DT
    assert detect_rests(time_s[:20], (np.zeros((20, 3)),)) == ()
    assert detect_rests(time_s, (np.full((1000, 3), np.nan),)) == ()


def recording(profile: str, stand_time_s: np.ndarray | None = None, rate: float = 0.0) -> Recording:
    time_s, acc, _ = hand_session(0)
    units = {"t": "s", "acc_x": "m/s^2", "acc_y": "m/s^2", "acc_z": "m/s^2"}
    columns = {"t": time_s, **{f"acc_{axis}": acc[:, k] for k, axis in enumerate("xyz")}}
    streams = {"dut": Stream("dut", "dut", "t", units, columns)}
    if stand_time_s is not None:
        rates = {f"rate_{axis}": np.full(len(stand_time_s), rate) for axis in "xyz"}
        units = {"t": "s", **dict.fromkeys(rates, "deg/s")}
        streams["stand"] = Stream("stand", "stand", "t", units, {"t": stand_time_s, **rates})
    return Recording("r1", {"serial": "U1", "product": "imu"}, {"profile": profile}, streams)


def test_a_hole_in_the_stands_rows_is_never_bridged() -> None:
    stand_time_s = np.concatenate([np.arange(30), np.arange(40, 70)]) * 0.1 + 0.005
    found = rests(recording("poses", stand_time_s), None)
    assert found.source == "rests where the stand says rate 0"
    assert [(segment.first, segment.last) for segment in found.segments] == [(1, 291), (401, 691)]


def test_a_stand_that_turns_is_no_rest() -> None:
    found = rests(recording("poses", np.arange(0, 19, 0.1), rate=5.0), None)
    assert found.source == "rests found by the variance of the data"
    assert len(found.segments) == 5


def test_tables_beside_the_recording_win_and_are_checked(tmp_path: Path) -> None:
    (tmp_path / "static_intervals.csv").write_text("0,400\n299,699\n")
    found = rests(recording("multi_position"), tmp_path)
    assert [(segment.first, segment.last) for segment in found.segments] == [(0, 300), (400, 700)]
    for damaged in ("0,400\n299\n", "0,x\n1,2\n", "5,6\n4,7\n", "0\n9999\n"):
        (tmp_path / "static_intervals.csv").write_text(damaged)
        with pytest.raises(CalibrationError, match=r"static_intervals\.csv"):
            rests(recording("multi_position"), tmp_path)
    assert named_sections(recording("ferraris_session"), tmp_path) is None
    (tmp_path / "sections.csv").write_text("section,start_s,end_s\nx_p,0,3\nx_a,4,7\n")
    sections = named_sections(recording("ferraris_session"), tmp_path)
    assert sections is not None
    assert [(segment.name, segment.first, segment.last) for segment in sections.segments] == [
        ("x_p", 0, 300),
        ("x_a", 400, 700),
    ]
    for damaged in ("x_p,0\n", "x_p,3,0\n", "x_p,100,200\n", "x_p,a,b\n"):
        (tmp_path / "sections.csv").write_text(damaged)
        with pytest.raises(CalibrationError, match=r"sections\.csv"):
            named_sections(recording("ferraris_session"), tmp_path)

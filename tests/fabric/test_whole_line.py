"""A whole line, from an order to verdicts, as real processes on loopback addresses."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

pytestmark = [pytest.mark.fabric, pytest.mark.xdist_group("line"), pytest.mark.timeout(400)]

TIMEOUT_S = 300.0
MAX_RECORDINGS_READ = 12


@dataclass(frozen=True)
class FinishedLine:
    """A run that ended by itself."""

    folder: Path
    summary: dict
    output: str


def _up(folder: Path, *options: str) -> subprocess.Popen[str]:
    """As a script starts it in the background: with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "cli.main", "up", "--dir", str(folder), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    finally:
        signal.signal(signal.SIGINT, before)


def _finished(folder: Path, units: int, seed: int) -> FinishedLine:
    summary = folder / "summary.json"
    line = _up(
        folder / "run",
        "--units",
        str(units),
        "--seed",
        str(seed),
        "--summary",
        str(summary),
        "--no-dashboard",
    )
    output, _ = line.communicate(timeout=TIMEOUT_S)
    assert line.returncode == 0, output
    return FinishedLine(folder / "run", json.loads(summary.read_text()), output)


def _left_behind(folder: Path) -> list[str]:
    """Command lines of running processes that belong to the run in this folder."""
    found = []
    for process in psutil.process_iter(["cmdline", "status"]):
        words = process.info["cmdline"] or []
        if any(str(folder) in word for word in words) and process.pid != os.getpid():
            found.append(" ".join(words))
    return found


@pytest.fixture(scope="module")
def finished_line(tmp_path_factory: pytest.TempPathFactory) -> FinishedLine:
    return _finished(tmp_path_factory.mktemp("line"), units=24, seed=7)


def test_every_unit_gets_the_right_verdict_and_nothing_is_lost(finished_line: FinishedLine) -> None:
    summary = finished_line.summary
    assert summary["units"] == 24
    assert sum(summary["dispositions"].values()) == 24
    assert (summary["lost"], summary["duplicated"], summary["unfinished"]) == (0, 0, [])
    assert summary["true_defective"] > 0, "a lot without a defect would show nothing"
    assert (summary["escapes"], summary["false_rejects"]) == (0, 0)
    assert summary["attempts"] >= 24
    assert set(summary["fpy"]) == set(summary["fpy_unit"]) == {"functional", "imu_calibration"}
    assert all(0 < fraction <= 1 for fraction in summary["fpy"].values())
    assert summary["rty"] == pytest.approx(summary["fpy"]["functional"] * summary["fpy"]["imu_calibration"])


def test_the_run_is_kept_in_one_folder_and_leaves_no_process(finished_line: FinishedLine) -> None:
    table = json.loads((finished_line.folder / "processes.json").read_text())
    assert {row["role"] for row in table} == {"router", "coordinator", "bench", "station"}
    assert len([row for row in table if row["role"] == "station"]) == 6
    assert _left_behind(finished_line.folder) == []
    for name in ("coordinator.sqlite", "logs", "spools", "recordings"):
        assert (finished_line.folder / name).exists(), name


def test_shipped_units_have_a_recording_that_can_be_read(finished_line: FinishedLine) -> None:
    from protocol.adapters.recording_forms import read_recording

    shipped = finished_line.summary["dispositions"]["SHIP"]
    recordings = sorted((finished_line.folder / "recordings").rglob("*.mcap"))
    assert len(recordings) >= 2 * shipped  # the calibration and the second look at what it made
    lengths: dict[str, list[int]] = {}
    for recording in map(read_recording, recordings[:MAX_RECORDINGS_READ]):
        dut = recording.stream("dut")
        assert {"gyro_x", "acc_x"} <= set(dut.columns)
        lengths.setdefault(recording.test["profile"], []).append(len(dut))
    # six positions of 30 s, or of 5 s, at 200 Hz; the turns come on top
    assert min(lengths["imu_calibration"]) > 36_000
    assert min(lengths["imu_verification"]) > 6_000


def test_stations_and_coordinator_do_not_know_the_truth(finished_line: FinishedLine) -> None:
    """The seed makes the truth: whoever has it could cheat."""
    table = json.loads((finished_line.folder / "processes.json").read_text())
    for row in table:
        if row["role"] != "bench":
            assert "--seed" not in row["command"]
            assert not any("sealed" in word for word in row["command"])


def test_interrupting_the_line_leaves_no_process(tmp_path: Path) -> None:
    line = _up(tmp_path / "run", "--units", "8", "--no-dashboard")
    table = tmp_path / "run" / "processes.json"
    deadline_s = time.monotonic() + 60
    while not (table.exists() and len(json.loads(table.read_text())) == 14):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    line.send_signal(signal.SIGINT)
    output, _ = line.communicate(timeout=60)
    assert line.returncode == 130, output
    assert "Traceback" not in output
    assert _left_behind(tmp_path / "run") == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 11, 42, 2026])
def test_other_lots_too(seed: int, tmp_path: Path) -> None:
    summary = _finished(tmp_path, units=24, seed=seed).summary
    assert (summary["lost"], summary["duplicated"]) == (0, 0)
    assert (summary["escapes"], summary["false_rejects"]) == (0, 0)

"""A gap diagnosis of one hour, 200 Hz, six axes: time and memory, by the command line, folder and MCAP."""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

GOAL_S, GOAL_GB = 60.0, 2.0
HOUR = {
    "temperature ramp": ("temperature_ramp", ("cold_c=-10", "hot_c=50", "ramp_c_per_min=4", "soak_s=600")),
    "sweep": ("sweep", ("duration_s=3500",)),
}
LONGEST_S = 900.0


def run() -> list[dict[str, Any]]:
    """Children's largest memory only grows: the quiet hour comes first."""
    rows: list[dict[str, Any]] = []
    for words, (profile, settings) in HOUR.items():
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            values = [part for one in settings for part in ("--set", one)]
            record = ["record", "mems_ahrs", profile, "--rate", "200", *values, "--out", str(place / "hour")]
            _testloom("emulator", *record)
            for number, path in enumerate(sorted((place / "hour").iterdir())):
                begin = time.perf_counter()
                _testloom("gap", "diagnose", str(path), "--out", str(place / f"out{number}"))
                took_s = time.perf_counter() - begin
                form = "folder" if path.is_dir() else "MCAP"
                rows.append(_row(f"gap diagnose, 1 h, {words}, {form}", took_s, "s", GOAL_S))
            used_gb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
            rows.append(_row(f"gap diagnose, 1 h, {words}, memory", used_gb, "GB", GOAL_GB))
    return rows


def _testloom(*arguments: str) -> None:
    command = [sys.executable, "-c", "from cli.entry import run; run()", *arguments]
    subprocess.run(command, check=True, capture_output=True, timeout=LONGEST_S)


def _row(figure: str, value: float, unit: str, goal: float) -> dict[str, Any]:
    return {
        "figure": figure,
        "value": round(value, 2),
        "unit": unit,
        "goal": f"at most {goal:g}",
        "met": value <= goal,
        "compared_with": "",
    }

"""A gap diagnosis of one hour, 200 Hz, six axes: time and memory, by the command line, folder and MCAP."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

GOAL_S, GOAL_GB = 60.0, 2.0
HOUR = {
    "temperature ramp": ("temperature_ramp", ("cold_c=-10", "hot_c=50", "ramp_c_per_min=4", "soak_s=600")),
    "staircase": ("rate_staircase", ("dwell_s=57",)),
    "swing": ("swing", ("cycles=1000", "amplitude_deg=113")),
    "tumble": ("tumble", ("turns=57",)),
    "sweep": ("sweep", ("duration_s=1166",)),
}
"""Profile and settings that make an hour of it, all axes together."""
LONGEST_S = 900.0
COMMAND = """
import resource, sys
from cli.entry import run
try:
    run()
finally:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)
"""


def run() -> list[dict[str, Any]]:
    """Each profile in both forms, each in a process of its own."""
    rows: list[dict[str, Any]] = []
    for words, (profile, settings) in HOUR.items():
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            values = [part for one in settings for part in ("--set", one)]
            record = ["record", "mems_ahrs", profile, "--rate", "200", *values, "--out", str(place / "hour")]
            _testloom("emulator", *record)
            for number, path in enumerate(sorted((place / "hour").iterdir())):
                begin = time.perf_counter()
                used_gb = _testloom("gap", "diagnose", str(path), "--out", str(place / f"out{number}"))
                took_s = time.perf_counter() - begin
                form = "folder" if path.is_dir() else "MCAP"
                rows.append(_row(f"gap diagnose, 1 h, {words}, {form}", took_s, "s", GOAL_S))
                rows.append(_row(f"gap diagnose, 1 h, {words}, {form}, memory", used_gb, "GB", GOAL_GB))
    return rows


def _testloom(*arguments: str) -> float:
    """The largest memory that it had resident, GB."""
    command = [sys.executable, "-c", COMMAND, *arguments]
    done = subprocess.run(command, check=True, capture_output=True, timeout=LONGEST_S, text=True)
    return float(done.stderr.splitlines()[-1]) / 1e6


def _row(figure: str, value: float, unit: str, goal: float) -> dict[str, Any]:
    return {
        "figure": figure,
        "value": round(value, 2),
        "unit": unit,
        "goal": f"at most {goal:g}",
        "met": value <= goal,
        "compared_with": "",
    }

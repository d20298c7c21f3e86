"""SIGKILL (or SIGSTOP) of a line's processes at random moments, and the count of what was lost.

    python tests/fabric/kill_processes.py --role router --times 20 --seed 1

runs whole lines (`testloom up`), kills a process of the role at random moments, several times a line,
and ends non-zero when a result was lost or recorded twice, or a line did not finish. Everything is
on loopback addresses; only processes of the lines started here are killed.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

KILLS_PER_LINE = 5
UNITS_PER_LINE = 16
LINE_TIMEOUT_S = 300.0
START_TIMEOUT_S = 90.0
PAUSE_S = (1.0, 4.0)
POLL_S = 0.1
ROLES = ("station", "router", "coordinator", "bench")


@dataclass(frozen=True)
class LineResult:
    """What came of one line. `kills`: 'id at seconds since the order'."""

    kills: list[str]
    exit_code: int
    summary: dict[str, object]
    folder: Path

    def faults(self) -> list[str]:
        """What must not be, in words; empty when all is well."""
        if not self.summary:
            return [f"the line did not finish (exit code {self.exit_code}); see {self.folder}"]
        wrong = [f"{key} = {self.summary[key]}" for key in ("lost", "duplicated") if self.summary[key]]
        wrong += [f"{key}: {self.summary[key]}" for key in ("unfinished", "unsupported") if self.summary[key]]
        return wrong


def run_line(
    roles: Sequence[str], kills: int, seed: int, folder: Path, units: int = UNITS_PER_LINE
) -> LineResult:
    """Run one line of `units` units and kill `kills` processes while it works, of these roles by turns."""
    chance = random.Random(seed)
    summary_file = folder / "summary.json"
    command = [
        *(sys.executable, "-m", "cli.main", "up", "--units", str(units), "--seed", str(seed)),
        *("--dir", str(folder / "run"), "--summary", str(summary_file), "--no-dashboard"),
    ]
    with (folder / "up.log").open("wb") as log:
        line = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    story: list[str] = []
    try:
        _wait_for_work(folder / "run", line)
        began_s = time.monotonic()
        for number in range(kills):
            _sleep_while_running(chance.uniform(*PAUSE_S), line)
            if line.poll() is not None:
                break
            role = roles[number % len(roles)]
            victim = chance.choice([p for p in _processes(folder / "run") if p["role"] == role])
            if _kill(int(victim["pid"])):
                story.append(f"{victim['id']} at {time.monotonic() - began_s:.1f} s")
        line.wait(timeout=LINE_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        pass  # it is ended below; without a summary `faults` says that it did not finish
    finally:
        if line.poll() is None:
            line.send_signal(signal.SIGTERM)
            line.wait(timeout=30)
    summary = json.loads(summary_file.read_text()) if summary_file.exists() else {}
    return LineResult(story, line.returncode, summary, folder)


def _processes(run: Path) -> list[dict[str, str]]:
    return json.loads((run / "processes.json").read_text())


def _wait_for_work(run: Path, line: subprocess.Popen[bytes]) -> None:
    """Until the first sequence has left its trace in a station's spool."""
    deadline_s = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline_s and line.poll() is None:
        if any(run.glob("spools/*.sqlite")):
            return
        time.sleep(POLL_S)


def _sleep_while_running(pause_s: float, line: subprocess.Popen[bytes]) -> None:
    deadline_s = time.monotonic() + pause_s
    while time.monotonic() < deadline_s and line.poll() is None:
        time.sleep(POLL_S)


def _kill(pid: int) -> bool:
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def main() -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--role", choices=ROLES, required=True)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    done, faults, lines = 0, 0, 0
    while done < chosen.times and lines < 4 * chosen.times:
        folder = Path(tempfile.mkdtemp(prefix=f"testloom-kill-{chosen.role}-"))
        result = run_line(
            [chosen.role], min(KILLS_PER_LINE, chosen.times - done), chosen.seed + lines, folder
        )
        lines += 1
        done += len(result.kills)
        wrong = result.faults()
        faults += bool(wrong)
        words = "; ".join(wrong) or f"{result.summary['attempts']} attempts, 0 lost, 0 duplicated"
        print(f"{done:3d}/{chosen.times}  {words}  ({', '.join(result.kills)})", flush=True)
    print(f"{chosen.role}: {done} kills in {lines} lines, {faults} lines with faults")
    return 1 if faults or done < chosen.times else 0


if __name__ == "__main__":
    sys.exit(main())

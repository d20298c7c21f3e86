"""A dashboard in a process of its own, over files instead of a coordinator."""

import os
import re
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

from protocol.line_views import LineStatus, UnitHistory
from protocol.station_messages import SocketProgress

HERE = Path(__file__).parent
START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0


@dataclass
class ServedLine:
    """A dashboard in a process of its own over files that a test may change."""

    folder: Path
    url: str
    process: "subprocess.Popen[str]"

    def show(self, status: LineStatus, progress: list[SocketProgress] | None = None) -> None:
        _write(self.folder / "status.json", status.model_dump_json())
        if progress is not None:
            _write(
                self.folder / "progress.json", f"[{','.join(view.model_dump_json() for view in progress)}]"
            )

    def show_unit(self, history: UnitHistory) -> None:
        _write(self.folder / f"unit-{history.status.unit.serial}.json", history.model_dump_json())

    def coordinator_leaves(self) -> None:
        (self.folder / "status.json").unlink()


def _write(file: Path, text: str) -> None:
    """All at once: the server may be reading."""
    beside = file.with_suffix(".tmp")
    beside.write_text(text)
    beside.replace(file)


def start_served_line(folder: Path, *arguments: str) -> ServedLine:
    """Start the process and wait for its address (the read ends when the process does)."""
    command = [sys.executable, str(HERE / "serve_imagined_line.py"), str(folder), *arguments]
    environment = os.environ | {"PYTHONPATH": str(HERE.parent.parent), "PYTHONWARNINGS": "default"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=folder
    )
    watchdog = threading.Timer(START_TIMEOUT_S, process.kill)
    watchdog.start()
    assert process.stdout is not None
    line = process.stdout.readline().strip()
    watchdog.cancel()
    if not re.match(r"http://127\.0\.0\.1:\d+/$", line):
        _, error = process.communicate(timeout=STOP_TIMEOUT_S)
        raise AssertionError(f"the dashboard did not start: {error}")
    return ServedLine(folder, line, process)


def stop_served_line(line: ServedLine) -> tuple[int, str]:
    """SIGTERM; exit code and what was written to standard error."""
    line.process.terminate()
    _, error = line.process.communicate(timeout=STOP_TIMEOUT_S)
    return line.process.returncode, error

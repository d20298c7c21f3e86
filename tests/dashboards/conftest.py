"""Chromium and a served imagined line for the tests of the dashboard."""

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the imagined line and the browser live beside the tests

from imagined_line import failed_then_passed, small_line  # noqa: E402
from playwright.sync_api import BrowserContext  # noqa: E402
from take_screenshot import CHROMIUM, open_browser  # noqa: E402

from protocol.line_views import LineStatus, UnitHistory  # noqa: E402
from protocol.station_messages import SocketProgress  # noqa: E402

START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0


@dataclass
class ServedLine:
    """A dashboard in a process of its own over files that a test may change."""

    folder: Path
    url: str
    process: "subprocess.Popen[str]"
    requests: list[str] = field(default_factory=list)

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


@pytest.fixture(scope="module")
def served_line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedLine]:
    """One process for a module of tests."""
    line = start_served_line(tmp_path_factory.mktemp("imagined-line"))
    try:
        yield line
    finally:
        stop_served_line(line)


@pytest.fixture
def imagined(served_line: ServedLine) -> ServedLine:
    """The served line, showing the small imagined line in mid-run."""
    served_line.show(*small_line())
    served_line.show_unit(failed_then_passed())
    return served_line


@pytest.fixture(scope="module")
def browser() -> Iterator[BrowserContext]:
    """Headless Chromium; a skip is loud, and a failure where everything is required."""
    if not Path(CHROMIUM).is_file():
        words = f"{CHROMIUM} is missing (apt-get install chromium): the dashboard was not tested in a browser"
        if os.environ.get("TESTLOOM_REQUIRE_ALL") == "1":
            pytest.fail(words)
        pytest.skip(words)
    with open_browser(viewport={"width": 1600, "height": 1000}) as context:
        context.set_default_timeout(15_000)
        yield context

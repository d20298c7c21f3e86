"""What every process writes into its log, and what a log that cannot be written does to it: nothing."""

import errno
import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog

from protocol.adapters.structured_log import log_as_json, structured_log


class FullDisk(io.StringIO):
    """A stream on a disk that is full until there is room."""

    full = True

    def write(self, text: str) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(text)


@pytest.fixture(autouse=True)
def _defaults_again() -> Iterator[None]:
    yield
    structlog.reset_defaults()


def test_every_line_is_json_with_the_names_of_its_process(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with structured_log(path, line="demo", station="turntable-1"):
        structlog.get_logger("stations.agent").warning("sequence_aborted", why="测试")
        try:
            raise ValueError("inside")
        except ValueError:
            structlog.get_logger("stations.sequencing").exception("step_failed", step="test_cpu")
    first, second = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
    assert first.pop("timestamp").endswith("Z")
    assert first == {
        "line": "demo",
        "station": "turntable-1",
        "event": "sequence_aborted",
        "level": "warning",
        "why": "测试",
    }
    assert "ValueError: inside" in second["exception"]


def test_a_full_disk_stops_no_process_and_shows_in_the_log() -> None:
    stream = FullDisk()
    log_as_json(stream, line="demo")
    log = structlog.get_logger("stations.agent")
    log.error("alarm", alarm="spool_unwritable")
    log.error("alarm", alarm="spool_unwritable")
    stream.full = False
    log.info("record_spooled")
    dropped, kept = (json.loads(line) for line in stream.getvalue().splitlines())
    assert dropped == {"event": "log_lines_dropped", "count": 2}
    assert kept["event"] == "record_spooled"

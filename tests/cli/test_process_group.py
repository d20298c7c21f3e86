"""Processes of a line: started again when they die, listed, and none left behind."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from cli import process_group
from cli.process_group import ProcessGroup, ProcessSpecification

TIMEOUT_S = 30.0


def _until(condition, group: ProcessGroup | None = None) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline_s
        if group is not None:
            group.tend()
        time.sleep(0.02)


def _has_ended(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def _router(port: int) -> ProcessSpecification:
    endpoint = f"tcp/127.0.0.1:{port}"
    return ProcessSpecification("router", "router", ("router", "--listen", endpoint), {"router": endpoint})


def _table(folder: Path) -> list[dict]:
    return json.loads((folder / "processes.json").read_text())


def test_a_killed_process_is_started_again_and_listed(tmp_path: Path, free_port: int) -> None:
    group = ProcessGroup(tmp_path)
    try:
        group.start(_router(free_port))
        first = _table(tmp_path)[0]
        assert first["role"] == "router"
        assert first["addresses"] == {"router": f"tcp/127.0.0.1:{free_port}"}
        os.kill(first["pid"], signal.SIGKILL)
        _until(lambda: _table(tmp_path)[0]["pid"] != first["pid"], group)
        assert group.restarts() == {"router": 1}
        again = _table(tmp_path)[0]["pid"]
        assert psutil.pid_exists(again)
    finally:
        group.stop()
    assert not psutil.pid_exists(again)


def test_a_process_that_always_dies_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_group, "MAX_RESTARTS", 1)
    monkeypatch.setattr(process_group, "RESTART_DELAY_FIRST_S", 0.0)
    group = ProcessGroup(tmp_path)
    group.start(ProcessSpecification("router", "r", ("router", "--no-such-option")))
    _until(lambda: group.given_up() == ["r"], group)
    group.stop()
    assert "No such option" in (tmp_path / "logs" / "r.log").read_text()


def test_a_process_that_ends_by_itself_says_why(tmp_path: Path, free_port: int) -> None:
    group = ProcessGroup(tmp_path)
    told: list[str] = []
    with socket.create_server(("127.0.0.1", free_port)):
        try:
            group.start(_router(free_port))
            _until(lambda: told.extend(group.tend()) or told)
        finally:
            group.stop()
    assert "router ended (1) and is started again: The router cannot listen at" in told[0]


def test_children_end_when_their_parent_is_killed(tmp_path: Path, free_port: int) -> None:
    script = (
        "import sys, time\nfrom pathlib import Path\n"
        "from cli.process_group import ProcessGroup, ProcessSpecification\n"
        f"group = ProcessGroup(Path({str(tmp_path)!r}))\n"
        f"arguments = ('router', '--listen', 'tcp/127.0.0.1:{free_port}')\n"
        "group.start(ProcessSpecification('router', 'r', arguments))\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script])
    try:
        log = tmp_path / "logs" / "r.log"
        _until(lambda: log.exists() and b"listens" in log.read_bytes())
        child = _table(tmp_path)[0]["pid"]
    finally:
        parent.kill()
        parent.wait()
    _until(lambda: _has_ended(child))
    assert _has_ended(child)

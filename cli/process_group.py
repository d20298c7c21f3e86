"""Processes of a line on one machine: started, watched, started again when they die, stopped.

What systemd does on the floor, `testloom up` does on a laptop. Every process is in
`processes.json` with its role, id, pid and addresses. When this process dies, even by SIGKILL,
the kernel ends its children (PR_SET_PDEATHSIG), so that nothing is left behind.
"""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from protocol.language import say

RESTART_DELAY_FIRST_S = 0.2
RESTART_DELAY_MAX_S = 5.0
HEALTHY_AFTER_S = 10.0
MAX_RESTARTS = 50
LAST_WORDS_BYTES = 4_096
STOP_GRACE_S = 8.0
STOP_POLL_S = 0.05
PARENT_VARIABLE = "TESTLOOM_PARENT_PID"
_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """In a child of a `ProcessGroup`: ask the kernel to end this process when its parent ends.

    The child asks for itself, since code between fork and exec is not safe beside other threads.
    """
    parent = os.environ.get(PARENT_VARIABLE)
    if parent is None or sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != int(parent):  # it ended before we could ask
        os._exit(1)


@dataclass(frozen=True)
class ProcessSpecification:
    """A process to run: `arguments` follow `testloom`. `stop_rank`: lower ranks are stopped first."""

    role: str
    name: str
    arguments: tuple[str, ...]
    addresses: Mapping[str, str] = field(default_factory=dict)
    stop_rank: int = 0


@dataclass
class _Running:
    specification: ProcessSpecification
    process: subprocess.Popen[bytes]
    log: IO[bytes]
    started_at_s: float
    restarts: int = 0
    restart_at_s: float | None = None
    given_up: bool = False


class ProcessGroup:
    """Runs processes until `stop`. `tend` has to be called a few times a second."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._logs = directory / "logs"
        self._logs.mkdir(parents=True, exist_ok=True)
        self._running: list[_Running] = []

    def start(self, specification: ProcessSpecification) -> None:
        """Start a process and keep it running."""
        log = (self._logs / f"{specification.name}.log").open("ab", buffering=0)
        process = self._spawn(specification, log)
        self._running.append(_Running(specification, process, log, time.monotonic()))
        self._write_table()

    def tend(self) -> list[str]:
        """Start again what has died, after a growing delay. Returns a sentence for each event."""
        now_s = time.monotonic()
        story: list[str] = []
        for running in self._running:
            if running.given_up or running.process.poll() is None:
                continue
            if running.restart_at_s is None:
                story.append(self._schedule_restart(running, now_s))
            elif now_s >= running.restart_at_s:
                running.process = self._spawn(running.specification, running.log)
                running.started_at_s = now_s
                running.restart_at_s = None
                running.restarts += 1
                self._write_table()
        return story

    def pids(self) -> dict[str, int]:
        """The process that runs now under each name, or ran last."""
        return {r.specification.name: r.process.pid for r in self._running}

    def restarts(self) -> dict[str, int]:
        """How often each process was started again, where that was at all."""
        return {r.specification.name: r.restarts for r in self._running if r.restarts}

    def given_up(self) -> list[str]:
        """Names of the processes that died too often."""
        return [r.specification.name for r in self._running if r.given_up]

    def stop(self) -> None:
        """Stop everything, rank by rank: SIGTERM, and SIGKILL after a grace. Leaves no process."""
        for rank in sorted({r.specification.stop_rank for r in self._running}):
            group = [r for r in self._running if r.specification.stop_rank == rank]
            for running in group:
                if running.process.poll() is None:
                    running.process.send_signal(signal.SIGTERM)
            deadline_s = time.monotonic() + STOP_GRACE_S
            while any(r.process.poll() is None for r in group) and time.monotonic() < deadline_s:
                time.sleep(STOP_POLL_S)
            for running in group:
                if running.process.poll() is None:
                    running.process.kill()
                running.process.wait()
                running.log.close()
        self._running = []

    def _schedule_restart(self, running: _Running, now_s: float) -> str:
        name, code = running.specification.name, running.process.returncode
        if running.restarts >= MAX_RESTARTS:
            running.given_up = True
            times = running.restarts + 1
            return say(
                "{name} died {times} times and is given up; see logs/{name}.log", name=name, times=times
            )
        lived_s = now_s - running.started_at_s
        exponent = 0 if lived_s > HEALTHY_AFTER_S else min(running.restarts, 10)
        running.restart_at_s = now_s + min(RESTART_DELAY_MAX_S, RESTART_DELAY_FIRST_S * 1.5**exponent)
        story = say("{name} ended ({code}) and is started again", name=name, code=code)
        reason = self._last_words(name) if code > 0 else ""
        return f"{story}: {reason}" if reason else story

    def _last_words(self, name: str) -> str:
        """Why a process says that it ended: the last line of its log that is neither a log event (JSON)
        nor one of the indented lines that follow an error's first."""
        with (self._logs / f"{name}.log").open("rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - LAST_WORDS_BYTES))
            lines = log.read().decode(errors="replace").splitlines()
        return next((line for line in reversed(lines) if line and line[0] not in " {│╭╰"), "")

    def _spawn(self, specification: ProcessSpecification, log: IO[bytes]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "cli.main", *specification.arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,  # Ctrl-C reaches us alone: we stop the others in order
            env={**os.environ, "PYTHONUNBUFFERED": "1", PARENT_VARIABLE: str(os.getpid())},
        )

    def _write_table(self) -> None:
        table = [
            {
                "role": r.specification.role,
                "id": r.specification.name,
                "pid": r.process.pid,
                "restarts": r.restarts,
                "addresses": dict(r.specification.addresses),
                "log": f"logs/{r.specification.name}.log",
                "command": ["testloom", *r.specification.arguments],
            }
            for r in self._running
        ]
        target = self._directory / "processes.json"
        draft = target.with_suffix(".json.draft")
        draft.write_text(json.dumps(table, indent=1))
        draft.replace(target)

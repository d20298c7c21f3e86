"""The agent as a process, over a real router, against a scripted coordinator."""

import json
import os
import queue
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest

from protocol.adapters.zenoh_link import IncomingQuery, ZenohLink, open_link, open_router
from protocol.attempts import AttemptRecord, Lease, UnitIdentity
from protocol.errors import Fault
from protocol.keys import COORDINATOR_VERBS, coordinator_queryable, station_command_key
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from protocol.station_messages import (
    COMMAND_REPLY,
    STATION_REQUEST,
    AbortSequence,
    CommandAccepted,
    CommandRefused,
    CommandReply,
    LeasesRenewed,
    RecordsAcknowledged,
    RegisterStation,
    StartSequence,
    StationAccepted,
    StationRefused,
    SubmitRecords,
)
from stations.sequencing.step_registry import load_plan
from stations.spool import records_made, unacknowledged_count

pytestmark = pytest.mark.fabric
WAIT_S = 15.0
ROOT = Path(__file__).parents[2]
BENCH = {
    "bench": "bench-1",
    "bench_identity": "FIX-1",
    "operations": ["functional"],
    "sockets": [{"socket": "1", "unit_link": "none"}, {"socket": "2", "unit_link": "none"}],
    "power_supply": "none",
    "site": {"latitude_deg": 34.2, "gravity_m_s2": 9.797},
}


class ScriptedCoordinator:
    """Answers what it is told to, keeps what it is given."""

    def __init__(self, link: ZenohLink) -> None:
        self._link = link
        self.registrations: queue.Queue[RegisterStation] = queue.Queue()
        self.records: queue.Queue[AttemptRecord] = queue.Queue()
        self.submissions_to_ignore = 0
        self.refuse_with = ""
        self.register_again = False
        for verb in COORDINATOR_VERBS:
            link.serve(coordinator_queryable("test", verb), self._answer)

    def command(self, command: Lease | AbortSequence) -> CommandReply:
        key = station_command_key("test", "st-1")
        message = StartSequence(lease=command) if isinstance(command, Lease) else command
        return COMMAND_REPLY.validate_json(self._link.ask(key, message.model_dump_json().encode(), WAIT_S))

    def _answer(self, query: IncomingQuery) -> None:
        request = STATION_REQUEST.validate_json(query.payload)
        if isinstance(request, RegisterStation):
            self.registrations.put(request)
            reply = StationAccepted(lease_duration_s=2.0, renewal_period_s=0.1)
            if self.refuse_with:
                reply = StationRefused(reason=self.refuse_with)
        elif isinstance(request, SubmitRecords):
            for spooled in request.records:
                self.records.put(spooled.record)
            if self.submissions_to_ignore > 0:
                self.submissions_to_ignore -= 1
                query.reject("the database is away", Fault.TESTLOOM)
                return
            reply = RecordsAcknowledged(attempt_ids=tuple(one.record.attempt_id for one in request.records))
        else:
            reply = LeasesRenewed(register_again=self.register_again)
            self.register_again = False
        query.reply(reply.model_dump_json().encode())


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with open_router(address):
        yield address


@pytest.fixture
def coordinator(endpoint: str) -> Iterator[ScriptedCoordinator]:
    with open_link(endpoint) as link:
        yield ScriptedCoordinator(link)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "bench.json").write_text(json.dumps(BENCH))
    (tmp_path / "plans").mkdir()
    (tmp_path / "plans" / "p.yaml").write_text(PLAN_TEXT)
    return tmp_path


PLAN_TEXT = """
format: testloom-plan/1
name: stand_in
version: 1.0.0
product: gnc_module
operation: functional
deadline_s: 10
sequence:
  main: [{step: power_down, timeout_s: 1}]
  teardown: [{step: power_down, timeout_s: 1}]
"""


@contextmanager
def agent(endpoint: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    script = Path(__file__).with_name("agent_process.py")
    process = subprocess.Popen(
        [sys.executable, str(script), endpoint, str(folder)],
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def log_of(process: subprocess.Popen[bytes]) -> list[dict[str, Any]]:
    """What a process that has ended has logged."""
    assert process.stderr is not None
    return [json.loads(line) for line in process.stderr.read().splitlines()]


def plan_reference(folder: Path) -> PlanReference:
    return load_plan(folder / "plans" / "p.yaml").reference()


def lease(folder: Path, fence: int, serial: str, socket_name: str = "1") -> Lease:
    return Lease(
        fence=fence,
        attempt_id=f"a-{fence}",
        unit=UnitIdentity(serial=serial, product="gnc_module", lot="L1"),
        operation="functional",
        station="st-1",
        socket=socket_name,
        plan=plan_reference(folder),
    )


def eventually(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.02)


def test_a_killed_agent_leaves_an_aborted_record(
    coordinator: ScriptedCoordinator, endpoint: str, folder: Path
) -> None:
    slow = lease(folder, 2, "SLOW-1", "2")
    with agent(endpoint, folder) as process:
        first = coordinator.registrations.get(timeout=WAIT_S)
        assert first.bench_identity == "FIX-1"
        assert plan_reference(folder) in first.plans
        assert coordinator.command(lease(folder, 1, "U-1")) == CommandAccepted(fence=1)
        assert coordinator.records.get(timeout=WAIT_S).outcome is Outcome.PASS
        assert coordinator.command(slow) == CommandAccepted(fence=2)
        coordinator.register_again = True
        assert coordinator.registrations.get(timeout=WAIT_S).held == (slow,)
        process.send_signal(signal.SIGKILL)
        process.wait(WAIT_S)
    with agent(endpoint, folder) as process:
        second = coordinator.registrations.get(timeout=WAIT_S)
        assert second.incarnation > first.incarnation
        assert (second.held, second.spool_first, second.spool_last) == ((), 2, 2)
        record = coordinator.records.get(timeout=WAIT_S)
        assert (record.attempt_id, record.outcome, record.fault) == ("a-2", Outcome.ABORTED, Fault.STATION)
        assert coordinator.command(slow) == CommandAccepted(fence=2)  # late, and not run again
        eventually(lambda: unacknowledged_count(folder / "spool.sqlite") == 0)
        process.terminate()
        assert process.wait(WAIT_S) == 0
    assert records_made(folder / "spool.sqlite") == 2
    assert coordinator.records.empty()


def test_records_stay_until_they_are_acknowledged_and_a_mistake_leaves_one_too(
    coordinator: ScriptedCoordinator, endpoint: str, folder: Path
) -> None:
    coordinator.submissions_to_ignore = 2
    with agent(endpoint, folder):
        coordinator.registrations.get(timeout=WAIT_S)
        coordinator.command(lease(folder, 1, "BROKEN-1"))
        seen = [coordinator.records.get(timeout=WAIT_S) for _ in range(3)]
        assert seen[0] == seen[1] == seen[2]
        assert (seen[0].outcome, seen[0].fault) == (Outcome.ERROR, Fault.TESTLOOM)
        eventually(lambda: unacknowledged_count(folder / "spool.sqlite") == 0)


def test_sigterm_aborts_to_the_safe_state_and_spools(
    coordinator: ScriptedCoordinator, endpoint: str, folder: Path
) -> None:
    coordinator.submissions_to_ignore = 100
    with agent(endpoint, folder) as process:
        coordinator.registrations.get(timeout=WAIT_S)
        coordinator.command(lease(folder, 1, "SLOW-1"))
        process.terminate()
        assert process.wait(WAIT_S) == 0
    assert unacknowledged_count(folder / "spool.sqlite") == 1


def test_a_second_station_of_the_same_name_leaves_with_code_3_and_says_why(
    coordinator: ScriptedCoordinator, endpoint: str, folder: Path
) -> None:
    coordinator.refuse_with = "the station st-1 is on the bench FIX-9"
    with agent(endpoint, folder) as process:
        assert process.wait(WAIT_S) == 3
        lines = log_of(process)
        assert any(line.get("text") == coordinator.refuse_with for line in lines)
        assert {(line["line"], line["station"]) for line in lines} == {("test", "st-1")}


def test_a_disk_that_refuses_keeps_the_record_in_the_agent_until_it_takes_it(
    coordinator: ScriptedCoordinator, endpoint: str, folder: Path
) -> None:
    """The kernel refuses every write of the process, as a full disk does, and then takes them again."""
    with agent(endpoint, folder) as process:
        coordinator.registrations.get(timeout=WAIT_S)
        coordinator.command(lease(folder, 1, "SLOW-1"))
        limits = psutil.Process(process.pid)
        unlimited = limits.rlimit(psutil.RLIMIT_FSIZE)
        limits.rlimit(psutil.RLIMIT_FSIZE, (1, unlimited[1]))
        coordinator.command(AbortSequence(station="st-1", socket="1", fence=1, reason="test"))

        def refuses() -> bool:
            reply = coordinator.command(lease(folder, 2, "U-2", "2"))
            return isinstance(reply, CommandRefused) and reply.reason == "stopping"

        eventually(refuses)
        assert coordinator.records.empty()
        limits.rlimit(psutil.RLIMIT_FSIZE, unlimited)
        record = coordinator.records.get(timeout=WAIT_S)
        assert (record.attempt_id, record.outcome) == ("a-1", Outcome.ABORTED)
        eventually(lambda: coordinator.command(lease(folder, 3, "U-3", "2")) == CommandAccepted(fence=3))
        assert coordinator.records.get(timeout=WAIT_S).outcome is Outcome.PASS
        process.terminate()
        assert process.wait(WAIT_S) == 0
        alarms = [line for line in log_of(process) if line["event"] == "alarm"]
        assert alarms
        assert {line["alarm"] for line in alarms} == {"spool_unwritable"}

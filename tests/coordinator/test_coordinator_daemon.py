"""The daemon as a process behind a real router: killed, stopped, refused."""

import json
import os
import queue
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from protocol import keys
from protocol.adapters.zenoh_link import (
    IncomingQuery,
    NoReplyError,
    RequestRejectedError,
    ZenohLink,
    open_link,
    open_router,
)
from protocol.attempts import SpooledRecord, UnitIdentity
from protocol.frozen_model import FrozenModel
from protocol.line_views import GetUnit, GetYield, OrderUnits
from protocol.plans import PlanReference
from protocol.routes import GNC_MODULE_ROUTE
from protocol.station_messages import (
    CommandAccepted,
    RegisterStation,
    SocketDescription,
    StartSequence,
    SubmitRecords,
)

pytestmark = pytest.mark.fabric

PATIENCE_S = 30.0
PLAN = PlanReference(operation="functional", name="functional", version="1", sha256="a" * 64)


class Fabric:
    """A router, a coordinator process, and a link to speak as a station or a client."""

    def __init__(self, folder: Path, endpoint: str, link: ZenohLink) -> None:
        self.folder = folder
        self.endpoint = endpoint
        self.link = link
        self.commands: queue.Queue[StartSequence] = queue.Queue()
        self.processes: list[subprocess.Popen[str]] = []

    def start_coordinator(self) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "cli.main", "coordinator", "--line", "L1"]
        command += ["--router", self.endpoint, "--database", f"sqlite:///{self.folder / 'line.db'}"]
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        self.processes.append(process)
        return process

    def ask(self, verb: Any, message: FrozenModel, sender: str) -> dict[str, Any]:
        """Ask until somebody answers, as every client does."""
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            try:
                key = keys.coordinator_key("L1", verb, sender)
                return json.loads(self.link.ask(key, message.model_dump_json().encode(), 2.0))
            except NoReplyError:
                if time.monotonic() > deadline_s:
                    raise

    def serve_station(self, station: str) -> None:
        def on_command(query: IncomingQuery) -> None:
            command = StartSequence.model_validate_json(query.payload)
            self.commands.put(command)
            query.reply(CommandAccepted(fence=command.lease.fence).model_dump_json().encode())

        self.link.serve(keys.station_command_key("L1", station), on_command)


@pytest.fixture
def fabric(tmp_path: Path, free_port: int) -> Iterator[Fabric]:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with open_router(endpoint), open_link(endpoint) as link:
        fabric = Fabric(tmp_path, endpoint, link)
        yield fabric
        for process in fabric.processes:
            process.kill()
            process.communicate()


def test_a_killed_coordinator_knows_everything_it_acknowledged(fabric: Fabric, record_of: Callable) -> None:
    fabric.serve_station("F1")
    process = fabric.start_coordinator()
    unit = UnitIdentity(serial="GM-1", product="gnc_module", lot="L1")
    fabric.ask("request", OrderUnits(order_id="o", route=GNC_MODULE_ROUTE, units=(unit,)), "cli")
    registration = RegisterStation(
        station="F1",
        incarnation=1,
        bench_identity="b1",
        sockets=(SocketDescription(socket="A", operations=("functional",)),),
        plans=(PLAN,),
    )
    fabric.ask("register", registration, "F1")
    lease = fabric.commands.get(timeout=PATIENCE_S).lease

    process.kill()
    process.wait(PATIENCE_S)
    record = SpooledRecord(sequence_number=1, record=record_of(lease))
    submission = SubmitRecords(station="F1", incarnation=1, records=(record,))
    key = keys.coordinator_key("L1", "submit", "F1")
    with pytest.raises(NoReplyError):
        fabric.link.ask(key, submission.model_dump_json().encode(), 0.5)
    process = fabric.start_coordinator()
    assert fabric.ask("submit", submission, "F1")["attempt_ids"] == ["GM-1.functional.1"]

    process.kill()
    process.wait(PATIENCE_S)
    process = fabric.start_coordinator()
    history = fabric.ask("request", GetUnit(serial="GM-1"), "cli")
    assert history["status"]["operation"] == "imu_calibration"
    assert len(history["attempts"]) == 1
    with pytest.raises(RequestRejectedError, match="'GM-2' is not known"):
        fabric.ask("request", GetUnit(serial="GM-2"), "cli")

    process.send_signal(signal.SIGTERM)
    _, log = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    events = [json.loads(line)["event"] for line in log.splitlines()]
    assert events == ["line_taken_up", "serving", "stopped"]


def test_the_command_line_orders_and_says_what_it_does_not_know(fabric: Fabric) -> None:
    fabric.start_coordinator()
    fabric.ask("request", GetYield(), "cli")

    def testloom(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "cli.main", *arguments, "--line", "L1", "--router", fabric.endpoint]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)

    assert json.loads(testloom("order", "--serials", "GM-1,GM-2", "--json").stdout)["accepted"] == 2
    assert json.loads(testloom("unit", "GM-1", "--json").stdout)["status"]["queue_position"] == 1
    unknown = testloom("unit", "GM-9")
    assert unknown.returncode == 1
    assert "'GM-9' is not known" in unknown.stderr
    assert "Traceback" not in unknown.stderr


def test_a_second_coordinator_makes_the_first_stop_and_say_why(fabric: Fabric) -> None:
    first = fabric.start_coordinator()
    fabric.ask("request", GetYield(), "cli")
    second = fabric.start_coordinator()
    _, said = first.communicate(timeout=PATIENCE_S)
    assert first.returncode == 1
    assert "Another coordinator has written to this line's journal." in said
    assert "Traceback" not in said
    fabric.ask("request", GetYield(), "cli")
    assert second.poll() is None


def test_a_database_that_is_none_is_an_error_in_words(fabric: Fabric) -> None:
    (fabric.folder / "line.db").write_bytes(b"not a database" * 1_000)
    process = fabric.start_coordinator()
    _, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert "damaged" in said
    assert "Traceback" not in said

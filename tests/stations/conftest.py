"""Benches for the stations' tests: in lock-step, served by a thread of their own, or by a process."""

import asyncio
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from dut_emulator.server.assembly import serve
from dut_emulator.server.configuration import BenchServerConfiguration
from protocol.attempts import Lease, UnitIdentity
from protocol.bench_control import Inject
from protocol.bench_description import BenchDescription
from protocol.plans import Plan
from stations.drivers.arbitration import Arbitration
from stations.drivers.control_channel import ControlChannel
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult, SequenceRunner
from stations.sequencing.step_registry import bundled_plans

SEED = 7
START_GUARD_S = 60.0


def wait_for_description(path: Path) -> BenchDescription:
    """The bench's description, once everything listens."""
    guard = time.monotonic() + START_GUARD_S
    while not path.exists():
        assert time.monotonic() < guard, "the bench did not start"
        threading.Event().wait(0.01)
    return BenchDescription.model_validate_json(path.read_text())


class ServedBench:
    """An emulated bench in a thread."""

    def __init__(
        self,
        folder: Path,
        *,
        kind: str = "socket_board",
        pace: float = 0.0,
        port_base: int = 0,
        serial: str = "socket",
    ) -> None:
        configuration = BenchServerConfiguration(
            name="bench",
            kind=kind,
            units_dir=folder / "units",
            description=folder / "bench.json",
            seed=SEED,
            pace=pace,
            port_base=port_base,
            serial=serial,
        )
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = threading.Thread(target=self._serve, args=(configuration,))
        self._thread.start()
        self.description = wait_for_description(configuration.description)

    def _serve(self, configuration: BenchServerConfiguration) -> None:
        try:
            self._loop.run_until_complete(serve(configuration, self._stop))
        finally:
            self._loop.close()

    def inject(self, target: str, fault: str) -> None:
        """A fault of the bench itself."""
        channel = ControlChannel(self.description.control or "", "test", observer=True)
        channel.request(Inject.model_validate({"target": target, "fault": fault}))
        channel.close()

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(START_GUARD_S)
        assert not self._thread.is_alive()


@dataclass
class Floor:
    """A bench with runners for its sockets."""

    bench: ServedBench
    arbitration: Arbitration
    runners: dict[str, SequenceRunner]
    folder: Path

    def run(
        self,
        serial: str,
        plan: Plan | None = None,
        socket: str = "1",
        abort: AbortFlag | None = None,
        on_progress: Callable[..., None] = lambda progress: None,
    ) -> SequenceResult:
        """One sequence on a socket."""
        plan = plan or bundled_plans()["functional"]
        return self.runners[socket].run(
            plan, lease_of(plan, serial, socket), on_progress, abort or AbortFlag()
        )


def lease_of(plan: Plan, serial: str, socket: str = "1") -> Lease:
    return Lease(
        fence=1,
        attempt_id=f"attempt-{serial}-{socket}",
        unit=UnitIdentity(serial=serial, product="gnc_module", lot="LOT"),
        operation=plan.operation,
        station="station",
        socket=socket,
        plan=plan.reference(),
    )


def floor_of(bench: ServedBench, description: BenchDescription, folder: Path) -> Floor:
    arbitration = Arbitration(description)
    runners = {
        socket.socket: SequenceRunner(description, socket.socket, arbitration, folder)
        for socket in description.sockets
    }
    return Floor(bench, arbitration, runners, folder)


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Floor]:
    """A socket-board bench of two sockets in lock-step, shared by a module's tests."""
    folder = tmp_path_factory.mktemp("bench")
    bench = ServedBench(folder)
    floor = floor_of(bench, bench.description, folder)
    yield floor
    for runner in floor.runners.values():
        runner.close()
    floor.arbitration.close()
    bench.close()


@pytest.fixture
def bench_process(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], BenchDescription]]:
    """A bench as a process of its own, to be killed."""
    description = tmp_path / "bench.json"
    command = [sys.executable, "-m", "cli.main", "bench", "--name", "mortal", "--seed", str(SEED)]
    command += ["--units-dir", str(tmp_path / "units"), "--description", str(description)]
    with (tmp_path / "bench.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            yield process, wait_for_description(description)
        finally:
            process.kill()
            process.wait()

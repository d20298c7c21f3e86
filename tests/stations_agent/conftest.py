"""An emulated turntable bench in a thread, and the sequence runner on it."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from dut_emulator.server.assembly import serve
from dut_emulator.server.configuration import BenchServerConfiguration
from protocol.attempts import Lease, UnitIdentity
from protocol.bench_description import BenchDescription
from protocol.plans import Plan
from stations.agent.bench_watch import read_description
from stations.drivers.arbitration import Arbitration
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult, SequenceRunner

TIMEOUT_S = 20.0


@dataclass
class Turntable:
    """A bench that is up, and how to run plans on it."""

    description: BenchDescription
    recordings: Path
    seed: int
    stop: Callable[[], None]
    fence: int = 0
    runners: list[SequenceRunner] = field(default_factory=list)
    arbitration: Arbitration | None = None

    def run(self, plan: Plan, serial: str) -> SequenceResult:
        if not self.runners:
            self.arbitration = Arbitration(self.description)
            self.runners.append(SequenceRunner(self.description, "1", self.arbitration, self.recordings))
        self.fence += 1
        lease = Lease(
            fence=self.fence,
            attempt_id=f"a-{self.fence}",
            unit=UnitIdentity(serial=serial, product="gnc_module", lot="L1"),
            operation=plan.operation,
            station="turntable-1",
            socket="1",
            plan=plan.reference(),
        )
        return self.runners[0].run(plan, lease, lambda progress: None, AbortFlag())


@pytest.fixture(scope="module")
def turntable(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Turntable]:
    folder = tmp_path_factory.mktemp("turntable")
    configuration = BenchServerConfiguration(
        name="bench-1",
        kind="three_axis_turntable",
        units_dir=folder / "units",
        description=folder / "bench.json",
        seed=7,
        heading_deg=30.0,
    )
    loops: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = []

    async def main() -> None:
        stop = asyncio.Event()
        loops.append((asyncio.get_running_loop(), stop))
        await serve(configuration, stop)

    thread = threading.Thread(target=lambda: asyncio.run(main()), daemon=True)
    thread.start()
    deadline = time.monotonic() + TIMEOUT_S
    while not configuration.description.exists():
        assert thread.is_alive()
        assert time.monotonic() < deadline, "the bench does not come up"
        thread.join(0.01)

    def stop() -> None:
        loop, event = loops[0]
        loop.call_soon_threadsafe(event.set)
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()

    bench = Turntable(
        read_description(configuration.description), folder / "recordings", configuration.seed, stop
    )
    yield bench
    for runner in bench.runners:
        runner.close()
    if bench.arbitration is not None:
        bench.arbitration.close()
    bench.stop()

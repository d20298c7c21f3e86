"""A real agent over a real router, with a stand-in for the sequence runner: no bench is needed.

A unit whose serial begins with SLOW keeps its socket until it is aborted.
"""

import sys
import threading
from collections.abc import Callable
from pathlib import Path

from protocol.attempts import Lease
from protocol.bench_description import BenchDescription
from protocol.errors import Fault
from protocol.outcomes import Outcome
from protocol.plans import Plan
from protocol.station_messages import SocketProgress
from stations.agent.shell import AgentSettings, run_agent
from stations.drivers.arbitration import Arbitration
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult
from stations.sequencing.safe_state import SafeState


class StandInRunner:
    def __init__(
        self, bench: BenchDescription, socket: str, arbitration: Arbitration, recordings_dir: Path
    ) -> None:
        self._bench = bench

    def run(
        self, plan: Plan, lease: Lease, on_progress: Callable[[SocketProgress], None], abort: AbortFlag
    ) -> SequenceResult:
        on_progress(
            SocketProgress(
                station=lease.station, socket=lease.socket, serial=lease.unit.serial, step="identify"
            )
        )
        outcome, fault = Outcome.PASS, Fault.NONE
        if lease.unit.serial.startswith("BROKEN"):
            raise RuntimeError("a mistake of ours")
        if lease.unit.serial.startswith("SLOW"):
            while not abort.is_requested:
                threading.Event().wait(0.01)
            outcome = Outcome.ABORTED
        return SequenceResult(outcome, fault, abort.reason, (), (), 1.0, True)

    def make_safe(self) -> SafeState:
        return SafeState(True, ())

    def close(self) -> None:
        pass


if __name__ == "__main__":
    folder = Path(sys.argv[2])
    sys.exit(
        run_agent(
            AgentSettings(
                line="test",
                station="st-1",
                router=sys.argv[1],
                bench=folder / "bench.json",
                spool=folder / "spool.sqlite",
                recordings=folder / "recordings",
                plans=(folder / "plans",),
                make_runner=StandInRunner,
            )
        )
    )

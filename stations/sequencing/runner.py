"""The shell of the sequence core: runs a plan's steps on a bench, one thread and one clock a branch."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from protocol.attempts import Lease, RecordingReference, StepRecord
from protocol.bench_description import BenchDescription
from protocol.errors import Fault
from protocol.outcomes import Outcome
from protocol.plans import Plan
from protocol.station_messages import SocketProgress
from stations.drivers.arbitration import Arbitration
from stations.interruptions import AbortFlag


@dataclass(frozen=True)
class SequenceResult:
    """What a sequence left behind. `safe_state`: unit unpowered, relays open, stand at rest, all seen."""

    outcome: Outcome
    fault: Fault
    message: str
    steps: tuple[StepRecord, ...]
    recordings: tuple[RecordingReference, ...]
    duration_bench_s: float
    safe_state: bool


class SequenceRunner:
    """Runs sequences on one socket of a bench, one at a time; links stay open between them."""

    def __init__(
        self, bench: BenchDescription, socket: str, arbitration: Arbitration, recordings_dir: Path
    ) -> None:
        raise NotImplementedError

    def run(
        self, plan: Plan, lease: Lease, on_progress: Callable[[SocketProgress], None], abort: AbortFlag
    ) -> SequenceResult:
        """Run one sequence; never raises for what a bench, a unit or a plan does. Blocks."""
        raise NotImplementedError

    def close(self) -> None:
        """Close every link. The runner can be used again afterwards."""
        raise NotImplementedError

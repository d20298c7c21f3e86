"""A socket's thread: safe first, one record a lease whatever happens, aborts only for their own lease."""

import queue
from collections.abc import Callable
from typing import Any

import pytest

from protocol.attempts import AttemptRecord, Lease, UnitIdentity
from protocol.errors import Fault, TestloomError
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from protocol.station_messages import SocketProgress
from stations.agent.records import record_of
from stations.agent.socket_worker import SocketWorker
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult
from stations.sequencing.safe_state import SafeState

WAIT_S = 10.0
PLAN = PlanReference(operation="functional", name="functional", version="1.0.0", sha256="0" * 64)


def lease(fence: int) -> Lease:
    return Lease(
        fence=fence,
        attempt_id=f"a-{fence}",
        unit=UnitIdentity(serial=f"U-{fence}", product="gnc_module", lot="L1"),
        operation="functional",
        station="st-1",
        socket="1",
        plan=PLAN,
    )


class ScriptedBench:
    """Stands for the bench and its runner: says what was asked of it, and does as it is told."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.begun: queue.Queue[int] = queue.Queue()
        self.end: queue.Queue[BaseException | None] = queue.Queue()
        self.gone = False

    def runner(self, socket: str, keep_waiting: Callable[[], bool]) -> "ScriptedBench":
        if self.gone:
            raise TestloomError("The bench is gone.", fault=Fault.STATION)
        return self

    def make_safe(self) -> SafeState:
        self.asked.append("make_safe")
        return SafeState(False, ("power: still on",))

    def run(
        self, plan: Any, lease: Lease, on_progress: Callable[[SocketProgress], None], abort: AbortFlag
    ) -> SequenceResult:
        self.asked.append(f"run {lease.fence}")
        self.begun.put(lease.fence)
        error = self.end.get(timeout=WAIT_S)
        if error is not None:
            raise error
        outcome = Outcome.ABORTED if abort.is_requested else Outcome.PASS
        return SequenceResult(outcome, Fault.NONE, abort.reason, (), (), 1.0, True)


def test_the_life_of_a_socket() -> None:
    bench, records = ScriptedBench(), queue.Queue[AttemptRecord]()
    plans: Any = {PLAN.sha256: None}
    worker = SocketWorker(
        "1",
        bench,  # type: ignore[arg-type]  # the watch's one method
        plans,
        incarnation=9,
        software_version="t",
        on_progress=lambda progress: None,
        on_record=records.put,
    )

    def ended(
        fence: int, error: BaseException | None = None, abort_fence: int | None = None
    ) -> AttemptRecord:
        worker.run(lease(fence), started_at_s=5.0)
        if not bench.gone:
            bench.begun.get(timeout=WAIT_S)
            if abort_fence is not None:
                worker.abort(abort_fence, "the operator says so")
            bench.end.put(error)
        return records.get(timeout=WAIT_S)

    passed = ended(1, abort_fence=77)  # another lease's abort
    assert (passed.outcome, passed.incarnation, passed.started_at_s) == (Outcome.PASS, 9, 5.0)
    aborted = ended(2, abort_fence=2)
    assert (aborted.outcome, aborted.message) == (Outcome.ABORTED, "the operator says so")
    broken = ended(3, error=RuntimeError("a mistake"))
    assert (broken.outcome, broken.fault, broken.safe_state) == (Outcome.ERROR, Fault.TESTLOOM, False)
    bench.gone = True
    missing = ended(4)
    assert (missing.outcome, missing.fault, missing.safe_state) == (Outcome.ERROR, Fault.STATION, True)
    worker.close()
    assert bench.asked == ["make_safe", "run 1", "run 2", "run 3"]


def test_a_record_too_large_to_keep_loses_its_steps_not_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stations.agent.records.MAX_RECORD_BYTES", 700)
    result = SequenceResult(Outcome.PASS, Fault.NONE, "x" * 1000, (), (), 1.0, True)
    record = record_of(
        lease(1), result, incarnation=1, started_at_s=1.0, ended_at_s=0.5, software_version="t"
    )
    assert (record.outcome, record.fault, record.steps) == (Outcome.ERROR, Fault.PLAN, ())
    assert "too large" in record.message
    assert record.ended_at_s == record.started_at_s

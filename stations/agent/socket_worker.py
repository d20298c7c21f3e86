"""One thread for each socket: runs the socket's sequences one after the other."""

import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import structlog

from protocol.attempts import AttemptRecord, Lease
from protocol.errors import Fault, TestloomError
from protocol.outcomes import Outcome
from protocol.plans import Plan
from protocol.station_messages import SocketProgress
from stations.agent.bench_watch import BenchWatch
from stations.agent.records import failed_result, record_of
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult

MAX_LEASES_WAITING = 1
JOIN_TIMEOUT_S = 2.0

_log = structlog.get_logger("stations.agent")


@dataclass(frozen=True)
class RunningLease:
    """A lease on its way through the worker."""

    lease: Lease
    started_at_s: float
    abort: AbortFlag = field(default_factory=AbortFlag)


class SocketWorker:
    """Runs leases on one socket. Every lease that is given to it ends in exactly one `on_record`."""

    def __init__(
        self,
        socket: str,
        bench: BenchWatch,
        plans: Mapping[str, Plan],
        *,
        incarnation: int,
        software_version: str,
        on_progress: Callable[[SocketProgress], None],
        on_record: Callable[[AttemptRecord], None],
    ) -> None:
        self._socket = socket
        self._bench = bench
        self._plans = plans
        self._incarnation = incarnation
        self._software_version = software_version
        self._on_progress = on_progress
        self._on_record = on_record
        self._leases: queue.Queue[RunningLease | None] = queue.Queue(MAX_LEASES_WAITING + 1)
        self._present: RunningLease | None = None
        self._thread = threading.Thread(target=self._work, name=f"socket-{socket}", daemon=True)
        self._thread.start()

    def run(self, lease: Lease, started_at_s: float) -> None:
        """Run this lease next."""
        self._present = RunningLease(lease, started_at_s)
        self._leases.put(self._present)

    def abort(self, fence: int, why: str) -> None:
        """Abort the lease of this fence, if it is the one at hand."""
        present = self._present
        if present is not None and present.lease.fence == fence:
            present.abort.request(why)

    def close(self) -> None:
        """End when the sequence at hand has ended; a sequence that hangs is left to the process's end."""
        self._leases.put(None)
        self._thread.join(JOIN_TIMEOUT_S)

    def _work(self) -> None:
        self._make_safe()
        while (running := self._leases.get()) is not None:
            result = self._result(running)
            self._on_record(
                record_of(
                    running.lease,
                    result,
                    incarnation=self._incarnation,
                    started_at_s=running.started_at_s,
                    ended_at_s=time.time(),
                    software_version=self._software_version,
                )
            )

    def _make_safe(self) -> None:
        """An agent that was killed here may have left a unit under power, or a stand in motion."""
        try:
            safe = self._bench.runner(self._socket, lambda: self._leases.empty()).make_safe()
        except TestloomError as error:
            _log.warning("socket_not_made_safe", socket=self._socket, problems=[str(error)])
            return
        if not safe.reached:
            _log.warning("socket_not_made_safe", socket=self._socket, problems=safe.problems)

    def _result(self, running: RunningLease) -> SequenceResult:
        try:
            runner = self._bench.runner(self._socket, lambda: not running.abort.is_requested)
            plan = self._plans[running.lease.plan.sha256]
            return runner.run(plan, running.lease, self._on_progress, running.abort)
        except TestloomError as error:
            _log.error("sequence_not_started", attempt=running.lease.attempt_id, what=str(error))
            result = failed_result(error, safe_state=True)
            if running.abort.is_requested:
                return replace(result, outcome=Outcome.ABORTED, message=running.abort.reason)
            return result
        except Exception as error:  # noqa: BLE001 - an attempt leaves a record, whatever we did wrong
            _log.exception("sequence_broke", attempt=running.lease.attempt_id)
            mistake = TestloomError(
                f"The sequence broke on a mistake of ours ({type(error).__name__}: {error}).",
                where=f"station socket {self._socket}",
                fault=Fault.TESTLOOM,
                remedy="send us the station's log.",
            )
            return failed_result(mistake, safe_state=False)

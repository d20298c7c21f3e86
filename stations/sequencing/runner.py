"""The shell of the sequence core: runs a plan's steps on a bench, one thread and one clock a branch.

The dispatcher (the calling thread) takes no part in bench time. Between two steps a lane stays at
work, so that time stands while the core decides; lanes that get work join before the one that has
just ended may leave. So time can neither run away between steps nor wait for an idle lane.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue

import structlog

from protocol.attempts import Lease, RecordingReference, StepRecord
from protocol.bench_description import BenchDescription
from protocol.errors import Fault, LinkError, TestloomError
from protocol.outcomes import Outcome
from protocol.plans import Plan
from protocol.station_messages import SocketProgress
from stations.drivers.arbitration import Arbitration
from stations.drivers.socket_bench import SocketBench, nobody_to_ask
from stations.interruptions import AbortFlag
from stations.sequencing.context import Attempt
from stations.sequencing.core import (
    AbortRequested,
    Command,
    CutShort,
    DeadlinePassed,
    Event,
    Finish,
    RunStep,
    SequenceCore,
    SequenceStarted,
    StepEnded,
    StepKey,
)
from stations.sequencing.lane import Lane, SequenceEnvironment
from stations.sequencing.safe_state import SafeState, make_safe
from stations.sequencing.step_registry import definitions

EVENT_POLL_S = 0.05
STEP_GUARD_WALL_S = 120.0
"""Wall time beyond a step's time-out after which its thread counts as lost. Every wait inside a step is
bounded by less, so this fires only for a step function that hangs by itself."""

_log = structlog.get_logger("stations.sequencing")


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
        self,
        bench: BenchDescription,
        socket: str,
        arbitration: Arbitration,
        recordings_dir: Path,
        ask_operator: Callable[[str], None] = nobody_to_ask,
    ) -> None:
        """A runner for one socket; nothing is opened yet.

        Raises:
            TestloomError: the bench has no such socket.
        """
        self._bench = SocketBench(bench, socket, arbitration, ask_operator)
        self._bench.load_libraries()
        definitions()
        self._recordings_dir = recordings_dir
        self._one_at_a_time = threading.Lock()

    def run(
        self, plan: Plan, lease: Lease, on_progress: Callable[[SocketProgress], None], abort: AbortFlag
    ) -> SequenceResult:
        """Run one sequence; never raises for what a bench, a unit or a plan does. Blocks.

        Args:
            plan: what to run.
            lease: on which unit, for which attempt.
            on_progress: called on this thread when a step begins or ends.
            abort: ends the sequence at the next wait; the teardown still runs.
        """
        with self._one_at_a_time:
            attempt = Attempt(lease, self._recordings_dir)
            shared = SequenceEnvironment(plan, attempt, self._bench, abort)
            return _Dispatch(shared, on_progress).run()

    def make_safe(self) -> SafeState:
        """Bring the socket into the safe state outside a sequence: after a start, before an end.

        A station that was killed may have left a unit under power. Never raises.
        """
        with self._one_at_a_time:
            clock = self._bench.clock(0)
            try:
                clock.join()
                safe = make_safe(self._bench, clock)
                clock.leave()
            except LinkError as error:
                return SafeState(False, (error.what,))
            return safe

    def close(self) -> None:
        """Close every link. The runner can be used again afterwards."""
        with self._one_at_a_time:
            self._bench.close()


class _Dispatch:
    """One sequence under way."""

    def __init__(self, shared: SequenceEnvironment, on_progress: Callable[[SocketProgress], None]) -> None:
        self._shared = shared
        self._bench = shared.bench
        self._on_progress = on_progress
        self._core = SequenceCore(shared.plan)
        self._events: SimpleQueue[Event] = SimpleQueue()
        self._lanes: dict[int, Lane] = {}
        self._guards: dict[StepKey, float] = {}
        self._abort_told = False
        self._steps_total = sum(1 for _ in shared.plan.steps())
        self._current_step: str | None = None

    def run(self) -> SequenceResult:
        """The whole sequence, to its safe state."""
        self._begin()
        finish = self._carry_out(self._core.handle(SequenceStarted()), None)
        while finish is None:
            event = self._next_event()
            ended = event.key if isinstance(event, StepEnded) else None
            finish = self._carry_out(self._core.handle(event), ended)
        lane = self._lane(0)
        safe = self._make_safe(lane)
        duration_s = max(0.0, lane.clock.now_s() - self._shared.began_s)
        for each in self._lanes.values():
            each.leave_time()
            each.end()
        result = self._result(finish, safe, duration_s)
        self._tell(result.outcome)
        return result

    def _begin(self) -> None:
        try:
            self._bench.begin_sequence()
            lane = self._lane(0)
            lane.join_time()
            self._shared.began_s = lane.clock.now_s()
        except LinkError:
            # the first step meets the same and says so in the record
            _log.info("bench_not_reached", bench=self._bench.where, exc_info=True)

    def _make_safe(self, lane: Lane) -> SafeState:
        try:
            lane.join_time()
        except LinkError:
            _log.info("safe_state_without_clock", bench=self._bench.where, exc_info=True)
        return make_safe(self._bench, lane.clock)

    def _result(self, finish: Finish, safe: SafeState, duration_s: float) -> SequenceResult:
        outcome, fault, message = finish.outcome, finish.fault, finish.message
        if not safe.reached:
            text = f"The safe state was not reached: {'; '.join(safe.problems)}."
            message = f"{message} {text}".strip()
            if outcome is Outcome.PASS:
                outcome, fault = Outcome.ERROR, Fault.STATION
        return SequenceResult(
            outcome=outcome,
            fault=fault,
            message=message,
            steps=self._core.records,
            recordings=tuple(self._shared.attempt.recordings),
            duration_bench_s=duration_s,
            safe_state=safe.reached,
        )

    def _carry_out(self, commands: list[Command], ended: StepKey | None) -> Finish | None:
        """Begin what the core commands; let the lane that has ended leave if it gets no work."""
        ready: list[RunStep] = []
        finish: Finish | None = None
        for command in commands:
            if isinstance(command, Finish):
                finish = command
            else:
                ready += self._join(command)
        for command in ready:
            self._guards[command.key] = self._guard(command)
            self._current_step = command.step.step
            self._lane(command.key.branch).give(command)
        busy = {key.branch for key in self._core.running}
        if ended is not None and ended.branch not in busy and finish is None:
            self._lane(ended.branch).leave_time()
        if finish is None:
            self._tell(None)
        return finish

    def _join(self, command: RunStep) -> list[RunStep]:
        """The command, if its lane could join bench time; else its step ends at once in ERROR."""
        try:
            self._lane(command.key.branch).join_time()
        except LinkError as error:
            cut_short = CutShort(Outcome.ERROR, error.fault, str(error))
            self._events.put(StepEnded(command.key, 0.0, 0.0, cut_short=cut_short))
            return []
        return [command]

    def _guard(self, command: RunStep) -> float:
        pace = self._bench.description.pace or 1.0
        return time.monotonic() + STEP_GUARD_WALL_S + command.step.timeout_s / pace

    def _next_event(self) -> Event:
        """The next thing that happens: a step's end, an abort, or a thread that is lost."""
        while True:
            if self._shared.abort.is_requested and not self._abort_told:
                self._abort_told = True
                return AbortRequested(self._shared.abort.reason)
            try:
                event = self._events.get(timeout=EVENT_POLL_S)
            except Empty:
                lost = self._lost_step()
                if lost is not None:
                    return lost
                continue
            if isinstance(event, DeadlinePassed):
                return event
            # a thread that was given up may still report
            if isinstance(event, StepEnded) and event.key in self._core.running:
                return event

    def _lost_step(self) -> StepEnded | None:
        now = time.monotonic()
        for key in self._core.running:
            if now > self._guards.get(key, now):
                self._lanes.pop(key.branch).end()
                self._bench.renew_clock(key.branch)
                text = f"The step's thread has not come back for {STEP_GUARD_WALL_S:g} s beyond its time-out."
                return StepEnded(key, 0.0, 0.0, cut_short=CutShort(Outcome.ERROR, Fault.TESTLOOM, text))
        return None

    def _lane(self, branch: int) -> Lane:
        if branch not in self._lanes:
            clock = self._bench.clock(branch)
            self._lanes[branch] = Lane(branch, clock, self._shared, self._events.put)
        return self._lanes[branch]

    def _tell(self, outcome: Outcome | None) -> None:
        lease = self._shared.attempt.lease
        records = self._core.records
        progress = SocketProgress(
            station=lease.station,
            socket=lease.socket,
            serial=lease.unit.serial,
            operation=lease.operation,
            step=None if outcome is not None else self._current_step,
            steps_done=len(records),
            steps_total=self._steps_total,
            bench_time_s=max((record.ended_bench_s for record in records), default=0.0),
            outcome=outcome,
        )
        try:
            self._on_progress(progress)
        except (TestloomError, OSError, RuntimeError):
            # a view is never worth a sequence
            _log.warning("progress_not_shown", bench=self._bench.where, exc_info=True)

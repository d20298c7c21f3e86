"""A lane: the thread and the clock of one branch number. Serial steps run on lane 0."""

import threading
from collections.abc import Callable
from queue import SimpleQueue

import structlog

from protocol.errors import Fault, TestloomError
from protocol.outcomes import Outcome
from protocol.plans import Plan
from stations.drivers.clock import BranchClock
from stations.drivers.socket_bench import SocketBench
from stations.interruptions import AbortFlag, SequenceAborted, StepTimeout
from stations.sequencing.context import Attempt, StepContext
from stations.sequencing.core import CutShort, DeadlinePassed, Event, RunStep, StepEnded
from stations.sequencing.fault_finding import find_fault
from stations.sequencing.step_registry import definitions

_log = structlog.get_logger("stations.sequencing")


class SequenceEnvironment:
    """What the lanes of one sequence share. `began_s`: bench time at its beginning."""

    def __init__(self, plan: Plan, attempt: Attempt, bench: SocketBench, abort: AbortFlag) -> None:
        self.plan = plan
        self.attempt = attempt
        self.bench = bench
        self.abort = abort
        self.began_s = 0.0


class Lane:
    """Runs steps one after the other and puts what came of them to `report`.

    The dispatcher calls `join_time` before it gives the lane work, and `leave_time` when it has none
    for it; the lane's thread uses the clock only in between.
    """

    def __init__(
        self, branch: int, clock: BranchClock, shared: SequenceEnvironment, report: Callable[[Event], None]
    ) -> None:
        self.clock = clock
        self.in_time = False
        self._shared = shared
        self._report = report
        self._work: SimpleQueue[RunStep | None] = SimpleQueue()
        name = f"{shared.bench.where}, branch {branch}"
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def join_time(self) -> None:
        """Take part in bench time. Raises LinkError: the bench is dead."""
        if not self.in_time:
            self.clock.join()
            self.in_time = True

    def leave_time(self) -> None:
        """Take no part in it."""
        if self.in_time:
            self.in_time = False
            try:
                self.clock.leave()
            except TestloomError:
                _log.info("branch_could_not_leave_time", bench=self._shared.bench.where, exc_info=True)

    def give(self, command: RunStep) -> None:
        """Run a step; its StepEnded is reported."""
        self._work.put(command)

    def end(self) -> None:
        """Let the thread end after what it does now."""
        self._work.put(None)

    def _run(self) -> None:
        while (command := self._work.get()) is not None:
            for event in self._events_of(command):
                self._report(event)

    def _events_of(self, command: RunStep) -> list[Event]:
        shared, clock = self._shared, self.clock
        started_s = clock.now_s()
        teardown = command.key.section == "teardown"
        clock.interruption = (lambda: None) if teardown else shared.abort.check
        deadline_s = None if teardown else shared.began_s + shared.plan.deadline_s
        clock.limit(started_s + command.step.timeout_s, deadline_s)
        context = StepContext(command.step, shared.attempt, shared.bench, clock)
        events: list[Event] = []
        cut_short: CutShort | None = None
        try:
            definitions()[command.step.step].function(context)
        except SequenceAborted as abort:
            cut_short = CutShort(Outcome.ABORTED, Fault.NONE, abort.what)
        except StepTimeout as timeout:
            if timeout.of_sequence:
                events.append(DeadlinePassed(shared.plan.deadline_s))
            cut_short = self._cut_short(timeout, Outcome.TIMEOUT)
        except TestloomError as error:
            cut_short = self._cut_short(error, Outcome.ERROR)
        except Exception as error:  # noqa: BLE001 - a step function is anybody's code
            _log.exception("step_failed", step=command.step.step)
            text = f"The step failed inside: {type(error).__name__}: {error}. Its traceback is in the log."
            cut_short = CutShort(Outcome.ERROR, Fault.TESTLOOM, text)
        clock.limit(None)
        ended = StepEnded(
            key=command.key,
            started_bench_s=started_s - shared.began_s,
            ended_bench_s=clock.now_s() - shared.began_s,
            measurements=context.measurements(),
            cut_short=cut_short,
            message=context.message,
        )
        return [*events, ended]

    def _cut_short(self, error: TestloomError, outcome: Outcome) -> CutShort:
        fault, evidence = find_fault(error, self._shared.bench, self.clock)
        parts = [error.what, evidence]
        parts += [f"Where: {error.where}."] if error.where else []
        parts += [f"What to do: {error.remedy}"] if error.remedy else []
        text = " ".join(part for part in parts if part)
        assert outcome in (Outcome.ERROR, Outcome.TIMEOUT)
        return CutShort(outcome, fault, text)

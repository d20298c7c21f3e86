# pyright: strict
"""The state machine of one sequence: events in, commands out. It runs nothing and knows no time.

A sequence goes through its phases in one direction:

    READY ──SequenceStarted──▶ SETUP ──▶ MAIN ──▶ TEARDOWN ──▶ FINISHED

Within SETUP and MAIN the items run one after the other; a `Parallel` item has its branches side by
side and ends when all of them have. A *stop* (below) starts nothing new there: steps under way end
by themselves or are interrupted by the shell, then TEARDOWN begins. TEARDOWN runs each of its steps
once, in order, whatever they or anything before them did; there is no way around it.

What stops the sequence before its end:
  - a step that is not PASS in setup, or that is a gate: what follows would be dangerous or void;
  - a step that ended in ERROR, TIMEOUT or ABORTED: the bench cannot measure, going on says nothing;
  - AbortRequested and DeadlinePassed, until the teardown has begun; after that they are too late.
A FAIL without a gate stops nothing: the next measurement tells more about the same unit.

The outcome of a step: how it was cut short, if it was; else ERROR if a measurement is not a number;
else ERROR if a declared measurement was never taken (the plan promises what the step does not do);
else FAIL, by the unit's fault, if a limit was missed; else PASS.

The outcome of the sequence: ABORTED, ERROR, TIMEOUT, FAIL, PASS, the first of these that a step of
setup or main (or an abort, or the deadline) has. An ERROR stands above a FAIL, because what kept the
bench from measuring may have caused the FAIL as well. A teardown that is not PASS turns a PASS into
an ERROR and changes nothing else: it comes too late to have caused anything.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple

from protocol.attempts import StepRecord
from protocol.errors import Fault, TestloomError
from protocol.measurements import Measurement
from protocol.outcomes import MeasurementOutcome, Outcome
from protocol.plans import Parallel, Plan, Step

MAX_NAMED_FAILURES = 3
"""A step's message names this many missed limits and counts the others."""

Section = Literal["setup", "main", "teardown"]


class Phase(StrEnum):
    """Where a sequence is."""

    READY = "ready"
    SETUP = "setup"
    MAIN = "main"
    TEARDOWN = "teardown"
    FINISHED = "finished"


class StepKey(NamedTuple):
    """One step's place in the plan: section, item in it, branch of the item, step in the branch."""

    section: Section
    item: int
    branch: int
    position: int


@dataclass(frozen=True)
class CutShort:
    """Why a step did not come to its own end."""

    outcome: Literal[Outcome.ERROR, Outcome.TIMEOUT, Outcome.ABORTED]
    fault: Fault
    message: str


@dataclass(frozen=True)
class SequenceStarted:
    """The shell is ready to run steps."""


@dataclass(frozen=True)
class StepEnded:
    """A step came to its end, or was cut short. Times are bench time since the sequence began."""

    key: StepKey
    started_bench_s: float
    ended_bench_s: float
    measurements: tuple[Measurement, ...] = ()
    cut_short: CutShort | None = None
    message: str = ""


@dataclass(frozen=True)
class AbortRequested:
    """Somebody wants the sequence to end now."""

    reason: str


@dataclass(frozen=True)
class DeadlinePassed:
    """The plan's deadline for the whole sequence has passed."""

    deadline_s: float


Event = SequenceStarted | StepEnded | AbortRequested | DeadlinePassed


@dataclass(frozen=True)
class RunStep:
    """Run this step on its branch; answer with StepEnded."""

    key: StepKey
    step: Step


@dataclass(frozen=True)
class Finish:
    """The sequence has ended; nothing runs any more."""

    outcome: Outcome
    fault: Fault
    message: str


Command = RunStep | Finish


class InvalidTransition(TestloomError):
    """An event that cannot happen in this phase; the story says how it came there."""


class _Stop(NamedTuple):
    outcome: Outcome
    fault: Fault
    message: str


_PRECEDENCE = (Outcome.ABORTED, Outcome.ERROR, Outcome.TIMEOUT, Outcome.FAIL, Outcome.PASS)
_STOPPING = (Outcome.ABORTED, Outcome.ERROR, Outcome.TIMEOUT)

_Items = tuple[tuple[tuple[Step, ...], ...], ...]  # items → branches → steps


class SequenceCore:
    """One sequence of one plan."""

    def __init__(self, plan: Plan) -> None:
        sequence = plan.sequence
        self._items: dict[Section, _Items] = {
            "setup": tuple(((step,),) for step in sequence.setup),
            "main": tuple(
                item.parallel if isinstance(item, Parallel) else ((item,),) for item in sequence.main
            ),
            "teardown": tuple(((step,),) for step in sequence.teardown),
        }
        self._phase = Phase.READY
        self._item = 0
        self._running: set[StepKey] = set()
        self._records: list[StepRecord] = []
        self._stop: _Stop | None = None
        self._findings: list[_Stop] = []
        self._story: list[str] = []

    @property
    def phase(self) -> Phase:
        return self._phase

    @property
    def running(self) -> frozenset[StepKey]:
        """Steps that have been commanded and have not ended."""
        return frozenset(self._running)

    @property
    def records(self) -> tuple[StepRecord, ...]:
        """The steps that ran, in the order in which they ended."""
        return tuple(self._records)

    @property
    def stopped(self) -> bool:
        """True once nothing but the teardown will be started."""
        return self._stop is not None

    def handle(self, event: Event) -> list[Command]:
        """What is to be done after an event.

        Raises:
            InvalidTransition: the event cannot happen now.
        """
        self._story.append(f"{self._phase}: {type(event).__name__}")
        reaction = _TRANSITIONS.get((self._phase, type(event)))
        if reaction is None:
            raise self._invalid(f"{type(event).__name__} cannot happen in the phase {self._phase}")
        return reaction(self, event)

    # reactions, named in _TRANSITIONS

    def _start(self, _: Event) -> list[Command]:
        self._enter(Phase.SETUP)
        return self._advance()

    def _step_ended(self, event: Event) -> list[Command]:
        assert isinstance(event, StepEnded)
        if event.key not in self._running:
            raise self._invalid(f"the step {event.key} ended but was not running")
        self._running.remove(event.key)
        record = self._record(event)
        self._records.append(record)
        self._weigh(record, self._step(event.key))
        key = event.key
        branch = self._items[key.section][key.item][key.branch]
        if key.position + 1 < len(branch) and not (self.stopped and self._phase is not Phase.TEARDOWN):
            return [self._run(key._replace(position=key.position + 1))]
        if self._running:
            return []
        self._item += 1
        return self._advance()

    def _abort(self, event: Event) -> list[Command]:
        assert isinstance(event, AbortRequested)
        finding = _Stop(Outcome.ABORTED, Fault.NONE, f"The sequence was aborted: {event.reason}.")
        return self._stop_for(finding)

    def _deadline(self, event: Event) -> list[Command]:
        assert isinstance(event, DeadlinePassed)
        finding = _Stop(
            Outcome.TIMEOUT,
            Fault.UNIT,
            f"The sequence did not end within the plan's deadline of {event.deadline_s:g} s.",
        )
        return self._stop_for(finding)

    def _too_late(self, _: Event) -> list[Command]:
        return []

    # how the sequence moves on

    def _stop_for(self, finding: _Stop) -> list[Command]:
        self._findings.append(finding)
        self._stop = self._stop or finding
        return [] if self._running else self._advance()

    def _advance(self) -> list[Command]:
        """Begin the next item that may begin; nothing is running."""
        while self._phase is not Phase.FINISHED:
            section = _SECTION_OF_PHASE[self._phase]
            may_begin = section == "teardown" or not self.stopped
            if may_begin and self._item < len(self._items[section]):
                branches = self._items[section][self._item]
                keys = [StepKey(section, self._item, branch, 0) for branch in range(len(branches))]
                commands: list[Command] = [self._run(key) for key in keys if branches[key.branch]]
                if commands:
                    return commands
                self._item += 1
                continue
            self._enter(_NEXT_PHASE[self._phase])
        return [Finish(*self._verdict())]

    def _enter(self, phase: Phase) -> None:
        self._phase = phase
        self._item = 0

    def _run(self, key: StepKey) -> RunStep:
        self._running.add(key)
        return RunStep(key, self._step(key))

    def _step(self, key: StepKey) -> Step:
        return self._items[key.section][key.item][key.branch][key.position]

    # how steps and the sequence are judged

    def _record(self, event: StepEnded) -> StepRecord:
        outcome, fault, message = judge_step(event.measurements, event.cut_short)
        return StepRecord(
            step=self._step(event.key).step,
            section=event.key.section,
            branch=event.key.branch,
            outcome=outcome,
            started_bench_s=event.started_bench_s,
            ended_bench_s=event.ended_bench_s,
            measurements=event.measurements,
            fault=fault,
            message=" ".join(part for part in (message, event.message) if part),
        )

    def _weigh(self, record: StepRecord, step: Step) -> None:
        if record.outcome is Outcome.PASS:
            return
        finding = _Stop(record.outcome, record.fault, f"{record.step}: {record.message}")
        if record.section == "teardown":
            finding = finding._replace(outcome=Outcome.ERROR)
            if not self._findings:
                self._findings.append(finding)
            return
        self._findings.append(finding)
        if record.outcome in _STOPPING or step.gate or record.section == "setup":
            self._stop = self._stop or finding

    def _verdict(self) -> _Stop:
        if not self._findings:
            return _Stop(Outcome.PASS, Fault.NONE, "")
        return min(self._findings, key=lambda finding: _PRECEDENCE.index(finding.outcome))

    def _invalid(self, what: str) -> InvalidTransition:
        return InvalidTransition(
            f"The sequence engine met something impossible: {what}.",
            where="stations/sequencing/core.py",
            remedy="report this with its story.",
            story=tuple(self._story),
        )


def judge_step(
    measurements: tuple[Measurement, ...], cut_short: CutShort | None
) -> tuple[Outcome, Fault, str]:
    """Outcome, fault and words of a step, by the rules in the module's prose."""
    if cut_short is not None:
        return cut_short.outcome, cut_short.fault, cut_short.message

    def those(outcome: MeasurementOutcome) -> list[Measurement]:
        return [measurement for measurement in measurements if measurement.outcome is outcome]

    if not_numbers := those(MeasurementOutcome.ERROR):
        first = not_numbers[0]
        reason = first.message or f"{first.value!r} cannot be compared with limits"
        return (
            Outcome.ERROR,
            Fault.UNIT,
            f"The measurement {first.specification.name} is no number: {reason}.",
        )
    if unset := those(MeasurementOutcome.UNSET):
        names = ", ".join(measurement.specification.name for measurement in unset[:MAX_NAMED_FAILURES])
        return Outcome.ERROR, Fault.PLAN, f"Declared in the plan and never measured: {names}."
    if failed := those(MeasurementOutcome.FAIL):
        named = "; ".join(_missed_limit(measurement) for measurement in failed[:MAX_NAMED_FAILURES])
        more = len(failed) - MAX_NAMED_FAILURES
        return Outcome.FAIL, Fault.UNIT, f"{named}{f'; and {more} more' if more > 0 else ''}."
    return Outcome.PASS, Fault.NONE, ""


def _missed_limit(measurement: Measurement) -> str:
    asked = measurement.specification
    value = f"{measurement.value:.6g}" if isinstance(measurement.value, float) else f"{measurement.value}"
    if asked.equals is not None:
        return f"{asked.name} is {value}, not {asked.equals}"
    low = "−∞" if asked.low is None else f"{asked.low:g}"
    high = "∞" if asked.high is None else f"{asked.high:g}"
    return f"{asked.name} = {value} {asked.unit} is not within {low} … {high} {asked.unit}"


_SECTION_OF_PHASE: dict[Phase, Section] = {
    Phase.SETUP: "setup",
    Phase.MAIN: "main",
    Phase.TEARDOWN: "teardown",
}
_NEXT_PHASE = {Phase.SETUP: Phase.MAIN, Phase.MAIN: Phase.TEARDOWN, Phase.TEARDOWN: Phase.FINISHED}

# pyright: reportPrivateUsage=false
_TRANSITIONS: dict[tuple[Phase, type[Event]], Callable[[SequenceCore, Event], list[Command]]] = {
    (Phase.READY, SequenceStarted): SequenceCore._start,
    (Phase.SETUP, StepEnded): SequenceCore._step_ended,
    (Phase.SETUP, AbortRequested): SequenceCore._abort,
    (Phase.SETUP, DeadlinePassed): SequenceCore._deadline,
    (Phase.MAIN, StepEnded): SequenceCore._step_ended,
    (Phase.MAIN, AbortRequested): SequenceCore._abort,
    (Phase.MAIN, DeadlinePassed): SequenceCore._deadline,
    (Phase.TEARDOWN, StepEnded): SequenceCore._step_ended,
    (Phase.TEARDOWN, AbortRequested): SequenceCore._too_late,
    (Phase.TEARDOWN, DeadlinePassed): SequenceCore._too_late,
    (Phase.FINISHED, AbortRequested): SequenceCore._too_late,
    (Phase.FINISHED, DeadlinePassed): SequenceCore._too_late,
}

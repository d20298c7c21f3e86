"""The sequence core under random plans and random fates of their steps."""

from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.errors import Fault
from protocol.measurements import Measurement, MeasurementSpecification
from protocol.outcomes import MeasurementOutcome, Outcome
from protocol.plans import Parallel, Plan, Sequence, Step
from stations.sequencing.core import (
    AbortRequested,
    Command,
    CutShort,
    DeadlinePassed,
    Finish,
    InvalidTransition,
    Phase,
    RunStep,
    SequenceCore,
    SequenceStarted,
    StepEnded,
    StepKey,
    judge_step,
)

FATES = ("pass", "fail", "unset", "not_a_number", "error", "timeout", "aborted")
BAD = {
    "fail": Outcome.FAIL,
    "unset": Outcome.ERROR,
    "not_a_number": Outcome.ERROR,
    "error": Outcome.ERROR,
    "timeout": Outcome.TIMEOUT,
    "aborted": Outcome.ABORTED,
}
SPECIFICATION = MeasurementSpecification(name="reading", unit="V", low=1.0, high=2.0)


@dataclass
class Played:
    """What a run of the core did."""

    finish: Finish | None = None
    started: list[StepKey] = field(default_factory=list)
    ended: list[StepKey] = field(default_factory=list)
    records: tuple = ()
    most_side_by_side: int = 0

    @property
    def verdict(self) -> Finish:
        assert self.finish is not None
        return self.finish


@st.composite
def plans(draw) -> Plan:
    """Plans whose step names tell their fate: `fate_number`."""
    counter = iter(range(1000))

    def one(fates=FATES) -> Step:
        fate = draw(st.sampled_from(fates))
        specification = SPECIFICATION.model_copy(update={"name": f"m{next(counter)}"})
        return Step(
            step=f"{fate}_step", timeout_s=1.0, gate=draw(st.booleans()), measurements=(specification,)
        )

    def items():
        for _ in range(draw(st.integers(1, 4))):
            if draw(st.booleans()):
                yield one()
            else:
                yield Parallel(
                    parallel=tuple(
                        tuple(one() for _ in range(draw(st.integers(1, 3))))
                        for _ in range(draw(st.integers(2, 4)))
                    )
                )

    return Plan(
        format="testloom-plan/1",
        name="drawn",
        version="1.0.0",
        product="any",
        operation="any",
        deadline_s=10.0,
        sequence=Sequence(
            setup=tuple(one() for _ in range(draw(st.integers(0, 2)))),
            main=tuple(items()),
            teardown=tuple(one() for _ in range(draw(st.integers(1, 3)))),
        ),
    )


def ended(command: Command) -> StepEnded:
    assert isinstance(command, RunStep)
    fate = command.step.step.removesuffix("_step")
    specification = command.step.measurements[0]
    value, outcome = {
        "fail": (3.0, MeasurementOutcome.FAIL),
        "unset": (None, MeasurementOutcome.UNSET),
        "not_a_number": (None, MeasurementOutcome.ERROR),
    }.get(fate, (1.5, MeasurementOutcome.PASS))
    cut = {
        "error": CutShort(Outcome.ERROR, Fault.STATION, "lost"),
        "timeout": CutShort(Outcome.TIMEOUT, Fault.UNIT, "slow"),
        "aborted": CutShort(Outcome.ABORTED, Fault.NONE, "stopped"),
    }.get(fate)
    return StepEnded(
        command.key,
        0.0,
        1.0,
        (Measurement(specification=specification, value=value, outcome=outcome),),
        cut,
    )


def play(plan: Plan, data: st.DataObject | None, interruptions: list = []) -> Played:  # noqa: B006
    """Run a plan to its end; which of several running steps ends first is drawn."""
    core, played = SequenceCore(plan), Played()
    open_steps: dict[StepKey, RunStep] = {}
    pending = list(interruptions)

    def take(commands) -> None:
        for command in commands:
            if isinstance(command, Finish):
                assert played.finish is None
                played.finish = command
            else:
                assert command.key not in played.started
                played.started.append(command.key)
                open_steps[command.key] = command
        played.most_side_by_side = max(played.most_side_by_side, len(open_steps))
        assert core.running == set(open_steps)
        branches = [key.branch for key in open_steps]
        assert len(branches) == len(set(branches))

    take(core.handle(SequenceStarted()))
    while open_steps:
        if pending and (data is None or data.draw(st.booleans())):
            take(core.handle(pending.pop()))
            continue
        keys = sorted(open_steps)
        key = keys[0] if data is None else data.draw(st.sampled_from(keys))
        played.ended.append(key)
        take(core.handle(ended(open_steps.pop(key))))
    played.records = core.records
    assert core.phase is Phase.FINISHED
    return played


INTERRUPTIONS = st.lists(
    st.sampled_from([AbortRequested("the operator said so"), DeadlinePassed(10.0)]), max_size=2
)


@settings(max_examples=50)
@given(plans(), INTERRUPTIONS, st.data())
def test_teardown_runs_once_in_order_whatever_happens(plan, interruptions, data):
    played = play(plan, data, interruptions)
    teardown = [key for key in played.started if key.section == "teardown"]
    assert [key.item for key in teardown] == list(range(len(plan.sequence.teardown)))
    assert played.started[-len(teardown) :] == teardown
    assert played.finish is not None
    assert len(played.records) == len(played.started) == len(played.ended)


@settings(max_examples=50)
@given(plans(), INTERRUPTIONS, st.data())
def test_pass_only_if_every_declared_measurement_of_every_step_passed(plan, interruptions, data):
    played = play(plan, data, interruptions)
    taken = [m for record in played.records for m in record.measurements]
    all_passed = len(taken) == sum(len(step.measurements) for step in plan.steps()) and all(
        measurement.outcome is MeasurementOutcome.PASS for measurement in taken
    )
    no_cut = all(record.outcome is Outcome.PASS for record in played.records)
    if played.verdict.outcome is Outcome.PASS:
        assert all_passed
        assert no_cut
        assert played.verdict.fault is Fault.NONE
    elif not interruptions:
        assert not (all_passed and no_cut)


@settings(max_examples=50)
@given(plans(), st.data())
def test_the_outcome_is_the_worst_that_a_step_before_the_teardown_had(plan, data):
    played = play(plan, data)
    order = [Outcome.ABORTED, Outcome.ERROR, Outcome.TIMEOUT, Outcome.FAIL]
    before = [record.outcome for record in played.records if record.section != "teardown"]
    bad = [outcome for outcome in order if outcome in before]
    late = [r for r in played.records if r.section == "teardown" and r.outcome is not Outcome.PASS]
    expected = bad[0] if bad else (Outcome.ERROR if late else Outcome.PASS)
    assert played.verdict.outcome is expected


@settings(max_examples=50)
@given(plans(), st.data())
def test_nothing_new_starts_after_a_stop(plan, data):
    """Independent rule: after the first stopping end, main steps may end but none may begin."""
    core = SequenceCore(plan)
    open_steps: dict[StepKey, RunStep] = {}
    stopped = False

    def take(commands) -> None:
        for command in commands:
            if isinstance(command, RunStep):
                assert not (stopped and command.key.section != "teardown")
                open_steps[command.key] = command

    take(core.handle(SequenceStarted()))
    while open_steps:
        key = data.draw(st.sampled_from(sorted(open_steps)))
        command = open_steps.pop(key)
        fate = command.step.step.removesuffix("_step")
        if key.section != "teardown" and fate != "pass":
            stopped = stopped or fate != "fail" or command.step.gate or key.section == "setup"
        take(core.handle(ended(command)))


def plan_of(*main: Step | Parallel) -> Plan:
    return Plan(
        format="testloom-plan/1",
        name="given",
        version="1.0.0",
        product="any",
        operation="any",
        deadline_s=10.0,
        sequence=Sequence(main=main, teardown=(Step(step="pass_step", timeout_s=1.0),)),
    )


def step_of(fate: str, number: int, gate: bool = False) -> Step:
    specification = SPECIFICATION.model_copy(update={"name": f"m{number}"})
    return Step(step=f"{fate}_step", timeout_s=1.0, gate=gate, measurements=(specification,))


def with_teardown_measurement(plan: Plan) -> Plan:
    teardown = (step_of("pass", 99),)
    return plan.model_copy(update={"sequence": plan.sequence.model_copy(update={"teardown": teardown})})


@pytest.mark.parametrize(
    ("main", "started", "outcome"),
    [
        ([step_of("fail", 0), step_of("pass", 1)], 3, Outcome.FAIL),
        ([step_of("fail", 0, gate=True), step_of("pass", 1)], 2, Outcome.FAIL),
        ([step_of("error", 0), step_of("pass", 1)], 2, Outcome.ERROR),
        ([step_of("fail", 0), step_of("error", 1)], 3, Outcome.ERROR),
        ([step_of("unset", 0), step_of("pass", 1)], 2, Outcome.ERROR),
    ],
)
def test_stop_rules(main, started, outcome):
    played = play(with_teardown_measurement(plan_of(*main)), None)
    assert len(played.started) == started
    assert played.verdict.outcome is outcome


def test_branches_run_side_by_side_and_join():
    parallel = Parallel(parallel=((step_of("pass", 0), step_of("pass", 1)), (step_of("pass", 2),)))
    played = play(with_teardown_measurement(plan_of(parallel, step_of("pass", 3))), None)
    assert played.most_side_by_side == 2
    assert played.verdict.outcome is Outcome.PASS
    after_join = played.started.index(StepKey("main", 1, 0, 0))
    assert after_join == 3


def test_an_abort_in_the_teardown_is_too_late():
    core = SequenceCore(with_teardown_measurement(plan_of(step_of("pass", 0))))
    (first,) = core.handle(SequenceStarted())
    (teardown,) = core.handle(ended(first))
    assert core.handle(AbortRequested("late")) == []
    (finish,) = core.handle(ended(teardown))
    assert isinstance(finish, Finish)
    assert finish.outcome is Outcome.PASS


def test_impossible_events_tell_their_story():
    core = SequenceCore(plan_of(step_of("pass", 0)))
    with pytest.raises(InvalidTransition) as early:
        core.handle(StepEnded(StepKey("main", 0, 0, 0), 0.0, 1.0))
    assert early.value.story == ("ready: StepEnded",)
    core.handle(SequenceStarted())
    with pytest.raises(InvalidTransition):
        core.handle(SequenceStarted())


def test_whose_fault_a_step_is():
    def measured(outcome: MeasurementOutcome, value: float | None = 3.0) -> Measurement:
        return Measurement(specification=SPECIFICATION, value=value, outcome=outcome)

    assert judge_step((measured(MeasurementOutcome.FAIL),), None)[:2] == (Outcome.FAIL, Fault.UNIT)
    assert judge_step((measured(MeasurementOutcome.UNSET, None),), None)[:2] == (Outcome.ERROR, Fault.PLAN)
    words = judge_step((measured(MeasurementOutcome.FAIL),), None)[2]
    assert words == "reading = 3 V is not within 1 … 2 V."
    cut = CutShort(Outcome.TIMEOUT, Fault.FIXTURE, "slow")
    assert judge_step((measured(MeasurementOutcome.FAIL),), cut) == (Outcome.TIMEOUT, Fault.FIXTURE, "slow")

"""The agent's core: what it promises holds in every order of events, with every answer lost."""

from collections.abc import Iterable
from typing import TypeVar

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from protocol.attempts import AttemptRecord, Lease, UnitIdentity
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from protocol.station_messages import (
    MAX_RECORDS_PER_SUBMISSION,
    AbortSequence,
    CommandAccepted,
    CommandRefused,
    LeasesRenewed,
    SocketDescription,
    StartSequence,
    StationAccepted,
    StationRefused,
)
from stations.agent import events as on
from stations.agent.core import (
    EXIT_REFUSED,
    EXIT_STOPPED,
    RENEWALS_UNANSWERED,
    RETRY_MAX_S,
    AgentCore,
)
from stations.agent.fences import FENCE_WINDOW
from stations.agent.state import AgentIdentity, SpoolContent

PLAN = PlanReference(operation="functional", name="functional", version="1.0.0", sha256="0" * 64)
IDENTITY = AgentIdentity(
    station="st-1",
    incarnation=1,
    bench_identity="B-1",
    sockets=tuple(SocketDescription(socket=socket, operations=("functional",)) for socket in "12"),
    plans=(PLAN,),
)
EMPTY = SpoolContent({}, 1)
ACCEPTED = StationAccepted(lease_duration_s=5.0, renewal_period_s=1.0)


def lease(fence: int, socket: str = "1", serial: str = "U-1", plan: PlanReference = PLAN) -> Lease:
    return Lease(
        fence=fence,
        attempt_id=f"a-{fence}",
        unit=UnitIdentity(serial=serial, product="gnc_module", lot="L1"),
        operation="functional",
        station="st-1",
        socket=socket,
        plan=plan,
    )


def record(of: Lease, outcome: Outcome = Outcome.PASS) -> AttemptRecord:
    return AttemptRecord(
        attempt_id=of.attempt_id,
        lease=of,
        incarnation=1,
        outcome=outcome,
        started_at_s=0.0,
        ended_at_s=1.0,
        software_version="t",
    )


def core(content: SpoolContent = EMPTY) -> AgentCore:
    agent = AgentCore(IDENTITY, content)
    agent.handle(on.AgentStarted())
    agent.handle(on.RegistrationAnswered(ACCEPTED))
    return agent


def start(agent: AgentCore, of: Lease, query: int = 0) -> list[on.Command]:
    return agent.handle(on.CommandReceived(query, StartSequence(lease=of)))


def running(agent: AgentCore, of: Lease) -> None:
    assert start(agent, of) == [on.WriteTrace(of)]
    commands = agent.handle(on.TraceWritten(of.fence))
    assert commands == [on.RunLease(of), on.Reply(0, CommandAccepted(fence=of.fence))]


def reason(commands: Iterable[on.Command]) -> str:
    (refusal,) = commands
    assert isinstance(refusal, on.Reply)
    assert isinstance(refusal.reply, CommandRefused)
    return refusal.reply.reason


CommandKind = TypeVar("CommandKind")


def only(commands: Iterable[on.Command], kind: type[CommandKind]) -> list[CommandKind]:
    return [command for command in commands if isinstance(command, kind)]


def only_timers(commands: Iterable[on.Command]) -> list[on.SetTimer]:
    return only(commands, on.SetTimer)


def test_a_start_that_arrives_again_is_acknowledged_and_not_run_again() -> None:
    agent = core()
    running(agent, lease(5))
    accepted = [on.Reply(9, CommandAccepted(fence=5))]
    assert start(agent, lease(5), query=9) == accepted
    agent.handle(on.SequenceEnded(record(lease(5))))
    assert start(agent, lease(5), query=9) == accepted
    agent.handle(on.RecordSpooled("a-5", 1))
    assert start(agent, lease(5), query=9) == accepted
    restarted = core(SpoolContent({1: "a-5"}, 2, ((5, "1", "U-1"),)))
    assert start(restarted, lease(5), query=9) == accepted


def test_both_who_asked_before_the_trace_was_durable_are_answered_after_it() -> None:
    agent = core()
    start(agent, lease(5), query=1)
    assert start(agent, lease(5), query=2) == []
    replies = only(agent.handle(on.TraceWritten(5)), on.Reply)
    assert [reply.query for reply in replies] == [1, 2]


def test_what_must_not_run_is_refused_with_its_reason() -> None:
    agent = core(SpoolContent({}, 1, ((3, "2", "U-2"), (4, "1", "U-1"), (7, "2", "U-7"))))
    other_plan = PLAN.model_copy(update={"sha256": "1" * 64})
    assert reason(start(agent, lease(3, "1", "U-3"))) == "stale_fence"  # older than the socket's newest
    assert reason(start(agent, lease(6, "1", "U-7"))) == "stale_fence"  # the unit went elsewhere since
    assert reason(start(agent, lease(9, "3"))) == "unknown_socket"
    assert reason(start(agent, lease(9, plan=other_plan))) == "unknown_plan"
    running(agent, lease(8))
    assert reason(start(agent, lease(9, "1", "U-9"))) == "socket_busy"
    assert reason(start(agent, lease(9, "2", "U-1"))) == "socket_busy"
    running(agent, lease(FENCE_WINDOW + 10, "2", "U-10"))
    assert (
        reason(start(core(SpoolContent({}, 1, ((FENCE_WINDOW + 9, "2", "U-2"),))), lease(9))) == "stale_fence"
    )


def test_a_revoked_lease_is_aborted_once_and_still_leaves_its_record() -> None:
    agent = core()
    running(agent, lease(5))
    renewed = on.RenewalAnswered(LeasesRenewed(revoked=(5, 99)))
    (abort,) = only(agent.handle(renewed), on.AbortSocket)
    assert (abort.socket, abort.fence) == ("1", 5)
    assert only(agent.handle(renewed), on.AbortSocket) == []
    ended = record(lease(5), Outcome.ABORTED)
    assert agent.handle(on.SequenceEnded(ended)) == [on.SpoolRecord(ended)]


def test_an_abort_meets_its_sequence_at_any_stage() -> None:
    agent = core()
    command = AbortSequence(station="st-1", socket="1", fence=5, reason="operator")
    assert reason(agent.handle(on.CommandReceived(1, command))) == "stale_fence"
    start(agent, lease(5))
    agent.handle(on.CommandReceived(1, command))  # while the trace is being written
    assert agent.handle(on.TraceWritten(5))[-1] == on.AbortSocket("1", 5, "operator")
    agent.handle(on.SequenceEnded(record(lease(5), Outcome.ABORTED)))
    agent.handle(on.RecordSpooled("a-5", 1))
    late = agent.handle(on.CommandReceived(2, command))
    assert late == [on.Reply(2, CommandAccepted(fence=5))]


def test_a_full_spool_keeps_the_record_refuses_leases_and_recovers() -> None:
    agent = core()
    running(agent, lease(5))
    ended = record(lease(5))
    agent.handle(on.SequenceEnded(ended))
    (alarm,) = only(agent.handle(on.SpoolFailed("a-5", "disk full")), on.RaiseAlarm)
    assert alarm.text == "disk full"
    assert only(agent.handle(on.SpoolFailed("a-5", "disk full")), on.RaiseAlarm) == []  # said once
    assert reason(start(agent, lease(6, "2", "U-2"))) == "stopping"
    assert agent.unspooled == (ended,)
    assert agent.held == (lease(5),)  # its lease is renewed until the record is safe
    assert agent.handle(on.TimerExpired("spool")) == [on.SpoolRecord(ended)]
    assert only(agent.handle(on.RecordSpooled("a-5", 1)), on.Submit) == [on.Submit((1,))]
    running(agent, lease(6, "2", "U-2"))


def test_no_sequence_starts_without_its_trace() -> None:
    agent = core()
    start(agent, lease(5))
    commands = agent.handle(on.TraceFailed(5, "disk full"))
    assert only(commands, on.RunLease) == []
    assert reason(only(commands, on.Reply)) == "stopping"
    agent.handle(on.TimerExpired("spool"))
    running(agent, lease(5))  # there was no trace, so the same lease may be tried again


def test_records_go_in_batches_and_stay_until_their_ids_are_echoed() -> None:
    backlog = {number: f"a-{number}" for number in range(1, 101)}
    agent = AgentCore(IDENTITY, SpoolContent(backlog, 101, ((40, "1", "U-1"), (77, "2", "U-2"))))
    (registration,) = agent.handle(on.AgentStarted())
    assert isinstance(registration, on.Register)
    request = registration.request
    assert (request.spool_first, request.spool_last, request.spool_next) == (1, 100, 101)
    assert request.newest_fence == 77
    (submission,) = only(agent.handle(on.RegistrationAnswered(ACCEPTED)), on.Submit)
    assert submission.sequence_numbers == tuple(range(1, MAX_RECORDS_PER_SUBMISSION + 1))
    assert only(agent.handle(on.SubmissionAnswered(("never sent",))), on.DropRecords) == []
    assert agent.unacknowledged == backlog
    (again,) = only(agent.handle(on.TimerExpired("submit")), on.Submit)
    assert again == submission
    assert agent.handle(on.SubmissionAnswered(("a-2", "a-1"))) == [on.DropRecords(("a-2", "a-1"))]
    assert agent.unacknowledged == backlog
    (following,) = only(agent.handle(on.RecordsDropped(("a-2", "a-1"))), on.Submit)
    assert following.sequence_numbers == tuple(range(3, MAX_RECORDS_PER_SUBMISSION + 3))


def test_a_silent_coordinator_is_asked_with_growing_pauses_then_told_everything_again() -> None:
    agent = core()
    running(agent, lease(5))
    timers = [agent.handle(on.RenewalAnswered(None)) for _ in range(RENEWALS_UNANSWERED)]
    assert [timer.timer for (timer,) in map(only_timers, timers)] == ["renew", "renew", "register"]
    pauses: list[float] = []
    for _ in range(8):
        (registration,) = only(agent.handle(on.TimerExpired("register")), on.Register)
        assert registration.request.held == (lease(5),)
        (timer,) = only_timers(agent.handle(on.RegistrationAnswered(None)))
        pauses.append(timer.after_s)
    assert pauses == sorted(pauses)
    assert pauses[-1] == RETRY_MAX_S
    agent.handle(on.SequenceEnded(record(lease(5))))
    assert only(agent.handle(on.RecordSpooled("a-5", 1)), on.Submit) == []  # nobody is there
    assert only(agent.handle(on.RegistrationAnswered(ACCEPTED)), on.Submit) == [on.Submit((1,))]


def test_a_refused_station_aborts_says_why_and_leaves_with_its_own_code() -> None:
    agent = core()
    running(agent, lease(5))
    commands = agent.handle(on.RenewalAnswered(StationRefused(reason="another bench is st-1")))
    assert only(commands, on.RaiseAlarm)[0].text == "another bench is st-1"
    assert len(only(commands, on.AbortSocket)) == 1
    assert only(commands, on.Leave) == []
    agent.handle(on.SequenceEnded(record(lease(5), Outcome.ABORTED)))
    (leave,) = only(agent.handle(on.RecordSpooled("a-5", 1)), on.Leave)
    assert leave.exit_code == EXIT_REFUSED


def test_stop_waits_for_the_safe_state_and_no_longer_than_its_deadline() -> None:
    agent = core()
    running(agent, lease(5))
    commands = agent.handle(on.StopRequested("SIGTERM"))
    assert len(only(commands, on.AbortSocket)) == 1
    assert only(commands, on.Leave) == []
    assert reason(start(agent, lease(6, "2", "U-2"))) == "stopping"
    (leave,) = agent.handle(on.TimerExpired("stop"))
    assert leave == on.Leave(EXIT_STOPPED, "sequences were still running at the deadline")


class AgentUnderAnything(RuleBasedStateMachine):
    """Events in any order, answers lost or late, the process killed: the promises hold throughout."""

    @initialize()
    def begin(self) -> None:
        self.issued: dict[int, Lease] = {}
        self.disk: dict[int, str] = {}
        self.traces: dict[str, Lease] = {}
        self.fences: list[tuple[int, str, str]] = []
        self.next_number = 1
        self.disk_full = False
        self.started: list[str] = []
        self.recorded: list[str] = []
        self.acknowledged: set[str] = set()
        self.running: dict[str, Lease] = {}
        self.submitted: list[tuple[int, ...]] = []
        self.left = False
        self._boot()

    def _boot(self) -> None:
        for one in list(self.traces.values()):
            self._spool(record(one, Outcome.ABORTED))
        self.running, self.submitted, self.left = {}, [], False
        self.agent = AgentCore(IDENTITY, SpoolContent(dict(self.disk), self.next_number, tuple(self.fences)))
        self._do(on.AgentStarted())

    def _spool(self, one: AttemptRecord) -> int:
        number, self.next_number = self.next_number, self.next_number + 1
        self.disk[number] = one.attempt_id
        self.recorded.append(one.attempt_id)
        del self.traces[one.attempt_id]
        return number

    def _do(self, event: on.Event) -> None:
        """A synchronous shell: durable work is answered at once, everything else when a rule says."""
        for command in self.agent.handle(event):
            match command:
                case on.WriteTrace(of):
                    if self.disk_full:
                        self._do(on.TraceFailed(of.fence, "full"))
                    else:
                        self.traces[of.attempt_id] = of
                        self.fences.append((of.fence, of.socket, of.unit.serial))
                        self._do(on.TraceWritten(of.fence))
                case on.RunLease(of):
                    assert of.socket not in self.running, "two leases on one socket"
                    assert of.attempt_id in self.traces, "a sequence without a trace"
                    self.running[of.socket] = of
                    self.started.append(of.attempt_id)
                case on.SpoolRecord(one):
                    if self.disk_full:
                        self._do(on.SpoolFailed(one.attempt_id, "full"))
                    else:
                        self._do(on.RecordSpooled(one.attempt_id, self._spool(one)))
                case on.Submit(numbers):
                    assert 0 < len(numbers) <= MAX_RECORDS_PER_SUBMISSION
                    assert all(number in self.disk for number in numbers)
                    self.submitted.append(numbers)
                case on.DropRecords(ids):
                    assert set(ids) <= self.acknowledged, "dropped without an acknowledgement"
                    if self.disk_full:
                        self._do(on.DropFailed("full"))
                    else:
                        self.disk = {n: one for n, one in self.disk.items() if one not in ids}
                        self._do(on.RecordsDropped(ids))
                case on.Leave():
                    self.left = True
                case _:
                    pass

    @rule(
        fence=st.integers(1, 30), socket=st.sampled_from("12"), serial=st.sampled_from(["U-1", "U-2", "U-3"])
    )
    def start(self, fence: int, socket: str, serial: str) -> None:
        issued = self.issued.setdefault(fence, lease(fence, socket, serial))  # a fence is given once
        self._do(on.CommandReceived(0, StartSequence(lease=issued)))

    @rule(fence=st.integers(1, 30), socket=st.sampled_from("12"))
    def abort(self, fence: int, socket: str) -> None:
        command = AbortSequence(station="st-1", socket=socket, fence=fence, reason="test")
        self._do(on.CommandReceived(0, command))

    @precondition(lambda self: self.running)
    @rule(data=st.data(), outcome=st.sampled_from(list(Outcome)))
    def sequence_ends(self, data: st.DataObject, outcome: Outcome) -> None:
        of = self.running.pop(data.draw(st.sampled_from(sorted(self.running))))
        self._do(on.SequenceEnded(record(of, outcome)))

    @rule(answered=st.booleans())
    def registration(self, answered: bool) -> None:
        self._do(on.RegistrationAnswered(ACCEPTED if answered else None))

    @rule(revoked=st.lists(st.integers(1, 30), max_size=2), again=st.booleans())
    def renewal(self, revoked: list[int], again: bool) -> None:
        self._do(on.RenewalAnswered(LeasesRenewed(revoked=tuple(revoked), register_again=again)))

    @precondition(lambda self: self.submitted)
    @rule(data=st.data(), answered=st.booleans())
    def submission(self, data: st.DataObject, answered: bool) -> None:
        numbers = self.submitted.pop()
        taken = tuple(self.disk[number] for number in numbers if number in self.disk)
        taken = tuple(data.draw(st.lists(st.sampled_from(taken), unique=True))) if taken else ()
        self.acknowledged |= set(taken)
        self._do(on.SubmissionAnswered(taken if answered else None))

    @rule(timer=st.sampled_from(["register", "renew", "submit", "spool"]))
    def timer(self, timer: str) -> None:
        self._do(on.TimerExpired(timer))

    @rule(full=st.booleans())
    def disk_changes(self, full: bool) -> None:
        self.disk_full = full

    @rule()
    def kill_and_restart(self) -> None:
        self._boot()

    @rule()
    def stop(self) -> None:
        self._do(on.StopRequested("test"))

    @invariant()
    def promises(self) -> None:
        assert len(self.started) == len(set(self.started)), "a lease ran twice"
        assert len(self.recorded) == len(set(self.recorded)), "a lease left two records"
        assert set(self.recorded) | set(self.traces) == set(self.started), "a lease left nothing"
        assert set(self.recorded) - self.acknowledged <= set(self.disk.values()), "a record is lost"
        assert self.agent.unacknowledged == self.disk
        assert {one.attempt_id for one in self.agent.held} == set(self.traces)
        assert not (self.left and self.running), "it left while a sequence was running"


AgentUnderAnything.TestCase.settings = settings(max_examples=100, stateful_step_count=40, deadline=None)
test_the_promises_hold_in_every_order = AgentUnderAnything.TestCase

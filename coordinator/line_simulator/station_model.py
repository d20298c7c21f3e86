"""A station's agent as the coordinator sees it: leases, a spool that survives, and the truth.

It keeps the real agent's promises: a lease is written down before it is accepted; StartSequence is
idempotent by fence, an older fence is refused, one lease per socket; a record is in the spool
before the socket is free; it leaves the spool when its id was acknowledged; after a crash every
interrupted lease gets an ABORTED record.

What it omits: steps, instruments, measurements and the unit's physics. An attempt's outcome is
drawn from the unit's truth and the station's troubles.
"""

# pyright: strict

from collections.abc import Callable
from dataclasses import dataclass, field

from coordinator.line_simulator.world import World
from protocol.attempts import Lease
from protocol.coordinator_events import (
    Event,
    RecordsSubmitted,
    RecordSummary,
    StationRegistered,
    StationRenewed,
)
from protocol.errors import Fault
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from protocol.station_messages import (
    AbortSequence,
    CommandAccepted,
    CommandRefused,
    LeasesRenewed,
    RecordsAcknowledged,
    RegisterStation,
    RenewLeases,
    SocketDescription,
    StartSequence,
    StationAccepted,
    StationCommand,
)

RETRY_S = 0.5
MAX_RECORDS_PER_SUBMISSION = 4
NEVER_S = 1e9

Ask = Callable[[str, Event, Callable[[object], None], Callable[[], None]], None]
Attempted = Callable[[Lease], tuple[float, Outcome, Fault]]
"""How an attempt will go: (seconds it takes, outcome, fault)."""


@dataclass
class StationModel:
    """One bench. From `active` to the line: on its disk; below the line: dies with the process."""

    world: World
    station: str
    sockets: tuple[str, ...]
    operation: str
    attempted: Attempted
    ask: Ask
    made: Callable[[RecordSummary], None]
    renews_until_acknowledged: bool
    refuses: Callable[[], bool] = lambda: False
    renewal_period_s: float = 1.0
    active: dict[str, Lease] = field(default_factory=dict[str, Lease])
    newest_fence: dict[str, int] = field(default_factory=dict[str, int])
    spool: list[RecordSummary] = field(default_factory=list[RecordSummary])
    next_sequence: int = 1
    # ---
    up: bool = False
    epoch: int = 0
    incarnation: int = 0
    registered: bool = False
    submitting: bool = False

    def start(self) -> None:
        """The process starts: interrupted leases get their record, then it registers."""
        self.epoch += 1
        self.up, self.registered, self.submitting = True, False, False
        self.incarnation = int(self.world.now_s * 1e9) + 1
        for socket in tuple(self.active):
            self._record(socket, Outcome.ABORTED, Fault.STATION)
        self._register()
        self._later(self.renewal_period_s, self._renew)

    def crash(self) -> None:
        """SIGKILL."""
        self.up = False
        self.epoch += 1

    def command(self, command: StationCommand, answer: Callable[[object], None]) -> None:
        """A command arrives."""
        if not self.up:
            return
        if isinstance(command, StartSequence):
            answer(self._take(command.lease))
        else:
            answer(self._abort(command))

    def _take(self, lease: Lease) -> CommandAccepted | CommandRefused:
        socket, newest = lease.socket, self.newest_fence.get(lease.socket, 0)
        if lease.fence == newest:
            return CommandAccepted(fence=lease.fence)
        if lease.fence < newest:
            return CommandRefused(fence=lease.fence, reason="stale_fence", text="a newer lease was here")
        if socket in self.active:
            return CommandRefused(fence=lease.fence, reason="socket_busy", text="another lease runs")
        if self.refuses():  # a full spool, say; if the command comes again, it may be taken
            return CommandRefused(fence=lease.fence, reason="stopping", text="the spool is full")
        self.active[socket], self.newest_fence[socket] = lease, lease.fence
        duration_s, outcome, fault = self.attempted(lease)
        self._later(duration_s, lambda: self._end(socket, lease.fence, outcome, fault))
        return CommandAccepted(fence=lease.fence)

    def _abort(self, command: AbortSequence) -> CommandAccepted | CommandRefused:
        self._end(command.socket, command.fence, Outcome.ABORTED, Fault.STATION)
        return CommandAccepted(fence=command.fence)

    def _end(self, socket: str, fence: int, outcome: Outcome, fault: Fault) -> None:
        lease = self.active.get(socket)
        if lease is not None and lease.fence == fence:
            self._record(socket, outcome, fault)
            self._submit()

    def _record(self, socket: str, outcome: Outcome, fault: Fault) -> None:
        lease = self.active.pop(socket)
        summary = RecordSummary(
            sequence_number=self.next_sequence,
            attempt_id=lease.attempt_id,
            fence=lease.fence,
            serial=lease.unit.serial,
            operation=lease.operation,
            station=lease.station,
            socket=socket,
            plan_sha256=lease.plan.sha256,
            outcome=outcome,
            fault=fault,
            safe_state=True,
        )
        self.next_sequence += 1
        self.spool.append(summary)
        self.made(summary)

    # --- what it asks the coordinator ------------------------------------------------------------

    def _register(self) -> None:
        registration = RegisterStation(
            station=self.station,
            incarnation=self.incarnation,
            bench_identity=f"bench-{self.station}",
            sockets=tuple(SocketDescription(socket=s, operations=(self.operation,)) for s in self.sockets),
            plans=(plan_of(self.operation),),
            held=tuple(self.active.values()),
            spool_first=self.spool[0].sequence_number if self.spool else 0,
            spool_last=self.spool[-1].sequence_number if self.spool else 0,
            spool_next=self.next_sequence,
            newest_fence=max(self.newest_fence.values(), default=0),
        )
        event = StationRegistered(at_s=self.world.now_s, registration=registration)
        self._ask(event, self._registration_answered, self._register)

    def _registration_answered(self, reply: object) -> None:
        if isinstance(reply, StationAccepted):
            self.registered = True
            self._revoke(reply.revoked)
            self._submit()
        else:
            self._later(RETRY_S * 4, self._register)

    def _renew(self) -> None:
        self._later(self.renewal_period_s, self._renew)
        if not self.registered:
            return
        fences = [lease.fence for lease in self.active.values()]
        if self.renews_until_acknowledged:
            fences += [summary.fence for summary in self.spool]
        renewal = RenewLeases(station=self.station, incarnation=self.incarnation, fences=tuple(fences))
        self._ask(StationRenewed(at_s=self.world.now_s, renewal=renewal), self._renewed, lambda: None)

    def _renewed(self, reply: object) -> None:
        if isinstance(reply, LeasesRenewed):
            self._revoke(reply.revoked)
            if reply.register_again and self.registered:
                self.registered = False
                self._register()

    def _revoke(self, fences: tuple[int, ...]) -> None:
        for socket, lease in tuple(self.active.items()):
            if lease.fence in fences:
                self._end(socket, lease.fence, Outcome.ABORTED, Fault.STATION)

    def _submit(self) -> None:
        if not self.spool or self.submitting:
            return
        self.submitting = True
        event = RecordsSubmitted(
            at_s=self.world.now_s,
            station=self.station,
            incarnation=self.incarnation,
            records=tuple(self.spool[:MAX_RECORDS_PER_SUBMISSION]),
        )
        self._ask(event, self._submitted, lambda: self._submitted(None))

    def _submitted(self, reply: object) -> None:
        self.submitting = False
        if isinstance(reply, RecordsAcknowledged):
            self.spool = [s for s in self.spool if s.attempt_id not in reply.attempt_ids]
            self._submit()
        else:
            self._later(RETRY_S, self._submit)

    # --- this process's life -----------------------------------------------------------------------

    def _ask(self, event: Event, answered: Callable[[object], None], unanswered: Callable[[], None]) -> None:
        epoch = self.epoch

        def mine(action: Callable[[], None]) -> None:
            if self.epoch == epoch:
                action()

        self.ask(self.station, event, lambda reply: mine(lambda: answered(reply)), lambda: mine(unanswered))

    def _later(self, delay_s: float, action: Callable[[], None]) -> None:
        epoch = self.epoch

        def act() -> None:
            if self.epoch == epoch:
                action()

        if delay_s < NEVER_S:
            self.world.after(delay_s, act)


def plan_of(operation: str) -> PlanReference:
    """The plan that every station of an operation runs."""
    return PlanReference(operation=operation, name=operation, version="1", sha256="0" * 64)

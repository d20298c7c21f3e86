# pyright: strict
"""The station agent as a state machine: `handle(event) -> commands`. No clock, no IO, no threads.

A socket is free, or it holds one lease, which passes these phases:

    TRACING --TraceWritten--> RUNNING --SequenceEnded--> SPOOLING --RecordSpooled--> (free)
       |                         | AbortSequence, revoked, stop
       +--TraceFailed--> (free)  +--> ABORTING --SequenceEnded--> SPOOLING

A command to start is answered once the lease's trace is durable: from then on the lease leaves
exactly one record, whatever dies. A socket stays held, and its lease is renewed, until the record is
in the spool. Fences only grow: a lease that was here before is acknowledged and not run again, an
older one is refused.

The agent never gives a lease up because the coordinator is silent: it finishes, spools, and asks
again with growing pauses until somebody answers. Whether the record still counts is the
coordinator's to say, by the fence.
"""

from collections.abc import Iterable, Mapping

from protocol.attempts import AttemptRecord, Lease
from protocol.station_messages import (
    MAX_RECORDS_PER_SUBMISSION,
    AbortSequence,
    CommandAccepted,
    CommandRefused,
    LeasesRenewed,
    RegisterStation,
    RenewLeases,
    SocketProgress,
    StartSequence,
    StationAccepted,
    StationRefused,
)
from stations.agent import events as on
from stations.agent.fences import FenceMemory
from stations.agent.state import AgentIdentity, HeldLease, Link, Phase, SpoolContent

RETRY_FIRST_S = 0.2
RETRY_MAX_S = 1.0
"""Pauses between unanswered questions double from the first to the largest."""
RENEWALS_UNANSWERED = 3
"""After so many the coordinator may have forgotten this station: it registers again."""
SPOOL_RETRY_S = 1.0
STOP_DEADLINE_S = 6.0
"""Sequences that have not reached their safe state by then are left to the next start's record."""

EXIT_STOPPED = 0
EXIT_REFUSED = 3

REGISTER, RENEW, SUBMIT, SPOOL, STOP = "register", "renew", "submit", "spool", "stop"


class AgentCore:
    """The state of a station agent. Every method but `handle` only looks."""

    def __init__(self, identity: AgentIdentity, content: SpoolContent) -> None:
        self._identity = identity
        self._sockets = {socket.socket for socket in identity.sockets}
        self._plans = {plan.sha256: plan for plan in identity.plans}
        self._held: dict[str, HeldLease] = {}
        self._spooled = dict(content.unacknowledged)
        self._next_number = content.next_number
        self._fences = FenceMemory()
        for fence, socket, serial in content.fences:
            self._fences.remember(fence, socket, serial)
        self._link = Link.REGISTERING
        self._renewal_period_s = RETRY_MAX_S
        self._unanswered = {REGISTER: 0, RENEW: 0, SUBMIT: 0}
        self._submitting = False
        self._submit_timer_set = False
        self._spool_alarm = ""
        self._stopping = ""
        self._exit_code = EXIT_STOPPED
        self._left = False

    @property
    def held(self) -> tuple[Lease, ...]:
        """Leases whose record is not in the spool yet, by fence."""
        return tuple(sorted((held.lease for held in self._held.values()), key=lambda lease: lease.fence))

    @property
    def unacknowledged(self) -> Mapping[int, str]:
        """Sequence number → attempt id of the records that the spool keeps."""
        return self._spooled

    @property
    def unspooled(self) -> tuple[AttemptRecord, ...]:
        """Records that the spool could not take yet: they are here and nowhere else."""
        return tuple(held.record for held in self._held.values() if held.record is not None)

    def handle(self, event: on.Event) -> list[on.Command]:
        """What the shell has to do now, in this order."""
        match event:
            case on.AgentStarted():
                return self._register()
            case on.CommandReceived(query, command):
                if isinstance(command, StartSequence):
                    return self._start(query, command.lease)
                return self._abort_commanded(query, command)
            case on.TraceWritten() | on.TraceFailed() | on.SequenceEnded():
                return self._sequence_event(event)
            case on.RecordSpooled() | on.SpoolFailed():
                return self._spool_event(event)
            case on.RegistrationAnswered(reply):
                return self._registration_answered(reply)
            case on.RenewalAnswered(reply):
                return self._renewal_answered(reply)
            case on.SubmissionAnswered() | on.RecordsDropped() | on.DropFailed():
                return self._submission_event(event)
            case on.TimerExpired(timer):
                return self._timer_expired(timer)
            case on.StopRequested(why):
                return self._stop(why, EXIT_STOPPED)

    # Commands of the coordinator

    def _start(self, query: int, lease: Lease) -> list[on.Command]:
        held = self._held.get(lease.socket)
        if held is not None and held.lease == lease:
            if held.phase is Phase.TRACING:
                held.queries.append(query)
                return []
            return [_accepted(query, lease.fence)]
        if self._fences.was_here(lease):  # its record is spooled, acknowledged or on its way
            return [_accepted(query, lease.fence)]
        refusal = self._refusal(lease, held)
        if refusal is not None:
            return [on.Reply(query, refusal)]
        self._held[lease.socket] = HeldLease(lease, Phase.TRACING, [query])
        return [on.WriteTrace(lease)]

    def _refusal(self, lease: Lease, held: HeldLease | None) -> CommandRefused | None:
        def refused(reason: str, text: str) -> CommandRefused:
            return CommandRefused.model_validate({"fence": lease.fence, "reason": reason, "text": text})

        if lease.station != self._identity.station or lease.socket not in self._sockets:
            return refused("unknown_socket", f"there is no socket {lease.station}/{lease.socket} here")
        stale_before = self._fences.stale_before(lease)
        if lease.fence <= stale_before:
            return refused("stale_fence", f"fence {lease.fence} is stale: {stale_before} was here before")
        if self._stopping or self._link is Link.REFUSED:
            return refused("stopping", f"the station is stopping: {self._stopping}")
        if self._spool_alarm:
            return refused("stopping", f"the station cannot keep results: {self._spool_alarm}")
        if held is not None:
            text = f"socket {lease.socket} works on lease {held.lease.fence} ({held.lease.unit.serial})"
            return refused("socket_busy", text)
        elsewhere = next((h for h in self._held.values() if h.lease.unit == lease.unit), None)
        if elsewhere is not None:
            return refused("socket_busy", f"the unit is still on socket {elsewhere.lease.socket}")
        if self._plans.get(lease.plan.sha256) != lease.plan:
            return refused(
                "unknown_plan",
                f"plan {lease.plan.name} {lease.plan.version} ({lease.plan.sha256[:12]}) is not loaded here",
            )
        return None

    def _abort_commanded(self, query: int, command: AbortSequence) -> list[on.Command]:
        held = self._held.get(command.socket)
        if held is not None and held.lease.fence == command.fence:
            return [_accepted(query, command.fence), *self._abort(held, command.reason)]
        if self._fences.newest_on_socket(command.socket) >= command.fence:
            return [_accepted(query, command.fence)]  # over: its record says how it ended
        text = f"no sequence with fence {command.fence} has been started on socket {command.socket}"
        return [on.Reply(query, CommandRefused(fence=command.fence, reason="stale_fence", text=text))]

    def _abort(self, held: HeldLease, why: str) -> list[on.Command]:
        if held.phase is Phase.TRACING:
            held.abort_why = held.abort_why or why
            return []
        if held.phase is not Phase.RUNNING:
            return []
        held.phase = Phase.ABORTING
        return [on.AbortSocket(held.lease.socket, held.lease.fence, why)]

    # The life of a lease

    def _sequence_event(self, event: on.TraceWritten | on.TraceFailed | on.SequenceEnded) -> list[on.Command]:
        fence = event.record.lease.fence if isinstance(event, on.SequenceEnded) else event.fence
        held = self._held_by_fence(fence)
        if held is None:
            return []
        lease = held.lease
        if isinstance(event, on.SequenceEnded):
            held.phase, held.record = Phase.SPOOLING, event.record
            return [on.SpoolRecord(event.record)]
        waiting, held.queries = held.queries, []
        if isinstance(event, on.TraceFailed):
            del self._held[lease.socket]
            refusal = CommandRefused(
                fence=fence, reason="stopping", text=f"the station cannot keep results: {event.why}"
            )
            return [*(on.Reply(query, refusal) for query in waiting), *self._spool_is_full(event.why)]
        self._fences.remember(fence, lease.socket, lease.unit.serial)
        held.phase = Phase.RUNNING
        commands: list[on.Command] = [on.RunLease(lease), *(_accepted(query, fence) for query in waiting)]
        if held.abort_why:
            commands += self._abort(held, held.abort_why)
        return commands

    def _spool_event(self, event: on.RecordSpooled | on.SpoolFailed) -> list[on.Command]:
        held = next((h for h in self._held.values() if h.lease.attempt_id == event.attempt_id), None)
        if held is None:
            return []
        if isinstance(event, on.SpoolFailed):
            return self._spool_is_full(event.why)
        del self._held[held.lease.socket]
        self._spool_alarm = ""
        self._spooled[event.sequence_number] = event.attempt_id
        self._next_number = max(self._next_number, event.sequence_number + 1)
        idle = SocketProgress(station=self._identity.station, socket=held.lease.socket)
        commands: list[on.Command] = [on.Publish(idle), *self._submit()]
        return commands + self._leave_if_done()

    def _spool_is_full(self, why: str) -> list[on.Command]:
        commands: list[on.Command] = [on.SetTimer(SPOOL, SPOOL_RETRY_S)]
        if not self._spool_alarm:
            commands.append(on.RaiseAlarm("spool_unwritable", why))
        self._spool_alarm = why
        return commands

    # The coordinator

    def _register(self) -> list[on.Command]:
        self._link = Link.REGISTERING
        request = RegisterStation(
            station=self._identity.station,
            incarnation=self._identity.incarnation,
            bench_identity=self._identity.bench_identity,
            sockets=self._identity.sockets,
            plans=self._identity.plans,
            held=self.held,
            spool_first=min(self._spooled, default=0),
            spool_last=max(self._spooled, default=0),
            spool_next=self._next_number,
            newest_fence=self._fences.newest,
        )
        return [on.Register(request)]

    def _registration_answered(self, reply: object) -> list[on.Command]:
        match reply:
            case StationAccepted():
                self._unanswered[REGISTER] = self._unanswered[RENEW] = 0
                self._link = Link.REGISTERED
                self._renewal_period_s = reply.renewal_period_s
                timer = on.SetTimer(RENEW, self._renewal_period_s)
                return [timer, *self._revoke(reply.revoked), *self._submit()]
            case StationRefused():
                self._link = Link.REFUSED
                alarm = on.RaiseAlarm("station_refused", reply.reason)
                return [alarm, *self._stop(reply.reason, EXIT_REFUSED)]
            case _:
                return [on.SetTimer(REGISTER, self._pause_s(REGISTER))]

    def _renewal_answered(self, reply: object) -> list[on.Command]:
        match reply:
            case LeasesRenewed():
                self._unanswered[RENEW] = 0
                revocations = self._revoke(reply.revoked)
                if reply.register_again:
                    return [*revocations, *self._register()]
                return [*revocations, on.SetTimer(RENEW, self._renewal_period_s), *self._submit()]
            case StationRefused():
                return self._registration_answered(reply)
            case _:
                pause_s = min(self._pause_s(RENEW), self._renewal_period_s)
                if self._unanswered[RENEW] < RENEWALS_UNANSWERED:
                    return [on.SetTimer(RENEW, pause_s)]
                self._link = Link.REGISTERING
                return [on.SetTimer(REGISTER, pause_s)]

    def _revoke(self, fences: Iterable[int]) -> list[on.Command]:
        commands: list[on.Command] = []
        for fence in fences:
            held = self._held_by_fence(fence)
            if held is not None:
                commands += self._abort(held, "the coordinator has revoked the lease")
        return commands

    def _submit(self) -> list[on.Command]:
        """The oldest records, one batch outstanding, and only while somebody is there to take them."""
        waiting = self._submitting or self._submit_timer_set
        if waiting or not self._spooled or self._link is not Link.REGISTERED:
            return []
        self._submitting = True
        return [on.Submit(tuple(sorted(self._spooled)[:MAX_RECORDS_PER_SUBMISSION]))]

    def _submission_event(
        self, event: on.SubmissionAnswered | on.RecordsDropped | on.DropFailed
    ) -> list[on.Command]:
        if isinstance(event, on.SubmissionAnswered):
            known = set(self._spooled.values())
            acknowledged = tuple(one for one in event.acknowledged or () if one in known)
            if acknowledged:
                return [on.DropRecords(acknowledged)]
        self._submitting = False
        if isinstance(event, on.RecordsDropped):
            self._unanswered[SUBMIT] = 0
            gone = set(event.attempt_ids)
            self._spooled = {n: one for n, one in self._spooled.items() if one not in gone}
            return self._submit()
        self._submit_timer_set = True
        return [on.SetTimer(SUBMIT, self._pause_s(SUBMIT))]

    # Time and the end

    def _timer_expired(self, timer: str) -> list[on.Command]:
        if timer == STOP:
            return self._leave("sequences were still running at the deadline")
        if timer == SPOOL:
            if not self._spool_alarm:
                return []
            records = self.unspooled
            if not records:
                self._spool_alarm = ""  # the next lease's trace will show whether there is room again
            return [on.SpoolRecord(record) for record in records]
        if timer == SUBMIT:
            self._submit_timer_set = False
            return self._submit()
        if self._link is Link.REFUSED:
            return []
        if timer == REGISTER:
            return self._register()
        fences = tuple(lease.fence for lease in self.held)
        return [
            on.Renew(
                RenewLeases(
                    station=self._identity.station, incarnation=self._identity.incarnation, fences=fences
                )
            )
        ]

    def _stop(self, why: str, exit_code: int) -> list[on.Command]:
        self._exit_code = max(self._exit_code, exit_code)
        if self._stopping:
            return []
        self._stopping = why
        commands: list[on.Command] = [on.SetTimer(STOP, STOP_DEADLINE_S)]
        for held in self._held.values():
            commands += self._abort(held, f"the station is stopping: {why}")
        return commands + self._leave_if_done()

    def _leave_if_done(self) -> list[on.Command]:
        return self._leave(self._stopping) if self._stopping and not self._held else []

    def _leave(self, why: str) -> list[on.Command]:
        if self._left:
            return []
        self._left = True
        return [on.Leave(self._exit_code, why)]

    def _pause_s(self, question: str) -> float:
        self._unanswered[question] += 1
        return min(RETRY_FIRST_S * 2 ** min(self._unanswered[question] - 1, 16), RETRY_MAX_S)

    def _held_by_fence(self, fence: int) -> HeldLease | None:
        return next((held for held in self._held.values() if held.lease.fence == fence), None)


def _accepted(query: int, fence: int) -> on.Command:
    return on.Reply(query, CommandAccepted(fence=fence))

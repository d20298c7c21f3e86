"""The coordinator's core: events in, commands out.

    core = CoordinatorCore()
    for fact in journal: core.replay(fact)
    commands = core.handle(CoordinatorStarted(...))
    commands = core.handle(event)          # for every event from then on

An event is first *decided*: what of it is news, and what facts follow. Each fact is then *applied*
(facts.py) and returned as a `Journal` command; then the policy is asked until nothing matches, and
each of its choices is a fact too. So the journal holds only what moved the line, replay needs no
policy, and an event that says nothing new (a duplicate, a stale answer, a renewal) leaves no trace.
"""

# pyright: strict

from collections.abc import Callable
from typing import Any

from coordinator.core import facts, orders
from coordinator.core.floor import Floor
from coordinator.core.line_state import Line
from protocol.coordinator_commands import Answer, Command, Journal, SetTimer
from protocol.coordinator_events import (
    CommandUndelivered,
    CoordinatorStarted,
    Event,
    Fact,
    LeaseGranted,
    LeaseLapsed,
    LeaseOverran,
    LineSettings,
    RecordsSubmitted,
    SequenceAccepted,
    SequenceRefused,
    StationRegistered,
    StationRenewed,
    StationTokenVanished,
    Timer,
    TimerExpired,
    UnitsOrdered,
)
from protocol.station_messages import (
    LeasesRenewed,
    RecordsAcknowledged,
    RegisterStation,
    StationAccepted,
    StationRefused,
)


class CoordinatorCore:
    """The state machine of one line. Not thread-safe: one thread owns it."""

    def __init__(self) -> None:
        self.floor = Floor(Line(LineSettings()))
        self._decide: dict[type, Callable[[Any], None]] = {
            CoordinatorStarted: self.conclude,
            UnitsOrdered: self._units_ordered,
            StationRegistered: self._station_registered,
            StationRenewed: self._station_renewed,
            RecordsSubmitted: self._records_submitted,
            SequenceAccepted: self._answer_to_offer,
            SequenceRefused: self._answer_to_offer,
            CommandUndelivered: self._command_undelivered,
            StationTokenVanished: self._station_token_vanished,
            TimerExpired: self._timer_expired,
        }
        self._on_timer: dict[Timer, Callable[[Any, float], None]] = {
            "lease": self._lease_due,
            "silence": self._silence_due,
            "recheck": self._recheck_due,
            "resend": self._resend_due,
            "rest": self._rest_due,
            "patience": self._patience_due,
            "queue": self._queue_due,
        }

    @property
    def line(self) -> Line:
        """The line's state, to be read only."""
        return self.floor.line

    def replay(self, fact: Fact) -> None:
        """Apply a fact from the journal; nothing is asked of the shell."""
        facts.apply(self.floor, fact)
        self.floor.outbox.clear()

    def handle(self, event: Event) -> tuple[Command, ...]:
        """Take in an event; what the shell has to do about it, in order.

        Raises:
            InvalidTransition: a defect; the core must be thrown away and replayed.
        """
        self.floor.outbox.clear()
        self._decide[type(event)](event)
        self._dispatch(event.at_s)
        return tuple(self.floor.outbox)

    def conclude(self, fact: Fact) -> None:
        """Journal a fact and apply it."""
        self.floor.outbox.append(Journal(fact))
        facts.apply(self.floor, fact)

    def _dispatch(self, at_s: float) -> None:
        floor = self.floor
        while (proposal := floor.dispatcher.next_proposal(floor.line, at_s)) is not None:
            socket = floor.line.sockets[proposal.socket_key]
            self.conclude(
                LeaseGranted(
                    at_s=at_s,
                    fence=floor.line.last_fence + 1,
                    serial=proposal.entry[2],
                    operation=proposal.operation,
                    station=socket.station,
                    socket=socket.socket,
                    plan=socket.plans[proposal.operation],
                )
            )

    # --- requests ----------------------------------------------------------------------------

    def _units_ordered(self, event: UnitsOrdered) -> None:
        reply, is_news = orders.decide(self.line, event.order)
        if is_news:
            self.conclude(event)
        self.floor.outbox.append(Answer(reply))

    def _station_registered(self, event: StationRegistered) -> None:
        registration, floor = event.registration, self.floor
        refusal = self._refusal(registration, event.at_s)
        if refusal:
            floor.outbox.append(Answer(StationRefused(reason=refusal)))
            return
        first_contact = registration.station not in floor.presence.heard_at_s
        self.conclude(event)
        if first_contact:
            floor.set_silence_timer(registration.station, event.at_s)
        floor.heard(registration.station, event.at_s)
        settings = floor.settings
        floor.outbox.append(
            Answer(
                StationAccepted(
                    lease_duration_s=settings.lease_duration_s,
                    renewal_period_s=settings.renewal_period_s,
                    revoked=self._not_held_by(
                        registration.station, tuple(lease.fence for lease in registration.held)
                    ),
                )
            )
        )

    def _refusal(self, registration: RegisterStation, at_s: float) -> str:
        known = self.line.stations.get(registration.station)
        if known is None:
            return ""
        if known.bench_identity != registration.bench_identity:
            self.floor.alarm(
                at_s,
                "station_id_twice",
                registration.station,
                "Bench {other} calls itself {station}, which is bench {known}: it is refused.",
                other=registration.bench_identity,
                station=registration.station,
                known=known.bench_identity,
            )
            return (
                f"The station id {registration.station} belongs to bench {known.bench_identity}: "
                f"give bench {registration.bench_identity} an id of its own."
            )
        if registration.incarnation < known.incarnation:
            return f"A newer agent of station {registration.station} has taken over: stop this one."
        return ""

    def _not_held_by(self, station: str, fences: tuple[int, ...]) -> tuple[int, ...]:
        leases = self.line.leases
        return tuple(f for f in fences if (lease := leases.get(f)) is None or lease.station != station)

    def _station_renewed(self, event: StationRenewed) -> None:
        renewal, floor, at_s = event.renewal, self.floor, event.at_s
        station = self.line.stations.get(renewal.station)
        if station is None or renewal.incarnation > station.incarnation:
            floor.outbox.append(Answer(LeasesRenewed(register_again=True)))
            return
        if renewal.incarnation < station.incarnation:
            floor.outbox.append(Answer(LeasesRenewed(revoked=renewal.fences, register_again=True)))
            return
        floor.heard(renewal.station, at_s)
        revoked = self._not_held_by(renewal.station, renewal.fences)
        for fence in renewal.fences:
            if fence in revoked:
                continue
            floor.presence.renewed_until_s[fence] = at_s + floor.settings.lease_duration_s
            if self.line.leases[fence].state == "OFFERED":  # its answer to StartSequence was lost
                self.conclude(SequenceAccepted(at_s=at_s, fence=fence))
        if floor.presence.lingering:
            for socket in station.sockets.values():
                fence = floor.presence.lingering.get(socket.key)
                if fence is not None and fence not in renewal.fences:
                    del floor.presence.lingering[socket.key]
                    floor.refresh(socket)
        floor.outbox.append(Answer(LeasesRenewed(revoked=revoked)))

    def _records_submitted(self, event: RecordsSubmitted) -> None:
        floor, recorded = self.floor, self.line.recorded
        station = self.line.stations.get(event.station)
        if station is not None and station.incarnation == event.incarnation:
            floor.heard(event.station, event.at_s)
        news = {
            key: summary for summary in event.records if (key := facts.record_key(summary)) not in recorded
        }
        if len(news) == len(event.records):
            self.conclude(event)
        else:
            floor.presence.duplicates_ignored += len(event.records) - len(news)
            if news:
                self.conclude(event.model_copy(update={"records": tuple(news.values())}))
        attempt_ids = tuple(summary.attempt_id for summary in event.records)
        floor.outbox.append(Answer(RecordsAcknowledged(attempt_ids=attempt_ids)))

    # --- answers of stations to commands -------------------------------------------------------

    def _answer_to_offer(self, event: SequenceAccepted | SequenceRefused) -> None:
        lease = self.line.leases.get(event.fence)
        if lease is not None and lease.state == "OFFERED":
            self.conclude(event)

    def _command_undelivered(self, event: CommandUndelivered) -> None:
        lease = self.line.leases.get(event.fence)
        if lease is not None and lease.state != "RUNNING":
            at_s = event.at_s + self.floor.settings.resend_period_s
            self.floor.outbox.append(SetTimer("resend", event.fence, at_s))

    def _station_token_vanished(self, event: StationTokenVanished) -> None:
        station = self.line.stations.get(event.station)
        if station is not None and station.incarnation == event.incarnation:
            self.floor.presence.token_lost_at_s[event.station] = event.at_s
            at_s = event.at_s + self.floor.settings.recheck_after_s
            self.floor.outbox.append(SetTimer("recheck", event.station, at_s))

    # --- timers --------------------------------------------------------------------------------

    def _timer_expired(self, event: TimerExpired) -> None:
        self._on_timer[event.timer](event.subject, event.at_s)

    def _lease_due(self, fence: int, at_s: float) -> None:
        lease = self.line.leases.get(fence)
        if lease is None:
            return
        if at_s >= self.floor.presence.renewed_until_s[fence]:
            self.conclude(LeaseLapsed(at_s=at_s, fence=fence))
        elif at_s < lease.deadline_s:
            self.floor.watch_lease(lease)
        elif lease.state == "ABORTING":
            self.conclude(LeaseLapsed(at_s=at_s, fence=fence))
        else:
            self.conclude(LeaseOverran(at_s=at_s, fence=fence))

    def _silence_due(self, station: str, at_s: float) -> None:
        presence = self.floor.presence
        if station in presence.silent:
            return
        if at_s >= presence.heard_at_s[station] + self.floor.settings.lease_duration_s:
            self.floor.fall_silent(station, at_s)
        else:
            self.floor.set_silence_timer(station, presence.heard_at_s[station])

    def _recheck_due(self, station: str, at_s: float) -> None:
        presence = self.floor.presence
        lost_at_s = presence.token_lost_at_s.get(station)
        if lost_at_s is not None and station not in presence.silent:
            if presence.heard_at_s[station] <= lost_at_s:
                self.floor.fall_silent(station, at_s)
            else:
                del presence.token_lost_at_s[station]

    def _resend_due(self, fence: int, _at_s: float) -> None:
        lease = self.line.leases.get(fence)
        if lease is not None and lease.state == "OFFERED":
            self.floor.start(lease)
        elif lease is not None and lease.state == "ABORTING":
            self.floor.abort(lease)

    def _rest_due(self, socket_key: str, at_s: float) -> None:
        until_s = self.floor.presence.resting_until_s.get(socket_key)
        if until_s is not None and at_s >= until_s:
            del self.floor.presence.resting_until_s[socket_key]
            self.floor.refresh(self.line.sockets[socket_key])

    def _patience_due(self, serial: str, _at_s: float) -> None:
        unit = self.line.units[serial]
        if unit.state == "WAITING":
            self.floor.dispatcher.touch(unit.operation.name)

    def _queue_due(self, operation: str, at_s: float) -> None:
        floor = self.floor
        queue = floor.dispatcher.queue(operation)
        head = queue.head()
        if head is None:
            floor.queue_timers.discard(operation)
            return
        if (
            not queue.in_service
            and at_s - self.line.units[head[2]].queued_at_s >= floor.settings.queue_alarm_s
        ):
            floor.alarm(
                at_s,
                "no_socket",
                operation,
                "{count} units wait for {operation} and no socket in service can run it.",
                count=str(len(queue.waiting)),
                operation=operation,
            )
        floor.outbox.append(SetTimer("queue", operation, at_s + floor.settings.queue_alarm_s))

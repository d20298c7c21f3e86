"""The line with its presence, its queues and the commands of the event at hand, kept in step."""

# pyright: strict

from dataclasses import dataclass, field

from coordinator.core.dispatch import Dispatcher
from coordinator.core.line_state import HeldLease, Line, Socket, Unit
from coordinator.core.presence import Presence
from protocol.attempts import Lease, UnitIdentity
from protocol.coordinator_commands import Command, KeepUnit, RaiseAlarm, SetTimer
from protocol.coordinator_events import LineSettings
from protocol.station_messages import AbortSequence, StartSequence


@dataclass(slots=True)
class Floor:
    """What the core works on. `outbox`: the commands of the event at hand; replay drops them."""

    line: Line
    presence: Presence = field(default_factory=Presence)
    dispatcher: Dispatcher = field(default_factory=Dispatcher)
    outbox: list[Command] = field(default_factory=list[Command])
    queue_timers: set[str] = field(default_factory=set[str])

    @property
    def settings(self) -> LineSettings:
        """The line's named times."""
        return self.line.settings

    def refresh(self, socket: Socket) -> None:
        """Bring the pools in step with a socket that changed."""
        in_service, free = self.availability(socket)
        self.dispatcher.place(socket, in_service, free)

    def availability(self, socket: Socket) -> tuple[bool, bool]:
        """(in service, free for a unit)."""
        presence = self.presence
        in_service = socket.station not in presence.silent and socket.key not in presence.resting_until_s
        return in_service, in_service and not socket.fence and socket.key not in presence.lingering

    def wait(self, unit: Unit, at_s: float) -> None:
        """Queue a unit for its operation, with the deadlines of waiting."""
        unit.queued_at_s = at_s
        self.dispatcher.join(unit, self.settings.retest_credit_s)
        if unit.failed_sockets:
            self.outbox.append(SetTimer("patience", unit.serial, at_s + self.settings.retest_patience_s))
        operation = unit.operation.name
        if operation not in self.queue_timers:
            self.queue_timers.add(operation)
            self.outbox.append(SetTimer("queue", operation, at_s + self.settings.queue_alarm_s))

    def rest(self, socket: Socket, at_s: float, tolerated: int) -> None:
        """A socket made trouble: it rests when that was not the first time in a row."""
        rest_s = self.presence.rest_of(socket.key, self.settings, tolerated)
        if rest_s > 0:
            self.presence.resting_until_s[socket.key] = at_s + rest_s
            self.outbox.append(SetTimer("rest", socket.key, at_s + rest_s))

    def heard(self, station: str, at_s: float) -> None:
        """A station showed that it is there: if it was silent, it gets work again."""
        presence = self.presence
        presence.heard_at_s[station] = at_s
        if station in presence.silent:
            presence.silent.discard(station)
            self.set_silence_timer(station, at_s)
            self._refresh_station(station)

    def fall_silent(self, station: str, at_s: float) -> None:
        """A station is not heard of: it gets no more work. Its leases live until they lapse."""
        self.presence.silent.add(station)
        self._refresh_station(station)
        self.alarm(
            at_s, "station_silent", station, "Station {station} is not heard of any more.", station=station
        )

    def set_silence_timer(self, station: str, heard_at_s: float) -> None:
        """Look at a station again when it should have been heard of."""
        self.outbox.append(SetTimer("silence", station, heard_at_s + self.settings.lease_duration_s))

    def rearm_waiting(self, at_s: float) -> None:
        """Set the deadlines of waiting again, after a restart."""
        for operation, queue in self.dispatcher.queues.items():
            if queue.waiting:
                self.queue_timers.add(operation)
                self.outbox.append(SetTimer("queue", operation, at_s + self.settings.queue_alarm_s))
            for _, _, serial in queue.retests:
                self.outbox.append(SetTimer("patience", serial, at_s + self.settings.retest_patience_s))

    def _refresh_station(self, station: str) -> None:
        for socket in self.line.stations[station].sockets.values():
            self.refresh(socket)

    def watch_lease(self, lease: HeldLease) -> None:
        """Look at a lease again when the first of its two deadlines is there."""
        at_s = min(self.presence.renewed_until_s[lease.fence], lease.deadline_s)
        self.outbox.append(SetTimer("lease", lease.fence, at_s))

    def start(self, lease: HeldLease) -> None:
        """Offer a lease to its station."""
        self.outbox.append(
            StartSequence(
                lease=Lease(
                    fence=lease.fence,
                    attempt_id=lease.attempt_id,
                    unit=self.identity(self.line.units[lease.serial]),
                    operation=lease.operation,
                    station=lease.station,
                    socket=lease.socket,
                    plan=lease.plan,
                )
            )
        )

    @staticmethod
    def identity(unit: Unit) -> UnitIdentity:
        """The unit as the wire names it."""
        return UnitIdentity(serial=unit.serial, product=unit.product, lot=unit.lot)

    def abort(self, lease: HeldLease) -> None:
        """Ask a station to stop a lease that ran over its operation's deadline."""
        self.outbox.append(
            AbortSequence(
                station=lease.station,
                socket=lease.socket,
                fence=lease.fence,
                reason=f"the deadline of operation {lease.operation} has passed",
            )
        )

    def keep_unit(self, unit: Unit, at_s: float) -> None:
        """Store where a unit is now."""
        finished = unit.state == "FINISHED"
        self.outbox.append(
            KeepUnit(
                serial=unit.serial,
                product=unit.product,
                lot=unit.lot,
                route=unit.route.name,
                disposition=unit.disposition,
                operation=None if finished else unit.operation.name,
                at_s=at_s,
            )
        )

    def alarm(self, at_s: float, alarm: str, subject: str, template: str, **values: str) -> None:
        """Raise an alarm, unless it was raised a moment ago."""
        raised = self.presence.new_alarm(at_s, alarm, subject, template, values, self.settings.alarm_repeat_s)
        if raised is not None:
            self.outbox.append(RaiseAlarm(raised))

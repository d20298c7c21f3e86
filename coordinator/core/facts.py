"""What each fact does to the line: used live and in replay alike.

The line's state follows from facts alone. Presence and queues are kept in step on the way and are
never asked for a decision here; commands go to the floor's outbox, which replay drops.
"""

# pyright: strict

from collections.abc import Callable
from typing import Any

from coordinator.core.floor import Floor
from coordinator.core.line_state import Attempt, HeldLease, OrderReceipt, Socket, Unit, socket_key
from coordinator.core.registrations import check_gap, station_registered
from coordinator.core.transitions import LeaseTrigger, UnitTrigger
from coordinator.core.yield_statistics import judge
from protocol.coordinator_commands import KeepRecord
from protocol.coordinator_events import (
    CoordinatorStarted,
    Fact,
    LeaseGranted,
    LeaseLapsed,
    LeaseOverran,
    RecordsSubmitted,
    RecordSummary,
    SequenceAccepted,
    SequenceRefused,
    StationRegistered,
    UnitsOrdered,
)
from protocol.errors import Fault
from protocol.outcomes import Disposition, Outcome

MEAN_CYCLE_WEIGHT = 0.1
"""Weight of the newest attempt in the running mean of an operation's cycle time."""

DISTURBANCES_TOLERATED = 1
"""Disturbed attempts in a row at one socket before it rests."""


def apply(floor: Floor, fact: Fact) -> None:
    """Move the line by one fact.

    Raises:
        InvalidTransition: the fact does not fit the state: a defect, or a journal of another line.
    """
    _APPLY[type(fact)](floor, fact)


def _coordinator_started(floor: Floor, fact: CoordinatorStarted) -> None:
    line, presence, at_s = floor.line, floor.presence, fact.at_s
    line.settings = fact.settings
    presence.forget()
    floor.queue_timers.clear()
    for station in line.stations.values():
        floor.presence.heard_at_s[station.station] = at_s
        floor.set_silence_timer(station.station, at_s)
        for socket in station.sockets.values():
            floor.refresh(socket)
    for lease in line.leases.values():
        presence.renewed_until_s[lease.fence] = at_s + fact.settings.lease_duration_s
        floor.watch_lease(lease)
        if lease.state == "OFFERED":
            floor.start(lease)
        elif lease.state == "ABORTING":
            floor.abort(lease)
    floor.rearm_waiting(at_s)
    floor.dispatcher.touch_all()


def _units_ordered(floor: Floor, fact: UnitsOrdered) -> None:
    line, order, at_s = floor.line, fact.order, fact.at_s
    line.routes.setdefault(order.route.name, order.route)
    known: list[str] = []
    for identity in order.units:
        if identity.serial in line.units:
            known.append(identity.serial)
            continue
        unit = line.units[identity.serial] = Unit(
            serial=identity.serial,
            product=identity.product,
            lot=identity.lot,
            route=order.route,
            arrival=len(line.units) + 1,
            ready_since_s=at_s,
            queued_at_s=at_s,
        )
        line.unfinished += 1
        floor.wait(unit, at_s)
        floor.keep_unit(unit, at_s)
    line.orders[order.order_id] = OrderReceipt(len(order.units) - len(known), tuple(known))


def _lease_granted(floor: Floor, fact: LeaseGranted) -> None:
    line, at_s, fence = floor.line, fact.at_s, fact.fence
    unit = line.units[fact.serial]
    socket = line.sockets[socket_key(fact.station, fact.socket)]
    floor.dispatcher.leave(unit)
    unit.state = line.story.unit_step(unit.serial, unit.state, "granted", at_s)
    unit.fence = socket.fence = line.last_fence = fence
    unit.leases_here += 1
    lease = line.leases[fence] = HeldLease(
        fence=fence,
        attempt_id=f"{unit.serial}.{fact.operation}.{unit.leases_here}",
        serial=unit.serial,
        operation=fact.operation,
        station=fact.station,
        socket=fact.socket,
        socket_key=socket.key,
        plan=fact.plan,
        granted_at_s=at_s,
        deadline_s=at_s + unit.operation.deadline_s,
    )
    floor.presence.renewed_until_s[fence] = at_s + line.settings.lease_duration_s
    floor.refresh(socket)
    floor.start(lease)
    floor.watch_lease(lease)


def _sequence_accepted(floor: Floor, fact: SequenceAccepted) -> None:
    lease = floor.line.leases[fact.fence]
    lease.state = floor.line.story.lease_step(fact.fence, lease.state, "accepted", fact.at_s)


def _sequence_refused(floor: Floor, fact: SequenceRefused) -> None:
    line, at_s = floor.line, fact.at_s
    lease = line.leases[fact.fence]
    unit, socket = _end_lease(floor, lease, "refused", at_s)
    floor.rest(socket, at_s, tolerated=0)
    unit.state = line.story.unit_step(unit.serial, unit.state, "withdrawn", at_s)
    floor.wait(unit, at_s)
    floor.refresh(socket)
    if fact.reason != "stopping":
        floor.alarm(
            at_s,
            "sequence_refused",
            socket.key,
            "Station {station} refused {serial} at socket {socket}: {text} ({reason})",
            station=lease.station,
            serial=lease.serial,
            socket=lease.socket,
            text=fact.text,
            reason=fact.reason,
        )


def _lease_overran(floor: Floor, fact: LeaseOverran) -> None:
    line, at_s = floor.line, fact.at_s
    lease = line.leases[fact.fence]
    lease.state = line.story.lease_step(fact.fence, lease.state, "overran", at_s)
    lease.deadline_s = at_s + line.settings.abort_patience_s
    floor.abort(lease)
    floor.watch_lease(lease)
    floor.alarm(
        at_s,
        "deadline_passed",
        lease.socket_key,
        "{serial} at {socket} passed the deadline of {operation} and is aborted.",
        serial=lease.serial,
        socket=lease.socket_key,
        operation=lease.operation,
    )


def _lease_lapsed(floor: Floor, fact: LeaseLapsed) -> None:
    line, at_s = floor.line, fact.at_s
    lease = line.leases[fact.fence]
    unit, socket = _end_lease(floor, lease, "lapsed", at_s)
    line.lapses += 1
    floor.presence.lingering[socket.key] = lease.fence
    _judge_unit(floor, unit, lease, None, Fault.STATION, at_s)
    floor.refresh(socket)
    floor.alarm(
        at_s,
        "lease_lapsed",
        lease.station,
        "Station {station} did not renew its lease of {serial}: the unit is queued again.",
        station=lease.station,
        serial=lease.serial,
    )


def _records_submitted(floor: Floor, fact: RecordsSubmitted) -> None:
    station = floor.line.stations.get(fact.station)
    for summary in fact.records:
        if station is not None and summary.sequence_number:
            check_gap(floor, station, summary.sequence_number, fact.at_s)
            station.highest_sequence = max(station.highest_sequence or 0, summary.sequence_number)
        _record(floor, summary, fact.at_s)


def _record(floor: Floor, summary: RecordSummary, at_s: float) -> None:
    line, fence = floor.line, summary.fence
    line.recorded.add(record_key(summary))
    lease = line.leases.get(fence)
    set_aside = lease is None or not _belongs(summary, lease)
    floor.outbox.append(KeepRecord(summary.attempt_id, fence, set_aside, at_s))
    if lease is None or set_aside:
        _set_aside(floor, summary, at_s)
    else:
        line.attempts_recorded += 1
        unit, socket = _end_lease(floor, lease, "recorded", at_s)
        judgement = judge(summary.outcome, summary.fault)
        if judgement == "disturbed":
            floor.rest(socket, at_s, DISTURBANCES_TOLERATED)
        else:
            floor.presence.trouble.pop(socket.key, None)
        if summary.outcome is Outcome.PASS:
            mean_s = line.mean_cycle_s.get(lease.operation, at_s - lease.granted_at_s)
            mean_s += MEAN_CYCLE_WEIGHT * (at_s - lease.granted_at_s - mean_s)
            line.mean_cycle_s[lease.operation] = mean_s
        _judge_unit(floor, unit, lease, summary.outcome, summary.fault, at_s)
        floor.refresh(socket)
    if not summary.safe_state:
        floor.alarm(
            at_s,
            "unit_not_safe",
            socket_key(summary.station, summary.socket),
            "{serial} at {socket} was not left powered off: look before you touch it.",
            serial=summary.serial,
            socket=socket_key(summary.station, summary.socket),
        )


def _set_aside(floor: Floor, summary: RecordSummary, at_s: float) -> None:
    line, presence = floor.line, floor.presence
    line.records_set_aside += 1
    key = socket_key(summary.station, summary.socket)
    if presence.lingering.get(key) == summary.fence:
        del presence.lingering[key]
        floor.refresh(line.sockets[key])
    if summary.fence > line.last_fence or summary.serial not in line.units:
        line.last_fence = max(line.last_fence, summary.fence)  # a station has seen it: go beyond
        floor.alarm(
            at_s,
            "unknown_lease",
            summary.attempt_id,
            "The record {attempt} of station {station} is of a lease that this line never gave: "
            "it is kept, set aside.",
            attempt=summary.attempt_id,
            station=summary.station,
        )


def _belongs(summary: RecordSummary, lease: HeldLease) -> bool:
    return (
        summary.attempt_id == lease.attempt_id
        and summary.serial == lease.serial
        and summary.station == lease.station
        and summary.socket == lease.socket
        and summary.plan_sha256 == lease.plan.sha256
    )


def record_key(summary: RecordSummary) -> str:
    """What a record is recognised by when it comes again."""
    return f"{summary.attempt_id}#{summary.fence}"


def _end_lease(floor: Floor, lease: HeldLease, trigger: LeaseTrigger, at_s: float) -> tuple[Unit, Socket]:
    line, fence = floor.line, lease.fence
    lease.state = line.story.lease_step(fence, lease.state, trigger, at_s)
    del line.leases[fence]
    floor.presence.renewed_until_s.pop(fence, None)
    unit, socket = line.units[lease.serial], line.sockets[lease.socket_key]
    unit.fence = socket.fence = 0
    return unit, socket


def _judge_unit(
    floor: Floor, unit: Unit, lease: HeldLease, outcome: Outcome | None, fault: Fault, at_s: float
) -> None:
    """Count an attempt and move its unit."""
    line, operation = floor.line, unit.operation
    judgement = judge(outcome, fault)
    first = unit.failed_here + unit.disturbed_here == 0
    line.yields.add(operation.name, lease.station, judgement, first, unit.failed_here > 0)
    unit.attempts.append(Attempt(lease.fence, operation.name, lease.station, lease.socket, outcome, fault))
    if judgement == "passed":
        if unit.operation_index + 1 == len(unit.route.operations):
            _finish(floor, unit, "passed_last", Disposition.SHIP, at_s)
            return
        unit.state = line.story.unit_step(unit.serial, unit.state, "passed", at_s)
        unit.operation_index += 1
        unit.leases_here = unit.failed_here = unit.disturbed_here = 0
        unit.failed_sockets, unit.last_socket = (), ""
        unit.disposition = Disposition.IN_PROCESS
        unit.ready_since_s = at_s
        floor.keep_unit(unit, at_s)
    elif judgement == "failed":
        unit.failed_here += 1
        unit.failed_sockets += (lease.socket_key,)
        if unit.failed_here >= operation.max_attempts_failed:
            _finish(floor, unit, "confirmed", operation.on_confirmed_failure, at_s)
            return
        unit.state = line.story.unit_step(unit.serial, unit.state, "failed", at_s)
        unit.disposition = Disposition.RETEST
        floor.keep_unit(unit, at_s)
    else:
        unit.disturbed_here += 1
        unit.last_socket = lease.socket_key
        if unit.disturbed_here >= operation.max_attempts_disturbed:
            _finish(floor, unit, "unjudgeable", operation.on_unjudgeable, at_s)
            return
        unit.state = line.story.unit_step(unit.serial, unit.state, "disturbed", at_s)
    floor.wait(unit, at_s)


def _finish(floor: Floor, unit: Unit, trigger: UnitTrigger, disposition: Disposition, at_s: float) -> None:
    line = floor.line
    unit.state = line.story.unit_step(unit.serial, unit.state, trigger, at_s)
    unit.disposition = disposition
    line.dispositions[disposition] = line.dispositions.get(disposition, 0) + 1
    line.unfinished -= 1
    floor.keep_unit(unit, at_s)


_APPLY: dict[type, Callable[[Floor, Any], None]] = {
    CoordinatorStarted: _coordinator_started,
    UnitsOrdered: _units_ordered,
    StationRegistered: station_registered,
    LeaseGranted: _lease_granted,
    SequenceAccepted: _sequence_accepted,
    SequenceRefused: _sequence_refused,
    LeaseOverran: _lease_overran,
    LeaseLapsed: _lease_lapsed,
    RecordsSubmitted: _records_submitted,
}

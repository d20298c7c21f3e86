"""What must hold after every event, whatever happened. Tests and the line simulator check it.

Recomputed from first principles, the slow way; the core itself keeps everything incrementally.
"""

# pyright: strict

from collections import Counter

from coordinator.core.floor import Floor
from coordinator.core.line_state import HeldLease, Socket, Unit, socket_key
from coordinator.core.transitions import LIVE_LEASE_STATES
from coordinator.core.yield_statistics import YieldStatistics, judge
from protocol.errors import Fault, TestloomError
from protocol.outcomes import Disposition


class InvariantBroken(TestloomError):
    """Something that must never be is."""


class InvariantChecker:
    """Checks one line. Remembers the newest fence: fences grow strictly, also over restarts, and a
    lease is looked at once more closely when it is new."""

    def __init__(self) -> None:
        self._last_fence: int | None = None

    def check(self, floor: Floor) -> None:
        """Check everything.

        Raises:
            InvariantBroken: with what is broken and the story of whom it is about.
        """
        line = floor.line
        before = line.last_fence if self._last_fence is None else self._last_fence
        _must(line.last_fence >= before, floor, 0, "the fence counter went back")
        self._last_fence = line.last_fence
        _check_leases(floor)
        for lease in line.leases.values():
            if lease.fence > before:
                _check_place(floor, lease)
        _check_units(floor)
        _check_pools(floor)
        _check_counts(floor)


def recomputed_yield(units: dict[str, Unit]) -> YieldStatistics:
    """The yield statistics counted anew from all attempts of all units."""
    statistics = YieldStatistics()
    for unit in units.values():
        seen: Counter[str] = Counter()
        judged: set[str] = set()
        for attempt in unit.attempts:
            judgement = judge(attempt.outcome, attempt.fault)
            first, judged_before = not seen[attempt.operation], attempt.operation in judged
            statistics.add(attempt.operation, attempt.station, judgement, first, judged_before)
            seen[attempt.operation] += 1
            if judgement != "disturbed":
                judged.add(attempt.operation)
    return statistics


def _must(holds: bool, floor: Floor, subject: str | int, what: str) -> None:
    if not holds:
        raise InvariantBroken(
            f"Invariant broken: {what}.",
            where=str(subject),
            fault=Fault.TESTLOOM,
            story=floor.line.story.of(subject),
        )


def _check_leases(floor: Floor) -> None:
    """One lease per unit and per socket, each under a fence of its own, watched and not ended."""
    line = floor.line
    serials: set[str] = set()
    sockets: set[str] = set()
    for fence, lease in line.leases.items():
        _must(lease.fence == fence <= line.last_fence, floor, fence, "a fence was never given out")
        _must(lease.state in LIVE_LEASE_STATES, floor, fence, "an ended lease is kept as live")
        _must(lease.serial not in serials, floor, lease.serial, "a unit has two leases")
        _must(lease.socket_key not in sockets, floor, fence, f"two units at socket {lease.socket_key}")
        _must(fence in floor.presence.renewed_until_s, floor, fence, "a lease has no expiry")
        unit, socket = line.units[lease.serial], line.sockets[lease.socket_key]
        _must(unit.fence == fence, floor, lease.serial, "a unit does not know its lease")
        _must(socket.fence == fence, floor, fence, f"socket {socket.key} does not know its lease")
        _must(unit.operation.name == lease.operation, floor, fence, "a lease is of another operation")
        serials.add(lease.serial)
        sockets.add(lease.socket_key)
    for socket in line.sockets.values():
        _must(not socket.fence or socket.key in sockets, floor, socket.fence, "a socket holds no live lease")
    _must(
        set(floor.presence.renewed_until_s) == set(line.leases), floor, 0, "expiries are kept of ended leases"
    )


def _check_place(floor: Floor, lease: HeldLease) -> None:
    """A new lease is at a socket in service where nothing runs any more, and a retest is at another
    socket than the failure's, unless there is none and it has waited."""
    line, presence = floor.line, floor.presence

    def in_service(socket: Socket) -> bool:
        return socket.station not in presence.silent and socket.key not in presence.resting_until_s

    unit, socket = line.units[lease.serial], line.sockets[lease.socket_key]
    _must(in_service(socket), floor, lease.fence, f"work for {socket.key}, which is out of service")
    _must(socket.key not in presence.lingering, floor, lease.fence, f"{socket.key} may still be at work")
    failed_at = {
        socket_key(attempt.station, attempt.socket)
        for attempt in unit.attempts
        if attempt.operation == lease.operation and judge(attempt.outcome, attempt.fault) == "failed"
    }
    if socket.key in failed_at:
        others = [
            other.key
            for other in line.sockets.values()
            if lease.operation in other.plans and other.key not in failed_at and in_service(other)
        ]
        _must(not others, floor, lease.serial, f"a retest where it failed, though there is {others}")
        patient = lease.granted_at_s >= unit.queued_at_s + floor.settings.retest_patience_s
        _must(patient, floor, lease.serial, "a retest where it failed, without waiting for another socket")


def _check_units(floor: Floor) -> None:
    """No unit is lost: it waits in exactly one queue, or is leased, or is finished; outcomes follow
    records."""
    line = floor.line
    waiting = Counter(serial for queue in floor.dispatcher.queues.values() for serial in queue.waiting)
    for serial, unit in line.units.items():
        if unit.state == "WAITING":
            queue = floor.dispatcher.queues.get(unit.operation.name)
            in_its_queue = queue is not None and serial in queue.waiting and waiting[serial] == 1
            _must(in_its_queue, floor, serial, "a waiting unit is not in its queue, and only there")
            _must(not unit.fence, floor, serial, "a waiting unit has a lease")
        else:
            _must(not waiting[serial], floor, serial, f"a unit {unit.state} is in a queue")
            leased = unit.fence in line.leases
            _must(
                leased == (unit.state == "AT_STATION"), floor, serial, f"a unit {unit.state}: {unit.fence=}"
            )
        _check_outcomes(floor, unit)


def _check_outcomes(floor: Floor, unit: Unit) -> None:
    operations = [operation.name for operation in unit.route.operations]
    judgements = [(attempt.operation, judge(attempt.outcome, attempt.fault)) for attempt in unit.attempts]
    passed = [operation for operation, judgement in judgements if judgement == "passed"]
    shipped = unit.disposition is Disposition.SHIP
    expected = operations if shipped else operations[: unit.operation_index]
    _must(passed == expected, floor, unit.serial, "passes are not those of the route, in order")
    _must(not shipped or unit.state == "FINISHED", floor, unit.serial, "shipped, and not finished")
    here = Counter(judgement for operation, judgement in judgements if operation == unit.operation.name)
    _must(
        here["failed"] == unit.failed_here and here["disturbed"] == unit.disturbed_here,
        floor,
        unit.serial,
        "failures are not those of the records",
    )
    final = unit.disposition not in (Disposition.IN_PROCESS, Disposition.RETEST)
    _must(final == (unit.state == "FINISHED"), floor, unit.serial, "finished and disposed of differ")
    if final and not shipped:
        operation = unit.operation
        enough = (
            unit.failed_here >= operation.max_attempts_failed
            or unit.disturbed_here >= operation.max_attempts_disturbed
        )
        _must(enough, floor, unit.serial, f"{unit.disposition.value} without the attempts for it")
    fences = [attempt.fence for attempt in unit.attempts]
    _must(fences == sorted(set(fences)), floor, unit.serial, "a unit's fences do not grow")


def _check_pools(floor: Floor) -> None:
    """Sockets are offered for work exactly when they are free for it."""
    line = floor.line
    for operation, queue in floor.dispatcher.queues.items():
        for socket in line.sockets.values():
            in_service, free = floor.availability(socket)
            able = operation in socket.plans
            _must((socket.key in queue.free) == (able and free), floor, socket.key, f"pool of {operation}")
            _must(
                (socket.key in queue.in_service) == (able and in_service),
                floor,
                socket.key,
                f"service of {operation}",
            )
        _must(set(queue.free) <= set(line.sockets), floor, operation, "the pool has an unknown socket")
        fresh = {entry[2] for entry in queue.fresh if queue.waiting.get(entry[2]) is entry}
        retests = {entry[2] for entry in queue.retests}
        _must(
            fresh | retests == set(queue.waiting) and not fresh & retests,
            floor,
            operation,
            "queue membership",
        )


def _check_counts(floor: Floor) -> None:
    """Counters are what a recount gives; each record counts once."""
    line = floor.line
    attempts = sum(len(unit.attempts) for unit in line.units.values())
    _must(attempts == line.attempts_recorded + line.lapses, floor, 0, "attempts are not those recorded")
    _must(
        len(line.recorded) == line.attempts_recorded + line.records_set_aside,
        floor,
        0,
        "records counted twice",
    )
    finished = Counter(unit.disposition for unit in line.units.values() if unit.state == "FINISHED")
    _must(dict(finished) == line.dispositions, floor, 0, "dispositions are not those of the units")
    _must(line.unfinished == len(line.units) - finished.total(), floor, 0, "the count of unfinished units")
    _must(recomputed_yield(line.units) == line.yields, floor, 0, "the yield is not that of the attempts")

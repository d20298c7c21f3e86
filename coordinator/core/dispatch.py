"""Who goes where next: a queue and a pool of free sockets per operation. The policy, and only it.

The policy proposes a unit and a socket; the proposal becomes a fact (`LeaseGranted`) that replay
takes as it is, so the policy may change between versions without a journal losing its meaning.

**Order.** A unit's priority grows as it waits, at the same rate for all; a retest starts with a
credit of `retest_credit_s`. Ageing at one rate never changes who is before whom, so the order is
fixed when a unit joins: ascending `ready_since_s - credit`, then arrival on the line. A retest
therefore overtakes only units that became ready less than the credit before it, and no unit can
starve. A disturbed unit keeps its `ready_since_s`: it returns to its old place.

**Place.** Free sockets are taken in the order in which they became free, so that work spreads. A
retest never takes a socket where the unit failed the operation, while another capable socket is in
service (even a busy one); when there is none, it may after `retest_patience_s`. A disturbed unit
takes another socket than the last when one is free. When a socket can run several operations, the
unit with the smaller key gets it.

**Cost.** Nothing scans units or stations: joining and leaving cost O(log n) comparisons, and at
most `MAX_RETESTS_EXAMINED` retests are looked at for one decision (a blocked retest further back
waits until one before it has gone).
"""

# pyright: strict

from bisect import bisect_left, insort
from collections import OrderedDict
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import NamedTuple

from coordinator.core.line_state import Line, Socket, Unit

MAX_RETESTS_EXAMINED = 16

Entry = tuple[float, int, str]
"""(key, arrival, serial): smaller goes first."""


class Proposal(NamedTuple):
    """A unit for a socket. `entry` is the unit's place in its queue."""

    entry: Entry
    operation: str
    socket_key: str


@dataclass(slots=True)
class OperationQueue:
    """Units waiting for one operation, and the sockets for it.

    `fresh` is a heap in which entries of units that have left stay until they come to its top;
    `retests` is sorted. `free` is ordered by how long a socket has been free.
    """

    waiting: dict[str, Entry] = field(default_factory=dict[str, Entry])
    fresh: list[Entry] = field(default_factory=list[Entry])
    retests: list[Entry] = field(default_factory=list[Entry])
    free: OrderedDict[str, None] = field(default_factory=OrderedDict[str, None])
    in_service: set[str] = field(default_factory=set[str])

    def head(self) -> Entry | None:
        """The entry that is first in order."""
        fresh = self.first_fresh()
        if self.retests and (fresh is None or self.retests[0] < fresh):
            return self.retests[0]
        return fresh

    def first_fresh(self) -> Entry | None:
        """The first unit that is not a retest."""
        while self.fresh:
            entry = self.fresh[0]
            if self.waiting.get(entry[2]) is entry:
                return entry
            heappop(self.fresh)
        return None


class Dispatcher:
    """Queues and pools of all operations, and which of them may have a match."""

    __slots__ = ("_touched", "queues")

    def __init__(self) -> None:
        self.queues: dict[str, OperationQueue] = {}
        self._touched: dict[str, None] = {}

    def queue(self, operation: str) -> OperationQueue:
        """The queue of an operation, made when it is first asked for."""
        found = self.queues.get(operation)
        if found is None:
            found = self.queues[operation] = OperationQueue()
        return found

    def join(self, unit: Unit, retest_credit_s: float) -> None:
        """A unit waits for its operation."""
        operation = unit.operation.name
        queue = self.queue(operation)
        if unit.failed_here:
            entry = (unit.ready_since_s - retest_credit_s, unit.arrival, unit.serial)
            insort(queue.retests, entry)
        else:
            entry = (unit.ready_since_s, unit.arrival, unit.serial)
            heappush(queue.fresh, entry)
        queue.waiting[unit.serial] = entry
        if queue.free:
            self._touched[operation] = None

    def leave(self, unit: Unit) -> None:
        """A unit no longer waits."""
        queue = self.queues[unit.operation.name]
        entry = queue.waiting.pop(unit.serial)
        at = bisect_left(queue.retests, entry)
        if at < len(queue.retests) and queue.retests[at] is entry:
            del queue.retests[at]

    def place(self, socket: Socket, in_service: bool, free: bool) -> None:
        """A socket came into or went out of service, became free or occupied."""
        key = socket.key
        for operation in socket.plans:
            queue = self.queue(operation)
            if in_service:
                queue.in_service.add(key)
            elif key in queue.in_service:
                queue.in_service.discard(key)
                self._touched[operation] = None  # a retest may now have to take what there is
            if not free:
                queue.free.pop(key, None)
            elif key not in queue.free:
                queue.free[key] = None
                if queue.waiting:
                    self._touched[operation] = None

    def remove(self, socket: Socket) -> None:
        """A socket is gone, or about to be described anew."""
        self.place(socket, in_service=False, free=False)

    def touch(self, operation: str) -> None:
        """There may be a match at this operation now."""
        self._touched[operation] = None

    def touch_all(self) -> None:
        """There may be a match at every operation now."""
        self._touched.update(dict.fromkeys(self.queues))

    def next_proposal(self, line: Line, at_s: float) -> Proposal | None:
        """The best match there is now, None when there is none."""
        best: Proposal | None = None
        for operation in tuple(self._touched):
            proposal = self._match(operation, line, at_s)
            if proposal is None:
                del self._touched[operation]
            elif best is None or proposal.entry < best.entry:
                best = proposal
        return best

    def _match(self, operation: str, line: Line, at_s: float) -> Proposal | None:
        queue = self.queues.get(operation)
        if queue is None or not queue.free or not queue.waiting:
            return None
        fresh = queue.first_fresh()
        for entry in queue.retests[:MAX_RETESTS_EXAMINED]:
            if fresh is not None and fresh < entry:
                break
            key = _socket_for_retest(line.units[entry[2]], queue, line, at_s)
            if key is not None:
                return Proposal(entry, operation, key)
        if fresh is None:
            return None
        return Proposal(fresh, operation, _socket_for_fresh(line.units[fresh[2]], queue))


def _socket_for_fresh(unit: Unit, queue: OperationQueue) -> str:
    first = next(iter(queue.free))
    if first != unit.last_socket or len(queue.free) == 1:
        return first
    return next(key for key in queue.free if key != unit.last_socket)


def _socket_for_retest(unit: Unit, queue: OperationQueue, line: Line, at_s: float) -> str | None:
    failed = unit.failed_sockets
    usable = [key for key, _ in zip(queue.free, range(len(failed) + 2), strict=False) if key not in failed]
    if usable:
        return next((key for key in usable if key != unit.last_socket), usable[0])
    others = len(queue.in_service) - sum(key in queue.in_service for key in set(failed))
    patient_until_s = unit.queued_at_s + line.settings.retest_patience_s  # as the timer was set
    if others > 0 or at_s < patient_until_s:
        return None
    return next(iter(queue.free))

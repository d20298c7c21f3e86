"""Instruments that the sockets of a bench share: one session each, and first come, first served.

Multimeter and oscilloscope hang on one measuring bus, to which one socket board at a time may route
test points. Who wants to measure takes the bus; meanwhile the branch that waits takes no part in
the bench's time, which could not go on otherwise.
"""

import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from protocol.bench_description import BenchDescription
from protocol.errors import Fault, LinkError, LinkTimeoutError
from stations.drivers.clock import BranchClock
from stations.drivers.scpi import ScpiSession

MAX_WAIT_WALL_S = 60.0
"""Wall time after which a shared instrument counts as held by somebody who will not return it."""
WAIT_POLL_S = 0.05


@dataclass(eq=False)
class _Ticket:
    clock: BranchClock
    granted: bool = False
    failure: LinkError | None = None


class FairLock:
    """A lock that is given to its waiters in the order in which they came.

    Who gives it back puts the next one's clock back to work before it goes on itself; otherwise
    bench time could run away between the two.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._condition = threading.Condition()
        self._queue: deque[_Ticket] = deque()

    @contextmanager
    def held(self, clock: BranchClock) -> Iterator[None]:
        """Hold it inside the `with`; wait outside the bench's time.

        Raises on entry:
            LinkTimeoutError: it did not become free within MAX_WAIT_WALL_S.
            SequenceAborted: the sequence was aborted meanwhile.
            LinkError: the bench is dead.
        """
        ticket = _Ticket(clock)
        left_at_s = clock.now_s()
        with self._condition:
            ticket.granted = not self._queue
            if not ticket.granted:
                clock.leave()
            self._queue.append(ticket)
        try:
            if not ticket.granted:
                self._wait_for_turn(ticket)
                clock.extend_step(clock.now_s() - left_at_s)
            yield
        finally:
            self._give_back(ticket)

    def _wait_for_turn(self, ticket: _Ticket) -> None:
        with self._condition:
            for _ in range(int(MAX_WAIT_WALL_S / WAIT_POLL_S)):
                if ticket.granted:
                    if ticket.failure is not None:
                        raise ticket.failure
                    return
                ticket.clock.interruption()
                self._condition.wait(WAIT_POLL_S)
        raise LinkTimeoutError(
            f"The shared {self._name} did not become free within {MAX_WAIT_WALL_S:g} s.",
            where=self._name,
            fault=Fault.STATION,
            remedy="see which socket of the bench holds it; restart the station.",
        )

    def _give_back(self, ticket: _Ticket) -> None:
        with self._condition:
            self._queue.remove(ticket)
            if not ticket.granted:
                ticket.clock.join()
            elif self._queue:
                successor = self._queue[0]
                try:
                    successor.clock.join()
                except LinkError as error:
                    successor.failure = error
                successor.granted = True
                self._condition.notify_all()


class Arbitration:
    """The shared instruments of one bench: one object for all its SequenceRunners."""

    def __init__(self, bench: BenchDescription) -> None:
        self.bench = bench
        self.measuring_bus = FairLock("measuring bus")
        self.power_supply = ScpiSession(bench.power_supply, "power supply")
        self.multimeter = _optional(bench.multimeter, "multimeter")
        self.oscilloscope = _optional(bench.oscilloscope, "oscilloscope")
        self._boards_are_open = False

    @contextmanager
    def measuring(self, clock: BranchClock) -> Iterator[None]:
        """The measuring bus for one socket. Raises on entry as `FairLock.held`.

        Whoever measures first opens the relays of every board: a station that was killed may have
        left some closed, and the bus would be refused for as long as they are.
        """
        with self.measuring_bus.held(clock):
            if not self._boards_are_open:
                for resources in self.bench.sockets:
                    if resources.board is not None:
                        board = ScpiSession(resources.board, f"socket board {resources.socket}")
                        board.set("ROUT:OPEN:ALL")
                        board.close()
                self._boards_are_open = True
            yield

    def close(self) -> None:
        """Close the sessions; the next use opens them again."""
        for session in (self.power_supply, self.multimeter, self.oscilloscope):
            if session is not None:
                session.close()


def _optional(resource: str | None, name: str) -> ScpiSession | None:
    return None if resource is None else ScpiSession(resource, name)

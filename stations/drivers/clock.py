"""A branch's clock: bench time, waits that look at aborts and deadlines, and waits for a link's bytes.

In lock-step a branch is a participant of the bench's clock: time stands while the branch works. On
hardware bench time is the wall clock, and the same calls sleep for real.
"""

import select
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from serial import SerialException

from protocol.bench_control import BenchTime, Resume, Suspend, Wait
from stations.drivers.control_channel import ControlChannel
from stations.drivers.serial_port import LockstepPort, lost_port
from stations.interruptions import StepTimeout

MAX_WAIT_BENCH_S = 5.0
"""Longer waits are cut, so that a streaming link is drained on the way and not at the end."""
WALL_POLL_S = 0.02
UNCOUNTED_POLL_S = 0.005
"""Bench time after which a port without counts (a pty) is looked at again."""
TRANSFER_S = 0.05
"""On hardware, a byte that was sent is here after this."""


def _never() -> None:
    """Nothing interrupts."""


class BranchClock(ABC):
    """Bench time for one branch of a sequence. Belongs to one thread.

    Attributes:
        interruption: called in every wait; raises SequenceAborted when the sequence is to end.
        while_sleeping: called again and again in every sleep: takes in what streams meanwhile, before a
            port of hardware, which keeps a fraction of a second, is full.
    """

    def __init__(self) -> None:
        self.interruption: Callable[[], None] = _never
        self.while_sleeping: Callable[[], None] = _never
        self._step_deadline_s: float | None = None
        self._sequence_deadline_s: float | None = None

    @abstractmethod
    def now_s(self) -> float:
        """Bench time."""

    @abstractmethod
    def _wait(self, until_s: float, port: Any | None, seen: int) -> None:
        """Let time pass to `until_s`, or less: a slice of it, or until `port` got more than `seen` bytes."""

    @abstractmethod
    def _synchronise(self) -> None:
        """Make `now_s` no earlier than the bench's own time at the moment of the call."""

    @abstractmethod
    def catch_up(self) -> None:
        """Take in what every link has been handed until now, also where no reply tells its end."""

    @abstractmethod
    def join(self) -> None:
        """Take part in the bench's time (again): from here on it waits for this branch."""

    @abstractmethod
    def leave(self) -> None:
        """Take no part in it for a while: the branch has nothing to do or waits for something outside."""

    def limit(self, step_deadline_s: float | None, sequence_deadline_s: float | None = None) -> None:
        """Set the moments after which waits raise StepTimeout; None: no limit."""
        self._step_deadline_s = step_deadline_s
        self._sequence_deadline_s = sequence_deadline_s

    def sleep_until(self, time_s: float) -> None:
        """Let bench time pass.

        Raises:
            SequenceAborted: the sequence was aborted meanwhile.
            StepTimeout: the step's time or the sequence's deadline ends before.
            LinkError: the bench is dead.
        """
        while True:
            self._check()
            if self.now_s() >= time_s:
                return
            self._wait(self._bounded(time_s), None, 0)
            self.while_sleeping()

    def sleep_for(self, duration_s: float) -> None:
        """Let at least so much bench time pass from now, counted by the bench; raises as `sleep_until`.

        For instruments and relays, which need their time after a command that has just been done.
        """
        self._synchronise()
        self.sleep_until(self.now_s() + duration_s)

    def wait_for_bytes(self, port: Any, seen: int, until_s: float) -> bool:
        """Wait until a port may have new bytes (True), or a moment has passed (False).

        Args:
            port: the port.
            seen: `bytes_seen(port)` from before the caller last looked at what had come; bytes that
                another branch took in since then end the wait at once.
            until_s: bench time.

        Raises:
            SequenceAborted, StepTimeout, LinkError: as `sleep_until`.
        """
        self._check()
        if self.now_s() >= until_s:
            return False
        self._wait(self._bounded(until_s), port, seen)
        return True

    def extend_step(self, by_s: float) -> None:
        """Give the step more time: what it spent waiting for others is not its own."""
        if self._step_deadline_s is not None:
            self._step_deadline_s += by_s

    def _bounded(self, time_s: float) -> float:
        limits = [time_s, self.now_s() + MAX_WAIT_BENCH_S]
        return min(limits + [d for d in (self._step_deadline_s, self._sequence_deadline_s) if d is not None])

    def _check(self) -> None:
        self.interruption()
        now_s = self.now_s()
        if self._sequence_deadline_s is not None and now_s >= self._sequence_deadline_s:
            raise StepTimeout("The plan's deadline for the whole sequence has passed.", of_sequence=True)
        if self._step_deadline_s is not None and now_s >= self._step_deadline_s:
            raise StepTimeout("The step did not end within its time-out.")


def bytes_seen(port: Any) -> int:
    """Bytes that a counted port has received; 0 for others, whose waits are short."""
    return port.bytes_received if isinstance(port, LockstepPort) else 0


class LockstepLinks:
    """The counted ports of one socket: what lock-step needs to know of its bytes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ports: dict[str, LockstepPort] = {}

    def add(self, port: Any) -> None:
        """Count this port, if it is one that counts."""
        if isinstance(port, LockstepPort):
            with self._lock:
                self._ports[port.link] = port

    def remove(self, port: Any) -> None:
        """Forget a port that is being closed."""
        with self._lock:
            if isinstance(port, LockstepPort) and self._ports.get(port.link) is port:
                del self._ports[port.link]

    def written(self) -> dict[str, int]:
        """Bytes written so far, by link."""
        with self._lock:
            return {link: port.bytes_written for link, port in self._ports.items()}

    def take_in(self, handed_over: dict[str, int]) -> None:
        """Receive what the bench has handed over.

        Raises:
            LinkError: a port is gone, or its bytes do not come.
        """
        with self._lock:
            ports = list(self._ports.items())
        for link, port in ports:
            count = handed_over.get(link, 0)
            if port.is_open and port.bytes_received < count:
                try:
                    port.receive_up_to(count)
                except (SerialException, OSError) as error:
                    raise lost_port(error, f"link {link}") from None


class LockstepClock(BranchClock):
    """The clock of an emulated bench, in lock-step (pace 0) or at a pace of the wall clock."""

    def __init__(self, control: ControlChannel, links: LockstepLinks) -> None:
        super().__init__()
        self._control = control
        self._links = links
        self._known_s = 0.0
        self._known_at = 0.0
        self._pace = 0.0

    def now_s(self) -> float:
        """Bench time: at a pace, carried on by the wall clock since the bench's last word."""
        if self._pace == 0.0:
            return self._known_s
        return self._known_s + (time.monotonic() - self._known_at) * self._pace

    def _synchronise(self) -> None:
        # in lock-step time stands while this branch works: what is known is exact
        if self._pace:
            self.catch_up()

    def catch_up(self) -> None:
        self._wait(self.now_s(), None, 0)

    def join(self) -> None:
        hello = self._control.connect()
        self._learn(hello if hello is not None else self._control.request(Resume()))

    def leave(self) -> None:
        self._learn(self._control.request(Suspend()))

    def _wait(self, until_s: float, port: Any | None, seen: int) -> None:
        if port is not None and not isinstance(port, LockstepPort):
            until_s = min(until_s, self.now_s() + UNCOUNTED_POLL_S)
        expected_s = max(0.0, until_s - self.now_s()) / self._pace if self._pace else 0.0
        wake_above = {port.link: seen} if isinstance(port, LockstepPort) else {}
        request = Wait(until_s=until_s, written=self._links.written(), wake_above=wake_above)
        reply = self._control.request(request, expected_wall_s=expected_s, interruption=self.interruption)
        self._learn(reply)
        self._links.take_in(reply.handed_over)

    def _learn(self, reply: BenchTime) -> None:
        self._known_s = reply.now_s
        self._known_at = time.monotonic()
        self._pace = reply.pace


class WallClock(BranchClock):
    """Hardware: bench time is the monotonic wall clock. Joining and leaving mean nothing."""

    def now_s(self) -> float:
        return time.monotonic()

    def _synchronise(self) -> None:
        """The wall clock is one for all."""

    def catch_up(self) -> None:
        time.sleep(TRANSFER_S)

    def join(self) -> None:
        """Nothing to do."""

    def leave(self) -> None:
        """Nothing to do."""

    def _wait(self, until_s: float, port: Any | None, seen: int) -> None:
        del seen  # nothing is counted here: waits are short, and the caller looks again
        wall_s = min(WALL_POLL_S, max(0.0, until_s - time.monotonic()))
        if port is None:
            time.sleep(wall_s)
        else:
            select.select([port.fileno()], [], [], wall_s)

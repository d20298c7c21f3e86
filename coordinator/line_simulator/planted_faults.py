"""Faults planted into the core or its shell, to show that the simulator would find them.

Each replaces one function for as long as its block lasts. None of them lives in the core.
"""

# pyright: strict, reportPrivateUsage=false

from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from coordinator.core import dispatch, facts, line_core
from coordinator.core.dispatch import Dispatcher, OperationQueue
from coordinator.core.floor import Floor
from coordinator.core.line_state import HeldLease, Line, Socket, Unit
from coordinator.core.transitions import LeaseTrigger
from coordinator.core.yield_statistics import Judgement
from coordinator.line_simulator.coordinator_model import CoordinatorModel
from protocol.coordinator_commands import Command, Journal
from protocol.coordinator_events import Event, LeaseGranted, RecordSummary
from protocol.errors import Fault, TestloomError
from protocol.outcomes import Outcome
from protocol.station_messages import RegisterStation


def _unfenced_lease() -> tuple[object, str, object]:
    """A record closes whatever lease its unit has now, old fence or not."""
    original = facts._record

    def record(floor: Floor, summary: RecordSummary, at_s: float) -> None:
        unit = floor.line.units.get(summary.serial)
        lease = floor.line.leases.get(unit.fence) if unit is not None else None
        if lease is None or lease.fence == summary.fence:
            original(floor, summary, at_s)
            return
        present = summary.model_copy(
            update={
                "fence": lease.fence,
                "attempt_id": lease.attempt_id,
                "station": lease.station,
                "socket": lease.socket,
            }
        )
        floor.line.recorded.add(facts.record_key(summary))
        original(floor, present, at_s)

    return facts, "_record", record


def _double_grant() -> tuple[object, str, object]:
    """A socket with a unit on it counts as free."""

    def availability(self: Floor, socket: Socket) -> tuple[bool, bool]:
        in_service = socket.station not in self.presence.silent
        return in_service, in_service

    return Floor, "availability", availability


def _lost_requeue() -> tuple[object, str, object]:
    """A disturbed unit is not put back into its queue."""
    original = Dispatcher.join

    def join(self: Dispatcher, unit: Unit, retest_credit_s: float) -> None:
        if not unit.disturbed_here:
            original(self, unit, retest_credit_s)

    return Dispatcher, "join", join


def _ack_before_commit() -> tuple[object, str, object]:
    """Records are acknowledged before they are committed."""
    return CoordinatorModel, "acknowledge_before_commit", True


def _recorded_twice() -> tuple[object, str, object]:
    """A record that comes again is taken for a new one."""
    count = [0]

    def record_key(summary: RecordSummary) -> str:
        count[0] += 1
        return f"{summary.attempt_id}#{count[0]}"

    return facts, "record_key", record_key


def _error_passes() -> tuple[object, str, object]:
    """An attempt that ended in ERROR lets the unit move on."""
    original = facts.judge

    def judge(outcome: Outcome | None, fault: Fault) -> Judgement:
        return "passed" if outcome is Outcome.ERROR else original(outcome, fault)

    return facts, "judge", judge


def _grants_not_journaled() -> tuple[object, str, object]:
    """A lease goes out without a line in the journal."""
    original = line_core.CoordinatorCore.handle

    def handle(self: line_core.CoordinatorCore, event: Event) -> tuple[Command, ...]:
        commands = original(self, event)
        return tuple(c for c in commands if not (isinstance(c, Journal) and isinstance(c.fact, LeaseGranted)))

    return line_core.CoordinatorCore, "handle", handle


def _second_bench_accepted() -> tuple[object, str, object]:
    """Any bench may call itself by any station's id."""

    def refusal(self: line_core.CoordinatorCore, registration: RegisterStation, at_s: float) -> str:
        del self, registration, at_s
        return ""

    return line_core.CoordinatorCore, "_refusal", refusal


def _retest_without_patience_timer() -> tuple[object, str, object]:
    """Nobody looks again at a retest that waits for another socket."""

    def patience_due(self: line_core.CoordinatorCore, serial: str, at_s: float) -> None:
        del self, serial, at_s

    return line_core.CoordinatorCore, "_patience_due", patience_due


def _lapsed_never() -> tuple[object, str, object]:
    """A lease's timer is not set."""

    def watch_lease(self: Floor, lease: HeldLease) -> None:
        del self, lease

    return Floor, "watch_lease", watch_lease


def _retest_where_it_failed() -> tuple[object, str, object]:
    """A retest takes any free socket."""

    def socket_for_retest(unit: Unit, queue: OperationQueue, line: Line, at_s: float) -> str:
        del unit, line, at_s
        return next(iter(queue.free))

    return dispatch, "_socket_for_retest", socket_for_retest


def _lingering_forgotten() -> tuple[object, str, object]:
    """A socket whose lease lapsed counts as free, though its sequence may still run."""

    def availability(self: Floor, socket: Socket) -> tuple[bool, bool]:
        presence = self.presence
        in_service = socket.station not in presence.silent and socket.key not in presence.resting_until_s
        return in_service, in_service and not socket.fence

    return Floor, "availability", availability


def _fence_given_twice() -> tuple[object, str, object]:
    """The fence of a refused lease is given out again."""
    original = facts._end_lease

    def end_lease(floor: Floor, lease: HeldLease, trigger: LeaseTrigger, at_s: float) -> tuple[Unit, Socket]:
        if trigger == "refused":
            floor.line.last_fence -= 1
        return original(floor, lease, trigger, at_s)

    return facts, "_end_lease", end_lease


PLANTED_FAULTS: dict[str, Callable[[], tuple[object, str, object]]] = {
    "unfenced_lease": _unfenced_lease,
    "double_grant": _double_grant,
    "lost_requeue": _lost_requeue,
    "ack_before_commit": _ack_before_commit,
    "recorded_twice": _recorded_twice,
    "error_passes": _error_passes,
    "grants_not_journaled": _grants_not_journaled,
    "second_bench_accepted": _second_bench_accepted,
    "retest_forgotten": _retest_without_patience_timer,
    "lapsed_never": _lapsed_never,
    "retest_where_it_failed": _retest_where_it_failed,
    "lingering_forgotten": _lingering_forgotten,
    "fence_given_twice": _fence_given_twice,
}


@contextmanager
def planted(name: str) -> Generator[None]:
    """Plant a fault for as long as the block lasts; an empty name plants none.

    Raises:
        TestloomError: there is no such fault.
    """
    if not name:
        yield
        return
    if name not in PLANTED_FAULTS:
        raise TestloomError(
            f"There is no planted fault '{name}'.",
            fault=Fault.OPERATOR,
            remedy=f"choose one of: {', '.join(PLANTED_FAULTS)}.",
        )
    owner, attribute, replacement = PLANTED_FAULTS[name]()
    original: Any = getattr(owner, attribute)
    setattr(owner, attribute, replacement)
    try:
        yield
    finally:
        setattr(owner, attribute, original)

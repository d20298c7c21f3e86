"""The line as the journal tells it: units, leases, stations, sockets.

Plain mutable dataclasses, reached by key in constant time. Everything here follows from the facts
alone; what is known only from being in contact lives in presence.py, and the queues in dispatch.py.
"""

# pyright: strict

from dataclasses import dataclass, field
from typing import NamedTuple

from coordinator.core.transitions import LeaseState, Story, UnitState
from coordinator.core.yield_statistics import YieldStatistics
from protocol.coordinator_events import LineSettings
from protocol.errors import Fault
from protocol.outcomes import Disposition, Outcome
from protocol.plans import PlanReference
from protocol.routes import Operation, Route


class Attempt(NamedTuple):
    """One counted attempt of a unit. `outcome` is None for a lease that lapsed without a record."""

    fence: int
    operation: str
    station: str
    socket: str
    outcome: Outcome | None
    fault: Fault


@dataclass(slots=True)
class Unit:
    """A unit on the line.

    Attributes:
        arrival: place in the order of arrival on the line, counted from 1.
        operation_index: index in its route of the operation it waits for or is at.
        fence: of its live lease; 0 when it has none.
        leases_here, failed_here, disturbed_here: at the present operation.
        failed_sockets: keys of the sockets where the unit failed the present operation.
        last_socket: key of the socket of the last attempt at the present operation, if disturbed.
        ready_since_s: when the present operation became its next.
        queued_at_s: when it began to wait.
    """

    serial: str
    product: str
    lot: str
    route: Route
    arrival: int
    ready_since_s: float
    queued_at_s: float
    state: UnitState = "WAITING"
    disposition: Disposition = Disposition.IN_PROCESS
    operation_index: int = 0
    fence: int = 0
    leases_here: int = 0
    failed_here: int = 0
    disturbed_here: int = 0
    failed_sockets: tuple[str, ...] = ()
    last_socket: str = ""
    attempts: list[Attempt] = field(default_factory=list[Attempt])

    @property
    def operation(self) -> Operation:
        """The operation it waits for or is at; after its end the last one it was at."""
        return self.route.operations[self.operation_index]


@dataclass(slots=True)
class HeldLease:
    """A live lease. `deadline_s`: of the operation, then of its abort."""

    fence: int
    attempt_id: str
    serial: str
    operation: str
    station: str
    socket: str
    socket_key: str
    plan: PlanReference
    granted_at_s: float
    deadline_s: float
    state: LeaseState = "OFFERED"


@dataclass(slots=True)
class Socket:
    """A socket of a registered station. `plans`: what it can run, by operation.
    `fence`: of the live lease on it; 0 when there is none."""

    key: str
    station: str
    socket: str
    plans: dict[str, PlanReference]
    fence: int = 0


@dataclass(slots=True)
class Station:
    """A bench's agent. `highest_sequence`: of the records it has submitted, None before the first
    is known of."""

    station: str
    bench_identity: str
    incarnation: int
    registered_at_s: float
    sockets: dict[str, Socket] = field(default_factory=dict[str, Socket])
    highest_sequence: int | None = None


class OrderReceipt(NamedTuple):
    accepted: int
    already_known: tuple[str, ...]


@dataclass(slots=True)
class Line:
    """Everything that the facts determine."""

    settings: LineSettings
    units: dict[str, Unit] = field(default_factory=dict[str, Unit])
    leases: dict[int, HeldLease] = field(default_factory=dict[int, HeldLease])
    stations: dict[str, Station] = field(default_factory=dict[str, Station])
    sockets: dict[str, Socket] = field(default_factory=dict[str, Socket])
    orders: dict[str, OrderReceipt] = field(default_factory=dict[str, OrderReceipt])
    routes: dict[str, Route] = field(default_factory=dict[str, Route])
    recorded: set[str] = field(default_factory=set[str])
    last_fence: int = 0
    unfinished: int = 0
    attempts_recorded: int = 0
    records_set_aside: int = 0
    lapses: int = 0
    dispositions: dict[Disposition, int] = field(default_factory=dict[Disposition, int])
    yields: YieldStatistics = field(default_factory=YieldStatistics)
    mean_cycle_s: dict[str, float] = field(default_factory=dict[str, float])
    story: Story = field(default_factory=Story, compare=False, repr=False)


def socket_key(station: str, socket: str) -> str:
    """A socket's key: names hold no '/'."""
    return f"{station}/{socket}"

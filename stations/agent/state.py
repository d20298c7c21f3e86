# pyright: strict
"""What a station agent knows: who it is, what it holds, how it stands with the coordinator."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from protocol.attempts import AttemptRecord, Lease
from protocol.plans import PlanReference
from protocol.station_messages import SocketDescription


class Phase(StrEnum):
    """How far the lease on a socket is."""

    TRACING = "tracing"
    RUNNING = "running"
    ABORTING = "aborting"
    SPOOLING = "spooling"


class Link(StrEnum):
    """How the agent stands with the coordinator."""

    REGISTERING = "registering"
    REGISTERED = "registered"
    REFUSED = "refused"


@dataclass(frozen=True)
class AgentIdentity:
    """What does not change while the agent runs."""

    station: str
    incarnation: int
    bench_identity: str
    sockets: tuple[SocketDescription, ...]
    plans: tuple[PlanReference, ...]


@dataclass
class HeldLease:
    """A lease on its socket. `queries`: who waits to hear that it was taken."""

    lease: Lease
    phase: Phase
    queries: list[int] = field(default_factory=list[int])
    abort_why: str = ""
    record: AttemptRecord | None = None


@dataclass(frozen=True)
class SpoolContent:
    """What the spool held when the agent started."""

    unacknowledged: Mapping[int, str]
    next_number: int
    fences: tuple[tuple[int, str, str], ...] = ()
    """(fence, socket, serial)"""

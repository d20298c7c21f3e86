"""What stations and the coordinator say to each other, as queries and replies.

Station → coordinator on `…/coordinator/<verb>/<station>`: RegisterStation, RenewLeases,
SubmitRecords. Coordinator → station on `…/station/<station>/command`: StartSequence,
AbortSequence. No reply, an error reply and a time-out all mean: try again with backoff.
"""

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from protocol.attempts import Lease, SpooledRecord
from protocol.frozen_model import FrozenModel
from protocol.outcomes import Outcome
from protocol.plans import PlanReference

MAX_RECORDS_PER_SUBMISSION = 64


class SocketDescription(FrozenModel):
    """A socket and the operations that can be run on it."""

    socket: str
    operations: tuple[str, ...]


class RegisterStation(FrozenModel):
    """A station announces itself: at its start, and whenever the coordinator asks for it.

    `incarnation`: wall-clock nanoseconds at the agent's start: a newer agent of the same bench
    takes over. `bench_identity`: what the bench calls itself (serial number of the fixture); the
    same station id on another bench is refused. `held`: leases being worked on right now.
    `spool_first`, `spool_last`: sequence numbers not yet acknowledged (0, 0 when none);
    `spool_next` is the number that the next record will get. `newest_fence`: the largest that was ever
    started here, so that a coordinator with a new or restored journal gives out larger ones.
    """

    kind: Literal["RegisterStation"] = "RegisterStation"
    station: str
    incarnation: int
    bench_identity: str
    sockets: tuple[SocketDescription, ...]
    plans: tuple[PlanReference, ...]
    held: tuple[Lease, ...] = ()
    spool_first: int = 0
    spool_last: int = 0
    spool_next: int = 1
    newest_fence: int = 0


class StationAccepted(FrozenModel):
    """The station may work. `revoked`: fences among those it holds that are no longer its own."""

    kind: Literal["StationAccepted"] = "StationAccepted"
    lease_duration_s: float
    renewal_period_s: float
    revoked: tuple[int, ...] = ()


class StationRefused(FrozenModel):
    """The station may not work: `reason` says why, in words."""

    kind: Literal["StationRefused"] = "StationRefused"
    reason: str


class RenewLeases(FrozenModel):
    """'I am alive and work on these': sent every `renewal_period_s`, also with nothing held."""

    kind: Literal["RenewLeases"] = "RenewLeases"
    station: str
    incarnation: int
    fences: tuple[int, ...] = ()


class LeasesRenewed(FrozenModel):
    """`revoked`: stop working on these, their records will be set aside.
    `register_again`: the coordinator does not know this incarnation."""

    kind: Literal["LeasesRenewed"] = "LeasesRenewed"
    revoked: tuple[int, ...] = ()
    register_again: bool = False


class SubmitRecords(FrozenModel):
    """Spooled records, oldest first."""

    kind: Literal["SubmitRecords"] = "SubmitRecords"
    station: str
    incarnation: int
    records: tuple[SpooledRecord, ...] = Field(max_length=MAX_RECORDS_PER_SUBMISSION)


class RecordsAcknowledged(FrozenModel):
    """These attempt ids are durably committed: only now may the spool drop them."""

    kind: Literal["RecordsAcknowledged"] = "RecordsAcknowledged"
    attempt_ids: tuple[str, ...]


class StartSequence(FrozenModel):
    """Run this lease's plan on its unit at its socket."""

    kind: Literal["StartSequence"] = "StartSequence"
    lease: Lease


class AbortSequence(FrozenModel):
    """Stop the sequence of this lease, go to the safe state, record ABORTED."""

    kind: Literal["AbortSequence"] = "AbortSequence"
    station: str
    socket: str
    fence: int
    reason: str


class CommandAccepted(FrozenModel):
    """The station has the command (again, if it was a duplicate)."""

    kind: Literal["CommandAccepted"] = "CommandAccepted"
    fence: int


class CommandRefused(FrozenModel):
    """The station will not do it. `socket_busy`: another lease runs there."""

    kind: Literal["CommandRefused"] = "CommandRefused"
    fence: int
    reason: Literal["stale_fence", "socket_busy", "unknown_plan", "unknown_socket", "stopping"]
    text: str


class RequestRejected(FrozenModel):
    """Payload of an error reply: whose fault, and what to do."""

    kind: Literal["RequestRejected"] = "RequestRejected"
    what: str
    fault: str
    remedy: str = ""


class SocketProgress(FrozenModel):
    """A live view of one socket, published and never relied on."""

    kind: Literal["SocketProgress"] = "SocketProgress"
    station: str
    socket: str
    serial: str | None = None
    operation: str | None = None
    step: str | None = None
    steps_done: int = 0
    steps_total: int = 0
    bench_time_s: float = 0.0
    outcome: Outcome | None = None


StationRequest = Annotated[RegisterStation | RenewLeases | SubmitRecords, Field(discriminator="kind")]
StationReply = Annotated[
    StationAccepted | StationRefused | LeasesRenewed | RecordsAcknowledged, Field(discriminator="kind")
]
StationCommand = Annotated[StartSequence | AbortSequence, Field(discriminator="kind")]
CommandReply = Annotated[CommandAccepted | CommandRefused, Field(discriminator="kind")]

STATION_REQUEST: TypeAdapter[StationRequest] = TypeAdapter(StationRequest)
STATION_REPLY: TypeAdapter[StationReply] = TypeAdapter(StationReply)
STATION_COMMAND: TypeAdapter[StationCommand] = TypeAdapter(StationCommand)
COMMAND_REPLY: TypeAdapter[CommandReply] = TypeAdapter(CommandReply)

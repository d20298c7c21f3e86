"""What happens to the coordinator: facts, which are journaled, and observations, which are not.

A *fact* moves the line's state; replaying the facts in their order gives the same state again,
whatever the dispatch policy has become since: the policy's choices are facts themselves
(`LeaseGranted`). An *observation* (a renewal, a timer, a liveliness token) changes only what is
known from being in contact, which a restart forgets; it may lead the core to a fact.

Every event carries `at_s`, the wall clock in seconds since 1970 (UTC): the core reads no clock.
"""

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from protocol.attempts import AttemptRecord, SpooledRecord
from protocol.errors import Fault
from protocol.frozen_model import FrozenModel
from protocol.line_views import OrderUnits
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from protocol.station_messages import MAX_RECORDS_PER_SUBMISSION, RegisterStation, RenewLeases

JOURNAL_FORMAT = 1
"""Raised when a fact changes its meaning; a journal of another format is refused."""


class LineSettings(FrozenModel):
    """The line's named times, in seconds of wall clock.

    Attributes:
        lease_duration_s: a lease that is not renewed for this long lapses.
        renewal_period_s: how often a station renews.
        recheck_after_s: after a liveliness token vanished, how long until the station counts as
            silent unless it was heard of meanwhile.
        resend_period_s: pause before a command that was not delivered is sent again.
        refusal_rest_s: a socket that refused, or disturbed two attempts in a row, gets no work for
            this long; the time doubles with every further one, up to `rest_limit_s`.
        rest_limit_s: the longest rest.
        retest_patience_s: how long a retest waits before it may run on a socket where it failed,
            and then only if no other capable socket is in service.
        retest_credit_s: a retest is queued as if it had waited this much longer.
        abort_patience_s: after an abort was commanded, how long until the lease lapses.
        queue_alarm_s: a unit that waited this long without a capable socket raises an alarm.
        alarm_repeat_s: the same alarm about the same subject is not raised again within this time.
    """

    lease_duration_s: float = Field(default=10.0, gt=0)
    renewal_period_s: float = Field(default=1.0, gt=0)
    recheck_after_s: float = Field(default=3.0, gt=0)
    resend_period_s: float = Field(default=1.0, gt=0)
    refusal_rest_s: float = Field(default=5.0, gt=0)
    rest_limit_s: float = Field(default=300.0, gt=0)
    retest_patience_s: float = Field(default=5.0, gt=0)
    retest_credit_s: float = Field(default=60.0, ge=0)
    abort_patience_s: float = Field(default=30.0, gt=0)
    queue_alarm_s: float = Field(default=60.0, gt=0)
    alarm_repeat_s: float = Field(default=60.0, gt=0)


class RecordSummary(FrozenModel):
    """What of a record decides. The record itself is kept beside the journal, in one transaction."""

    sequence_number: int = Field(ge=0)
    attempt_id: str
    fence: int = Field(ge=1)
    serial: str
    operation: str
    station: str
    socket: str
    plan_sha256: str
    outcome: Outcome
    fault: Fault
    safe_state: bool

    @classmethod
    def of(cls, spooled: SpooledRecord) -> "RecordSummary":
        """The summary of a record as a station spooled it."""
        record: AttemptRecord = spooled.record
        lease = record.lease
        return cls(
            sequence_number=spooled.sequence_number,
            attempt_id=record.attempt_id,
            fence=lease.fence,
            serial=lease.unit.serial,
            operation=lease.operation,
            station=lease.station,
            socket=lease.socket,
            plan_sha256=lease.plan.sha256,
            outcome=record.outcome,
            fault=record.fault,
            safe_state=record.safe_state,
        )


# --- facts -----------------------------------------------------------------------------------


class CoordinatorStarted(FrozenModel):
    """A coordinator process took up the line; its settings hold from here on."""

    kind: Literal["CoordinatorStarted"] = "CoordinatorStarted"
    at_s: float
    software_version: str
    settings: LineSettings


class UnitsOrdered(FrozenModel):
    kind: Literal["UnitsOrdered"] = "UnitsOrdered"
    at_s: float
    order: OrderUnits


class StationRegistered(FrozenModel):
    kind: Literal["StationRegistered"] = "StationRegistered"
    at_s: float
    registration: RegisterStation


class LeaseGranted(FrozenModel):
    """The policy's choice: this unit, at this socket, for the operation it waits for."""

    kind: Literal["LeaseGranted"] = "LeaseGranted"
    at_s: float
    fence: int
    serial: str
    operation: str
    station: str
    socket: str
    plan: PlanReference


class SequenceAccepted(FrozenModel):
    """The station has the StartSequence of this lease."""

    kind: Literal["SequenceAccepted"] = "SequenceAccepted"
    at_s: float
    fence: int


class SequenceRefused(FrozenModel):
    """The station will not run this lease: it never began there."""

    kind: Literal["SequenceRefused"] = "SequenceRefused"
    at_s: float
    fence: int
    reason: str
    text: str


class RecordsSubmitted(FrozenModel):
    """Records from a station's spool, oldest first. In the journal: the new ones only."""

    kind: Literal["RecordsSubmitted"] = "RecordsSubmitted"
    at_s: float
    station: str
    incarnation: int
    records: tuple[RecordSummary, ...] = Field(max_length=MAX_RECORDS_PER_SUBMISSION)


class LeaseOverran(FrozenModel):
    """The operation's deadline passed while the station was still at it."""

    kind: Literal["LeaseOverran"] = "LeaseOverran"
    at_s: float
    fence: int


class LeaseLapsed(FrozenModel):
    """The lease was not renewed in time, or its abort not answered: the unit is free again."""

    kind: Literal["LeaseLapsed"] = "LeaseLapsed"
    at_s: float
    fence: int


# --- observations ----------------------------------------------------------------------------

Timer = Literal["lease", "silence", "recheck", "resend", "rest", "patience", "queue"]


class TimerExpired(FrozenModel):
    """A timer that the core had set. `subject`: what it was set for."""

    kind: Literal["TimerExpired"] = "TimerExpired"
    at_s: float
    timer: Timer
    subject: int | str


class StationRenewed(FrozenModel):
    kind: Literal["StationRenewed"] = "StationRenewed"
    at_s: float
    renewal: RenewLeases


class CommandUndelivered(FrozenModel):
    """No answer, an error or a time-out: the station may have the command or not."""

    kind: Literal["CommandUndelivered"] = "CommandUndelivered"
    at_s: float
    fence: int


class StationTokenVanished(FrozenModel):
    """A liveliness token went away: a reason to look, never a reason to re-queue."""

    kind: Literal["StationTokenVanished"] = "StationTokenVanished"
    at_s: float
    station: str
    incarnation: int


Fact = (
    CoordinatorStarted
    | UnitsOrdered
    | StationRegistered
    | LeaseGranted
    | SequenceAccepted
    | SequenceRefused
    | RecordsSubmitted
    | LeaseOverran
    | LeaseLapsed
)
Observation = TimerExpired | StationRenewed | CommandUndelivered | StationTokenVanished
Event = Fact | Observation

FACT: TypeAdapter[Fact] = TypeAdapter(Annotated[Fact, Field(discriminator="kind")])

# pyright: strict
"""What happens to a station agent, and what its core asks of the shell."""

from dataclasses import dataclass

from protocol.attempts import AttemptRecord, Lease
from protocol.station_messages import (
    AbortSequence,
    CommandReply,
    RegisterStation,
    RenewLeases,
    SocketProgress,
    StartSequence,
    StationReply,
)

# Events


@dataclass(frozen=True)
class AgentStarted:
    """The spool is open, the link is there."""


@dataclass(frozen=True)
class CommandReceived:
    """The coordinator commands. `query` names the question to be answered by one `Reply`."""

    query: int
    command: StartSequence | AbortSequence


@dataclass(frozen=True)
class TraceWritten:
    """The spool has the trace of a lease: its sequence may start."""

    fence: int


@dataclass(frozen=True)
class TraceFailed:
    """The spool cannot take the trace."""

    fence: int
    why: str


@dataclass(frozen=True)
class SequenceEnded:
    """The sequence of a lease is over, whatever the outcome, and its socket is at rest."""

    record: AttemptRecord


@dataclass(frozen=True)
class RecordSpooled:
    """A record is durable at the station."""

    attempt_id: str
    sequence_number: int


@dataclass(frozen=True)
class SpoolFailed:
    """The spool cannot take a record now; the core still has it."""

    attempt_id: str
    why: str


@dataclass(frozen=True)
class RegistrationAnswered:
    """The coordinator's answer to `Register`; None: nobody answered."""

    reply: StationReply | None


@dataclass(frozen=True)
class RenewalAnswered:
    """The coordinator's answer to `Renew`; None: nobody answered."""

    reply: StationReply | None


@dataclass(frozen=True)
class SubmissionAnswered:
    """Attempt ids that the coordinator has durably committed; None: nobody answered."""

    acknowledged: tuple[str, ...] | None


@dataclass(frozen=True)
class RecordsDropped:
    """The spool has let acknowledged records go."""

    attempt_ids: tuple[str, ...]


@dataclass(frozen=True)
class DropFailed:
    """The spool could not let them go; they stay and may be submitted again."""

    why: str


@dataclass(frozen=True)
class TimerExpired:
    """A timer set by `SetTimer` has run out."""

    timer: str


@dataclass(frozen=True)
class StopRequested:
    """The process is asked to end."""

    why: str


Event = (
    AgentStarted
    | CommandReceived
    | TraceWritten
    | TraceFailed
    | SequenceEnded
    | RecordSpooled
    | SpoolFailed
    | RegistrationAnswered
    | RenewalAnswered
    | SubmissionAnswered
    | RecordsDropped
    | DropFailed
    | TimerExpired
    | StopRequested
)

# Commands


@dataclass(frozen=True)
class WriteTrace:
    """Leave the trace of a lease in the spool; answered by TraceWritten or TraceFailed."""

    lease: Lease


@dataclass(frozen=True)
class RunLease:
    """Run the sequence of a lease on its socket; answered by SequenceEnded, always."""

    lease: Lease


@dataclass(frozen=True)
class AbortSocket:
    """Bring the running sequence of this lease to its safe state soon."""

    socket: str
    fence: int
    why: str


@dataclass(frozen=True)
class Reply:
    """Answer a command of the coordinator."""

    query: int
    reply: CommandReply


@dataclass(frozen=True)
class SpoolRecord:
    """Make a record durable; answered by RecordSpooled or SpoolFailed."""

    record: AttemptRecord


@dataclass(frozen=True)
class Register:
    """Ask the coordinator to take this station; answered by RegistrationAnswered."""

    request: RegisterStation


@dataclass(frozen=True)
class Renew:
    """Tell the coordinator what is being worked on; answered by RenewalAnswered."""

    request: RenewLeases


@dataclass(frozen=True)
class Submit:
    """Submit the spooled records with these numbers; answered by SubmissionAnswered."""

    sequence_numbers: tuple[int, ...]


@dataclass(frozen=True)
class DropRecords:
    """Acknowledged: let the spool forget them; answered by RecordsDropped or DropFailed."""

    attempt_ids: tuple[str, ...]


@dataclass(frozen=True)
class SetTimer:
    """Send TimerExpired after this time; a timer of the same name is replaced."""

    timer: str
    after_s: float


@dataclass(frozen=True)
class Publish:
    """Show this on the live view."""

    progress: SocketProgress


@dataclass(frozen=True)
class RaiseAlarm:
    """A person should look at this: into the log, and onto the live view of every socket."""

    alarm: str
    text: str


@dataclass(frozen=True)
class Leave:
    """End the process with this exit code."""

    exit_code: int
    why: str


Command = (
    WriteTrace
    | RunLease
    | AbortSocket
    | Reply
    | SpoolRecord
    | Register
    | Renew
    | Submit
    | DropRecords
    | SetTimer
    | Publish
    | RaiseAlarm
    | Leave
)

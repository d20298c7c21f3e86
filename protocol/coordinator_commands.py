"""What the coordinator's core asks of its shell.

`StartSequence` and `AbortSequence` (protocol/station_messages.py) are commands as they are: the
shell sends them to their station and reports back what became of them.

The order matters: within the commands of one `handle`, everything to be kept (`Journal`,
`KeepRecord`, `KeepUnit`, `RaiseAlarm`) is committed in one transaction before anything is
answered or sent.
"""

from typing import NamedTuple

from protocol.coordinator_events import Fact, Timer
from protocol.line_views import Alarm, OrderAccepted
from protocol.outcomes import Disposition
from protocol.station_messages import (
    AbortSequence,
    LeasesRenewed,
    RecordsAcknowledged,
    RequestRejected,
    StartSequence,
    StationAccepted,
    StationRefused,
)

Reply = (
    StationAccepted | StationRefused | LeasesRenewed | RecordsAcknowledged | OrderAccepted | RequestRejected
)


class Journal(NamedTuple):
    """Append this fact to the journal."""

    fact: Fact


class Answer(NamedTuple):
    """The reply to the request that this event came from. RequestRejected goes as an error reply."""

    reply: Reply


class SetTimer(NamedTuple):
    """Come back with TimerExpired at `at_s`. Timers are never cancelled, only found out of date."""

    timer: Timer
    subject: int | str
    at_s: float


class KeepRecord(NamedTuple):
    """Store this record of the submission. `set_aside`: its lease was no longer valid."""

    attempt_id: str
    fence: int
    set_aside: bool
    received_at_s: float


class KeepUnit(NamedTuple):
    """A unit is new or has moved: `operation` is the one it is at, None when it is finished."""

    serial: str
    product: str
    lot: str
    route: str
    disposition: Disposition
    operation: str | None
    at_s: float


class RaiseAlarm(NamedTuple):
    """Something a person should look at."""

    alarm: Alarm


Command = Journal | Answer | SetTimer | KeepRecord | KeepUnit | RaiseAlarm | StartSequence | AbortSequence

"""What people ask the coordinator, and the read models it answers with.

Queries on `…/coordinator/<verb>/<client>`: OrderUnits, GetLineStatus, GetUnit, GetYield.
An unknown serial is an error reply (RequestRejected), never an empty answer.
"""

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from protocol.attempts import AttemptRecord, UnitIdentity
from protocol.frozen_model import FrozenModel
from protocol.outcomes import Disposition, Outcome
from protocol.routes import Route

MAX_UNITS_PER_ORDER = 10_000


class OrderUnits(FrozenModel):
    """Put units on the line. `order_id` is the idempotency key."""

    kind: Literal["OrderUnits"] = "OrderUnits"
    order_id: str
    route: Route
    units: tuple[UnitIdentity, ...] = Field(min_length=1, max_length=MAX_UNITS_PER_ORDER)


class OrderAccepted(FrozenModel):
    """The order is durably on the line. `already_known`: serials that were there before."""

    kind: Literal["OrderAccepted"] = "OrderAccepted"
    order_id: str
    accepted: int
    already_known: tuple[str, ...] = ()


class GetLineStatus(FrozenModel):
    kind: Literal["GetLineStatus"] = "GetLineStatus"


class GetUnit(FrozenModel):
    kind: Literal["GetUnit"] = "GetUnit"
    serial: str


class GetYield(FrozenModel):
    kind: Literal["GetYield"] = "GetYield"


class SocketStatus(FrozenModel):
    """A socket and the unit on it, if any."""

    socket: str
    operations: tuple[str, ...]
    serial: str | None = None
    operation: str | None = None
    fence: int | None = None
    leased_since_s: float | None = None


class StationStatus(FrozenModel):
    """`state`: ready (renewing its leases), silent (not heard of), refused."""

    station: str
    state: Literal["ready", "silent", "refused"]
    incarnation: int
    sockets: tuple[SocketStatus, ...]
    last_heard_s: float


class UnitStatus(FrozenModel):
    """Where a unit is. `operation` is the one it waits for or is at; None when it is done.

    `waits_for` is English; `say(waits_for_template, **waits_for_values)` says it in the chosen
    language where the template is given.
    """

    unit: UnitIdentity
    disposition: Disposition
    operation: str | None = None
    station: str | None = None
    socket: str | None = None
    attempts: int = 0
    queue_position: int | None = None
    waits_for: str = ""
    waits_for_template: str = ""
    waits_for_values: dict[str, str] = Field(default_factory=dict)


class OperationYield(FrozenModel):
    """First-pass yield of one operation (or of one station at it).

    `fpy`: as peers count it, every first attempt that is not a PASS counts against it.
    `fpy_unit`: only unit faults count, at the first attempt that judged the unit (`first_judged`
    units: PASS or unit fault). None when there is no attempt yet.
    """

    operation: str
    station: str | None = None
    first_attempts: int
    first_passes: int
    first_unit_faults: int
    first_judged: int = 0
    attempts: int
    passes: int
    fpy: float | None = None
    fpy_unit: float | None = None


class YieldReport(FrozenModel):
    """Yield of the line. `rty`: product of the operations' FPY. `final`: shipped / finished."""

    kind: Literal["YieldReport"] = "YieldReport"
    operations: tuple[OperationYield, ...]
    stations: tuple[OperationYield, ...]
    rty: float | None = None
    rty_unit: float | None = None
    final: float | None = None
    dispositions: dict[str, int]


class Alarm(FrozenModel):
    """Something a person should look at.

    `text` is English; `say(alarm.template, **alarm.values)` says it in the chosen language.
    """

    raised_at_s: float
    alarm: str
    subject: str
    text: str
    template: str = ""
    values: dict[str, str] = Field(default_factory=dict)


class LineStatus(FrozenModel):
    """The whole line at one moment."""

    kind: Literal["LineStatus"] = "LineStatus"
    line: str
    at_s: float
    stations: tuple[StationStatus, ...]
    units: tuple[UnitStatus, ...]
    queue_lengths: dict[str, int]
    yield_report: YieldReport
    alarms: tuple[Alarm, ...]
    attempts_recorded: int
    records_set_aside: int
    duplicates_ignored: int
    finished: bool
    expected_remaining_s: float | None = None


class AttemptView(FrozenModel):
    """An attempt as kept. `set_aside`: its lease had been revoked, it did not move the unit."""

    record: AttemptRecord
    set_aside: bool = False
    received_at_s: float


class UnitHistory(FrozenModel):
    """A unit with everything known of it."""

    kind: Literal["UnitHistory"] = "UnitHistory"
    status: UnitStatus
    attempts: tuple[AttemptView, ...]
    outcomes: dict[str, Outcome] = Field(default_factory=dict)


ClientRequest = Annotated[OrderUnits | GetLineStatus | GetUnit | GetYield, Field(discriminator="kind")]
ClientReply = Annotated[OrderAccepted | LineStatus | UnitHistory | YieldReport, Field(discriminator="kind")]

CLIENT_REQUEST: TypeAdapter[ClientRequest] = TypeAdapter(ClientRequest)
CLIENT_REPLY: TypeAdapter[ClientReply] = TypeAdapter(ClientReply)

"""A line in one thread: the real core, and stations that say what a test tells them to."""

from collections.abc import Callable
from typing import Any

import pytest

from coordinator.core.invariants import InvariantChecker
from coordinator.core.line_core import CoordinatorCore
from protocol.attempts import AttemptRecord, Lease, SpooledRecord, UnitIdentity
from protocol.coordinator_commands import Answer, Command, Journal, KeepRecord, RaiseAlarm, SetTimer
from protocol.coordinator_events import (
    CoordinatorStarted,
    Event,
    LineSettings,
    RecordsSubmitted,
    RecordSummary,
    SequenceAccepted,
    StationRegistered,
    StationRenewed,
    TimerExpired,
    UnitsOrdered,
)
from protocol.errors import Fault
from protocol.line_views import OrderUnits
from protocol.measurements import Measurement, MeasurementSpecification
from protocol.outcomes import MeasurementOutcome, Outcome
from protocol.plans import PlanReference
from protocol.routes import GNC_MODULE_ROUTE, Route
from protocol.station_messages import (
    AbortSequence,
    RegisterStation,
    RenewLeases,
    SocketDescription,
    StartSequence,
)

PLANS = {
    name: PlanReference(operation=name, name=name, version="1", sha256=digit * 64)
    for name, digit in (("functional", "a"), ("imu_calibration", "b"))
}
MAX_TIMERS = 10_000


class LineDriver:
    """Drives a core, checks every invariant after every event, keeps its journal and timers."""

    def __init__(self, settings: LineSettings | None = None) -> None:
        self.core = CoordinatorCore()
        self.settings = settings or LineSettings()
        self.checker = InvariantChecker()
        self.now_s = 1_000.0
        self.journal: list[Any] = []
        self.timers: list[SetTimer] = []
        self.started: list[Lease] = []
        self.aborted: list[AbortSequence] = []
        self.kept: list[KeepRecord] = []
        self.alarms: list[str] = []
        self.sequence: dict[str, int] = {}
        self.start()

    def start(self) -> None:
        self.handle(CoordinatorStarted(at_s=self.now_s, software_version="test", settings=self.settings))

    def handle(self, event: Event) -> Any:
        """The answer to an event, None when there is none."""
        commands: tuple[Command, ...] = self.core.handle(event)
        self.checker.check(self.core.floor)
        answer = None
        for command in commands:
            match command:
                case Journal():
                    self.journal.append(command.fact)
                case Answer():
                    answer = command.reply
                case SetTimer():
                    self.timers.append(command)
                case StartSequence():
                    self.started.append(command.lease)
                case AbortSequence():
                    self.aborted.append(command)
                case KeepRecord():
                    self.kept.append(command)
                case RaiseAlarm():
                    self.alarms.append(command.alarm.alarm)
                case _:
                    pass
        return answer

    def wait(self, seconds: float) -> None:
        """Let time pass; timers that are due come back, in order."""
        end_s = self.now_s + seconds
        for _ in range(MAX_TIMERS):
            due = [timer for timer in self.timers if timer.at_s <= end_s]
            if not due:
                break
            first = min(due, key=lambda timer: timer.at_s)
            self.timers.remove(first)
            self.now_s = max(self.now_s, first.at_s)
            self.handle(TimerExpired(at_s=self.now_s, timer=first.timer, subject=first.subject))
        self.now_s = end_s

    def order(self, *serials: str, route: Route = GNC_MODULE_ROUTE, order_id: str = "") -> Any:
        units = tuple(UnitIdentity(serial=serial, product=route.product, lot="L1") for serial in serials)
        order = OrderUnits(order_id=order_id or "-".join(serials), route=route, units=units)
        return self.handle(UnitsOrdered(at_s=self.now_s, order=order))

    def register(
        self,
        station: str,
        operation: str = "functional",
        sockets: str = "A",
        incarnation: int = 1,
        bench: str = "",
        held: tuple[Lease, ...] = (),
        spool: tuple[int, int, int] | None = None,
        newest_fence: int = 0,
    ) -> Any:
        first, last, following = spool or (0, 0, self.sequence.get(station, 0) + 1)
        registration = RegisterStation(
            station=station,
            incarnation=incarnation,
            bench_identity=bench or f"bench of {station}",
            sockets=tuple(SocketDescription(socket=name, operations=(operation,)) for name in sockets),
            plans=(PLANS[operation],),
            held=held,
            spool_first=first,
            spool_last=last,
            spool_next=following,
            newest_fence=newest_fence,
        )
        return self.handle(StationRegistered(at_s=self.now_s, registration=registration))

    def renew(self, station: str, *fences: int, incarnation: int = 1) -> Any:
        renewal = RenewLeases(station=station, incarnation=incarnation, fences=fences)
        return self.handle(StationRenewed(at_s=self.now_s, renewal=renewal))

    def accept(self, lease: Lease) -> None:
        self.handle(SequenceAccepted(at_s=self.now_s, fence=lease.fence))

    def summary(
        self, lease: Lease, outcome: Outcome, fault: Fault, number: int | None = None
    ) -> RecordSummary:
        if number is None:
            number = self.sequence[lease.station] = self.sequence.get(lease.station, 0) + 1
        record = make_record(lease, outcome, fault)
        return RecordSummary.of(SpooledRecord(sequence_number=number, record=record))

    def submit(
        self,
        lease: Lease,
        outcome: Outcome = Outcome.PASS,
        fault: Fault | None = None,
        number: int | None = None,
    ) -> Any:
        """Submit the record of a lease: FAIL is the unit's fault if nothing else is said."""
        if fault is None:
            fault = Fault.UNIT if outcome is Outcome.FAIL else Fault.NONE
        summary = self.summary(lease, outcome, fault, number)
        return self.submit_again(summary)

    def submit_again(self, *summaries: RecordSummary) -> Any:
        event = RecordsSubmitted(
            at_s=self.now_s, station=summaries[0].station, incarnation=1, records=summaries
        )
        return self.handle(event)

    def unit(self, serial: str) -> Any:
        return self.core.line.units[serial]

    @property
    def newest(self) -> Lease:
        return self.started[-1]


def make_record(
    lease: Lease, outcome: Outcome = Outcome.PASS, fault: Fault = Fault.NONE, steps: tuple[Any, ...] = ()
) -> AttemptRecord:
    return AttemptRecord(
        attempt_id=lease.attempt_id,
        lease=lease,
        incarnation=1,
        outcome=outcome,
        fault=fault,
        started_at_s=1.0,
        ended_at_s=2.0,
        steps=steps,
        safe_state=True,
        software_version="test",
    )


def make_measurement(name: str, value: Any, **specification: Any) -> Measurement:
    described = MeasurementSpecification(name=name, **specification)
    outcome = described.judge(value) if value is not None else MeasurementOutcome.UNSET
    return Measurement(specification=described, value=value, outcome=outcome)


@pytest.fixture
def line() -> LineDriver:
    return LineDriver()


@pytest.fixture
def new_line() -> Callable[..., LineDriver]:
    return LineDriver


@pytest.fixture
def record_of() -> Callable[..., AttemptRecord]:
    return make_record


@pytest.fixture
def measurement_of() -> Callable[..., Measurement]:
    return make_measurement

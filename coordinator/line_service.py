"""Core and store together: requests in, answers out, everything durable before it is said.

One thread owns it. A batch of requests and events goes through the core, is committed in one
transaction, and only then answered; what stations are to be told is handed back. Views are answered
after the commit, so nobody sees what is not durable.

If the commit fails, the core knows more than the journal: it is thrown away, every request of the
batch is refused, and `recover` builds a new core from the journal once the store can be written
again. A request that cannot be handled or stored for a reason of its own is found by running its
batch one by one, and only it is refused.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

import structlog

from coordinator.core import views
from coordinator.core.line_core import CoordinatorCore
from coordinator.core.presence import MAX_ALARMS_KEPT
from coordinator.requests import NotUnderstood, Query, Request, understood
from coordinator.store.line_store import Batch, LineStore
from coordinator.store.schema import StoreConflictError, StoreDamagedError, StoreUnavailableError
from protocol.attempts import AttemptRecord
from protocol.coordinator_commands import (
    Answer,
    Journal,
    KeepRecord,
    KeepUnit,
    RaiseAlarm,
    SetTimer,
)
from protocol.coordinator_events import (
    CoordinatorStarted,
    Event,
    LineSettings,
    RecordsSubmitted,
    RecordSummary,
    StationRegistered,
    StationRenewed,
    Timer,
    TimerExpired,
    UnitsOrdered,
)
from protocol.errors import Fault, TestloomError
from protocol.line_views import GetLineStatus, GetUnit, GetYield, OrderUnits
from protocol.station_messages import (
    AbortSequence,
    RegisterStation,
    RenewLeases,
    RequestRejected,
    StartSequence,
    SubmitRecords,
)

MAX_TIMERS_PER_BATCH = 1_000
STANDSTILL_SHARE = 0.5
"""A coordinator that took no turn for this share of a lease's duration has not listened."""

CLOCK_STEP_S = 0.1
"""A clock that is this much behind the journal was set back."""

ToStation = StartSequence | AbortSequence

_log = structlog.get_logger("coordinator")


@dataclass(slots=True)
class _Turn:
    """One batch on its way: what to write, whom to answer after the commit, what to do then."""

    batch: Batch = field(default_factory=Batch)
    answers: list[tuple[Query, Any]] = field(default_factory=list[tuple[Query, Any]])
    views: list[tuple[Query, GetLineStatus | GetUnit | GetYield]] = field(
        default_factory=list[tuple[Query, GetLineStatus | GetUnit | GetYield]]
    )
    timers: list[SetTimer] = field(default_factory=list[SetTimer])
    to_stations: list[ToStation] = field(default_factory=list[ToStation])


class LineService:
    """The line's core on its store."""

    def __init__(
        self,
        url: str,
        line: str,
        settings: LineSettings,
        software_version: str,
        wall_clock: Callable[[], float],
    ) -> None:
        self._url = url
        self._line = line
        self._settings = settings
        self._software_version = software_version
        self._wall_clock = wall_clock
        self._newest_at_s = 0.0
        self._ahead_s = 0.0
        self._turn_at_s = 0.0
        self._store: LineStore | None = None
        self._core: CoordinatorCore | None = None
        self._timers: list[tuple[float, int, Timer, int | str]] = []
        self._timers_set = 0
        self.unavailable = StoreUnavailableError("The coordinator is starting.", remedy="try again.")

    @property
    def available(self) -> bool:
        """The line is being worked on; otherwise every request is refused."""
        return self._core is not None

    def recover(self) -> list[ToStation]:
        """Build the core from the journal and take up the line.

        Returns:
            What stations are to be told at once; empty when the store is (still) unavailable.

        Raises:
            StoreDamagedError, StoreConflictError, TestloomError: waiting will not help.
        """
        self.close()
        try:
            store = self._store = LineStore(self._url, self._line)
            core = CoordinatorCore()
            count = 0
            for fact in store.facts():
                core.replay(fact)
                self._newest_at_s = max(self._newest_at_s, fact.at_s)
                count += 1
            core.floor.presence.alarms.extend(store.recent_alarms(MAX_ALARMS_KEPT))
            self._core = core
            turn = _Turn()
            started = CoordinatorStarted(
                at_s=self._now_s(), software_version=self._software_version, settings=self._settings
            )
            self._handle(started, None, turn)
            store.commit(turn.batch)
        except StoreUnavailableError as error:
            self._become_unavailable(error)
            return []
        _log.info("line_taken_up", journal_lines=count, units=len(core.line.units), store=store.place)
        self._turn_at_s = self._now_s()
        return self._finish(turn)

    def stood_still(self) -> bool:
        """Whether no turn was begun for so long that leases look lapsed only because nobody listened
        (a frozen process or machine, a stalled disk). To be asked at the beginning of each turn; the
        answer to a standstill is `recover`, which gives every station a full term again."""
        before_s, self._turn_at_s = self._turn_at_s, self._now_s()
        away_s = self._turn_at_s - before_s
        stood = self.available and away_s > STANDSTILL_SHARE * self._settings.lease_duration_s
        if stood:
            _log.warning("stood_still", away_s=round(away_s, 1))
        return stood

    def process(self, items: Iterable[Request | Event]) -> list[ToStation]:
        """Handle requests, events and due timers as one batch.

        Returns:
            What stations are to be told now.

        Raises:
            StoreConflictError, StoreDamagedError: this coordinator must not go on.
        """
        work: list[Request | Event] = [*items, *self._due_timers()]
        if not work or self._refused_for_now(work):
            return []
        turn = _Turn()
        try:
            self._run(work, turn)
            self._commit(turn)
        except StoreUnavailableError as error:
            self._become_unavailable(error)
            self._refused_for_now(work)
            return []
        except (StoreConflictError, StoreDamagedError) as error:
            self._become_unavailable(StoreUnavailableError(error.what, remedy=error.remedy))
            self._refused_for_now(work)
            raise
        except Exception as error:  # noqa: BLE001 - one request must not stop the line
            return self._one_by_one(work, error)
        return self._finish(turn)

    def check_sole_writer(self) -> None:
        """Another coordinator of this line showed itself: whose is the journal?

        Raises:
            StoreConflictError: the other's.
        """
        if self._store is not None and self.available:
            try:
                self._store.check_sole_writer()
            except StoreUnavailableError as error:
                self._become_unavailable(error)

    def seconds_to_next_timer(self) -> float | None:
        """How long until a timer is due; None when there is none."""
        return max(0.0, self._timers[0][0] - self._now_s()) if self._timers else None

    def close(self) -> None:
        """Let go of the store."""
        self._core = None
        self._timers.clear()
        if self._store is not None:
            self._store.close()
            self._store = None

    # --- a turn ------------------------------------------------------------------------------------

    def _run(self, work: list[Request | Event], turn: _Turn) -> None:
        for item in work:
            if not isinstance(item, Request):
                self._handle(item.model_copy(update={"at_s": self._now_s()}), None, turn)
                continue
            try:
                self._take(item, turn)
            except NotUnderstood as error:
                rejection = RequestRejected(
                    what=f"The request was not understood: {error}.",
                    fault=Fault.OPERATOR.value,
                    remedy="see that both sides run the same version of Testloom.",
                )
                turn.answers.append((item.query, rejection))

    def _take(self, request: Request, turn: _Turn) -> None:
        match understood(request):
            case OrderUnits() as order:
                self._handle(UnitsOrdered(at_s=self._now_s(), order=order), request, turn)
            case RegisterStation() as registration:
                self._handle(StationRegistered(at_s=self._now_s(), registration=registration), request, turn)
            case RenewLeases() as renewal:
                self._handle(StationRenewed(at_s=self._now_s(), renewal=renewal), request, turn)
            case SubmitRecords() as submission:
                self._submit(submission, request, turn)
            case asked:
                turn.views.append((request.query, asked))

    def _submit(self, message: SubmitRecords, request: Request, turn: _Turn) -> None:
        records = {(s.record.attempt_id, s.record.lease.fence): s.record for s in message.records}
        event = RecordsSubmitted(
            at_s=self._now_s(),
            station=message.station,
            incarnation=message.incarnation,
            records=tuple(RecordSummary.of(spooled) for spooled in message.records),
        )
        self._handle(event, request, turn, records)

    def _handle(
        self,
        event: Event,
        request: Request | None,
        turn: _Turn,
        records: dict[tuple[str, int], AttemptRecord] | None = None,
    ) -> None:
        assert self._core is not None
        batch = turn.batch
        for command in self._core.handle(event):
            match command:
                case Journal():
                    batch.facts.append(command.fact)
                case Answer():
                    if request is not None:
                        turn.answers.append((request.query, command.reply))
                case KeepRecord():
                    assert records is not None
                    batch.records.append((records[command.attempt_id, command.fence], command))
                case KeepUnit():
                    batch.units[command.serial] = command
                case RaiseAlarm():
                    batch.alarms.append(command.alarm)
                case SetTimer():
                    turn.timers.append(command)
                case StartSequence() | AbortSequence():
                    turn.to_stations.append(command)

    def _commit(self, turn: _Turn) -> None:
        assert self._store is not None
        self._store.commit(turn.batch)

    def _finish(self, turn: _Turn) -> list[ToStation]:
        """After the commit: say it, show it, do it."""
        for query, reply in turn.answers:
            if isinstance(reply, RequestRejected):
                query.reject(reply.what, Fault(reply.fault), reply.remedy)
            else:
                query.reply(reply.model_dump_json().encode())
        for query, asked in turn.views:
            self._show(query, asked)
        for timer in turn.timers:
            self._timers_set += 1
            heappush(self._timers, (timer.at_s, self._timers_set, timer.timer, timer.subject))
        for alarm in turn.batch.alarms:
            _log.warning("alarm", alarm=alarm.alarm, subject=alarm.subject, text=alarm.text)
        return turn.to_stations

    def _show(self, query: Query, asked: GetLineStatus | GetUnit | GetYield) -> None:
        assert self._core is not None
        assert self._store is not None
        try:
            match asked:
                case GetLineStatus():
                    view = views.line_status(self._core.floor, self._line, self._now_s())
                case GetYield():
                    view = views.yield_report(self._core.line)
                case GetUnit():
                    if asked.serial not in self._core.line.units:
                        raise views.unknown_serial(asked.serial)
                    attempts = self._store.attempts_of(asked.serial)
                    view = views.unit_history(self._core.floor, asked.serial, attempts)
        except TestloomError as error:
            query.reject(error.what, error.fault, error.remedy)
        else:
            query.reply(view.model_dump_json().encode())

    # --- when something is wrong ---------------------------------------------------------------------

    def _become_unavailable(self, error: StoreUnavailableError) -> None:
        if self._core is not None or error.what != self.unavailable.what:
            _log.error("store_unavailable", what=error.what, where=error.where, story=error.story)
        self.unavailable = error
        self.close()

    def _refused_for_now(self, work: list[Request | Event]) -> bool:
        """Refuse all requests while there is no core. Events are forgotten: a new core asks again."""
        if self.available:
            return False
        for item in work:
            if isinstance(item, Request):
                item.query.reject(self.unavailable.what, self.unavailable.fault, self.unavailable.remedy)
        return True

    def _one_by_one(self, work: list[Request | Event], error: Exception) -> list[ToStation]:
        """A batch failed for a reason of its own: find the request and refuse only that one."""
        _log.error("batch_failed", error=type(error).__name__, text=str(error), items=len(work))
        to_stations = self.recover()
        if len(work) == 1:
            if isinstance(work[0], Request):
                work[0].query.reject(
                    f"The coordinator cannot take this request: {error}.",
                    Fault.TESTLOOM,
                    "keep it and report it with the coordinator's log.",
                )
            return to_stations
        for item in work:
            if isinstance(item, Request):
                to_stations += self.process([item])
        return to_stations

    # --- time ----------------------------------------------------------------------------------------

    def _now_s(self) -> float:
        """The wall clock, never going back, also not behind the journal. Where it was set back, time goes
        on from where it was: if it stood still until the clock has caught up, no lease could lapse."""
        behind_s = self._newest_at_s - (self._wall_clock() + self._ahead_s)
        if behind_s > 0:
            self._ahead_s += behind_s
            if behind_s > CLOCK_STEP_S:
                _log.warning("clock_set_back", by_s=round(behind_s, 3))
        self._newest_at_s = max(self._newest_at_s, self._wall_clock() + self._ahead_s)
        return self._newest_at_s

    def _due_timers(self) -> list[TimerExpired]:
        now_s = self._now_s()
        due: list[TimerExpired] = []
        while self._timers and self._timers[0][0] <= now_s and len(due) < MAX_TIMERS_PER_BATCH:
            _, _, timer, subject = heappop(self._timers)
            due.append(TimerExpired(at_s=now_s, timer=timer, subject=subject))
        return due

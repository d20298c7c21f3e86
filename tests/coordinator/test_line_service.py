"""Core and store together, driven by queries: durable before said, refused when it cannot be kept."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import create_engine, text

from coordinator.line_service import LineService
from coordinator.requests import Request
from coordinator.store.schema import StoreConflictError, StoreDamagedError
from protocol.attempts import Lease, SpooledRecord, UnitIdentity
from protocol.coordinator_events import LineSettings, SequenceAccepted
from protocol.errors import Fault
from protocol.frozen_model import FrozenModel
from protocol.line_views import GetLineStatus, GetUnit, GetYield, OrderUnits
from protocol.measurements import Measurement
from protocol.outcomes import Outcome
from protocol.plans import PlanReference
from protocol.routes import GNC_MODULE_ROUTE
from protocol.station_messages import RegisterStation, RenewLeases, SocketDescription, SubmitRecords

PLAN = PlanReference(operation="functional", name="functional", version="1", sha256="a" * 64)


class AskedQuery:
    """A query that remembers its answer."""

    def __init__(self, key: str, payload: bytes) -> None:
        self.key = key
        self.payload = payload
        self.answers: list[dict[str, Any]] = []
        self.rejections: list[tuple[str, Fault, str]] = []

    def reply(self, payload: bytes) -> None:
        self.answers.append(json.loads(payload))

    def reject(self, what: str, fault: Fault, remedy: str = "") -> None:
        self.rejections.append((what, fault, remedy))


class ServiceDriver:
    def __init__(self, folder: Path) -> None:
        self.url = f"sqlite:///{folder / 'line.db'}"
        self.now_s = 1_000.0
        self.service = self.new_service()
        self.service.recover()
        self.to_stations: list[Any] = []

    def new_service(self) -> LineService:
        return LineService(self.url, "line-1", LineSettings(), "test", lambda: self.now_s)

    def query(self, verb: str, message: FrozenModel | bytes, sender: str = "F1") -> AskedQuery:
        payload = message if isinstance(message, bytes) else message.model_dump_json().encode()
        return AskedQuery(f"testloom/line-1/coordinator/{verb}/{sender}", payload)

    def ask(self, verb: Any, message: FrozenModel | bytes, sender: str = "F1") -> AskedQuery:
        query = self.query(verb, message, sender)
        self.to_stations += self.service.process([Request(verb, query)])
        assert len(query.answers) + len(query.rejections) == 1, "exactly one answer"
        return query

    def restart(self) -> None:
        self.service.close()
        self.service = self.new_service()
        self.to_stations = self.service.recover()

    def sql(self, statement: str) -> None:
        engine = create_engine(self.url)
        with engine.begin() as connection:
            connection.execute(text(statement))
        engine.dispose()

    def begin(self) -> Lease:
        """One unit ordered, one station registered: the lease it is offered."""
        unit = UnitIdentity(serial="GM-1", product="gnc_module", lot="L1")
        self.ask("request", OrderUnits(order_id="o", route=GNC_MODULE_ROUTE, units=(unit,)), "cli")
        self.ask("register", registration())
        return self.to_stations[-1].lease


def registration(station: str = "F1") -> RegisterStation:
    return RegisterStation(
        station=station,
        incarnation=5,
        bench_identity="b1",
        sockets=(SocketDescription(socket="A", operations=("functional",)),),
        plans=(PLAN,),
    )


@pytest.fixture
def driver(tmp_path: Path) -> Iterator[ServiceDriver]:
    driver = ServiceDriver(tmp_path)
    yield driver
    driver.service.close()


@pytest.fixture
def submission(record_of: Callable) -> Callable[..., SubmitRecords]:
    def submit(lease: Lease, number: int = 1, **changes: Any) -> SubmitRecords:
        record = record_of(lease).model_copy(update=changes)
        spooled = SpooledRecord(sequence_number=number, record=record)
        return SubmitRecords(station="F1", incarnation=5, records=(spooled,))

    return submit


def test_a_record_once_acknowledged_survives_the_process(driver, submission) -> None:
    lease = driver.begin()
    acknowledged = driver.ask("submit", submission(lease)).answers[0]
    assert acknowledged["attempt_ids"] == ["GM-1.functional.1"]
    driver.restart()  # nothing was said good-bye to: the journal is all there is
    history = driver.ask("request", GetUnit(serial="GM-1"), "cli").answers[0]
    assert history["status"]["operation"] == "imu_calibration"
    assert history["outcomes"] == {"functional": "PASS"}
    assert [attempt["record"]["attempt_id"] for attempt in history["attempts"]] == ["GM-1.functional.1"]
    again = driver.ask("submit", submission(lease)).answers[0]
    assert again["attempt_ids"] == ["GM-1.functional.1"]
    status = driver.ask("request", GetLineStatus(), "cli").answers[0]
    assert (status["attempts_recorded"], status["duplicates_ignored"]) == (1, 1)


def test_an_offer_that_was_committed_and_never_sent_is_sent_after_a_restart(driver) -> None:
    lease = driver.begin()
    driver.restart()
    assert [command.lease for command in driver.to_stations] == [lease]
    driver.service.process([SequenceAccepted(at_s=0.0, fence=lease.fence)])
    driver.restart()
    assert driver.to_stations == []


def test_a_full_disk_refuses_and_keeps_the_daemon_up_until_there_is_room(driver, submission) -> None:
    lease = driver.begin()
    engine = driver.service._store._engine
    with engine.connect() as connection:
        connection.execute(
            text(f"PRAGMA max_page_count={connection.execute(text('PRAGMA page_count')).scalar()}")
        )
    big = submission(lease, message="x" * 200_000)
    what, fault, remedy = driver.ask("submit", big).rejections[0]
    assert "full" in what
    assert fault is Fault.TESTLOOM
    assert "make room" in remedy
    assert not driver.service.available
    assert "full" in driver.ask("request", GetYield(), "cli").rejections[0][0]
    driver.service.recover()  # a new connection has no page limit: there is room again
    assert driver.ask("submit", big).answers[0]["attempt_ids"] == [lease.attempt_id]


def test_a_locked_database_is_waited_for(driver, submission, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coordinator.store.schema.BUSY_TIMEOUT_MS", 10)
    lease = driver.begin()
    driver.restart()
    holder = create_engine(driver.url)
    with holder.connect() as connection:
        connection.exec_driver_sql("BEGIN IMMEDIATE")
        assert "locked" in driver.ask("submit", submission(lease)).rejections[0][0]
        assert driver.service.recover() == []
        assert not driver.service.available
        connection.exec_driver_sql("ROLLBACK")
    holder.dispose()
    driver.service.recover()
    assert driver.service.available
    assert driver.ask("submit", submission(lease)).answers


def test_a_damaged_journal_stops_the_coordinator_with_its_line(driver) -> None:
    driver.begin()
    driver.sql("UPDATE journal SET fact = '{}' WHERE sequence = 2")
    with pytest.raises(StoreDamagedError, match="line 2"):
        driver.restart()


def test_a_second_coordinator_stops_instead_of_mixing_in(driver, submission) -> None:
    lease = driver.begin()
    other = driver.new_service()
    other.recover()  # it writes 'CoordinatorStarted': from here on the journal is its own
    query = driver.query("submit", submission(lease))
    with pytest.raises(StoreConflictError, match="Another coordinator"):
        driver.service.process([Request("submit", query)])
    assert query.rejections, "the station keeps its record"
    assert not query.answers
    other.close()


def test_one_request_that_cannot_be_kept_is_refused_and_the_others_are_not(
    driver, submission, measurement_of: Callable[..., Measurement], record_of, monkeypatch: pytest.MonkeyPatch
) -> None:
    from coordinator.store import line_store

    lease = driver.begin()
    original = line_store._attempt_row

    def attempt_row(record: Any, keep: Any) -> Any:
        if record.message == "poison":
            raise OverflowError("int too large")
        return original(record, keep)

    monkeypatch.setattr(line_store, "_attempt_row", attempt_row)
    foreign = lease.model_copy(update={"fence": 900, "attempt_id": "X.1"})
    poison = driver.query("submit", submission(foreign, message="poison"))
    good = driver.query("submit", submission(lease))
    renewal = driver.query("renew", RenewLeases(station="F1", incarnation=5, fences=(lease.fence,)))
    driver.service.process([Request("submit", poison), Request("submit", good), Request("renew", renewal)])
    assert "cannot take this request: int too large" in poison.rejections[0][0]
    assert good.answers[0]["attempt_ids"] == [lease.attempt_id]
    assert len(renewal.answers) == 1
    assert driver.service.available


@pytest.mark.parametrize(
    ("verb", "payload", "said"),
    [
        ("request", b"not json", "Invalid JSON"),
        ("submit", b'{"kind": "RegisterStation"}', "station"),
        ("request", b'{"kind": "Destroy"}', "Destroy"),
        ("register", registration("F2").model_dump_json().encode(), "F1 speaks for F2"),
        ("register", registration().model_dump_json().replace('"A"', '"A/B"').encode(), "'A/B' cannot be"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_reason(driver, verb, payload, said) -> None:
    what, _, remedy = driver.ask(verb, payload).rejections[0]
    assert said in what
    assert remedy
    assert driver.service.available


def test_a_fence_that_no_line_could_have_given_is_refused(driver, submission) -> None:
    lease = driver.begin()
    absurd = lease.model_copy(update={"fence": 2**60})
    assert "no line has given out" in driver.ask("submit", submission(absurd)).rejections[0][0]


def test_an_unknown_serial_is_an_error_and_not_an_empty_answer(driver) -> None:
    what, fault, _ = driver.ask("request", GetUnit(serial="GM-9"), "cli").rejections[0]
    assert "'GM-9' is not known" in what
    assert fault is Fault.OPERATOR


def test_a_record_that_cannot_be_read_costs_its_view_and_not_the_line(driver, submission) -> None:
    driver.ask("submit", submission(driver.begin()))
    driver.sql("""update attempts set record = '{"format": "testloom-attempt/0"}'""")
    query = driver.ask("request", GetUnit(serial="GM-1"), "cli")
    assert query.rejections
    what, fault, _ = query.rejections[0]
    assert "a record of GM-1 cannot be read" in what
    assert fault is Fault.DATA
    assert driver.ask("request", GetLineStatus(), "cli").answers[0]["attempts_recorded"] == 1


def test_nobody_sees_what_is_not_committed(driver, submission, monkeypatch: pytest.MonkeyPatch) -> None:
    lease = driver.begin()
    seen: list[str] = []
    store = driver.service._store
    original = store.commit

    def commit(batch: Any) -> None:
        seen.append("committed" if not status.answers and not submitted.answers else "said before")
        original(batch)

    monkeypatch.setattr(store, "commit", commit)
    status, submitted = (
        driver.query("request", GetUnit(serial="GM-1"), "cli"),
        driver.query("submit", submission(lease)),
    )
    driver.service.process([Request("request", status), Request("submit", submitted)])
    assert seen == ["committed"]
    assert status.answers[0]["outcomes"] == {"functional": "PASS"}


def test_the_clock_never_goes_back_not_even_behind_the_journal(driver) -> None:
    driver.begin()
    driver.now_s = 500.0
    driver.restart()
    assert driver.ask("request", GetLineStatus(), "cli").answers[0]["at_s"] >= 1_000.0


def test_a_clock_that_was_set_back_stops_no_timer(driver) -> None:
    driver.begin()
    driver.now_s -= 3_600.0
    driver.restart()
    assert driver.service.seconds_to_next_timer() == pytest.approx(10.0)
    driver.now_s += 10.5
    driver.service.process([])
    status = driver.ask("request", GetLineStatus(), "cli").answers[0]
    assert "lease_lapsed" in {alarm["alarm"] for alarm in status["alarms"]}
    assert status["at_s"] == pytest.approx(1_010.5)


def test_timers_come_back_through_the_service(driver) -> None:
    lease = driver.begin()
    assert driver.service.seconds_to_next_timer() == pytest.approx(10.0)
    driver.now_s += 10.5
    driver.service.process([])
    status = driver.ask("request", GetLineStatus(), "cli").answers[0]
    assert status["stations"][0]["state"] == "silent"
    assert {alarm["alarm"] for alarm in status["alarms"]} == {"lease_lapsed", "station_silent"}
    driver.ask("renew", RenewLeases(station="F1", incarnation=5))
    assert driver.to_stations[-1].lease.fence > lease.fence


def test_a_coordinator_that_stood_still_blames_no_station(driver) -> None:
    lease = driver.begin()
    assert not driver.service.stood_still()
    driver.now_s += 4.0
    assert not driver.service.stood_still()  # a slow turn
    driver.now_s += 60.0
    assert driver.service.stood_still()
    offered_again = [*driver.service.recover(), *driver.service.process([])]
    assert [command.lease.fence for command in offered_again] == [lease.fence]
    assert driver.service.seconds_to_next_timer() == pytest.approx(10.0)
    assert driver.ask("request", GetLineStatus(), "cli").answers[0]["alarms"] == []
    assert not driver.service.stood_still()


def test_alarms_are_shown_after_a_restart(driver) -> None:
    driver.begin()
    driver.now_s += 10.5
    driver.service.process([])
    driver.restart()
    status = driver.ask("request", GetLineStatus(), "cli").answers[0]
    assert "lease_lapsed" in {alarm["alarm"] for alarm in status["alarms"]}


def test_the_measured_values_can_be_asked_for_by_sql(driver, record_of, measurement_of) -> None:
    from protocol.attempts import StepRecord

    lease = driver.begin()
    step = StepRecord(
        step="rails",
        section="main",
        outcome=Outcome.PASS,
        started_bench_s=0.0,
        ended_bench_s=1.0,
        measurements=(measurement_of("rail_5v_v", 5.02, unit="V", low=4.75, high=5.25),),
    )
    spooled = SpooledRecord(sequence_number=1, record=record_of(lease, steps=(step,)))
    driver.ask("submit", SubmitRecords(station="F1", incarnation=5, records=(spooled,)))
    engine = create_engine(driver.url)
    with engine.connect() as connection:
        query = "SELECT serial, value FROM measurements WHERE name = 'rail_5v_v'"
        assert [tuple(row) for row in connection.execute(text(query))] == [("GM-1", 5.02)]
        query = "SELECT serial, operation FROM units"
        assert [tuple(row) for row in connection.execute(text(query))] == [("GM-1", "imu_calibration")]
    engine.dispose()

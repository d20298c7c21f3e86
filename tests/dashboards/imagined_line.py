"""A line that was never run: made-up statuses, units and live views for tests and for looks.

Every serial begins with IMAGINED or GNC and the line is called 'imagined', so that a picture of it cannot
be taken for a result.
"""

import hashlib
import random

from protocol.attempts import AttemptRecord, Lease, RecordingReference, StepRecord, UnitIdentity
from protocol.errors import Fault
from protocol.line_views import (
    Alarm,
    AttemptView,
    LineStatus,
    OperationYield,
    SocketStatus,
    StationStatus,
    UnitHistory,
    UnitStatus,
    YieldReport,
)
from protocol.measurements import Measurement, MeasurementSpecification, Value
from protocol.outcomes import Disposition, Outcome
from protocol.plans import PlanReference
from protocol.station_messages import SocketProgress

LINE = "imagined"
NOW_S = 1_777_900_000.0
FUNCTIONAL, CALIBRATION = "functional", "imu_calibration"
STEPS = {
    FUNCTIONAL: (
        "static_impedance",
        "power_rails",
        "identify",
        "memories",
        "imu_self_test",
        "gnss_fix",
        "can",
    ),
    CALIBRATION: ("six_positions", "rotations", "evaluate", "write_coefficients", "verify"),
}


def identity(number: int) -> UnitIdentity:
    return UnitIdentity(serial=f"GNC-{number:04d}", product="gnc_module", lot="IMAGINED-1")


def unit(number: int, disposition: Disposition, **where: object) -> UnitStatus:
    return UnitStatus(unit=identity(number), disposition=disposition, **where)  # type: ignore[arg-type]


def operation_yield(
    operation: str,
    first: int,
    passes: int,
    unit_faults: int,
    judged: int | None = None,
    station: str | None = None,
) -> OperationYield:
    judged = first if judged is None else judged
    return OperationYield(
        operation=operation,
        station=station,
        first_attempts=first,
        first_passes=passes,
        first_unit_faults=unit_faults,
        first_judged=judged,
        attempts=first + 1,
        passes=passes,
        fpy=passes / first if first else None,
        fpy_unit=1 - unit_faults / judged if judged else None,
    )


def small_line() -> tuple[LineStatus, list[SocketProgress]]:
    """Four socket boards of two sockets, two turntables: 24 units in mid-run."""
    return imagined_line(functional=4, turntables=2, units=24, seed=3)


def large_line() -> tuple[LineStatus, list[SocketProgress]]:
    """Forty-two socket boards and eight turntables."""
    return imagined_line(functional=42, turntables=8, units=600, seed=5)


def imagined_line(
    *, functional: int, turntables: int, units: int, seed: int
) -> tuple[LineStatus, list[SocketProgress]]:
    """A line in mid-run: some units done, some at stations, the rest waiting."""
    rng = random.Random(seed)
    statuses: list[UnitStatus] = []
    progress: list[SocketProgress] = []
    stations: list[StationStatus] = []
    done = units // 3
    for number in range(1, done + 1):
        fell = rng.random() < 0.12
        disposition = rng.choice([Disposition.SCRAP, Disposition.QUARANTINE]) if fell else Disposition.SHIP
        statuses.append(unit(number, disposition, attempts=3 if fell else 2))
    next_number = done + 1
    names = [(f"socket-board-{n + 1}", FUNCTIONAL, ("a", "b")) for n in range(functional)]
    names += [(f"turntable-{n + 1}", CALIBRATION, ("a",)) for n in range(turntables)]
    for place, (station, operation, socket_names) in enumerate(names):
        state = "silent" if place == functional - 1 and functional > 1 else "ready"
        sockets = []
        for number_of_socket, socket in enumerate(socket_names):
            kind = (place + 3 * number_of_socket) % 7
            steps = STEPS[operation]
            at = rng.randrange(len(steps))
            view = SocketProgress(
                station=station,
                socket=socket,
                serial=identity(next_number).serial,
                operation=operation,
                step=steps[at],
                steps_done=at,
                steps_total=len(steps),
                outcome=(Outcome.FAIL if rng.random() < 0.5 else Outcome.PASS) if kind == 3 else None,
            )
            if kind == 6:
                sockets.append(SocketStatus(socket=socket, operations=(operation,)))
                continue
            progress.append(view)
            leased = kind != 3
            sockets.append(
                SocketStatus(
                    socket=socket,
                    operations=(operation,),
                    serial=view.serial if leased else None,
                    operation=operation if leased else None,
                    fence=next_number,
                    leased_since_s=NOW_S - 1 - rng.random() * 8,
                )
            )
            statuses.append(
                unit(
                    next_number,
                    Disposition.RETEST if view.outcome is Outcome.FAIL else Disposition.IN_PROCESS,
                    operation=CALIBRATION if view.outcome is Outcome.PASS else operation,
                    station=station if leased else None,
                    socket=socket if leased else None,
                    attempts=0 if leased else 1,
                    waits_for="" if leased else "a free socket",
                )
            )
            next_number += 1
        heard = NOW_S - (12.0 if state == "silent" else 0.2)
        stations.append(
            StationStatus(
                station=station, state=state, incarnation=1, sockets=tuple(sockets), last_heard_s=heard
            )
        )
    position = {FUNCTIONAL: 0, CALIBRATION: 0}
    for number in range(next_number, units + 1):
        operation = CALIBRATION if number % 3 == 0 else FUNCTIONAL
        position[operation] += 1
        retest = number % 11 == 0
        statuses.append(
            unit(
                number,
                Disposition.RETEST if retest else Disposition.IN_PROCESS,
                operation=operation,
                queue_position=position[operation],
                waits_for="another socket than socket-board-1/a" if retest else "a free socket",
                attempts=1 if retest else 0,
            )
        )
    fell = sum(u.disposition in (Disposition.SCRAP, Disposition.QUARANTINE) for u in statuses)
    counts = {d.value: sum(u.disposition is d for u in statuses) for d in Disposition}
    shipped = counts["SHIP"]
    first = done + functional
    by_operation = (
        operation_yield(FUNCTIONAL, first, first - fell - 1, fell, first - 1),
        operation_yield(CALIBRATION, done, done, 0),
    )
    by_station = tuple(
        operation_yield(
            operation, 3 + place % 3, 3 + place % 3 - (place % 5 == 0), int(place % 5 == 0), station=name
        )
        for place, (name, operation, _) in enumerate(names)
    )
    fpy, fpy_unit = by_operation[0].fpy or 0.0, by_operation[0].fpy_unit or 0.0
    report = YieldReport(
        operations=by_operation,
        stations=by_station,
        rty=fpy,
        rty_unit=fpy_unit,
        final=shipped / (shipped + fell),
        dispositions={name: count for name, count in counts.items() if count},
    )
    status = LineStatus(
        line=LINE,
        at_s=NOW_S,
        stations=tuple(stations),
        units=tuple(statuses),
        queue_lengths=position,
        yield_report=report,
        alarms=(
            Alarm(
                raised_at_s=NOW_S - 12,
                alarm="station_silent",
                subject=f"socket-board-{functional}",
                text="has not been heard of; its units are tested elsewhere when their leases end.",
            ),
        ),
        attempts_recorded=3 * done,
        records_set_aside=1,
        duplicates_ignored=2,
        finished=False,
        expected_remaining_s=34.0,
    )
    return status, progress


def measurement(
    name: str,
    value: Value | None,
    measured_in: str = "1",
    low: float | None = None,
    high: float | None = None,
    equals: Value | None = None,
    u: float | None = None,
) -> Measurement:
    specification = MeasurementSpecification(
        name=name, unit=measured_in, low=low, high=high, equals=equals, standard_uncertainty=u
    )
    return Measurement(specification=specification, value=value, outcome=specification.judge(value))


def attempt(
    number: int,
    operation: str,
    outcome: Outcome,
    steps: tuple[StepRecord, ...],
    *,
    fence: int,
    fault: Fault = Fault.NONE,
    message: str = "",
    recordings: tuple[RecordingReference, ...] = (),
    set_aside: bool = False,
    safe_state: bool = True,
) -> AttemptView:
    station = "socket-board-1" if operation == FUNCTIONAL else "turntable-1"
    plan = PlanReference(
        operation=operation,
        name=f"gnc_{operation}",
        version="1.0.0",
        sha256=hashlib.sha256(operation.encode()).hexdigest(),
    )
    lease = Lease(
        fence=fence,
        attempt_id=f"{LINE}-{fence}",
        unit=identity(number),
        operation=operation,
        station=station,
        socket="a",
        plan=plan,
    )
    record = AttemptRecord(
        attempt_id=lease.attempt_id,
        lease=lease,
        incarnation=1,
        outcome=outcome,
        fault=fault,
        message=message,
        started_at_s=NOW_S - 100 + fence,
        ended_at_s=NOW_S - 92 + fence,
        duration_bench_s=7.9,
        steps=steps,
        recordings=recordings,
        safe_state=safe_state,
        software_version="0.1.0",
    )
    return AttemptView(record=record, set_aside=set_aside, received_at_s=NOW_S)


def functional_steps(rail_v: float) -> tuple[StepRecord, ...]:
    power = (
        measurement("rail_5v", 5.02, "V", 4.75, 5.25, u=0.02),
        measurement("rail_3v3", rail_v, "V", 3.135, 3.465, u=0.01),
        measurement("supply_current", 0.4871, "A", 0.4655, 0.5145, u=0.002),
    )
    good = all(m.outcome.value == "PASS" for m in power)
    return (
        StepRecord(
            step="static_impedance",
            section="main",
            outcome=Outcome.PASS,
            started_bench_s=0.0,
            ended_bench_s=0.8,
            measurements=(
                measurement("insulation", 182.4, "Mohm", low=20.0),
                measurement("ground_bond", 0.031, "ohm", high=0.1),
            ),
        ),
        StepRecord(
            step="power_rails",
            section="main",
            outcome=Outcome.PASS if good else Outcome.FAIL,
            started_bench_s=0.8,
            ended_bench_s=1.9,
            measurements=power,
            fault=Fault.NONE if good else Fault.UNIT,
        ),
        StepRecord(
            step="identify",
            section="main",
            outcome=Outcome.PASS,
            started_bench_s=1.9,
            ended_bench_s=2.0,
            measurements=(measurement("product_code", "GNC-M1", equals="GNC-M1"),),
        ),
        StepRecord(
            step="power_off",
            section="teardown",
            outcome=Outcome.PASS,
            started_bench_s=7.6,
            ended_bench_s=7.9,
        ),
    )


def failed_then_passed() -> UnitHistory:
    """A unit that failed on a rail, passed its retest, was calibrated, and has a late record set aside."""
    recording = RecordingReference(
        sha256=hashlib.sha256(b"imagined").hexdigest(),
        path="recordings/GNC-0003/imu_calibration-12.mcap",
        size_bytes=5_184_233,
        sample_count=96_000,
        description="six positions and ±1080° about each axis, 200 Hz",
    )
    calibration = (
        StepRecord(
            step="evaluate",
            section="main",
            outcome=Outcome.PASS,
            started_bench_s=0.0,
            ended_bench_s=210.0,
            measurements=(
                measurement("gyro_bias_x", 0.21, "deg/s", -0.5, 0.5, u=0.004),
                measurement("residual_rate", 0.011, "deg/s", high=0.05),
                measurement("gyro_scale_x", 1.0004, "1", 0.99, 1.01, u=2e-4),
            ),
        ),
    )
    attempts = (
        attempt(3, FUNCTIONAL, Outcome.FAIL, functional_steps(3.02), fence=3, fault=Fault.UNIT),
        attempt(3, FUNCTIONAL, Outcome.PASS, functional_steps(3.31), fence=9),
        attempt(
            3,
            FUNCTIONAL,
            Outcome.ABORTED,
            (),
            fence=7,
            fault=Fault.STATION,
            message="the bench died in mid-step.",
            set_aside=True,
            safe_state=False,
        ),
        attempt(3, CALIBRATION, Outcome.PASS, calibration, fence=12, recordings=(recording,)),
    )
    return UnitHistory(
        status=unit(3, Disposition.SHIP, attempts=4),
        attempts=attempts,
        outcomes={FUNCTIONAL: Outcome.PASS, CALIBRATION: Outcome.PASS},
    )

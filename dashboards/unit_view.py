# pyright: strict
"""From a unit's history to what its page shows. Pure.

The bar of a measurement with two limits spans both limits and a quarter of their distance on
either side; with one limit the limit stands at three quarters (high) or one quarter (low) of it.
A value outside the bar is drawn at its edge and marked as off the scale.
"""

import math
from dataclasses import dataclass
from typing import Literal

from protocol.attempts import AttemptRecord, RecordingReference, StepRecord
from protocol.errors import Fault
from protocol.line_views import AttemptView, UnitHistory, UnitStatus
from protocol.measurements import Measurement, Value
from protocol.outcomes import MeasurementOutcome, Outcome

COVERAGE_FACTOR = 2.0
"""The whisker of a value is ± this many standard uncertainties (k = 2, about 95 %)."""

SIDE_MARGIN = 0.25
ONE_SIDED_SHARE = 0.6


@dataclass(frozen=True)
class LimitBar:
    """Positions along a bar, 0 to 1. `off_scale`: the value lies beyond this edge."""

    low_at: float | None
    high_at: float | None
    value_at: float
    off_scale: Literal["", "low", "high"]
    spread: tuple[float, float] | None


@dataclass(frozen=True)
class MeasurementRow:
    """A measurement against its limits.

    `margin`: distance to the nearest limit in the measurement's unit, negative outside.
    `margin_fraction`: the same over half the distance of the limits: 1 centred, 0 at a limit.
    """

    name: str
    unit: str
    value: str
    low: str
    high: str
    equals: str
    outcome: MeasurementOutcome
    message: str
    margin: str
    margin_fraction: float | None
    bar: LimitBar | None


@dataclass(frozen=True)
class StepRow:
    """A step with its measurements."""

    step: str
    section: Literal["setup", "main", "teardown"]
    outcome: Outcome
    duration_s: float
    fault: Fault
    message: str
    measurements: tuple[MeasurementRow, ...]


@dataclass(frozen=True)
class AttemptRow:
    """One attempt. `problems`: the steps that did not pass, in a line each."""

    number: int
    attempt_id: str
    operation: str
    station: str
    socket: str
    fence: int
    outcome: Outcome
    fault: Fault
    message: str
    set_aside: bool
    safe_state: bool
    plan: str
    plan_sha256: str
    software_version: str
    started_at_s: float
    wall_s: float
    duration_bench_s: float
    problems: tuple[str, ...]
    steps: tuple[StepRow, ...]
    recordings: tuple[RecordingReference, ...]


@dataclass(frozen=True)
class UnitView:
    """All that a unit's page shows."""

    status: UnitStatus
    outcomes: tuple[tuple[str, Outcome], ...]
    attempts: tuple[AttemptRow, ...]
    set_aside: int


def unit_view(history: UnitHistory) -> UnitView:
    """What to show of this unit, attempts in the order of their start."""
    in_order = sorted(history.attempts, key=lambda view: (view.record.started_at_s, view.record.lease.fence))
    return UnitView(
        status=history.status,
        outcomes=tuple(history.outcomes.items()),
        attempts=tuple(_attempt_row(number, view) for number, view in enumerate(in_order, start=1)),
        set_aside=sum(view.set_aside for view in in_order),
    )


def measurement_row(measurement: Measurement) -> MeasurementRow:
    """One measurement with its bar and margin, where it is a number and has a limit."""
    specification = measurement.specification
    number = _number(measurement.value)
    margin = None if number is None else _margin(number, specification.low, specification.high)
    fraction = None
    if margin is not None and specification.low is not None and specification.high is not None:
        half_width = (specification.high - specification.low) / 2
        fraction = margin / half_width if half_width > 0 else None
    return MeasurementRow(
        name=specification.name,
        unit="" if specification.unit == "1" else specification.unit,
        value=shown(measurement.value),
        low=shown(specification.low),
        high=shown(specification.high),
        equals=shown(specification.equals),
        outcome=measurement.outcome,
        message=measurement.message,
        margin="" if margin is None else shown(margin),
        margin_fraction=fraction,
        bar=None
        if number is None
        else limit_bar(number, specification.low, specification.high, specification.standard_uncertainty),
    )


def limit_bar(
    value: float, low: float | None, high: float | None, standard_uncertainty: float | None = None
) -> LimitBar | None:
    """Where value and limits stand on the bar; None when there is no limit."""
    if low is not None and high is not None:
        width = (high - low) or max(abs(high), 1.0)
        start, span = low - SIDE_MARGIN * width, (1 + 2 * SIDE_MARGIN) * width
    elif high is not None:
        span = _one_sided_span(value, high)
        start = high - (1 - SIDE_MARGIN) * span
    elif low is not None:
        span = _one_sided_span(value, low)
        start = low - SIDE_MARGIN * span
    else:
        return None

    def place(number: float) -> float:
        return min(1.0, max(0.0, (number - start) / span))

    u = standard_uncertainty
    return LimitBar(
        low_at=None if low is None else place(low),
        high_at=None if high is None else place(high),
        value_at=place(value),
        off_scale="low" if value < start else "high" if value > start + span else "",
        spread=None if not u else (place(value - COVERAGE_FACTOR * u), place(value + COVERAGE_FACTOR * u)),
    )


def shown(value: Value | None) -> str:
    """A value in at most six significant digits; nothing for None."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def _one_sided_span(value: float, limit: float) -> float:
    """Wide enough that a good value shows inside the bar; a bad one may run off its edge."""
    return max(abs(limit), abs(value - limit), 1e-300) / ONE_SIDED_SHARE


def _number(value: Value | None) -> float | None:
    if value is None or isinstance(value, (bool, str)) or not math.isfinite(value):
        return None
    return float(value)


def _margin(value: float, low: float | None, high: float | None) -> float | None:
    below = math.inf if low is None else value - low
    above = math.inf if high is None else high - value
    return None if low is None and high is None else min(below, above)


def _attempt_row(number: int, view: AttemptView) -> AttemptRow:
    record = view.record
    lease = record.lease
    return AttemptRow(
        number=number,
        attempt_id=record.attempt_id,
        operation=lease.operation,
        station=lease.station,
        socket=lease.socket,
        fence=lease.fence,
        outcome=record.outcome,
        fault=record.fault,
        message=record.message,
        set_aside=view.set_aside,
        safe_state=record.safe_state,
        plan=f"{lease.plan.name} {lease.plan.version}",
        plan_sha256=lease.plan.sha256,
        software_version=record.software_version,
        started_at_s=record.started_at_s,
        wall_s=max(0.0, record.ended_at_s - record.started_at_s),
        duration_bench_s=record.duration_bench_s,
        problems=_problems(record),
        steps=tuple(_step_row(step) for step in record.steps),
        recordings=record.recordings,
    )


def _problems(record: AttemptRecord) -> tuple[str, ...]:
    problems: list[str] = []
    for step in record.steps:
        failed = [m for m in step.measurements if m.outcome is not MeasurementOutcome.PASS]
        if step.outcome is Outcome.PASS and not failed:
            continue
        details = ", ".join(_problem(measurement) for measurement in failed) or step.message
        problems.append(f"{step.step}: {details or step.outcome.value}")
    return tuple(problems)


def _problem(measurement: Measurement) -> str:
    specification = measurement.specification
    unit = "" if specification.unit == "1" else f" {specification.unit}"
    value = shown(measurement.value) or measurement.outcome.value
    return f"{specification.name} = {value}{unit}"


def _step_row(step: StepRecord) -> StepRow:
    return StepRow(
        step=step.step,
        section=step.section,
        outcome=step.outcome,
        duration_s=max(0.0, step.ended_bench_s - step.started_bench_s),
        fault=step.fault,
        message=step.message,
        measurements=tuple(measurement_row(measurement) for measurement in step.measurements),
    )

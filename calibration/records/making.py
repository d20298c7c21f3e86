# pyright: strict
"""Calibration records from an evaluation: one for each sensor that it calibrated.

What is not in the data (the recordings' hashes, the code's version, the time, the plan) is handed in.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime
from typing import Any, Literal, cast

import numpy as np
from pydantic import ValidationError

from calibration.algorithms.coefficients import PARAMETER_NAMES, FloatArray, TriadCoefficients
from calibration.algorithms.uncertainty_budget import t_quantile
from calibration.evaluation import Evaluation, GyroBias, Method
from calibration.records.record import COVERAGE_PROBABILITY, LINEAR_TRIAD, CalibrationRecord
from calibration.records.record_parts import (
    CalibratedQuantity,
    CodeVersion,
    CovarianceBlock,
    Environment,
    Frame,
    LeftOut,
    Model,
    RecordedBudget,
    RecordTable,
    SourceRecording,
    StandReference,
    TableColumn,
    TemperatureSpan,
)
from protocol.errors import CalibrationError, Fault
from protocol.frozen_model import first_problem
from protocol.plans import PlanReference
from protocol.recordings import Recording

MARK = "compensated"
"""Key of a recording that lists what its samples were compensated by."""
BIAS_ONLY = "bias"
TRIAD_EQUATION = "y = M u + b; u = inv(M) (y - b)"
TRIAD_NAMES = (
    *(
        f"scale_factor_{row}" if row == column else f"cross_axis_sensitivity_{row}{column}"
        for row in "xyz"
        for column in "xyz"
    ),
    *(f"bias_{row}" for row in "xyz"),
)
"""The field's terms, in the order of `TriadCoefficients`. A scale factor is relative to the nominal one."""
BODY_AXES: dict[Method, str] = {
    "imu_calibration": "nominal axes of the unit, as the stand's mounting and encoders give them",
    "ferraris": "faces of the housing as it stood on the surface",
    "multi_position": "z along the input axis of z, y in the plane of the input axes of y and z",
}


@dataclass(frozen=True)
class RecordContent:
    """What a method found of one sensor, whatever the method: see `method_contents` for those of the papers.

    Attributes are those of `CalibrationRecord`.
    """

    method: str
    model: Model
    quantities: tuple[CalibratedQuantity, ...]
    covariance: tuple[CovarianceBlock, ...] = ()
    tables: tuple[RecordTable, ...] = ()
    budgets: tuple[RecordedBudget, ...] = ()
    frames: tuple[Frame, ...] = ()
    assumptions: tuple[str, ...] = ()
    not_used: tuple[LeftOut, ...] = ()
    valid_temperature: TemperatureSpan | None = None


@dataclass(frozen=True)
class Origin:
    """What a record says of its making.

    Attributes:
        recordings: that were evaluated, with their hashes.
        code: that evaluated them.
        created_at: when, with its time zone.
        plan: that they were recorded by.
        valid_temperature: where the coefficients hold; None: where the unit was while it was measured.
    """

    recordings: tuple[SourceRecording, ...]
    code: CodeVersion
    created_at: datetime
    plan: PlanReference | None = None
    valid_temperature: TemperatureSpan | None = None


def records_of(
    evaluation: Evaluation, recordings: Sequence[Recording], origin: Origin
) -> tuple[CalibrationRecord, ...]:
    """A record for each sensor of an evaluation by today's methods.

    Raises:
        CalibrationError: as `record_of`.
    """
    try:
        contents = tuple(_contents(evaluation))
    except ValidationError as error:
        raise _no_record(error, recordings) from None
    return tuple(record_of(content, sensor, recordings, origin) for sensor, content in contents)


def record_of(
    content: RecordContent, sensor: str, recordings: Sequence[Recording], origin: Origin
) -> CalibrationRecord:
    """A record of what a method found.

    Args:
        content: what it found.
        sensor: of the unit.
        recordings: that it was found from; the first one tells unit, stand and site.
        origin: what is not in them.

    Raises:
        CalibrationError: nobody could tell which unit the record would be of, or what the recordings
            say of it fits no record.
    """
    first = recordings[0]
    for name in ("serial", "product"):
        if not first.unit.get(name):
            raise CalibrationError(
                f"The recordings do not say the {name} of the unit: a calibration record must.",
                where=_named(recordings),
                fault=Fault.DATA,
                remedy=f"write unit.{name} into recording.json.",
            )
    _refuse_compensated(sensor, recordings)
    unit_temperature = _temperatures(recordings, "dut")
    try:
        return CalibrationRecord(
            serial=str(first.unit["serial"]),
            product=str(first.unit["product"]),
            sensor=sensor,
            method=content.method,
            model=content.model,
            quantities=content.quantities,
            covariance=content.covariance,
            tables=content.tables,
            budgets=content.budgets,
            frames=content.frames,
            assumptions=content.assumptions,
            not_used=content.not_used,
            valid_temperature=origin.valid_temperature or content.valid_temperature or unit_temperature,
            recordings=origin.recordings,
            plan=origin.plan,
            stand=_stand(first),
            environment=_environment(recordings, unit_temperature),
            code=origin.code,
            measured_at=min(filter(None, map(_started_at, recordings)), default=None),
            created_at=origin.created_at,
        )
    except ValidationError as error:
        raise _no_record(error, recordings) from None


def _no_record(error: ValidationError, recordings: Sequence[Recording]) -> CalibrationError:
    return CalibrationError(
        f"No calibration record can be made of this {first_problem(error)}.",
        where=_named(recordings),
        fault=Fault.DATA,
        remedy="correct what recording.json says of unit and site, and look at the coefficients.",
    )


def _named(recordings: Sequence[Recording]) -> str:
    return f"recording {', '.join(recording.recording_id for recording in recordings)}"


def marks(recording: Recording) -> list[Mapping[str, Any]]:
    """What a recording was compensated by, one entry for each sensor.

    Raises:
        CalibrationError: its key is not such a list.
    """
    found = recording.extra.get(MARK, [])
    if isinstance(found, list) and all(isinstance(mark, Mapping) for mark in cast(list[object], found)):
        return cast(list[Mapping[str, Any]], found)
    raise CalibrationError(
        f"The recording's key '{MARK}' is not a list of what it was compensated by.",
        where=f"recording {recording.recording_id}",
        fault=Fault.DATA,
        remedy="take the recording as it was taken.",
    )


def _refuse_compensated(sensor: str, recordings: Sequence[Recording]) -> None:
    """What is left after a compensation would be applied to recordings that have none."""
    for recording in recordings:
        if any(mark.get("sensor") == sensor for mark in marks(recording)):
            raise CalibrationError(
                f"The recording's {sensor} is compensated: a record of it would say what remains, "
                "not what the unit has.",
                where=f"recording {recording.recording_id}",
                fault=Fault.OPERATOR,
                remedy="calibrate without --record to see what remains, or the recording as it was taken.",
            )


def _contents(evaluation: Evaluation) -> Iterator[tuple[str, RecordContent]]:
    """By sensor."""
    shared = RecordContent(
        method=evaluation.method,
        model=Model(name=LINEAR_TRIAD, equation=TRIAD_EQUATION),
        quantities=(),
        frames=(Frame(name="body", definition=BODY_AXES[evaluation.method]),),
        assumptions=evaluation.assumptions,
        not_used=tuple(LeftOut(what=one.what, count=one.count, why=one.why) for one in evaluation.not_used),
    )
    for sensor, triad in (("acc", evaluation.acc), ("gyro", evaluation.gyro)):
        if triad is not None:
            quantities, covariance = triad_quantities(triad)
            tables = _residuals(evaluation, triad.unit)
            yield sensor, replace(shared, quantities=quantities, covariance=covariance, tables=tables)
    if evaluation.gyro is None and evaluation.gyro_bias is not None:
        model = Model(name=BIAS_ONLY, equation="y = b at zero input")
        yield "gyro", replace(shared, model=model, quantities=_bias(evaluation.gyro_bias))


def coverage_factor(degrees_of_freedom: float | None, probability: float = COVERAGE_PROBABILITY) -> float:
    """k of the t distribution; 2 where degrees of freedom do not limit it."""
    if degrees_of_freedom is None:
        return 2.0
    return max(2.0, t_quantile(0.5 * (1.0 + probability), degrees_of_freedom))


def covariance_block(names: Sequence[str], covariance: FloatArray) -> CovarianceBlock:
    """A block without the last bits of asymmetry that computing leaves."""
    symmetric = (covariance + covariance.T) / 2.0
    return CovarianceBlock(parameters=tuple(names), matrix=tuple(tuple(map(float, row)) for row in symmetric))


def triad_quantities(
    triad: TriadCoefficients,
) -> tuple[tuple[CalibratedQuantity, ...], tuple[CovarianceBlock, ...]]:
    """Scale factors, cross-axis sensitivities and biases, with their covariance."""
    freedom = float(triad.degrees_of_freedom) if triad.degrees_of_freedom > 0 else None
    values = [*triad.matrix.ravel(), *triad.bias]
    uncertainties = np.sqrt(np.diag(triad.covariance))
    quantities = tuple(
        CalibratedQuantity(
            name=name,
            symbol=symbol,
            value=float(value),
            unit=triad.unit if symbol.startswith("b") else "1",
            standard_uncertainty=float(uncertainty),
            degrees_of_freedom=freedom,
            coverage_factor=coverage_factor(freedom),
        )
        for name, symbol, value, uncertainty in zip(
            TRIAD_NAMES, PARAMETER_NAMES, values, uncertainties, strict=True
        )
    )
    return quantities, (covariance_block(TRIAD_NAMES, triad.covariance),)


def _bias(bias: GyroBias) -> tuple[CalibratedQuantity, ...]:
    freedom = float(bias.degrees_of_freedom)
    return tuple(
        CalibratedQuantity(
            name=f"bias_{axis}",
            symbol=f"b_{axis}",
            value=float(value),
            unit="rad/s",
            standard_uncertainty=float(uncertainty),
            degrees_of_freedom=freedom,
            coverage_factor=coverage_factor(freedom),
        )
        for axis, value, uncertainty in zip(
            "xyz", bias.bias_rad_s, bias.standard_uncertainty_rad_s, strict=True
        )
    )


def _residuals(evaluation: Evaluation, unit: str) -> tuple[RecordTable, ...]:
    rows = [residual for residual in evaluation.residuals if residual.unit == unit]
    if not rows:
        return ()
    width = len(rows[0].values)
    names = [f"residual_{axis}" for axis in "xyz"] if width == 3 else ["residual_norm"]
    columns = tuple(
        TableColumn(name=name, unit=unit, values=tuple(row.values[k] for row in rows))
        for k, name in enumerate(names)
    )
    return (
        RecordTable(
            name="residuals",
            row_names=tuple(row.name for row in rows),
            columns=columns,
            note="output less model, mean of each pose or turn",
        ),
    )


def _stand(recording: Recording) -> StandReference | None:
    stand = recording.stand
    if not stand:
        return None
    due = _date(stand.get("calibration_due"))
    started = _started_at(recording)
    overdue = stand.get("calibration_overdue") is True
    if due is not None and started is not None:
        overdue = started.date() > due
    return StandReference(
        id=str(stand.get("id", "")),
        kind=str(stand.get("kind", "")),
        calibration_due=due,
        calibration_overdue=overdue,
        emulated=stand.get("emulated") is True,
    )


def _environment(recordings: Sequence[Recording], unit_temperature: TemperatureSpan | None) -> Environment:
    site = recordings[0].site
    return Environment(
        unit_temperature=unit_temperature,
        stand_temperature=_temperatures(recordings, "stand"),
        latitude_deg=_number(site.get("latitude_deg")),
        gravity_m_s2=_number(site.get("gravity_m_s2")),
    )


def temperature_columns(recording: Recording, stream: Literal["dut", "stand"]) -> tuple[str, ...]:
    """Names of the columns of a stream that hold temperatures."""
    if stream not in recording.streams:
        return ()
    return tuple(
        name
        for name, unit in recording.streams[stream].units.items()
        if unit == "degC" and name.split("_")[0] == "temp"
    )


def _temperatures(recordings: Sequence[Recording], stream: Literal["dut", "stand"]) -> TemperatureSpan | None:
    seen = [
        np.asarray(recording.streams[stream].columns[name], dtype=np.float64)
        for recording in recordings
        for name in temperature_columns(recording, stream)
    ]
    measured = [column[np.isfinite(column)] for column in seen]
    measured = [column for column in measured if len(column)]
    if not measured:
        return None
    return TemperatureSpan(
        low_c=min(float(column.min()) for column in measured),
        high_c=max(float(column.max()) for column in measured),
    )


def _started_at(recording: Recording) -> datetime | None:
    """When the recording began; None where it does not say so with a time zone."""
    try:
        started = datetime.fromisoformat(str(recording.test.get("started_at", "")))
    except ValueError:
        return None
    return started if started.tzinfo is not None else None


def _date(stated: object) -> date | None:
    try:
        return date.fromisoformat(str(stated))
    except ValueError:
        return None


def _number(stated: object) -> float | None:
    return float(stated) if isinstance(stated, int | float) and np.isfinite(stated) else None

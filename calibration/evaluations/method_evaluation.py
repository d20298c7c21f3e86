"""What an evaluation by a profile's method hands back, whatever the method."""

# pyright: strict
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.screening import NotUsed
from calibration.records.making import RecordContent
from calibration.records.record_parts import LeftOut
from protocol.errors import CalibrationError, Fault
from protocol.recordings import Recording, Stream


@dataclass(frozen=True)
class Beside:
    """A figure that is shown beside the result and is in no record: a paper's own form, a probability.

    Attributes:
        name: words for people.
        value: None: not defined for these data.
        unit: of `value`.
    """

    name: str
    value: float | None
    unit: str


@dataclass(frozen=True)
class SensorResult:
    """What was found of one sensor: makes one record.

    Attributes:
        sensor: 'gyro', 'acc_x', 'mag' …
        content: quantities with uncertainties, budgets, tables.
        recordings: that it rests on.
        beside: shown with it.
    """

    sensor: str
    content: RecordContent
    recordings: tuple[Recording, ...]
    beside: tuple[Beside, ...] = ()


@dataclass(frozen=True)
class MethodEvaluation:
    """Results of one or more recordings of one unit.

    Attributes:
        recording_ids: evaluated together.
        serial, product: of the unit.
        profile: that was recorded.
        results: one a sensor.
        assumptions: sentences for people: what was taken from where.
        not_used: what, how many, why.
    """

    recording_ids: tuple[str, ...]
    serial: str
    product: str
    profile: str
    results: tuple[SensorResult, ...]
    assumptions: tuple[str, ...]
    not_used: tuple[NotUsed, ...] = ()


def method_evaluation(
    recordings: Sequence[Recording],
    results: Sequence[SensorResult],
    assumptions: Sequence[str],
    not_used: Sequence[NotUsed] = (),
) -> MethodEvaluation:
    """Put together; what holds for all results goes into each one's content too."""
    first = recordings[0]
    left_out = tuple(LeftOut(what=one.what, count=one.count, why=one.why) for one in not_used)
    said = tuple(
        replace(
            one,
            content=replace(
                one.content,
                assumptions=(*one.content.assumptions, *assumptions),
                not_used=(*one.content.not_used, *left_out),
            ),
        )
        for one in results
    )
    return MethodEvaluation(
        recording_ids=tuple(recording.recording_id for recording in recordings),
        serial=str(first.unit.get("serial", "")),
        product=str(first.unit.get("product", "")),
        profile=str(first.test.get("profile", "")),
        results=said,
        assumptions=tuple(assumptions),
        not_used=tuple(not_used),
    )


def refused(
    recording: Recording, what: str, remedy: str, where: str = "", fault: Fault = Fault.DATA
) -> CalibrationError:
    """An error that names the recording, and the stream or channel in it."""
    place = f"recording {recording.recording_id}" + (f", {where}" if where else "")
    return CalibrationError(what, where=place, fault=fault, remedy=remedy + ".")


def stream_with(recording: Recording, name: str, *columns: str) -> Stream:
    """A stream that has these columns and rows.

    Raises:
        CalibrationError: it is not there, is empty, or lacks a column.
    """
    if name not in recording.streams or not len(recording.streams[name]):
        raise refused(
            recording,
            f"The recording has no stream '{name}', or nothing in it.",
            f"record the profile with {', '.join(columns) or 'its columns'} in the stream '{name}'",
        )
    stream = recording.streams[name]
    missing = [column for column in columns if column not in stream.columns]
    if missing:
        raise refused(
            recording,
            f"The stream '{name}' has no {', '.join(missing)}.",
            "record these columns too, or correct their names",
            f"stream {name}",
        )
    return stream


def refuse_unjoined(recording: Recording) -> None:
    """Events of a stand say nothing about a unit whose clock is not joined to the stand's.

    Raises:
        CalibrationError: the recording says that no trigger joined them.
    """
    if recording.test.get("triggered") is False:
        raise refused(
            recording,
            "No trigger joins the clocks of unit and stand: where the stand's events lie is not known.",
            "record with the trigger connected",
        )


def refuse_backward_time(recording: Recording, stream: Stream) -> None:
    """Times that are missing, stand still or run back put samples in the wrong place.

    Raises:
        CalibrationError: how many there are.
    """
    time_s = stream.time_s()
    missing = int((~np.isfinite(time_s)).sum())
    backward = 0 if missing else int((np.diff(time_s) <= 0.0).sum())
    if missing or backward:
        raise refused(
            recording,
            f"{missing} times are missing and {backward} do not come after the one before.",
            "look at the recording's time column: two recordings in one, or a clock that was set",
            f"stream {stream.name}",
        )


def believed_sensor(recording: Recording, kind: str) -> Mapping[str, Any]:
    """What the recording says beforehand of 'gyro', 'acc' or 'mag'; empty: nothing."""
    described = recording.believed.get(kind)
    return cast(Mapping[str, Any], described) if isinstance(described, Mapping) else {}


def believed_number(recording: Recording, kind: str, key: str) -> float | None:
    """A finite number that the recording says of a sensor, else None."""
    stated = believed_sensor(recording, kind).get(key)
    return float(stated) if isinstance(stated, int | float) and math.isfinite(stated) else None


def believed_linear(recording: Recording, kind: str) -> tuple[FloatArray, FloatArray]:
    """Matrix (3, 3) and bias (3,), the latter in the stated unit.

    Raises:
        CalibrationError: the recording does not state them.
    """
    described = believed_sensor(recording, kind)
    try:
        matrix = np.array(described["matrix"], dtype=np.float64)
        bias = np.array(described["bias"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        matrix = bias = np.zeros(0)
    if matrix.shape != (3, 3) or bias.shape != (3,) or not np.isfinite(np.r_[matrix.ravel(), bias]).all():
        raise refused(
            recording,
            f"The recording does not say what is known of the {kind} beforehand: scale factors and bias.",
            f"write believed.{kind}.matrix and .bias into recording.json, from a multi-position test",
        )
    return matrix, bias


def sample_period_s(recording: Recording, stream: Stream) -> float:
    """The usual time between samples.

    Raises:
        CalibrationError: fewer than two samples, or a time that stands still.
    """
    steps = np.diff(stream.time_s())
    period_s = float(np.median(steps)) if len(steps) else 0.0
    if not (math.isfinite(period_s) and period_s > 0.0):
        raise refused(
            recording,
            "The samples have no period: there are too few, or their times stand still.",
            "look at the recording's time column",
            f"stream {stream.name}",
        )
    return period_s

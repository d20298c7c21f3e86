# pyright: strict
"""A record's coefficients, put to use on a recording of the unit that they are of.

    u = inv(M) (y - b)                    linear_triad
    u = inv(M) (y - sigma(y, T) - b)      linear_triad_temperature (paper 2, eq (2)): nodes from its table

The recording says afterwards which record its samples were compensated by, and is not compensated by a
second one. Coefficients of another unit, product, sensor or unit of measure are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.temperature_compensation import POWER_WORDS, hat_weights
from calibration.records.derived_units import derived_unit
from calibration.records.making import MARK, TRIAD_NAMES, marks, temperature_columns
from calibration.records.record import LINEAR_TRIAD, LINEAR_TRIAD_TEMPERATURE, CalibrationRecord
from calibration.sensor_knowledge import axes, sensor_range
from protocol.errors import CalibrationError, Fault
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import factor_to_si, quantity_of

TEMPERATURE_MARGIN_C = 1.0
"""So far beyond its valid range a record is still taken to hold."""
SUFFIX = "compensated"


@dataclass(frozen=True)
class Compensation:
    """A compensated recording.

    Attributes:
        recording: with the mark.
        samples: that were compensated.
        beyond_temperature: of them, taken outside the record's valid range; None: not known, because
            the recording has no temperature or the record no range.
        saturated: of them, at the end of the sensor's range: what they compensate to is wrong.
    """

    recording: Recording
    samples: int
    beyond_temperature: int | None
    saturated: int


def apply_record(record: CalibrationRecord, recording: Recording) -> Compensation:
    """Compensate the record's sensor in a recording.

    Raises:
        CalibrationError: the record is not of this unit, product, sensor or unit of measure, is no linear
            triad, or the recording is compensated already.
    """
    _refuse_other_unit(record, recording)
    matrix, bias, unit = _coefficients(record)
    names = axes(record.sensor)
    stream = recording.stream("dut")
    _refuse_other_measure(record, recording, stream, unit)
    output = stream.si(*names)
    more = _sigma(record, recording, output) if record.model.name == LINEAR_TRIAD_TEMPERATURE else 0.0
    true_input = (output - more - bias) @ np.linalg.inv(matrix).T
    columns = dict(stream.columns)
    for axis, name in enumerate(names):
        samples = stream.columns[name]
        kept = samples.dtype if np.issubdtype(samples.dtype, np.floating) else np.float64
        columns[name] = (true_input[:, axis] / factor_to_si(stream.units[name])).astype(kept)
    beyond = _beyond_temperature(record, recording)
    limit = sensor_range(recording, record.sensor)
    saturated = 0 if limit is None else int((np.abs(output) >= limit).any(axis=1).sum())
    entry: dict[str, Any] = {
        "sensor": record.sensor,
        "record_sha256": record.sha256(),
        "method": record.method,
        "samples": len(stream),
        "samples_beyond_valid_temperature": beyond,
        "samples_saturated": saturated,
        "recording_id": recording.recording_id,
    }
    believed = dict(recording.believed)
    if isinstance(before := believed.get(record.sensor), Mapping):
        # `believed` tells of the samples beside it: those now have the identity, and no known range.
        known = dict(cast(Mapping[str, Any], before))
        entry["believed"] = {
            key: known.pop(key) for key in ("matrix", "bias", "range", "quantum") if key in known
        }
        believed[record.sensor] = known
    compensated = replace(
        recording,
        recording_id=f"{recording.recording_id}-{SUFFIX}" if not marks(recording) else recording.recording_id,
        streams={**recording.streams, "dut": replace(stream, columns=columns)},
        believed=believed,
        extra={**recording.extra, MARK: [*marks(recording), entry]},
    )
    return Compensation(compensated, len(stream), beyond, saturated)


def _refuse_other_unit(record: CalibrationRecord, recording: Recording) -> None:
    where = f"recording {recording.recording_id}, record {record.title}"
    for word, ours, theirs in (
        ("unit", record.serial, recording.unit.get("serial")),
        ("product", record.product, recording.unit.get("product")),
    ):
        if ours != theirs:
            raise CalibrationError(
                f"The calibration record is of the {word} '{ours}', the recording of '{theirs}'.",
                where=where,
                fault=Fault.OPERATOR,
                remedy="take the record of this unit.",
            )
    for mark in marks(recording):
        if mark.get("sensor") == record.sensor:
            raise CalibrationError(
                f"The recording's {record.sensor} is compensated already, "
                f"by record {str(mark.get('record_sha256'))[:12]}.",
                where=where,
                fault=Fault.OPERATOR,
                remedy=f"apply the record to the recording as it was taken, {mark.get('recording_id')}.",
            )


def _coefficients(record: CalibrationRecord) -> tuple[FloatArray, FloatArray, str]:
    """M, b in SI, and the unit that b is stated in."""
    if record.model.name not in (LINEAR_TRIAD, LINEAR_TRIAD_TEMPERATURE):
        raise CalibrationError(
            f"A record of the model '{record.model.name}' cannot be applied: "
            f"only one of '{LINEAR_TRIAD}' can, or of '{LINEAR_TRIAD_TEMPERATURE}'.",
            where=f"record {record.title}",
            fault=Fault.OPERATOR,
            remedy="take a record with scale factors, cross-axis sensitivities and biases.",
        )
    found = [record.quantity(name) for name in TRIAD_NAMES]
    units = {one.unit for one in found[9:]}
    if len(units) != 1 or {one.unit for one in found[:9]} != {"1"}:
        raise CalibrationError(
            "The scale factors are not numbers (1), or the biases are not in one unit.",
            where=f"record {record.title}",
            fault=Fault.DATA,
            remedy="state scale factors relative to the nominal one, and biases in the sensor's unit.",
        )
    (unit,) = units
    values = np.array([one.value for one in found], dtype=np.float64)
    matrix = values[:9].reshape(3, 3)
    if not np.linalg.cond(matrix) < 100.0:
        raise CalibrationError(
            "The record's matrix cannot be inverted.",
            where=f"record {record.title}",
            fault=Fault.DATA,
            remedy="calibrate the unit anew.",
        )
    return matrix, values[9:] * factor_to_si(unit), unit


def _sigma(record: CalibrationRecord, recording: Recording, output: FloatArray) -> FloatArray:
    """What the output (n, 3) has more than at room temperature, SI; NaN where the temperature is missing."""
    tables = {table.name: table for table in record.tables}
    columns = {column.name: column for column in tables["nodes"].columns} if "nodes" in tables else {}
    wanted = {(axis, word): f"{word}_{axis}" for axis in "xyz" for word in POWER_WORDS}
    readings = recording.stream("dut").columns
    sensed = {
        axis: next((name for name in _thermometers(record.sensor, axis) if name in readings), "")
        for axis in "xyz"
    }
    if not {"temperature", *wanted.values()} <= set(columns) or not all(sensed.values()):
        raise CalibrationError(
            "The record's table of nodes is not whole, or the recording has no temperature to look it up by.",
            where=f"recording {recording.recording_id}, record {record.title}",
            fault=Fault.DATA,
            remedy="take a recording with the column 'temp', or a record without temperature.",
        )
    nodes = np.array(columns["temperature"].values)
    sigma = np.zeros_like(output)
    for place, axis in enumerate("xyz"):
        weights = hat_weights(nodes, np.asarray(readings[sensed[axis]], dtype=np.float64))
        for power, word in zip((2, 1, 0), POWER_WORDS, strict=True):
            column = columns[wanted[axis, word]]
            at_nodes = np.array(column.values) * derived_unit(column.unit).factor
            sigma[:, place] += weights @ at_nodes * output[:, place] ** power
    return sigma


def _thermometers(sensor: str, axis: str) -> tuple[str, ...]:
    """Columns that tell a sensor's temperature, the nearest one first."""
    return f"temp_{sensor}_{axis}", f"temp_{sensor}", "temp"


def _refuse_other_measure(record: CalibrationRecord, recording: Recording, stream: Stream, unit: str) -> None:
    where = f"recording {recording.recording_id}, stream {stream.name}"
    names = axes(record.sensor)
    if not stream.has(*names):
        raise CalibrationError(
            f"The recording has no {', '.join(names)}: the record is of the sensor '{record.sensor}'.",
            where=where,
            fault=Fault.OPERATOR,
            remedy="take a recording of this sensor, or the record of another.",
        )
    for name in names:
        if quantity_of(stream.units[name]) != quantity_of(unit):
            raise CalibrationError(
                f"The column {name} is in '{stream.units[name]}', the record's biases are in '{unit}': "
                "they do not measure the same.",
                where=where,
                fault=Fault.DATA,
                remedy="correct the unit in recording.json, or take the right record.",
            )


def _beyond_temperature(record: CalibrationRecord, recording: Recording) -> int | None:
    names = temperature_columns(recording, "dut")
    valid = record.valid_temperature
    own = tuple(name for name in names if record.sensor in name.split("_"))
    if valid is None or not names:
        return None
    readings = recording.stream("dut").columns
    beyond: NDArray[np.bool_] = np.zeros(len(recording.stream("dut")), dtype=np.bool_)
    seen = False
    for name in own or names:
        temperature = np.asarray(readings[name], dtype=np.float64)
        seen |= bool(np.isfinite(temperature).any())
        beyond |= temperature < valid.low_c - TEMPERATURE_MARGIN_C
        beyond |= temperature > valid.high_c + TEMPERATURE_MARGIN_C
    return int(beyond.sum()) if seen else None

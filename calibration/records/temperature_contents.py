# pyright: strict
"""What depends on temperature, in the one form that records have (paper 2)."""

from collections.abc import Iterator, Mapping

import numpy as np

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.temperature_compensation import POWER_WORDS, TemperatureModel
from calibration.algorithms.thermal_ramp import RampFit
from calibration.records.content_parts import quantity, record_table
from calibration.records.derived_units import derived_unit
from calibration.records.making import TRIAD_NAMES, RecordContent, covariance_block, triad_quantities
from calibration.records.record import LINEAR_TRIAD_TEMPERATURE, CalibrationRecord
from calibration.records.record_parts import (
    CalibratedQuantity,
    CovarianceBlock,
    Model,
    RecordTable,
    TemperatureSpan,
)
from protocol.errors import CalibrationError, Fault

CORRELATION_TABLE = "node_correlation_"
"""Begins the names of tables of correlations, one an axis."""
RATE_UNITS = {"rad/s": "rad/(degC)", "m/s^2": "m/s/(degC)"}
RAMP_STEMS = ("bias_temperature_sensitivity", "thermal_hysteresis", "temperature_rate_sensitivity")
"""Rise per degC from the coldest to the hottest; warming less cooling, mean; bias per degC/s."""
BRANCHES_NOTE = "bias after warming and after cooling, less the mean of both in the middle of the range"
BIAS_NOTE = "output without input, less that at room temperature: sigma(0, T)"
CORRELATION_NOTE = (
    "correlation of the coefficients of one node, and of each of them with those of the next node; sigma is "
    "straight between two nodes, so that its uncertainty needs no others"
)


def temperature_content(
    model: TemperatureModel, residuals: Mapping[str, FloatArray] | None = None
) -> RecordContent:
    """The frozen coefficients of room temperature, and a table of a, b, c at the nodes.

    Args:
        model: fitted.
        residuals: columns temperature (degC), residual_x … (SI) of what was fitted; None: no table.
    """
    quantities, covariance = triad_quantities(model.room)
    unit = model.room.unit
    tables = [_sigma_curves(model)]
    if residuals is not None:
        units = {"temperature": "degC"}
        columns = ((name, units.get(name, unit), values) for name, values in residuals.items())
        tables.append(record_table("residuals", *columns))
    tables.append(record_table("nodes", *_nodes(model)))
    tables += [_correlations(model, axis) for axis in range(3)]
    low, high = model.calibrated_range_c
    return RecordContent(
        method="temperature_compensation",
        model=Model(
            name=LINEAR_TRIAD_TEMPERATURE,
            equation="u = inv(M) (y - sigma(y, T) - b); sigma = square y^2 + slope y + constant, "
            "straight between nodes",
        ),
        quantities=quantities,
        covariance=covariance,
        tables=tuple(tables),
        valid_temperature=TemperatureSpan(low_c=low, high_c=high),
    )


def _sigma_curves(model: TemperatureModel) -> RecordTable:
    """sigma without input: what a person looks at first."""
    nothing = np.zeros((len(model.node_c), 3))
    sigma = model.sigma(nothing, model.node_c)
    uncertainty = model.sigma_standard_uncertainty(nothing, model.node_c)
    columns: list[tuple[str, str, FloatArray]] = [("temperature", "degC", model.node_c)]
    for axis, letter in enumerate("xyz"):
        columns.append((f"bias_change_{letter}", model.room.unit, sigma[:, axis]))
        columns.append((f"u_bias_change_{letter}", model.room.unit, uncertainty[:, axis]))
    return record_table("bias_over_temperature", *columns, note=BIAS_NOTE)


def _nodes(model: TemperatureModel) -> Iterator[tuple[str, str, FloatArray]]:
    unit = model.room.unit
    uncertainty = np.sqrt(np.einsum("akk->ak", model.covariance)).reshape(3, len(model.node_c), 3)
    units = (f"1/({unit})", "1", unit)
    yield "temperature", "degC", model.node_c
    for axis, letter in enumerate("xyz"):
        for power, word in enumerate(POWER_WORDS):
            yield f"{word}_{letter}", units[power], model.coefficients[:, axis, power]
            yield f"u_{word}_{letter}", units[power], uncertainty[axis, :, power]


def _correlations(model: TemperatureModel, axis: int) -> RecordTable:
    """Within each node, and with the next one (the last node has none: 0)."""
    count = len(model.node_c)
    covariance = model.covariance[axis]
    deviation = np.sqrt(np.diag(covariance))
    scale = np.outer(deviation, deviation)
    within = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0)
    correlation = np.pad(np.clip(within, -1.0, 1.0), ((0, 0), (0, 3)))
    first = 3 * np.arange(count)
    columns: list[tuple[str, str, FloatArray]] = [("temperature", "degC", model.node_c)]
    for row, column in ((0, 1), (0, 2), (1, 2)):
        name = f"{POWER_WORDS[row]}_with_{POWER_WORDS[column]}"
        columns.append((name, "1", correlation[first + row, first + column]))
    for row, word in enumerate(POWER_WORDS):
        for column, other in enumerate(POWER_WORDS):
            name = f"{word}_with_next_{other}"
            columns.append((name, "1", correlation[first + row, first + 3 + column]))
    return record_table(f"{CORRELATION_TABLE}{'xyz'[axis]}", *columns, note=CORRELATION_NOTE)


def model_of_record(record: CalibrationRecord) -> TemperatureModel:
    """The model that `temperature_content` put into a record; between distant nodes the correlation is 0.

    Raises:
        CalibrationError: a quantity or a column is missing.
    """
    tables = {table.name: {one.name: one for one in table.columns} for table in record.tables}
    nodes = tables.get("nodes", {})

    def column(name: str) -> FloatArray:
        if name not in nodes:
            raise CalibrationError(
                f"The record's table of nodes has no column '{name}'.",
                where=f"record {record.title}",
                fault=Fault.DATA,
                remedy="make the record anew with 'testloom calibrate FOLDER… --record DIR'.",
            )
        return np.array(nodes[name].values) * derived_unit(nodes[name].unit).factor

    node_c = np.array(nodes["temperature"].values) if "temperature" in nodes else column("temperature")
    count = len(node_c)
    coefficients, covariance = np.zeros((count, 3, 3)), np.zeros((3, 3 * count, 3 * count))
    for axis, letter in enumerate("xyz"):
        deviation = np.zeros(3 * count)
        for power, word in enumerate(POWER_WORDS):
            coefficients[:, axis, power] = column(f"{word}_{letter}")
            deviation[power::3] = column(f"u_{word}_{letter}")
        known = tables.get(f"{CORRELATION_TABLE}{letter}", {})
        correlation = _correlation({name: np.array(one.values) for name, one in known.items()}, count)
        covariance[axis] = correlation * np.outer(deviation, deviation)
    return TemperatureModel(_room(record), node_c, coefficients, covariance, np.zeros(3), 0, 0)


def _room(record: CalibrationRecord) -> TriadCoefficients:
    quantities = [record.quantity(name) for name in TRIAD_NAMES]
    factor = np.array([derived_unit(one.unit).factor for one in quantities])
    values = np.array([one.value for one in quantities]) * factor
    covariance = record.covariance_of(TRIAD_NAMES) * np.outer(factor, factor)
    measured = "angular_rate" if record.sensor == "gyro" else "acceleration"
    return TriadCoefficients(measured, values[:9].reshape(3, 3), values[9:], covariance, 0.0, 0)


def _correlation(columns: Mapping[str, FloatArray], count: int) -> FloatArray:
    matrix = np.eye(3 * count)
    first = 3 * np.arange(count)
    for name, values in columns.items():
        word, _, other = name.partition("_with_")
        if not other:
            continue
        row = first + POWER_WORDS.index(word)
        column = first + POWER_WORDS.index(other.removeprefix("next_")) + 3 * other.startswith("next_")
        there = column < 3 * count
        matrix[row[there], column[there]] = matrix[column[there], row[there]] = values[there]
    return matrix


def ramp_content(fit: RampFit, letters: str, unit: str) -> RecordContent:
    """Both ways over temperature: figures of each channel in `letters`, and its curves.

    `unit`: 'rad/s' or 'm/s^2'.
    """
    units = (f"{unit}/(degC)", unit, RATE_UNITS[unit])
    quantities: list[CalibratedQuantity] = []
    blocks: list[CovarianceBlock] = []
    for channel, letter in enumerate(letters):
        names = [f"{stem}_{letter}" for stem in RAMP_STEMS]
        values = (
            fit.sensitivity_si_per_c[channel],
            fit.hysteresis_si[channel],
            fit.rate_si_s_per_c[channel],
        )
        order = [2, 1, 0]
        covariance = fit.covariance[channel][np.ix_(order, order)]
        deviation = np.sqrt(np.diag(covariance))
        for name, symbol, value, one, u in zip(names, ("s", "h", "k"), values, units, deviation, strict=True):
            quantities.append(quantity(name, f"{symbol}_{letter}", float(value), one, float(u)))
        blocks.append(covariance_block(names, covariance))
    curves: list[tuple[str, str, FloatArray]] = [("temperature", "degC", fit.temperature_c)]
    loops: list[tuple[str, str, FloatArray]] = [("temperature", "degC", fit.temperature_c)]
    for channel, letter in enumerate(letters):
        curve, loop = fit.curve_si[:, channel], fit.loop_si[:, channel]
        curves.append((f"warming_{letter}", unit, curve + 0.5 * loop))
        curves.append((f"cooling_{letter}", unit, curve - 0.5 * loop))
        curves.append((f"u_mean_{letter}", unit, fit.curve_u_si[:, channel]))
        loops.append((f"hysteresis_{letter}", unit, loop))
        loops.append((f"u_hysteresis_{letter}", unit, fit.loop_u_si[:, channel]))
    low, high = fit.span_c
    return RecordContent(
        method="temperature_ramp",
        model=Model(
            name="bias_over_temperature",
            equation="y = f(T) + k dT/dt ± h(T)/2, + after warming, - after cooling; s = mean slope of f",
        ),
        quantities=tuple(quantities),
        covariance=tuple(blocks),
        tables=(
            record_table("branches", *curves, note=BRANCHES_NOTE),
            record_table("loop", *loops),
        ),
        valid_temperature=TemperatureSpan(low_c=low, high_c=high),
    )

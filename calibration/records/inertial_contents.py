# pyright: strict
"""Inertial figures of merit in the form of records: bias, staircase, response, tumble, repeatability.

Letters name the sensors and body axes: 'xyz', or the few that the unit has.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from calibration.algorithms.axis_geometry import axis_geometry
from calibration.algorithms.bias_figures import BiasFigure, BiasStability
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.correlated_fit import CorrelatedFit
from calibration.algorithms.frequency_response import DelayAndLag, FrequencyResponse
from calibration.algorithms.repeatability import Repeatability
from calibration.algorithms.scale_factor_figures import StaircaseFigures
from calibration.algorithms.tumble_g_sensitivity import TumbleFigures
from calibration.records.content_parts import quantity, record_table
from calibration.records.making import TRIAD_EQUATION, RecordContent, covariance_block
from calibration.records.record import COVERAGE_PROBABILITY, LINEAR_TRIAD
from calibration.records.record_parts import (
    CalibratedQuantity,
    CovarianceBlock,
    Frame,
    Interval,
    Model,
    RecordedBudget,
    RecordedBudgetRow,
    RecordTable,
)

ON_THE_STAND = Frame(
    name="body", definition="nominal axes of the unit, as the stand's mounting and encoders give them"
)
G_SENSITIVITY_UNIT = "rad/s/(m/s^2)"
QUADRATIC_UNIT = "1/(m/s^2)"
QUANTUM_SHOWN = 0.01
"""Part of a bias's uncertainty from which on its budget has a row for the quantum."""
PAIRS = ("xy", "xz", "yz")


def bias_content(
    letters: str, found: BiasFigure | None, stability: BiasStability | None, unit: str
) -> RecordContent:
    """Bias of one rest and, from an hour on, bias stability. `unit`: 'rad/s' or 'm/s^2'."""
    quantities: list[CalibratedQuantity] = []
    budgets: list[RecordedBudget] = []
    if found is not None:
        of_noise = np.sqrt(np.maximum(found.of_mean**2 - found.of_quantum**2, 0.0))
        for k, letter in enumerate(letters):
            value = float(found.bias[k])
            quantities.append(
                quantity(f"bias_{letter}", f"b_{letter}", value, unit, float(found.standard_uncertainty[k]))
            )
            rows = [
                _row("noise of the mean", value, unit, float(of_noise[k]), "t", 1.0),
                _row(
                    "what truly acts",
                    float(found.true_input.value[k]),
                    unit,
                    float(found.true_input.standard_uncertainty[k]),
                    "normal",
                    -1.0,
                ),
            ]
            if found.of_quantum[k] > QUANTUM_SHOWN * found.standard_uncertainty[k]:
                rows.append(
                    _row("quantum of the samples", 0.0, unit, float(found.of_quantum[k]), "normal", 1.0)
                )
            budgets.append(RecordedBudget(result=f"bias_{letter}", rows=tuple(rows)))
        quantities += _trend(letters, found, unit)
    if stability is not None:
        bounds = stability.interval(COVERAGE_PROBABILITY)
        for k, letter in enumerate(letters):
            quantities.append(
                quantity(
                    f"bias_stability_{letter}",
                    f"B_s{letter}",
                    float(stability.stability[k]),
                    unit,
                    float(stability.standard_uncertainty[k]),
                    float(stability.degrees_of_freedom[k]),
                    _interval(bounds[k]),
                )
            )
    return RecordContent(
        method="bias",
        model=Model(name="bias", equation="y = b at zero input"),
        quantities=tuple(quantities),
        budgets=tuple(budgets),
        frames=(ON_THE_STAND,),
    )


def _trend(letters: str, found: BiasFigure, unit: str) -> list[CalibratedQuantity]:
    return [
        quantity(
            f"bias_trend_{letter}",
            f"r_{letter}",
            float(found.trend_per_s[k]),
            f"{unit}/(s)",
            float(found.trend_standard_uncertainty[k]),
        )
        for k, letter in enumerate(letters)
    ]


def repeatability_content(
    figure: str,
    letters: str,
    found: Repeatability,
    runs: Sequence[str],
    values: tuple[FloatArray, FloatArray],
    unit: str,
) -> RecordContent:
    """Of `figure` ('bias', 'scale_factor') over `runs`; `values`: and their uncertainties, (Q, m) each."""
    turned_on = found.condition == "each_power_on"
    name = f"turn_on_{figure}_repeatability" if turned_on else f"{figure}_repeatability"
    bounds = found.interval(COVERAGE_PROBABILITY)
    columns = [
        (f"{prefix}{figure}_{letter}", unit, part[:, k])
        for k, letter in enumerate(letters)
        for prefix, part in zip(("", "u_"), values, strict=True)
    ]
    return RecordContent(
        method="repeatability",
        model=Model(name=name, equation="s^2 = sum (x_q - mean x)^2 / (Q - 1)"),
        quantities=tuple(
            quantity(
                f"{name}_{letter}",
                f"s_{letter}",
                float(found.repeatability[k]),
                unit,
                float(found.standard_uncertainty[k]),
                found.runs - 1.0,
                _interval(bounds[k]),
            )
            for k, letter in enumerate(letters)
        ),
        tables=(record_table("runs", *columns, rows=runs),),
        frames=(ON_THE_STAND,),
    )


def staircase_content(letters: str, found: StaircaseFigures) -> RecordContent:
    """M and b of each gyro, linearity and asymmetry; the geometry where there are three gyros."""
    names, symbols = _matrix_names(letters)
    values = np.concatenate([found.matrix.ravel(), found.bias_rad_s])
    doubt = np.sqrt(np.diag(found.covariance))
    quantities = [
        quantity(name, symbol, float(value), "rad/s" if name.startswith("bias") else "1", float(u))
        for name, symbol, value, u in zip(names, symbols, values, doubt, strict=True)
    ]
    blocks = [covariance_block(names, found.covariance)]
    for letter, axis in zip(letters, found.axes, strict=True):
        quantities += [
            quantity(
                f"scale_factor_nonlinearity_{letter}",
                f"L_{letter}",
                axis.nonlinearity[0],
                "1",
                axis.nonlinearity[1],
            ),
            quantity(
                f"scale_factor_asymmetry_{letter}", f"K_a{letter}", axis.asymmetry[0], "1", axis.asymmetry[1]
            ),
        ]
    if found.coefficients is not None:
        geometry = axis_geometry(found.coefficients)
        of_geometry = [f"misalignment_{letter}" for letter in "xyz"]
        of_geometry += [f"nonorthogonality_{pair}" for pair in PAIRS]
        angles = [*geometry.misalignment_rad, *geometry.nonorthogonality_rad]
        signs = [*(f"phi_{letter}" for letter in "xyz"), *(f"n_{pair}" for pair in PAIRS)]
        quantities += [
            quantity(name, symbol, float(value), "rad", float(u))
            for name, symbol, value, u in zip(
                of_geometry, signs, angles, geometry.standard_uncertainty[3:], strict=True
            )
        ]
        blocks.append(covariance_block(of_geometry, geometry.covariance[3:, 3:]))
    return RecordContent(
        method="rate_staircase",
        model=Model(name=LINEAR_TRIAD if found.coefficients else "linear_sensor", equation=TRIAD_EQUATION),
        quantities=tuple(quantities),
        covariance=tuple(blocks),
        tables=tuple(
            record_table(
                f"linearity_{letter}",
                ("rate", "rad/s", axis.rates_rad_s),
                (f"nonlinearity_{letter}", "1", axis.residuals),
                ("u_nonlinearity", "1", np.sqrt(np.diag(axis.residual_covariance))),
                note="deviation from the line by least squares, part of the largest output",
            )
            for letter, axis in zip(letters, found.axes, strict=True)
        ),
        frames=(ON_THE_STAND,),
    )


def response_content(found: Sequence[tuple[str, FrequencyResponse, DelayAndLag]]) -> RecordContent:
    """Gain, delay, lag and bandwidth of each axis that was swept, with H band by band."""
    quantities: list[CalibratedQuantity] = []
    blocks: list[CovarianceBlock] = []
    tables: list[RecordTable] = []
    for letter, response, told in found:
        names = [f"{word}_{letter}" for word in ("gain", "delay", "time_constant", "total_delay")]
        gain = told.gain[0]
        from_log = np.array([[gain, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1]], dtype=np.float64)
        covariance = from_log @ told.covariance @ from_log.T
        values = (gain, told.delay_s[0], told.time_constant_s[0], told.total_delay_s[0])
        lag = Interval(lower=0.0, upper=max(told.time_constant_below_s, values[2]), probability=0.95)
        for k, (name, symbol, value, unit) in enumerate(
            zip(names, ("K", "L", "tau", "t"), values, ("1", "s", "s", "s"), strict=True)
        ):
            bounds = lag if k == 2 and not told.separated else None
            u = math.sqrt(max(float(covariance[k, k]), 0.0))
            quantities.append(quantity(name, f"{symbol}_{letter}", value, unit, u, interval=bounds))
        if told.bandwidth_hz is not None:
            quantities.append(
                quantity(
                    f"bandwidth_{letter}", f"f_{letter}", told.bandwidth_hz[0], "Hz", told.bandwidth_hz[1]
                )
            )
        blocks.append(covariance_block(names, covariance))
        polar = np.sqrt(np.einsum("bii->bi", response.polar_covariance()))
        phase: FloatArray = np.asarray(np.unwrap(np.angle(response.response)), dtype=np.float64)
        phase -= 2.0 * np.pi * round(float(phase[0]) / (2.0 * np.pi))
        tables.append(
            record_table(
                f"frequency_response_{letter}",
                ("frequency", "Hz", response.frequency_hz),
                ("gain", "1", response.gain),
                ("u_gain", "1", response.gain * polar[:, 0]),
                ("phase", "rad", phase),
                ("u_phase", "rad", polar[:, 1]),
            )
        )
    return RecordContent(
        method="frequency_response",
        model=Model(name="delay_and_lag", equation="H(f) = K exp(-i w L) / (1 + i w tau); t = L + tau"),
        quantities=tuple(quantities),
        covariance=tuple(blocks),
        tables=tuple(tables),
        frames=(ON_THE_STAND,),
    )


def tumble_gyro_content(found: TumbleFigures) -> RecordContent:
    """G of three gyros and the bias at zero rate and zero force."""
    quantities: list[CalibratedQuantity] = []
    blocks: list[CovarianceBlock] = []
    for row, fit in zip("xyz", found.fits, strict=True):
        names = [f"g_sensitivity_{row}{column}" for column in "xyz"] + [f"bias_{row}"]
        index = [fit.names.index(name) for name in ("f_x", "f_y", "f_z", "bias")]
        symbols = [f"G_{row}{column}" for column in "xyz"] + [f"b_{row}"]
        units = [G_SENSITIVITY_UNIT] * 3 + ["rad/s"]
        _take(quantities, blocks, fit, names, symbols, units, index)
    return RecordContent(
        method="tumble",
        model=Model(name="g_sensitivity", equation="y = b + M w + G f"),
        quantities=tuple(quantities),
        covariance=tuple(blocks),
        frames=(ON_THE_STAND,),
    )


def tumble_acc_content(found: TumbleFigures) -> RecordContent:
    """M, bias and quadratic term of three accelerometers."""
    quantities: list[CalibratedQuantity] = []
    blocks: list[CovarianceBlock] = []
    for row, fit in zip("xyz", found.fits, strict=True):
        names, symbols = _matrix_names(row)
        names, symbols = [*names, f"quadratic_nonlinearity_{row}"], [*symbols, f"K_2{row}"]
        index = [fit.names.index(name) for name in ("f_x", "f_y", "f_z", "bias", f"f_{row}^2")]
        units = ["1", "1", "1", "m/s^2", QUADRATIC_UNIT]
        _take(quantities, blocks, fit, names, symbols, units, index)
    return RecordContent(
        method="tumble",
        model=Model(name="quadratic", equation="y_i = b_i + sum m_ij f_j + K_2i f_i^2"),
        quantities=tuple(quantities),
        covariance=tuple(blocks),
        frames=(ON_THE_STAND,),
    )


def _take(
    quantities: list[CalibratedQuantity],
    blocks: list[CovarianceBlock],
    fit: CorrelatedFit,
    names: list[str],
    symbols: list[str],
    units: list[str],
    index: list[int],
) -> None:
    """Terms `index` of a fit of one sensor, with their covariance."""
    covariance = fit.covariance[0][np.ix_(index, index)]
    doubt = np.sqrt(np.diag(covariance))
    for name, symbol, unit, term, u in zip(names, symbols, units, index, doubt, strict=True):
        quantities.append(quantity(name, symbol, float(fit.values[0, term]), unit, float(u)))
    blocks.append(covariance_block(names, covariance))


def _matrix_names(letters: str) -> tuple[list[str], list[str]]:
    """Names and symbols of the rows of M and of b, as `making.TRIAD_NAMES` for 'xyz'."""
    pairs = [(row, column) for row in letters for column in "xyz"]
    names = [
        f"scale_factor_{row}" if row == column else f"cross_axis_sensitivity_{row}{column}"
        for row, column in pairs
    ]
    symbols = [f"m_{row}{column}" for row, column in pairs]
    return [*names, *(f"bias_{row}" for row in letters)], [*symbols, *(f"b_{row}" for row in letters)]


def _interval(bounds: FloatArray) -> Interval:
    return Interval(lower=float(bounds[0]), upper=float(bounds[1]), probability=COVERAGE_PROBABILITY)


def _row(
    name: str, estimate: float, unit: str, u: float, distribution: Literal["normal", "t"], sensitivity: float
) -> RecordedBudgetRow:
    return RecordedBudgetRow(
        quantity=name,
        estimate=estimate,
        unit=unit,
        standard_uncertainty=u,
        distribution=distribution,
        sensitivity=sensitivity,
    )

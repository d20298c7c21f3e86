# pyright: strict
"""What the methods of the papers found, in the one form that records have.

Uncertainties of a reference that is common to all readings (table, voltmeter, grating) are part of the
standard uncertainties and stand as rows in the budgets.
"""

import math

import numpy as np

from calibration.algorithms.allan_coefficients import AllanFit
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.magnetometer import UPPER, MagnetometerCoefficients
from calibration.algorithms.overload_g_sensitivity import GSensitivity
from calibration.algorithms.pure_lag import PureLag
from calibration.algorithms.rate_gyro import FittedLine, LineMethod, RateGyroResult
from calibration.algorithms.rate_gyro_uncertainty import Multimeter, linearity_budget
from calibration.algorithms.rate_table_readings import RateTable, StrokeReadings
from calibration.algorithms.sinusoidal_overload import OverloadResult
from calibration.algorithms.uncertainty_budget import BudgetRow, UncertaintyBudget
from calibration.records.content_parts import limited, quantity, record_table
from calibration.records.making import RecordContent, covariance_block
from calibration.records.record import COVERAGE_PROBABILITY
from calibration.records.record_parts import (
    CalibratedQuantity,
    Interval,
    Model,
    RecordedBudget,
    RecordedBudgetRow,
    RecordTable,
)

SLOPE_UNIT = "V/(rad/s)"
QUADRATIC_UNIT = "1/(m/s^2)"
G_SENSITIVITY_UNIT = "rad/s/(m/s^2)"
_SPELLED = {"s^2/m": QUADRATIC_UNIT}
ALLAN_TERMS: dict[str, tuple[tuple[str, str], ...]] = {
    "rad/s": (
        ("quantization", "rad"),
        ("angle_random_walk", "rad/sqrt(s)"),
        ("bias_instability", "rad/s"),
        ("rate_random_walk", "rad/s/sqrt(s)"),
        ("rate_ramp", "rad/s/(s)"),
    ),
    "m/s^2": (
        ("quantization", "m/s"),
        ("velocity_random_walk", "m/s/sqrt(s)"),
        ("bias_instability", "m/s^2"),
        ("acceleration_random_walk", "m/s^2/sqrt(s)"),
        ("acceleration_ramp", "m/s^2/(s)"),
    ),
}
"""Names and units of Q, N, B, K, R for samples in SI."""


def rate_gyro_content(
    readings: StrokeReadings,
    result: RateGyroResult,
    table: RateTable,
    meter: Multimeter,
    line_method: LineMethod = "least_squares",
) -> RecordContent:
    """Paper 4: sensitivity, bias, linearity, hysteresis, repeatability.

    An error of the table or the meter that is proportional to the reading goes into K whole; the meter's
    part of its range into the bias. Neither shows in the scatter.
    """
    line = result.lines[line_method]
    of_slope, of_bias = _line_budgets(line, table, meter)
    worst = int(np.abs(line.residual_v).argmax())
    of_linearity = linearity_budget(readings, line, table, meter, worst)
    shared = float(line.covariance[0, 1] - table.earth_rate_on_axis_rad_s * line.covariance[1, 1])
    pair = np.array([[of_slope.standard_uncertainty**2, shared], [shared, of_bias.standard_uncertainty**2]])
    strokes = float(readings.repeatability_degrees_of_freedom)
    return RecordContent(
        method="rate_gyro",
        model=Model(name="line", equation=f"Y = bias + scale_factor R; line: {line_method}"),
        quantities=(
            _of_budget("scale_factor", "K", of_slope, of_slope.estimate),
            _of_budget("bias", "Y_0", of_bias, of_bias.estimate),
            _of_budget("scale_factor_nonlinearity", "l", of_linearity, result.linearity[line_method]),
            quantity(
                "hysteresis", "", result.hysteresis, "1", result.hysteresis_standard_uncertainty, strokes
            ),
            quantity(
                "repeatability",
                "s",
                result.repeatability,
                "1",
                result.repeatability_standard_uncertainty,
                strokes,
            ),
        ),
        covariance=(covariance_block(("scale_factor", "bias"), pair),),
        budgets=(
            recorded_budget("scale_factor", of_slope),
            recorded_budget("bias", of_bias),
            recorded_budget("scale_factor_nonlinearity", of_linearity),
        ),
        tables=(
            record_table(
                "readings",
                ("rate", "rad/s", readings.points.rate_rad_s),
                *(
                    (f"{way}_{cycle}", "V", stroke)
                    for cycle, strokes in enumerate(zip(readings.up_v, readings.down_v, strict=True), start=1)
                    for way, stroke in zip(("up", "down"), strokes, strict=True)
                ),
                ("mean_output", "V", readings.mean_v),
                ("residual", "V", line.residual_v),
            ),
        ),
    )


def _line_budgets(
    line: FittedLine, table: RateTable, meter: Multimeter
) -> tuple[UncertaintyBudget, UncertaintyBudget]:
    """Of K and of the output at zero inertial rate."""
    slope, freedom = line.sensitivity_v_per_rad_s, float(line.degrees_of_freedom)
    root3 = math.sqrt(3.0)
    of_slope = UncertaintyBudget(
        "scale_factor",
        slope,
        SLOPE_UNIT,
        (
            BudgetRow(
                "scatter about the line",
                slope,
                SLOPE_UNIT,
                line.sensitivity_standard_uncertainty,
                "t",
                1.0,
                freedom,
            ),
            BudgetRow("table rate, relative", 1.0, "1", table.relative_accuracy / root3, "uniform", -slope),
            BudgetRow("meter, part of the reading", 1.0, "1", meter.reading_part / root3, "uniform", slope),
        ),
    )
    bias = line.bias_v(table)
    earth = table.earth_rate_on_axis_rad_s
    to_bias = np.array([1.0, -earth])
    scatter = math.sqrt(float(to_bias @ line.covariance @ to_bias))
    of_bias = UncertaintyBudget(
        "bias",
        bias,
        "V",
        (
            BudgetRow("scatter about the line", bias, "V", scatter, "t", 1.0, freedom),
            BudgetRow("wander from stroke to stroke", 0.0, "V", line.wander_v, "normal", 1.0),
            BudgetRow(
                "meter, part of its range", 0.0, "V", meter.range_part * meter.range_v / root3, "uniform", 1.0
            ),
        ),
    )
    return of_slope, of_bias


def pure_lag_content(lag: PureLag, delays_s: FloatArray | None = None) -> RecordContent:
    """Paper 3: the lag and the bounds that it lies between for certain.

    `delays_s`: from each impact to the first frame that shows it, shape (shots,).
    """
    bounds = Interval(lower=lag.lower_s, upper=lag.upper_s, probability=1.0)
    # Evenly between bounds: 95.45 % lie within 1.653 standard deviations of the middle.
    found = quantity("pure_lag", "tau", lag.lag_s, "s", lag.standard_uncertainty_s)
    evenly = {"interval": bounds, "coverage_factor": math.sqrt(3.0) * COVERAGE_PROBABILITY}
    return RecordContent(
        method="pure_lag",
        model=Model(name="lag", equation="y(t) = u(t - pure_lag)"),
        quantities=(found.model_copy(update=evenly),),
        tables=() if delays_s is None else (_shots(delays_s),),
        assumptions=(f"{lag.shots} shots, the phases of their impacts to the frames evenly spread",),
    )


def _shots(delays_s: FloatArray) -> RecordTable:
    """Phases of the impacts fill one frame period evenly: a step or a hole in it shows at once."""
    return record_table(
        "shots",
        ("rank", "1", np.arange(1.0, len(delays_s) + 1.0)),
        ("first_response", "s", np.sort(delays_s)),
        note="from the impact to the first frame that shows it, in rising order",
    )


def overload_content(result: OverloadResult) -> RecordContent:
    """Paper 5: asymmetry and odd quadratic non-linearity of an accelerometer."""
    names = ("scale_factor_asymmetry", "odd_quadratic_nonlinearity")
    values = (result.asymmetry, result.odd_quadratic_nonlinearity_s2_m)
    units = ("1", QUADRATIC_UNIT)
    uncertainties = np.sqrt(np.diag(result.covariance))
    budgets: list[RecordedBudget] = []
    for k, name in enumerate(names):
        scatter = math.sqrt(float(result.random_covariance[k, k]))
        rows = [_row(BudgetRow("scatter of the cycles, counting", values[k], units[k], scatter, "t", 1.0))]
        for one in result.sensitivities:
            unit = _SPELLED.get(one.unit, one.unit)
            moved = (one.asymmetry, one.odd_quadratic_s2_m)[k]
            rows.append(_row(BudgetRow(one.quantity, 0.0, unit, one.standard_uncertainty, "normal", moved)))
        budgets.append(
            RecordedBudget(result=name, rows=tuple(rows), note="estimates of what is known: as an error")
        )
    return RecordContent(
        method="sinusoidal_overload",
        model=Model(name="overload", equation="dN/dt = K_1 (1 + K_a sgn A) (K_0 + A + K_2 A|A|)"),
        quantities=tuple(
            quantity(name, symbol, value, unit, float(u))
            for name, symbol, value, unit, u in zip(
                names, ("K_a", "K_2"), values, units, uncertainties, strict=True
            )
        ),
        covariance=(covariance_block(names, result.covariance),),
        budgets=tuple(budgets),
    )


def g_sensitivity_content(found: GSensitivity) -> RecordContent:
    """Paper 5: D of three gyros, row i of gyro i."""
    names = [[f"g_sensitivity_{row}{column}" for column in "xyz"] for row in "xyz"]
    uncertainty = found.standard_uncertainty
    return RecordContent(
        method="sinusoidal_overload",
        model=Model(name="g_sensitivity", equation="bias = bias_0 + D f"),
        quantities=tuple(
            quantity(
                names[i][j],
                f"D_{i + 1}{'xyz'[j]}",
                float(found.matrix[i, j]),
                G_SENSITIVITY_UNIT,
                float(uncertainty[i, j]),
            )
            for i in range(3)
            for j in range(3)
        ),
        covariance=tuple(covariance_block(names[i], found.covariance[i]) for i in range(3)),
    )


def allan_content(fit: AllanFit, unit: str) -> RecordContent:
    """IEEE 952 coefficients of samples in `unit`, 'rad/s' or 'm/s^2'.

    A term that the data do not determine has an interval alone, from 0 to what it could be at most.
    """
    terms = ("quantization", "random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
    quantities: list[CalibratedQuantity] = []
    known: list[int] = []
    for index, (term, (name, unit_of_term)) in enumerate(zip(terms, ALLAN_TERMS[unit], strict=True)):
        if fit.covariance[index, index] == 0.0:
            continue  # not asked for
        value = math.sqrt(float(fit.squares[index]))
        lower, upper = fit.interval(term)
        interval = Interval(lower=lower, upper=upper, probability=COVERAGE_PROBABILITY)
        uncertainty = None
        if fit.determined(term):
            uncertainty = fit.standard_uncertainty(term)
            known.append(index)
        found = quantity(name, "QNBKR"[index], value, unit_of_term, uncertainty, interval=interval)
        quantities.append(found)
    covariance = ()
    if known:
        twice = 2.0 * np.sqrt(fit.squares[known])
        block = fit.covariance[np.ix_(known, known)] / np.outer(twice, twice)
        covariance = (covariance_block([ALLAN_TERMS[unit][k][0] for k in known], block),)
    return RecordContent(
        method="allan_variance",
        model=Model(
            name="allan", equation="sigma^2 = 3 Q^2/t^2 + N^2/t + (2 ln 2/pi) B^2 + K^2 t/3 + R^2 t^2/2"
        ),
        quantities=tuple(quantities),
        covariance=covariance,
        tables=(
            record_table(
                "residuals", ("averaging_time", "s", fit.tau_s), ("relative_residual", "1", fit.residuals)
            ),
        ),
    )


def magnetometer_content(found: MagnetometerCoefficients, unit: str, field_unit: str) -> RecordContent:
    """Hard and soft iron: h = K (m - b).

    `unit`: of the outputs; `field_unit`: of h, '1' where only directions count.
    """
    of_compensation = "1" if unit == field_unit else f"{field_unit}/({unit})"
    names = [f"soft_iron_compensation_{'xyz'[row]}{'xyz'[column]}" for row, column in UPPER]
    names += [f"hard_iron_{axis}" for axis in "xyz"]
    values = [float(found.compensation[row, column]) for row, column in UPPER] + [
        float(b) for b in found.hard_iron
    ]
    units = [of_compensation] * 6 + [unit] * 3
    symbols = [f"k_{'xyz'[row]}{'xyz'[column]}" for row, column in UPPER] + ["b_x", "b_y", "b_z"]
    uncertainties = np.sqrt(np.diag(found.covariance))
    return RecordContent(
        method="magnetometer",
        model=Model(name="ellipsoid", equation="h = K (m - b), K symmetric"),
        quantities=tuple(
            quantity(*each)
            for each in zip(names, symbols, values, units, map(float, uncertainties), strict=True)
        ),
        covariance=(covariance_block(names, found.covariance),),
        assumptions=(
            f"{found.outliers} of {found.sample_count} samples lie off the ellipsoid and were left out",
        ),
    )


def recorded_budget(result: str, budget: UncertaintyBudget) -> RecordedBudget:
    """A budget of the quantity `result`."""
    return RecordedBudget(result=result, rows=tuple(_row(row) for row in budget.rows), note=budget.note)


def _row(row: BudgetRow) -> RecordedBudgetRow:
    return RecordedBudgetRow(
        quantity=row.quantity,
        estimate=row.estimate,
        unit=row.unit,
        standard_uncertainty=row.standard_uncertainty,
        distribution=row.distribution,
        sensitivity=row.sensitivity,
        degrees_of_freedom=limited(row.degrees_of_freedom),
    )


def _of_budget(name: str, symbol: str, budget: UncertaintyBudget, value: float) -> CalibratedQuantity:
    freedom = limited(budget.degrees_of_freedom)
    return quantity(name, symbol, value, budget.unit, budget.standard_uncertainty, freedom)

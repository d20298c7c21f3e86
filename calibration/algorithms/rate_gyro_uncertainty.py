"""How uncertain the linearity of a rate gyro is: by GUM and by Monte Carlo (JCGM 101:2008).

Paper 4's budget takes reading, intercept, sensitivity and rate as independent (`independent_budget`,
eq (7)). They are not: the line is made from the readings. `linearity_budget` sends every input through
the operator I - X W of the fit (see `rate_gyro`), so that a reading's part shrinks by sqrt(1 - h).

Meter and table errors are taken as independent from point to point, within their stated bounds. The
part of them that is proportional to the rate would go into K and leave the linearity alone, so
this bounds their effect from above. Rates in rad/s, outputs in V, linearity relative to Y_FS (1).
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.rate_gyro import FittedLine, LineMethod, design, residuals
from calibration.algorithms.rate_table_readings import FloatArray, RateTable, StrokeReadings
from calibration.algorithms.uncertainty_budget import BudgetRow, UncertaintyBudget
from protocol.errors import CalibrationError, Fault

MIN_TRIALS = 2_000
MAX_TRIALS = 1_000_000
"""Bounds of a Monte Carlo run; JCGM 101:2008, 7.2.2, advises 1e6 where a tail quantile is to be quoted."""
TRIALS_AT_ONCE = 5_000
INTERVAL = (0.025, 0.975)
"""Quantiles of the probabilistically symmetric 95 % interval."""


@dataclass(frozen=True)
class Multimeter:
    """Bounds of a voltmeter's error: `reading_part` of the reading plus `range_part` of `range_v`."""

    reading_part: float
    range_part: float
    range_v: float

    def bound_v(self, reading_v: FloatArray) -> FloatArray:
        """Half-width of the error's uniform distribution, V, in the shape of the readings."""
        return self.reading_part * np.abs(reading_v) + self.range_part * self.range_v


@dataclass(frozen=True)
class LinearityTerms:
    """The quantities of paper 4, eq (7), at one point, and what each is known to.

    Any one unit of rate does, as long as rate, sensitivity and their uncertainties share it.
    """

    rate: float
    rate_unit: str
    sensitivity: float
    intercept_v: float
    reading_v: float
    full_scale_v: float
    u_rate: float
    u_sensitivity: float
    u_intercept_v: float
    u_reading_v: float


def independent_budget(terms: LinearityTerms, note: str) -> UncertaintyBudget:
    """Paper 4's budget of l_i: all four quantities as if independent, eq (7).

    With the printed u(R_i) = 1e-4/sqrt(3) deg/s it is the paper's 0.0213 %; with the table's relative
    accuracy taken as relative it is 0.0215 %. Show both, and `linearity_budget` beside them.
    """
    per_volt = 1.0 / terms.full_scale_v
    residual = terms.reading_v - terms.intercept_v - terms.sensitivity * terms.rate
    slope_unit = f"V/({terms.rate_unit})"
    return UncertaintyBudget(
        result="linearity at one point",
        estimate=residual * per_volt,
        unit="1",
        rows=(
            BudgetRow("output y_i", terms.reading_v, "V", terms.u_reading_v, "normal", per_volt),
            BudgetRow("intercept Y_0", terms.intercept_v, "V", terms.u_intercept_v, "normal", -per_volt),
            BudgetRow(
                "sensitivity K",
                terms.sensitivity,
                slope_unit,
                terms.u_sensitivity,
                "normal",
                -terms.rate * per_volt,
            ),
            BudgetRow(
                "table rate R_i",
                terms.rate,
                terms.rate_unit,
                terms.u_rate,
                "uniform",
                -terms.sensitivity * per_volt,
            ),
        ),
        note=note,
    )


def linearity_budget(
    readings: StrokeReadings, line: FittedLine, table: RateTable, meter: Multimeter, point: int
) -> UncertaintyBudget:
    """The budget of l_i, eq (5), with the line's dependence on the readings.

    Args:
        readings, line: the line was fitted to these readings.
        table, meter: bounds of the instruments' errors.
        point: index of the point, -n … n - 1.

    Raises:
        CalibrationError: a point that is not there.
    """
    count = len(readings.points.rate_rad_s)
    if not -count <= point < count:
        raise _refused(f"There is no point {point} among {count}.")
    rate, mean, full_scale = readings.points.rate_rad_s, readings.mean_v, readings.full_scale_v
    strokes = 2 * len(readings.up_v)
    through_line = (np.eye(count) - design(rate) @ line.weights)[point]
    u_mean = readings.repeatability_v / math.sqrt(strokes)
    u_meter = meter.bound_v(mean) / math.sqrt(3.0)
    u_rate = table.rate_standard_uncertainty_rad_s(rate)
    slope = line.sensitivity_v_per_rad_s
    at_ends = u_mean**2 + u_meter[[0, -1]] ** 2 + (slope * u_rate[[0, -1]]) ** 2
    u_full_scale = math.sqrt(float(at_ends.sum()))
    residual = float(line.residual_v[point])
    per_volt = 1.0 / full_scale
    of_mean = float(np.linalg.norm(through_line)) * per_volt  # sqrt(1 - h) / Y_FS for least squares

    def reached(u: FloatArray) -> float:
        return math.sqrt(float((through_line**2) @ u**2))

    nu = float(readings.repeatability_degrees_of_freedom)
    repeats = f"repeatability, mean of {strokes}, through the line"
    of_table = "table rate, all points through the line"
    rows = (
        BudgetRow(repeats, float(mean[point]), "V", u_mean, "t", of_mean, nu),
        BudgetRow("meter, all points through the line", 0.0, "V", reached(u_meter), "uniform", per_volt),
        BudgetRow(of_table, 0.0, "V", reached(slope * u_rate), "uniform", -per_volt),
        BudgetRow("full scale Y_FS", full_scale, "V", u_full_scale, "normal", -residual * per_volt**2, nu),
    )
    words = f"linearity at {rate[point]:.6g} rad/s from the {line.method} line"
    return UncertaintyBudget(words, residual * per_volt, "1", rows, "the line depends on the readings")


@dataclass(frozen=True)
class MonteCarloLinearity:
    """Distributions propagated through fit and linearity (JCGM 101:2008); all relative to Y_FS (1).

    Attributes:
        point_mean, point_standard_uncertainty: of l_i, shape (n,).
        point_interval: its 95 % interval, shape (2, n).
        maximum_mean, maximum_standard_uncertainty, maximum_interval: of max |l_i|.
        straight_line_mean, straight_line_95: of max |l_i| of a gyro that is perfectly linear: the
            largest of n residuals is never zero. A linearity below the latter is not told from none.
        trials: how many.
    """

    point_mean: FloatArray
    point_standard_uncertainty: FloatArray
    point_interval: FloatArray
    maximum_mean: float
    maximum_standard_uncertainty: float
    maximum_interval: tuple[float, float]
    straight_line_mean: float
    straight_line_95: float
    trials: int


def monte_carlo_linearity(
    readings: StrokeReadings,
    method: LineMethod,
    table: RateTable,
    meter: Multimeter,
    generator: np.random.Generator,
    trials: int = 20_000,
) -> MonteCarloLinearity:
    """Draw readings, meter errors and table rates, fit again, and look at the linearities.

    The repeatability is pooled, so one chi-square scales a trial's normal draws (a t distribution at
    each point). A rate that is off by d shifts the reading by K d: exact to the square of 1e-4.

    Args:
        generator: seeded by the caller.
        trials: `MIN_TRIALS` to `MAX_TRIALS`.

    Raises:
        CalibrationError: a number of trials out of bounds.
    """
    if not MIN_TRIALS <= trials <= MAX_TRIALS:
        raise _refused(f"{trials} trials are not between {MIN_TRIALS} and {MAX_TRIALS}.")
    rate, mean = readings.points.rate_rad_s, readings.mean_v
    nu = readings.repeatability_degrees_of_freedom
    u_mean = readings.repeatability_v / math.sqrt(2 * len(readings.up_v))
    slope = float((mean[-1] - mean[0]) / (rate[-1] - rate[0]))
    meter_bound = meter.bound_v(mean)
    rate_bound = math.sqrt(3.0) * slope * table.rate_standard_uncertainty_rad_s(rate)
    straight = slope * rate
    linearity = np.empty((trials, len(rate)))
    floor = np.empty(trials)
    for start in range(0, trials, TRIALS_AT_ONCE):
        shape = (min(TRIALS_AT_ONCE, trials - start), len(rate))
        part = slice(start, start + shape[0])
        scale = np.sqrt(nu / generator.chisquare(nu, size=(shape[0], 1)))
        error = scale * u_mean * generator.standard_normal(shape)
        error += meter_bound * generator.uniform(-1.0, 1.0, shape)
        error += rate_bound * generator.uniform(-1.0, 1.0, shape)
        for base, where in ((mean, linearity), (straight, None)):
            drawn = base + error
            relative = residuals(method, rate, drawn) / np.abs(drawn[:, -1] - drawn[:, 0])[:, None]
            if where is None:
                floor[part] = np.abs(relative).max(axis=1)
            else:
                where[part] = relative
    largest = np.abs(linearity).max(axis=1)
    low, high = (float(value) for value in np.quantile(largest, INTERVAL))
    return MonteCarloLinearity(
        point_mean=linearity.mean(axis=0),
        point_standard_uncertainty=linearity.std(axis=0, ddof=1),
        point_interval=np.quantile(linearity, INTERVAL, axis=0),
        maximum_mean=float(largest.mean()),
        maximum_standard_uncertainty=float(largest.std(ddof=1)),
        maximum_interval=(low, high),
        straight_line_mean=float(floor.mean()),
        straight_line_95=float(np.quantile(floor, 0.95)),
        trials=trials,
    )


def gum_holds(budget: UncertaintyBudget, interval: tuple[float, float]) -> bool:
    """Does the GUM's 95 % interval agree with a Monte Carlo one to a digit (JCGM 101:2008, 8.1)?

    Tolerance: half of the last digit of u_c written with one significant digit.
    """
    u = budget.standard_uncertainty
    if u == 0.0:
        return interval[0] == interval[1] == budget.estimate
    tolerance = 0.5 * 10.0 ** math.floor(math.log10(u))
    half_width = budget.coverage_factor(INTERVAL[1] - INTERVAL[0]) * u
    return (
        abs(budget.estimate - half_width - interval[0]) <= tolerance
        and abs(budget.estimate + half_width - interval[1]) <= tolerance
    )


def _refused(what: str) -> CalibrationError:
    return CalibrationError(
        what,
        where="uncertainty of a rate gyro's linearity",
        fault=Fault.PLAN,
        remedy="ask for something that the calibration has.",
    )

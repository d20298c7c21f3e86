"""A rate gyro's line, linearity, hysteresis and repeatability from a rate table (paper 4).

    Y_i = Y_0 + K R_i                       eq (1): line of one of four kinds
    l_i = (y_i - Y_0 - K R_i) / Y_FS        eq (5): y_i the mean of all strokes at point i
    linearity = max |l_i|                   eq (6)

Every line is linear in the means: (Y_0, K) = W y. So the residuals are (I - X W) y, and what is
uncertain in y reaches them through that one operator. For least squares its diagonal is 1 - h_i,
h the leverage: the line follows the reading, and a residual's standard deviation is s sqrt(1 - h).

Least squares does not have the smallest non-linearity, as paper 4 says; the minimax line has.
Rates in rad/s, outputs in V.
"""

# pyright: strict
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.algorithms.rate_table_readings import FloatArray, RateTable, StrokeReadings
from protocol.errors import CalibrationError, Fault

LineMethod = Literal["end_point", "two_halves", "least_squares", "minimax"]
LINE_METHODS: tuple[LineMethod, ...] = ("end_point", "two_halves", "least_squares", "minimax")

RANGE_COEFFICIENT = {2: 1.13, 3: 1.69, 4: 2.06, 5: 2.33, 6: 2.53, 7: 2.70, 8: 2.85, 9: 2.97}
"""Mean range of n normal readings over their standard deviation (JJF 1059.1, table 1)."""
RANGE_DEGREES_OF_FREEDOM = {2: 0.9, 3: 1.8, 4: 2.7, 5: 3.6, 6: 4.5, 7: 5.3, 8: 6.0, 9: 6.8}
"""Of the range method (JJF 1059.1, table 1)."""
MAX_LOCAL_SLOPE = 0.5
"""How far, relative to the whole line's, the slope between two neighbouring points may be off."""
MIN_SPAN_TO_SCATTER = 10.0
"""An output that spans less than this many times its own repeatability does not follow the rate."""


@dataclass(frozen=True)
class FittedLine:
    """Y = Y_0 + K R through the means of the points.

    Attributes:
        method: which line.
        sensitivity_v_per_rad_s: K.
        intercept_v: Y_0, at zero rate of the *table*.
        covariance: of (Y_0, K), shape (2, 2), from the scatter of the means about the least-squares
            line (n - 2 degrees of freedom): what is no straight line counts as scatter. A bias
            that moves all readings alike is not in it.
        residual_v: y_i - Y_0 - K R_i, shape (n,).
        weights: W, shape (2, n). That of the minimax line holds while its three points stay the same.
        scatter_v: s, standard deviation of the means about the least-squares line.
        wander_v: standard uncertainty of Y_0 beside `covariance`, from how far whole strokes lie apart: a
            bias that wanders moves a stroke's readings alike. What stays off in the whole run is in neither.
    """

    method: LineMethod
    sensitivity_v_per_rad_s: float
    intercept_v: float
    covariance: FloatArray
    residual_v: FloatArray
    weights: FloatArray
    scatter_v: float
    wander_v: float = 0.0

    @property
    def degrees_of_freedom(self) -> int:
        """Of `covariance`: n - 2."""
        return len(self.residual_v) - 2

    @property
    def sensitivity_standard_uncertainty(self) -> float:
        """u(K), V/(rad/s); s / sqrt(S_xx) for least squares."""
        return math.sqrt(self.covariance[1, 1])

    @property
    def intercept_standard_uncertainty(self) -> float:
        """u(Y_0), V; s / sqrt(n) for least squares over points that are symmetric about zero."""
        return math.sqrt(self.covariance[0, 0])

    def bias_v(self, table: RateTable) -> float:
        """Output at zero *inertial* rate: the intercept less what the Earth's rotation adds, V."""
        return self.intercept_v - self.sensitivity_v_per_rad_s * table.earth_rate_on_axis_rad_s


def line_weights(method: LineMethod, rate_rad_s: FloatArray, mean_v: FloatArray) -> FloatArray:
    """W of (Y_0, K) = W y, shape (2, n).

    Args:
        method: 'end_point': through the outermost points. 'two_halves': slope between the means of the
            lower and the upper half (a middle point of an odd count in neither), through the mean of
            all. 'least_squares'. 'minimax': smallest largest residual (Chebyshev).
        rate_rad_s: shape (n,), ascending.
        mean_v: shape (n,); only 'minimax' looks at it.
    """
    count = len(rate_rad_s)
    centre = np.full(count, 1.0 / count)
    slope = np.zeros(count)
    if method == "end_point":
        slope[[0, -1]] = np.array([-1.0, 1.0]) / (rate_rad_s[-1] - rate_rad_s[0])
        centre = np.zeros(count)
        centre[0] = 1.0
    elif method == "two_halves":
        half = count // 2
        slope[:half], slope[-half:] = -1.0 / half, 1.0 / half
        slope /= slope @ rate_rad_s
    elif method == "least_squares":
        deviation = rate_rad_s - rate_rad_s.mean()
        slope = deviation / (deviation @ deviation)
    else:
        first, second, opposite = _minimax_points(rate_rad_s, mean_v)
        slope[[first, second]] = np.array([-1.0, 1.0]) / (rate_rad_s[second] - rate_rad_s[first])
        centre = np.zeros(count)
        centre[first] = centre[opposite] = 0.5
    # The line passes through (centre . R, centre . y).
    return np.vstack([centre - (centre @ rate_rad_s) * slope, slope])


def _minimax_points(rate_rad_s: FloatArray, mean_v: FloatArray) -> tuple[int, int, int]:
    """Two points on one side of the narrowest strip and the one on the other side.

    The strip's vertical width is convex and piecewise linear in its slope, with a kink at the slope
    of each pair: the least width is at one of them.
    """
    first, second = np.triu_indices(len(rate_rad_s), k=1)
    slopes = (mean_v[second] - mean_v[first]) / (rate_rad_s[second] - rate_rad_s[first])
    levels = mean_v[None, :] - slopes[:, None] * rate_rad_s[None, :]
    best = int(np.argmin(levels.max(axis=1) - levels.min(axis=1)))
    level = levels[best]
    own = level[first[best]]
    above = level.max() - own > own - level.min()
    opposite = int(np.argmax(level) if above else np.argmin(level))
    return int(first[best]), int(second[best]), opposite


def residuals(method: LineMethod, rate_rad_s: FloatArray, mean_v: FloatArray) -> FloatArray:
    """y - Y_0 - K R of many sets of means at once, shapes (n,), (m, n) → (m, n), V."""
    if method != "minimax":
        operator = np.eye(len(rate_rad_s)) - design(rate_rad_s) @ line_weights(method, rate_rad_s, mean_v)
        return mean_v @ operator.T
    first, second = np.triu_indices(len(rate_rad_s), k=1)
    slopes = (mean_v[:, second] - mean_v[:, first]) / (rate_rad_s[second] - rate_rad_s[first])
    width = np.full(len(mean_v), np.inf)
    narrowest = np.empty_like(mean_v)
    for column in range(slopes.shape[1]):
        level = mean_v - slopes[:, column, None] * rate_rad_s
        own = np.ptp(level, axis=1)
        better = own < width
        width[better] = own[better]
        narrowest[better] = level[better]
    return narrowest - 0.5 * (narrowest.max(axis=1) + narrowest.min(axis=1))[:, None]


def design(rate_rad_s: FloatArray) -> FloatArray:
    """X of y = X (Y_0, K), shape (n, 2)."""
    return np.column_stack([np.ones(len(rate_rad_s)), rate_rad_s])


def leverage(rate_rad_s: FloatArray) -> FloatArray:
    """h_i of the least-squares line, shape (n,): 0.318 at the ends of 11 equal points."""
    deviation = rate_rad_s - rate_rad_s.mean()
    return np.asarray(1.0 / len(rate_rad_s) + deviation**2 / (deviation @ deviation), dtype=np.float64)


def fit_line(readings: StrokeReadings, method: LineMethod = "least_squares") -> FittedLine:
    """Fit one kind of line to the means of the points (paper 4, eq (1)-(4)).

    Raises:
        CalibrationError: an output that does not follow the rate.
    """
    mean, rate = readings.mean_v, readings.points.rate_rad_s
    _refuse_dead_axis(readings)
    squares = line_weights("least_squares", rate, mean)
    from_squares = mean - design(rate) @ (squares @ mean)
    scatter = math.sqrt(float(from_squares @ from_squares) / (len(rate) - 2))
    weights = line_weights(method, rate, mean)
    intercept, sensitivity = weights @ mean
    return FittedLine(
        method=method,
        sensitivity_v_per_rad_s=float(sensitivity),
        intercept_v=float(intercept),
        covariance=scatter**2 * weights @ weights.T,
        residual_v=mean - design(rate) @ (weights @ mean),
        weights=weights,
        scatter_v=scatter,
        wander_v=_wander_v(readings),
    )


def _wander_v(readings: StrokeReadings) -> float:
    """Of the mean over all strokes: how strokes scatter beyond what their single readings make."""
    offsets = [stroke.mean(axis=1) - stroke.mean() for stroke in (readings.up_v, readings.down_v)]
    cycles, points = readings.up_v.shape
    of_stroke = float(sum((offset**2).sum() for offset in offsets)) / (2 * (cycles - 1))
    by_readings = readings.repeatability_v**2 / points
    return math.sqrt(max(of_stroke - by_readings, 0.0) / (2 * cycles))


@dataclass(frozen=True)
class RateGyroResult:
    """What a rate-table calibration tells; all but the lines are relative to Y_FS (1).

    Attributes:
        lines: by method.
        linearity: max |l_i| by method.
        point_linearity: l_i by method, shape (n,) each.
        hysteresis: largest difference of the mean up and the mean down stroke.
        hysteresis_standard_uncertainty: from the repeatability of single readings.
        hysteresis_rate_rad_s: the point where it is largest.
        repeatability: standard deviation of one reading, pooled over points and strokes.
        repeatability_standard_uncertainty: of it, for normal readings.
        full_scale_v: Y_FS.
    """

    lines: dict[LineMethod, FittedLine]
    linearity: dict[LineMethod, float]
    point_linearity: dict[LineMethod, FloatArray]
    hysteresis: float
    hysteresis_standard_uncertainty: float
    hysteresis_rate_rad_s: float
    repeatability: float
    repeatability_standard_uncertainty: float
    full_scale_v: float


def evaluate_rate_gyro(readings: StrokeReadings) -> RateGyroResult:
    """All four lines and what follows from the strokes.

    The uncertainty of the linearity is `rate_gyro_uncertainty`'s; the hysteresis is the largest of n
    differences and so, for a gyro that has none, above zero by about two of its uncertainties.

    Raises:
        CalibrationError: an output that does not follow the rate.
    """
    lines: dict[LineMethod, FittedLine] = {method: fit_line(readings, method) for method in LINE_METHODS}
    _refuse_bent_output(readings, lines["least_squares"])
    full_scale = readings.full_scale_v
    per_point: dict[LineMethod, FloatArray] = {
        method: line.residual_v / full_scale for method, line in lines.items()
    }
    linearity: dict[LineMethod, float] = {
        method: float(np.abs(values).max()) for method, values in per_point.items()
    }
    loop = np.abs(readings.up_v.mean(axis=0) - readings.down_v.mean(axis=0)) / full_scale
    widest = int(np.argmax(loop))
    cycles = len(readings.up_v)
    repeatability = readings.repeatability_v / full_scale
    return RateGyroResult(
        lines=lines,
        linearity=linearity,
        point_linearity=per_point,
        hysteresis=float(loop[widest]),
        hysteresis_standard_uncertainty=repeatability * math.sqrt(2.0 / cycles),
        hysteresis_rate_rad_s=float(readings.points.rate_rad_s[widest]),
        repeatability=repeatability,
        repeatability_standard_uncertainty=repeatability
        / math.sqrt(2.0 * readings.repeatability_degrees_of_freedom),
        full_scale_v=full_scale,
    )


def range_repeatability(readings_v: FloatArray) -> tuple[float, float]:
    """Standard deviation of a *single* reading by the range method, V, and its degrees of freedom.

    As paper 4 does with six readings at 100 deg/s, C = 2.53. For the mean of n divide by sqrt(n).

    Raises:
        CalibrationError: a number of readings that the method has no coefficient for.
    """
    count = len(readings_v)
    if count not in RANGE_COEFFICIENT or not np.isfinite(readings_v).all():
        raise CalibrationError(
            f"The range method takes {min(RANGE_COEFFICIENT)} to {max(RANGE_COEFFICIENT)} readings, each of "
            f"them a number; here are {count}.",
            where="repeatability by the range method",
            fault=Fault.DATA,
            remedy="use the standard deviation, which holds for any number of readings.",
        )
    return float(np.ptp(readings_v)) / RANGE_COEFFICIENT[count], RANGE_DEGREES_OF_FREEDOM[count]


def _refuse_bent_output(readings: StrokeReadings, line: FittedLine) -> None:
    """A gyro whose output stands still between two rates is saturated there, or the rates are not those."""
    rate, mean = readings.points.rate_rad_s, readings.mean_v
    slopes = np.diff(mean) / np.diff(rate) / line.sensitivity_v_per_rad_s
    by_noise = 6.0 * readings.repeatability_v / np.diff(rate) / abs(line.sensitivity_v_per_rad_s)
    bent = np.abs(slopes - 1.0) > np.maximum(MAX_LOCAL_SLOPE, by_noise)
    if not bent.any():
        return
    at = int(np.argmax(np.abs(slopes - 1.0)))
    raise CalibrationError(
        f"Between {rate[at]:.6g} and {rate[at + 1]:.6g} rad/s the output changes {slopes[at]:.2f} times as "
        "much as the line says: it is saturated, or these are not the rates.",
        where="line of a rate gyro",
        fault=Fault.DATA,
        remedy="leave out rates beyond the gyro's range, and look at the points' rates.",
    )


def _refuse_dead_axis(readings: StrokeReadings) -> None:
    if readings.full_scale_v > MIN_SPAN_TO_SCATTER * readings.repeatability_v:
        return
    raise CalibrationError(
        f"The output spans {readings.full_scale_v:.3g} V between the outermost points and repeats to "
        f"{readings.repeatability_v:.3g} V: it does not follow the rate.",
        where="line of a rate gyro",
        fault=Fault.UNIT,
        remedy="see that the axis under test is the axis that turns, and that its output is connected.",
    )

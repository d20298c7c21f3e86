"""Readings of a rate gyro on a single-axis rate table: the points, the strokes, what cannot be used.

A rate table does not hold a rate below its minimum. A point at zero is therefore taken with the
table locked, or not at all: that is asked, never assumed. Rates are the table's, relative to the
ground; what the Earth adds along the input axis is the same at every point and moves the line's
intercept only (`RateTable.earth_rate_on_axis_rad_s`).
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.errors import CalibrationError, Fault

FloatArray = NDArray[np.float64]

MIN_POINTS = 3
"""Two points carry a line but tell nothing of its linearity."""
MAX_POINTS = 201
"""More points than a calibration on a table ever has; bounds the search for the minimax line."""
MIN_CYCLES = 2
"""Up and down strokes that tell a repeatability."""
OUTLIER_SIGMAS = 6.0
"""A reading this many robust standard deviations from the others of its point and stroke is named."""
_ROBUST_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class RateTable:
    """The reference.

    Attributes:
        minimum_rate_rad_s, maximum_rate_rad_s: magnitudes between which the table holds a rate.
        relative_accuracy: half-width of its error's uniform distribution, relative to the rate.
        earth_rate_on_axis_rad_s: the Earth's rotation along the gyro's input axis.
    """

    minimum_rate_rad_s: float
    maximum_rate_rad_s: float
    relative_accuracy: float
    earth_rate_on_axis_rad_s: float

    def __post_init__(self) -> None:
        if not 0 <= self.minimum_rate_rad_s < self.maximum_rate_rad_s < math.inf:
            raise _refused("The table's range of rates is not a range.", Fault.STAND)
        if not 0 <= self.relative_accuracy < 1 or not math.isfinite(self.earth_rate_on_axis_rad_s):
            raise _refused("The table's accuracy or the Earth rate on its axis is not a number.", Fault.STAND)

    def rate_standard_uncertainty_rad_s(self, rate_rad_s: FloatArray) -> FloatArray:
        """u(R_i), shape (n,): relative to the rate, and zero where the table is locked.

        Paper 4 takes the relative 1e-4 for an absolute one; at 100 deg/s it is 5.77e-3 deg/s.
        """
        return np.abs(rate_rad_s) * self.relative_accuracy / math.sqrt(3.0)


@dataclass(frozen=True)
class CalibrationPoints:
    """Rates to take readings at: `rate_rad_s` (n,) ascending; `locked` (n,) where the table is at rest.

    Use `choose_points`, which holds them against the table.
    """

    rate_rad_s: FloatArray
    locked: NDArray[np.bool_]


def equal_points(end_rate_rad_s: float, count: int) -> FloatArray:
    """`count` rates at equal steps from -end to +end, shape (count,), rad/s (11 in paper 4)."""
    if not (math.isfinite(end_rate_rad_s) and end_rate_rad_s > 0 and MIN_POINTS <= count <= MAX_POINTS):
        raise _refused(f"Take {MIN_POINTS} to {MAX_POINTS} points up to a rate above zero.", Fault.PLAN)
    # Symmetric to the last bit, so that the middle of an odd count is zero itself.
    half = np.linspace(-end_rate_rad_s, end_rate_rad_s, count)
    return np.asarray(0.5 * (half - half[::-1]), dtype=np.float64)


def choose_points(rate_rad_s: FloatArray, table: RateTable, *, locked_at_zero: bool) -> CalibrationPoints:
    """Check an operator's rates against what the table can do.

    Args:
        rate_rad_s: shape (n,), in any order.
        table: that is to hold them.
        locked_at_zero: take the point at zero, if there is one, with the table locked.

    Raises:
        CalibrationError: too few or too many points, one twice, one that the table cannot hold, or
            zero without leave to lock the table.
    """
    rates = np.sort(np.array(rate_rad_s, dtype=np.float64))
    if rates.ndim != 1 or not MIN_POINTS <= len(rates) <= MAX_POINTS or not np.isfinite(rates).all():
        raise _refused(
            f"A calibration takes {MIN_POINTS} to {MAX_POINTS} points, each of them a number.", Fault.PLAN
        )
    if (np.diff(rates) <= 0).any():
        raise _refused("A calibration point is named twice.", Fault.PLAN)
    at_rest = rates == 0.0
    magnitude = np.abs(rates)
    beyond = (magnitude > table.maximum_rate_rad_s) | (~at_rest & (magnitude < table.minimum_rate_rad_s))
    if beyond.any():
        named = ", ".join(f"{rate:.6g}" for rate in rates[beyond])
        raise _refused(
            f"The table holds {table.minimum_rate_rad_s:.6g} to {table.maximum_rate_rad_s:.6g} rad/s either "
            f"way, not {named} rad/s.",
            Fault.PLAN,
        )
    if at_rest.any() and table.minimum_rate_rad_s > 0 and not locked_at_zero:
        raise _refused(
            f"The points include 0, below the table's {table.minimum_rate_rad_s:.6g} rad/s: it can only be "
            "taken with the table locked.",
            Fault.PLAN,
        )
    return CalibrationPoints(rates, at_rest)


@dataclass(frozen=True)
class SuspectReading:
    """A reading far from the others of its point and stroke. It is named, not left out."""

    stroke: str
    cycle: int
    rate_rad_s: float
    deviation_v: float


@dataclass(frozen=True)
class StrokeReadings:
    """What the multimeter showed on the way up and on the way down.

    Attributes:
        points: n of them.
        up_v, down_v: shape (cycles, n) each, V, in the order of the points.
        range_limit_v: magnitude at and above which a reading is saturated; None: not known.

    Raises:
        CalibrationError: shapes that do not fit, missing or saturated readings, or a single cycle.
    """

    points: CalibrationPoints
    up_v: FloatArray
    down_v: FloatArray
    range_limit_v: float | None = None

    def __post_init__(self) -> None:
        count = len(self.points.rate_rad_s)
        for stroke in ("up", "down"):
            readings = np.array(getattr(self, f"{stroke}_v"), dtype=np.float64)  # a copy of our own
            if readings.ndim != 2 or readings.shape[1] != count:
                raise _refused(
                    f"The {stroke} strokes have shape {readings.shape}, not (cycles, {count}).", Fault.DATA
                )
            self._refuse_unusable(stroke, readings)
            readings.setflags(write=False)
            object.__setattr__(self, f"{stroke}_v", readings)
        if self.up_v.shape != self.down_v.shape or len(self.up_v) < MIN_CYCLES:
            raise _refused(
                f"{len(self.up_v)} strokes up and {len(self.down_v)} down: repeatability takes as many of "
                f"each, and {MIN_CYCLES} at least.",
                Fault.DATA,
            )

    def _refuse_unusable(self, stroke: str, readings: FloatArray) -> None:
        limit = math.inf if self.range_limit_v is None else self.range_limit_v
        for what, wrong in (
            ("is missing", ~np.isfinite(readings)),
            (f"is at the end of the range ({limit:g} V)", np.abs(readings) >= limit),
        ):
            if wrong.any():
                cycle, point = (int(index[0]) for index in np.nonzero(wrong))
                raise _refused(
                    f"The {stroke} stroke {cycle + 1} at {self.points.rate_rad_s[point]:.6g} rad/s {what}.",
                    Fault.DATA,
                )

    @property
    def mean_v(self) -> FloatArray:
        """Mean of all strokes at each point, shape (n,), V."""
        return np.asarray(0.5 * (self.up_v.mean(axis=0) + self.down_v.mean(axis=0)), dtype=np.float64)

    @property
    def full_scale_v(self) -> float:
        """Y_FS = Y_M - Y_N (paper 4, eq (6)): the span of the means at the outermost points, V."""
        mean = self.mean_v
        return abs(float(mean[-1] - mean[0]))

    @property
    def repeatability_degrees_of_freedom(self) -> int:
        """Of `repeatability_v`: 2 n (cycles - 1)."""
        return 2 * self.up_v.shape[1] * (self.up_v.shape[0] - 1)

    @property
    def repeatability_v(self) -> float:
        """Standard deviation of one reading about the mean of its point and stroke, pooled, V.

        A bias that moves from cycle to cycle is in it: an upper bound for what a line cannot take up.
        """
        deviations = np.concatenate(
            [self.up_v - self.up_v.mean(axis=0), self.down_v - self.down_v.mean(axis=0)]
        )
        return math.sqrt(float((deviations**2).sum()) / self.repeatability_degrees_of_freedom)

    def suspects(self) -> tuple[SuspectReading, ...]:
        """Readings further than `OUTLIER_SIGMAS` from the median of their point and stroke.

        With two cycles both readings are as far from their median: nothing can be said, nothing is.
        """
        if len(self.up_v) <= MIN_CYCLES:
            return ()
        deviations = {
            "up": self.up_v - np.median(self.up_v, axis=0),
            "down": self.down_v - np.median(self.down_v, axis=0),
        }
        both = np.abs(np.concatenate(list(deviations.values())))
        # A median of a few is one of them: its zeros would pull the scale down.
        away = both[both > 0]
        bound = OUTLIER_SIGMAS * _ROBUST_SIGMA * float(np.median(away)) if len(away) else math.inf
        return tuple(
            SuspectReading(
                stroke, int(cycle) + 1, float(self.points.rate_rad_s[point]), float(table[cycle, point])
            )
            for stroke, table in deviations.items()
            for cycle, point in np.argwhere(np.abs(table) > bound)
        )


def _refused(what: str, fault: Fault) -> CalibrationError:
    remedies = {
        Fault.PLAN: "choose other calibration points, or lock the table at zero.",
        Fault.STAND: "look at the table's certificate.",
        Fault.DATA: "look at the recording, and take the strokes again.",
    }
    return CalibrationError(what, where="rate table readings", fault=fault, remedy=remedies[fault])

# pyright: strict
"""The unit's clock on the bench's clock, from the turns themselves.

Both streams see the same turns. The centroid in time of a turn's rate, ∫t ω dt / ∫ω dt, does not depend
on the gyro's scale factor; over a window that is symmetric about it the bias drops out as well. So each
turn gives one pair of moments, and a line through them gives the unit's offset and skew, without any
latency of a link or a program in it. For 1080° in 5 s and 0.05 °/s of noise at 200 Hz a centroid is good
to 15 µs; the skew of a session of some minutes to better than 1e-6, where a unit's crystal may be wrong
by 1e-4 and a scale factor would be wrong by the same.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RATE_THRESHOLD = 0.1
"""Share of the largest rate above which the stand or the unit counts as turning."""
EDGE_S = 0.3
"""A capture of a turn begins and ends with at least so much rest."""
WINDOW_SHARE = 0.58
"""Half the window over which a turn is integrated, as a share of the time above the threshold: beyond
the feet of a triangle's ramps (0.556), within the rests of a capture."""
MIN_SEEN_ANGLE = 0.5
"""A gyro that saw less than this share of a turn (a dead axis) tells nothing of its time."""
MIN_TURNS = 2
MAX_SKEW = 1e-3
MAX_RESIDUAL_S = 1e-3


@dataclass(frozen=True)
class ClockAlignment:
    """bench time = bench_reference_s + (1 + skew) · (unit time − unit_reference_s).

    Attributes:
        residual_max_s: largest distance of a turn from the line; 0 if there were too few for one.
        turns: how many turns it rests on; 0: skew is not known, and taken as 0.
    """

    unit_reference_s: float
    bench_reference_s: float
    skew: float
    residual_max_s: float
    turns: int

    def bench_time_s(self, unit_time_s: FloatArray) -> FloatArray:
        """Bench time (n,) of moments (n,) on the unit's clock."""
        return self.bench_reference_s + (1.0 + self.skew) * (unit_time_s - self.unit_reference_s)

    @property
    def is_plausible(self) -> bool:
        """Skew and residuals are those of a crystal."""
        return abs(self.skew) <= MAX_SKEW and self.residual_max_s <= MAX_RESIDUAL_S


def turn_centroid_s(time_s: FloatArray, rate_rad_s: FloatArray) -> tuple[float, float]:
    """Centroid of a turn, on the clock of `time_s`, and the angle it saw (rad, signed).

    Args:
        time_s: (n,), uniform.
        rate_rad_s: (n,), about the axis of the turn, with at least `EDGE_S` of rest before and after.
    """
    at_edges = (time_s < time_s[0] + EDGE_S) | (time_s > time_s[-1] - EDGE_S)
    magnitude = np.abs(rate_rad_s - rate_rad_s[at_edges].mean())
    if not magnitude.any():  # a dead axis: nothing at all
        return float(time_s.mean()), 0.0
    turning = np.flatnonzero(magnitude > RATE_THRESHOLD * magnitude.max())
    first, last = time_s[turning[0]], time_s[turning[-1]]
    middle = (first + last) / 2
    inside = np.abs(time_s - middle) <= WINDOW_SHARE * (last - first)
    rest = rate_rad_s[~inside].mean() if not inside.all() else 0.0
    rate, time = rate_rad_s[inside] - rest, time_s[inside]
    angle = float(rate.sum() * (time[-1] - time[0]) / (len(time) - 1))
    moment = float((rate * (time - middle)).sum() / rate.sum()) if angle else 0.0
    return float(middle) + moment, angle


def align(
    unit_centroids_s: FloatArray,
    bench_centroids_s: FloatArray,
    seen_angles: FloatArray,
    *,
    fallback: tuple[float, float],
) -> ClockAlignment:
    """The line through the turns.

    Args:
        unit_centroids_s, bench_centroids_s: (n,), of the same turns.
        seen_angles: (n,), the unit's angle over the stand's.
        fallback: (unit time, bench time) of one moment, as good as it is known; used when fewer than
            `MIN_TURNS` turns were seen.
    """
    usable = seen_angles >= MIN_SEEN_ANGLE
    if int(usable.sum()) < MIN_TURNS:
        return ClockAlignment(*fallback, skew=0.0, residual_max_s=0.0, turns=0)
    unit, bench = unit_centroids_s[usable], bench_centroids_s[usable]
    unit_mean, bench_mean = float(unit.mean()), float(bench.mean())
    from_mean = unit - unit_mean
    excess = (
        bench - bench_mean
    ) - from_mean  # differences of near-equal numbers: before the slope, not after
    skew = float(from_mean @ excess / (from_mean @ from_mean))
    residuals = excess - skew * from_mean
    return ClockAlignment(unit_mean, bench_mean, skew, float(np.abs(residuals).max()), len(unit))

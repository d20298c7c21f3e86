"""Acceptance of a sinusoidal overload rig (paper 5, 5.1): the guide's angles, how runs come to their peak.

Pitch and roll of the slide are read off an interferometer at 30 points or more of the stroke, with the crank
at 18 deg/s at most. A run is judged by its grating: when it started, when the overload was there, how long it
stayed, and how even it was.

Out of scope: what the interferometer itself is good to, and bending of the slide at speed.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.sinusoidal_overload import refused
from protocol.errors import Fault
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

MIN_POINTS = 30
MAX_GAP = 3.0
"""Largest distance between neighbouring points, in mean distances: the whole stroke is to be seen."""
AT_PEAK = 0.01
"""A cycle within this of the run's overload is at its peak."""
MOVED = 1e-3
"""Of the stroke: what is a motion at all."""
MIN_CYCLES = 4


@dataclass(frozen=True)
class GuideAngle:
    """One angle of the slide over its stroke.

    Attributes:
        largest_rad: largest deviation from the mean, signed.
        at_m: where.
        span_rad: largest less smallest.
        gravity_m_s2: what the largest deviation couples of gravity into a level axis.
    """

    largest_rad: float
    at_m: float
    span_rad: float
    gravity_m_s2: float


@dataclass(frozen=True)
class RunFigures:
    """How a run went.

    Attributes:
        overload_g: amplitude of the acceleration at its peak: half stroke times w^2, median of the cycles.
        start_up_s: from the first motion to the first cycle at the peak; None: it ran from the beginning.
        at_peak_s: how long cycles stayed within `AT_PEAK`.
        unevenness: standard deviation of the overload over those cycles, relative.
        cycles: at the peak.
    """

    overload_g: float
    start_up_s: float | None
    at_peak_s: float
    unevenness: float
    cycles: int


def guide_angle(position_m: FloatArray, angle_rad: FloatArray) -> GuideAngle:
    """Deviations of pitch or roll over the stroke.

    Args:
        position_m, angle_rad: shape (n,), n at least `MIN_POINTS`.

    Raises:
        CalibrationError: too few points, missing ones, or a part of the stroke without any.
    """
    position, angle = np.asarray(position_m, dtype=np.float64), np.asarray(angle_rad, dtype=np.float64)
    if position.shape != angle.shape or position.ndim != 1 or not np.isfinite(np.r_[position, angle]).all():
        raise refused("Positions and angles of the guide do not fit, or some are missing.", Fault.DATA)
    if len(position) < MIN_POINTS:
        raise refused(f"{len(position)} points of the stroke: {MIN_POINTS} are needed.", Fault.PLAN)
    gaps = np.diff(np.sort(position))
    if float(gaps.max()) > MAX_GAP * float(gaps.mean()) or gaps.mean() == 0.0:
        raise refused(f"A part of the stroke of {gaps.max():.3g} m has no point.", Fault.PLAN)
    deviation = angle - angle.mean()
    worst = int(np.abs(deviation).argmax())
    largest = float(deviation[worst])
    span = float(np.ptp(angle))
    return GuideAngle(largest, float(position[worst]), span, STANDARD_GRAVITY_M_S2 * math.sin(abs(largest)))


def run_figures(time_s: FloatArray, position_m: FloatArray) -> RunFigures:
    """Overload, start-up time, time at the peak and evenness, by the grating.

    Args:
        time_s, position_m: shape (n,), from before the start on for a start-up time.

    Raises:
        CalibrationError: missing samples, or fewer than `MIN_CYCLES` cycles.
    """
    time, position = np.asarray(time_s, dtype=np.float64), np.asarray(position_m, dtype=np.float64)
    if time.shape != position.shape or not np.isfinite(np.r_[time, position]).all() or len(time) < 2:
        raise refused("The grating's times and positions do not fit, or some are missing.", Fault.DATA)
    if (np.diff(time) <= 0.0).any():
        raise refused("The grating's time does not run forward.", Fault.DATA)
    low, high = float(position.min()), float(position.max())
    centred = position - 0.5 * (low + high)
    before = np.flatnonzero((centred[:-1] < 0.0) & (centred[1:] >= 0.0))
    if len(before) < MIN_CYCLES + 1:
        raise refused(f"{max(len(before) - 1, 0)} cycles: {MIN_CYCLES} are needed.", Fault.PLAN)
    part = -centred[before] / (centred[before + 1] - centred[before])
    passes = time[before] + part * (time[before + 1] - time[before])
    periods = np.diff(passes)
    overload = 0.5 * (high - low) * (2.0 * math.pi / periods) ** 2 / STANDARD_GRAVITY_M_S2
    peak = float(np.median(overload[overload >= 0.9 * float(np.quantile(overload, 0.9))]))
    there = np.abs(overload / peak - 1.0) <= AT_PEAK
    first = int(np.argmax(there))
    moving = np.flatnonzero(np.abs(position - position[0]) > MOVED * (high - low))
    began = float(time[max(int(moving[0]) - 1, 0)])
    start_up = None if first == 0 else float(passes[first]) - began
    even = float(overload[there].std() / peak)
    return RunFigures(peak, start_up, float(periods[there].sum()), even, int(there.sum()))

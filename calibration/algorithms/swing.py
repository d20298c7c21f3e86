"""A swing on a turntable: how far a unit's angle lags behind the stand's, what error is left (paper 2, 4.1).

Of each whole cycle, by least squares:

    y(t) - theta(t - tau_0) = c_0 + c_1 t + c_2 t^2 + s theta - (1 + s) (tau - tau_0) theta'

c: what the unit's zero and its gyro's bias do slowly; s: its scale factor error; tau: the lag, in quadrature
with the angle. A clock of the unit that runs fast by d makes tau grow by d a second: tau of the cycles lie on
a line over time, whose value at 0, where the trigger was, is the lag. tau_0 follows that line until it stands
still, so the lag may be many samples. The scatter about it is the uncertainty: with c in each, cycles share
little but what swings along with the angle. An error of the rate in step with the angle (g-sensitivity) is an
error of the angle in quadrature with it, and looks like a lag: `lag_per_error` says how much.

What is left once the lag is taken out is the attitude error proper. Clocks that no trigger joins shift tau by
their offset: no data of one swing tell the two apart, since both are a shift of the same time.
"""

# pyright: strict
import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.attitude_error_figures import ErrorFigure, error_figure
from calibration.algorithms.coefficients import FloatArray
from protocol.errors import CalibrationError, Fault

MIN_CYCLES = 4
MIN_SAMPLES_A_CYCLE = 20
MAX_LOST_PART = 0.1
"""A cycle that lost more of its samples than this is not used."""
REACHED_PART = 0.9
"""Of the amplitude, on both sides, by a cycle of the swing."""
MAX_PERIOD_CHANGE = 0.1
MAX_STEPS = 6
SETTLED_S = 1e-8
"""The line moves by no more."""
PAPER_OFFSET_S, PAPER_RATE_DEG_S, PAPER_ERROR_DEG = 0.013, 200.0, 2.6
"""Paper 2's largest error, and clocks that are 13 ms apart, which make it at 200 deg/s."""

Late = tuple[float, float]
"""Lag at time 0, and what it grows by in a second."""


@dataclass(frozen=True)
class SwingSamples:
    """The unit's angle (n,) at its times, the stand's angle and rate (m,) at its own, SI.

    `breaks_s`: where the unit's angle was begun anew; a cycle that holds one is not used.
    """

    unit_time_s: FloatArray
    unit_angle_rad: FloatArray
    stand_time_s: FloatArray
    stand_angle_rad: FloatArray
    stand_rate_rad_s: FloatArray
    breaks_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class SwingResult:
    """k cycles.

    Attributes:
        lag_s: at time 0 of the unit's clock.
        clock_drift: by which the unit's clock runs fast, relative.
        scale_factor_error: mean of the cycles.
        covariance: (3, 3) of these, from the cycles' scatter.
        cycle_time_s, lag_of_cycle_s: (k,) middle and lag of each.
        period_s, amplitude_rad, peak_rate_rad_s: of the swing.
        error: what is left without lag, and without each cycle's mean.
        error_time_s, error_rad: (j,) the same, over the cycles that were used.
        largest_rad: largest difference of the two angles as recorded, lag and all, each cycle's mean off.
        cycles_lost: not used for missing samples.
        lag_per_error: lag (s) that an added angle (name -> rad) looks like; see `fit_swing`.
    """

    lag_s: float
    clock_drift: float
    scale_factor_error: float
    covariance: FloatArray
    cycle_time_s: FloatArray
    lag_of_cycle_s: FloatArray
    period_s: float
    amplitude_rad: float
    peak_rate_rad_s: float
    error: ErrorFigure
    error_time_s: FloatArray
    error_rad: FloatArray
    largest_rad: float
    cycles_lost: int
    lag_per_error: dict[str, float]

    @property
    def cycles(self) -> int:
        """That were used."""
        return len(self.lag_of_cycle_s)

    @property
    def lag_scatter_uncertainty_s(self) -> float:
        """Standard uncertainty of the lag, `cycles` - 2 degrees of freedom."""
        return math.sqrt(float(self.covariance[0, 0]))


def fit_swing(samples: SwingSamples, added_rad: dict[str, FloatArray] | None = None) -> SwingResult:
    """Lag, scale factor error and attitude error.

    Args:
        samples: a record that holds a swing, with rests before and after or without.
        added_rad: errors of the unit's angle (n,) that could be there, by name: what lag each looks like.

    Raises:
        CalibrationError: no swing, fewer than `MIN_CYCLES` whole cycles with samples, a unit that does not
            follow.
    """
    cycles = swing_cycles(samples)
    kept: list[NDArray[np.intp]] = []
    usual = np.median(np.diff(samples.unit_time_s))
    for begin_s, end_s in cycles:
        if any(begin_s <= moment <= end_s for moment in samples.breaks_s):
            continue
        inside = np.flatnonzero((samples.unit_time_s >= begin_s) & (samples.unit_time_s < end_s))
        inside = inside[np.isfinite(samples.unit_angle_rad[inside])]
        if len(inside) >= max(MIN_SAMPLES_A_CYCLE, (1.0 - MAX_LOST_PART) * (end_s - begin_s) / usual):
            kept.append(inside)
    if len(kept) < MIN_CYCLES:
        raise _refused(
            f"{len(kept)} of {len(cycles)} whole cycles have samples: {MIN_CYCLES} are needed.",
            "swing for more cycles, and look at the unit's link",
        )
    middle_s = np.array([float(samples.unit_time_s[rows].mean()) for rows in kept])
    late, lags, scales = _settled(samples, kept, middle_s)
    values, covariance = _line(middle_s, lags, scales)
    error, largest = _errors(samples, kept, values)
    if np.std(np.concatenate(error)) > 0.5 * _amplitude(samples, cycles):
        raise _refused(
            "The unit's angle does not follow the stand's.",
            "see whether the unit's axes are mounted as stated, and whether its gyros live",
        )
    rows = np.concatenate(kept)
    return SwingResult(
        lag_s=float(values[0]),
        clock_drift=float(values[1]),
        scale_factor_error=float(values[2]),
        covariance=covariance,
        cycle_time_s=middle_s,
        lag_of_cycle_s=lags,
        period_s=float(np.mean([end - begin for begin, end in cycles])),
        amplitude_rad=_amplitude(samples, cycles),
        peak_rate_rad_s=_peak(samples, cycles),
        error=error_figure(np.concatenate(error)),
        error_time_s=samples.unit_time_s[rows],
        error_rad=np.concatenate(error),
        largest_rad=largest,
        cycles_lost=len(cycles) - len(kept),
        lag_per_error={
            name: _lag_of(samples, kept, late, angle) for name, angle in (added_rad or {}).items()
        },
    )


def swing_cycles(samples: SwingSamples) -> list[tuple[float, float]]:
    """Begin and end (s, the stand's clock) of each whole cycle, from centre to centre going up.

    Raises:
        CalibrationError: the stand did not swing.
    """
    angle, time_s = samples.stand_angle_rad, samples.stand_time_s
    centre = 0.5 * (float(np.nanmax(angle)) + float(np.nanmin(angle)))
    amplitude = 0.5 * float(np.nanmax(angle) - np.nanmin(angle))
    if not amplitude > 0.0:
        raise _refused("The stand did not swing.", "record the profile 'swing'")
    off = angle - centre
    up = np.flatnonzero((off[:-1] < 0.0) & (off[1:] >= 0.0))
    found: list[tuple[float, float]] = []
    for first, last in pairwise(up):
        piece = off[first : last + 1]
        if piece.max() >= REACHED_PART * amplitude and piece.min() <= -REACHED_PART * amplitude:
            found.append((_crossing(time_s, off, first), _crossing(time_s, off, last)))
    if not found:
        raise _refused("The stand's angle makes no whole cycle.", "record the profile 'swing'")
    spans = np.array([end - begin for begin, end in found])
    usual = float(np.median(spans))
    return [
        cycle
        for cycle, span in zip(found, spans, strict=True)
        if abs(span - usual) < MAX_PERIOD_CHANGE * usual
    ]


def _crossing(time_s: FloatArray, off: FloatArray, index: np.intp) -> float:
    part = -off[index] / (off[index + 1] - off[index])
    return float(time_s[index] + part * (time_s[index + 1] - time_s[index]))


def _settled(
    samples: SwingSamples, kept: list[NDArray[np.intp]], middle_s: FloatArray
) -> tuple[Late, FloatArray, FloatArray]:
    """(lag at 0, drift) that the cycles' fits stand still at; lag and scale factor error of each cycle."""
    late: Late = (0.0, 0.0)
    lags, scales = np.zeros(len(kept)), np.zeros(len(kept))
    for _ in range(MAX_STEPS):
        fits = np.array([_fit_cycle(samples, rows, late, samples.unit_angle_rad) for rows in kept])
        scales = fits[:, 3]
        left = fits[:, 4] / np.maximum(1.0 + scales, 0.1)
        lags = late[0] + late[1] * middle_s + left
        before, line = late, np.polynomial.polynomial.polyfit(middle_s, lags, 1)
        late = (float(line[0]), float(line[1]))
        moved = (late[0] - before[0]) + (late[1] - before[1]) * middle_s
        if float(np.abs(moved).max()) < SETTLED_S:
            break
    return late, lags, scales


def _fit_cycle(
    samples: SwingSamples, rows: NDArray[np.intp], late: Late, angle: FloatArray, of_added: bool = False
) -> FloatArray:
    time_s = samples.unit_time_s[rows]
    at_s = time_s - late[0] - late[1] * time_s
    theta = np.interp(at_s, samples.stand_time_s, samples.stand_angle_rad)
    rate = np.interp(at_s, samples.stand_time_s, samples.stand_rate_rad_s)
    span = 2.0 * (time_s - time_s.mean()) / max(float(np.ptp(time_s)), 1e-9)
    design = np.stack([np.ones_like(span), span, span**2, theta, -rate], axis=1)
    wanted = angle[rows] if of_added else angle[rows] - theta
    return np.asarray(np.linalg.lstsq(design, wanted, rcond=None)[0], dtype=np.float64)


def _lag_of(samples: SwingSamples, kept: list[NDArray[np.intp]], late: Late, added: FloatArray) -> float:
    return float(np.mean([_fit_cycle(samples, rows, late, added, of_added=True)[4] for rows in kept]))


def _line(middle_s: FloatArray, lags_s: FloatArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(lag at 0, drift, mean scale factor error) and their covariance (3, 3)."""
    design = np.stack([np.ones_like(middle_s), middle_s], axis=1)
    weights = np.zeros((3, len(middle_s)))
    weights[:2] = np.linalg.pinv(design)
    weights[2] = 1.0 / len(middle_s)
    line = weights[:2] @ lags_s
    left = np.stack([lags_s - design @ line, scales - scales.mean()])
    scatter = left @ left.T / (len(middle_s) - 2)
    of_cycle = scatter[np.ix_([0, 0, 1], [0, 0, 1])]
    return np.array([*line, scales.mean()]), (weights @ weights.T) * of_cycle


def _errors(
    samples: SwingSamples, kept: list[NDArray[np.intp]], values: FloatArray
) -> tuple[list[FloatArray], float]:
    """Of each cycle without the lag, its mean off; the largest difference as recorded."""
    without: list[FloatArray] = []
    largest = 0.0
    for rows in kept:
        time_s, angle = samples.unit_time_s[rows], samples.unit_angle_rad[rows]
        late_s: FloatArray = values[0] + values[1] * time_s
        left: FloatArray = angle - np.interp(time_s - late_s, samples.stand_time_s, samples.stand_angle_rad)
        asis: FloatArray = angle - np.interp(time_s, samples.stand_time_s, samples.stand_angle_rad)
        without.append(left - left.mean())
        largest = max(largest, float(np.abs(asis - asis.mean()).max()))
    return without, largest


def _amplitude(samples: SwingSamples, cycles: list[tuple[float, float]]) -> float:
    inside = _inside(samples, cycles)
    return 0.5 * float(np.ptp(samples.stand_angle_rad[inside]))


def _peak(samples: SwingSamples, cycles: list[tuple[float, float]]) -> float:
    return float(np.abs(samples.stand_rate_rad_s[_inside(samples, cycles)]).max())


def _inside(samples: SwingSamples, cycles: list[tuple[float, float]]) -> NDArray[np.bool_]:
    return np.asarray(
        (samples.stand_time_s >= cycles[0][0]) & (samples.stand_time_s <= cycles[-1][1]), dtype=np.bool_
    )


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="swing test", fault=Fault.DATA, remedy=remedy + ".")

"""How fast a unit's clock runs, from the turns of a stand that a trigger started with it.

A clock that runs fast by e stamps everything late by e t. Gyros lag too, each axis by an amount of its own
but always the same: turns about one axis at two times tell e. All of a gyro's scale factor rests on it, since
the encoders tell a turn's angle and the unit's clock how long the turn took.
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray

MAX_CLOCK_RATE = 5e-3
"""Further off the turns do not lie where the stand says; nothing is taken out."""
SHAPE_DOUBT = 1e-6
"""Standard uncertainty besides the noise's: a stand's wobble and ripple bend turns at places of its axis."""


@dataclass(frozen=True)
class ClockRate:
    """By how much a unit's clock is fast against the stand's, relative; how well that is known."""

    rate: float
    standard_uncertainty: float


def clock_rate_of_turns(
    time_s: FloatArray, rate_rad_s: FloatArray, output: FloatArray, turns: Sequence[slice]
) -> ClockRate | None:
    """From the delay of each turn, one lag for each axis taken out; None: no axis is turned twice.

    Args:
        time_s: of the unit's samples, shape (n,).
        rate_rad_s: of the stand at these times, body axes, shape (n, 3).
        output: of the gyros, shape (n, 3).
        turns: samples of each turn with rest at both ends.
    """
    rows: list[tuple[int, float, float, float]] = []
    for turn in turns:
        axis = int(np.abs(rate_rad_s[turn]).max(axis=0).argmax())
        told = _delay(time_s[turn], rate_rad_s[turn, axis], output[turn, axis])
        if told is not None:
            rows.append((axis, *told))
    if not rows:
        return None
    axes, middles, delays, doubts = (np.array(column) for column in zip(*rows, strict=True))
    design = np.column_stack([middles, *(axes == axis for axis in np.unique(axes))])
    freedom = len(rows) - design.shape[1]
    if freedom < 0 or np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    weighted = design / doubts[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    estimate = covariance @ weighted.T @ (delays / doubts)
    chi_square = float((((delays - design @ estimate) / doubts) ** 2).sum())
    # The delays' own scatter where there is one: what bends a turn's shape is no white noise.
    widened = max(1.0, chi_square / freedom) if freedom else 1.0
    rate, doubt = float(estimate[0]), float(np.sqrt(covariance[0, 0] * widened + SHAPE_DOUBT**2))
    return ClockRate(rate, doubt) if abs(rate) < MAX_CLOCK_RATE else None


def _delay(time_s: FloatArray, rate: FloatArray, output: FloatArray) -> tuple[float, float, float] | None:
    """Middle, delay and its standard uncertainty, s: output = K (rate - delay d(rate)/dt) + b."""
    usable = np.isfinite(rate) & np.isfinite(output)
    if usable.sum() < 10:
        return None
    steps = np.gradient(rate, time_s)
    design = np.column_stack([rate, steps, np.ones(len(rate))])[usable & np.isfinite(steps)]
    seen = output[usable & np.isfinite(steps)]
    # a turn at one rate throughout has no instant to tell
    if np.linalg.matrix_rank(design) < 3:
        return None
    inverse = np.linalg.inv(design.T @ design)
    scale, lagging, _ = inverse @ design.T @ seen
    residual = seen - design @ (inverse @ design.T @ seen)
    variance = float(residual @ residual) / max(len(seen) - 3, 1)
    if not abs(scale) > 0.0:
        return None
    doubt = float(np.sqrt(variance * inverse[1, 1]) / abs(scale))
    return float(time_s.mean()), float(-lagging / scale), max(doubt, 1e-9)

"""What an aircraft or a vehicle is doing, from its unit's own rates, forces and attitude (paper 2, 3.1).

From means over a second, in this order, what comes first wins:

    rest             neither turns nor has moved yet, or has stopped for good
    take_off         from the first push forward until the nose has been raised and the push is over
    landing          from the last lowering or raising of the nose before the brakes to the stop
    circling         a turn of at least 330 deg one way
    turn             turns about the vertical
    pitch_manoeuvre  the nose rises and falls
    cruise           straight, level and unaccelerated for at least 8 s
    straight         anything else

Rates about the vertical come from C w and forward accelerations from (C f), so a bank or a climb is not
mistaken for one. A push counts if it lasts: speed gained over a stretch, not a gust. Out of scope: flight on
the back, hovering, a start in motion (without a rest there is no level to begin with).
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.attitude_angles import matrix_of, roll_pitch_yaw_rad
from calibration.algorithms.coefficients import FloatArray

STATES = ("rest", "take_off", "landing", "circling", "turn", "pitch_manoeuvre", "cruise", "straight")
Mask = NDArray[np.bool_]
REST_BLOCK_S, REST_BLOCKS, REST_SIGMAS = 0.5, 4, 6.0
REST_RATE_RAD_S, REST_FORCE_M_S2 = math.radians(0.1), 0.05
"""Beside the noise: what a unit at rest may seem to turn and to be pushed by."""


@dataclass(frozen=True)
class PhaseLimits:
    """Between the states; SI.

    Attributes:
        smoothing_s: of all that is looked at.
        turn_rate_rad_s: about the vertical, of a turn.
        circle_rad: heading change of a turn that is a circle.
        pitch_rate_rad_s: of a manoeuvre.
        pitch_gap_s: manoeuvres less apart than this are one.
        push_m_s2: forward acceleration of a start or of brakes.
        least_speed_change_m_s: that a push must bring to be one.
        level_rad: largest pitch of a cruise.
        cruise_s: shortest one.
    """

    smoothing_s: float = 1.0
    turn_rate_rad_s: float = math.radians(1.5)
    circle_rad: float = math.radians(330.0)
    pitch_rate_rad_s: float = math.radians(0.7)
    pitch_gap_s: float = 6.0
    push_m_s2: float = 0.4
    least_speed_change_m_s: float = 5.0
    level_rad: float = math.radians(3.0)
    cruise_s: float = 8.0


def flight_phases(
    quaternion: FloatArray,
    rate_rad_s: FloatArray,
    force_m_s2: FloatArray,
    period_s: float,
    limits: PhaseLimits | None = None,
) -> NDArray[np.str_]:
    """The state at each of n samples, shape (n,), names of `STATES`.

    Args:
        quaternion: (n, 4) level from body.
        rate_rad_s: (n, 3) less the bias.
        force_m_s2: (n, 3).
        period_s: between samples.
        limits: None: the defaults.
    """
    limits = limits or PhaseLimits()
    size = max(1, round(limits.smoothing_s / period_s))
    step_s = size * period_s
    frames = matrix_of(quaternion)
    turning = -_means((frames[:, 2] * rate_rad_s).sum(axis=1), size)  # clockwise
    level_force = (frames @ force_m_s2[..., None])[..., 0]
    nose = frames[:, :, 0] / np.maximum(np.hypot(frames[:, 0, 0], frames[:, 1, 0]), 1e-9)[:, None]
    forward = _means((nose[:, :2] * level_force[:, :2]).sum(axis=1), size)
    pitch = _means(roll_pitch_yaw_rad(quaternion)[:, 1], size)
    pitching = np.abs(np.gradient(pitch, step_s)) > limits.pitch_rate_rad_s
    pushes = _lasting(np.abs(forward) > limits.push_m_s2, forward, limits.least_speed_change_m_s, step_s)
    turns = np.abs(turning) > limits.turn_rate_rad_s
    states = np.full(len(pitch), "straight", dtype="<U15")
    _mark_cruise(states, ~(turns | pitching | pushes) & (np.abs(pitch) < limits.level_rad), limits, step_s)
    _mark_joined(states, pitching & ~turns, "pitch_manoeuvre", limits.pitch_gap_s, step_s)
    for first, last in _runs(turns):
        heading = float(np.abs(turning[first:last].sum()) * step_s)
        states[first:last] = "circling" if heading >= limits.circle_rad else "turn"
    _mark_ends(states, pushes, forward, pitching, limits, step_s)
    return np.repeat(states, size)[: len(quaternion)]


def initial_rest_samples(rate_rad_s: FloatArray, force_m_s2: FloatArray, period_s: float) -> int:
    """Samples (of n, 3) from the start on in which the unit neither turns nor is pushed; 0: there is no rest.

    The first two seconds say what rest is; where they are none, what follows differs from them at once.
    """
    size = max(1, round(REST_BLOCK_S / period_s))
    if len(rate_rad_s) < size * REST_BLOCKS:
        return 0
    moved: Mask = np.zeros(len(rate_rad_s) // size, dtype=np.bool_)
    for values, allowed in ((rate_rad_s, REST_RATE_RAD_S), (force_m_s2, REST_FORCE_M_S2)):
        means = np.stack([_means(axis, size)[: len(moved)] for axis in values.T], axis=1)
        first = means[:REST_BLOCKS]
        bound = allowed + REST_SIGMAS * first.std(axis=0, ddof=1)
        steadiness = np.abs(first - first.mean(axis=0)).max()
        if steadiness > 10.0 * allowed:
            return 0
        moved |= (np.abs(means - first.mean(axis=0)) > bound).any(axis=1) | ~np.isfinite(means).all(axis=1)
    begun = np.flatnonzero(moved)
    return size * int(begun[0]) if len(begun) else len(rate_rad_s)


def _mark_cruise(states: NDArray[np.str_], steady: Mask, limits: PhaseLimits, step_s: float) -> None:
    for first, last in _runs(steady):
        if (last - first) * step_s >= limits.cruise_s:
            states[first:last] = "cruise"


def _mark_joined(states: NDArray[np.str_], found: Mask, name: str, gap_s: float, step_s: float) -> None:
    runs = _runs(found)
    for k, (first, last) in enumerate(runs):
        states[first:last] = name
        if k + 1 < len(runs) and (runs[k + 1][0] - last) * step_s <= gap_s:
            between = slice(last, runs[k + 1][0])
            states[between] = np.where(states[between] == "turn", "turn", name)


def _mark_ends(
    states: NDArray[np.str_],
    pushes: Mask,
    forward: FloatArray,
    pitching: Mask,
    limits: PhaseLimits,
    step_s: float,
) -> None:
    """Take-off and landing, and the rests outside them; without a push all of it is a rest or cruise."""
    runs = _runs(pushes)
    if not runs:
        states[:] = np.where(states == "cruise", "rest", states)
        return
    near = round(limits.pitch_gap_s / step_s)
    first, end = runs[0]
    states[:first] = "rest"
    if forward[first:end].mean() > 0.0:
        raised = [run for run in _runs(pitching) if first <= run[0] <= end + near]
        states[first : max(end, raised[0][1]) if raised else end] = "take_off"
    begin, last = runs[-1]
    states[last:] = "rest"
    if forward[begin:last].mean() < 0.0:
        lowered = [run for run in _runs(pitching) if begin - near <= run[1] <= last]
        states[min(begin, lowered[0][0]) if lowered else begin : last] = "landing"


def _lasting(found: Mask, forward: FloatArray, least_m_s: float, step_s: float) -> Mask:
    """Stretches over which the speed changes by at least so much, one way."""
    kept = np.zeros_like(found)
    for sign in (1.0, -1.0):
        for first, last in _runs(found & (sign * forward > 0.0)):
            kept[first:last] = float(np.abs(forward[first:last].sum())) * step_s >= least_m_s
    return kept


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """[first, last) of each stretch that is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _means(values: FloatArray, size: int) -> FloatArray:
    """Over stretches of `size`, the last one of what is left."""
    starts = np.arange(0, len(values), size)
    counts = np.diff(np.append(starts, len(values)))
    return np.add.reduceat(values, starts) / counts

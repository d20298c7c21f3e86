# pyright: strict
"""What needs the past: rates of change, first-order lags, play, delays. Each carries its past in the state.

Every function gives for chunks exactly what it gives for the whole: state is what the recursion itself
would have held. A key keeps the recursions of one effect apart.
"""

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import EffectState, FloatArray, Stimulus
from dut_emulator.effects.first_order import first_order

MAX_DELAY_S = 2.0
"""No delay is longer; so much of the past is kept."""


SAME_INSTANT = 1e-6
"""Share of the time between two samples within which rounding decides on which side of one an instant is."""


def cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """(n, 3) × (n, 3) or (3,), axis by axis: three times as fast as numpy's."""
    result = np.empty(one.shape, order="F")
    (ax, ay, az), (bx, by, bz) = one.T, other.T
    result[:, 0] = ay * bz - az * by
    result[:, 1] = az * bx - ax * bz
    result[:, 2] = ax * by - ay * bx
    return result


def rate_of_change(values: FloatArray, stimulus: Stimulus, state: EffectState, key: str) -> FloatArray:
    """(n, m) → (n, m) backward difference over the time that passed; 0 at the very first sample."""
    if len(values) == 0:
        return values.copy()
    before = state.carried.get(key, values[0])
    elapsed_s = float(stimulus.time_s[0] - state.carried.get(f"{key} time", stimulus.time_s)[0])
    change = np.empty(values.shape, order="F")
    np.subtract(values[1:], values[:-1], out=change[1:])
    change[1:] /= stimulus.steps_s[:, np.newaxis]
    change[0] = (values[0] - before) / elapsed_s if elapsed_s > 0 else 0.0
    state.carried[key] = values[-1].copy()
    state.carried[f"{key} time"] = stimulus.time_s[-1:].copy()
    return change


def lag_coefficients(period_s: float, time_constant_s: float) -> tuple[float, float, float]:
    """α, b0, b1 of y_k = α y_(k−1) + b0 u_k + b1 u_(k−1), exact for inputs linear between samples."""
    if time_constant_s <= 0:
        return 0.0, 1.0, 0.0
    ratio = time_constant_s / period_s
    alpha = float(np.exp(-1.0 / ratio))
    held = -ratio * float(np.expm1(-1.0 / ratio))
    return alpha, 1.0 - held, held - alpha


def recursion(
    values: FloatArray,
    feed: tuple[float, float],
    alpha: float,
    start: FloatArray,
    state: EffectState,
    key: str,
) -> FloatArray:
    """y_k = α y_(k−1) + f0 u_k + f1 u_(k−1), (n, m).

    Before the first sample u was what it is there, and y was `start` (m,).
    """
    if len(values) == 0:
        return values.copy()
    memory = state.carried.get(key)
    if memory is None:
        memory = alpha * start + feed[1] * values[0]
    result = first_order(values, alpha, memory, feed)
    state.carried[key] = feed[1] * values[-1] + alpha * result[-1]  # as inside a chunk
    return result


def first_order_lag(
    values: FloatArray, period_s: float, time_constant_s: float, state: EffectState, key: str
) -> FloatArray:
    """τ ẏ = u − y, (n, m), settled on the first sample; exact for inputs linear between samples."""
    if len(values) == 0 or time_constant_s <= 0:
        return values
    alpha, b0, b1 = lag_coefficients(period_s, time_constant_s)
    return recursion(values, (b0, b1), alpha, values[0], state, key)


def play(values: FloatArray, half_width: float, state: EffectState, key: str) -> FloatArray:
    """Where in its play each channel is, (n, m) in [−1, 1]: +1 after a long rise, −1 after a long fall.

    p_k = clip(p_(k−1) + Δu / w, −1, 1) from p = 0: the stop operator of hysteresis (Visintin, *Differential
    Models of Hysteresis*, 1994, III.2). It depends on the order of the values and not on their speed. Between
    two turns of the input it is clip(p_a + (u − u_a) / w, −1, 1), a being the turn before: only turns are
    gone through one by one.
    """
    out = np.empty_like(values)
    for axis in range(values.shape[1] if len(values) else 0):
        start = np.array([values[0, axis], values[0, axis], 0.0, 0.0])
        name = f"{key} {axis}"
        out[:, axis], state.carried[name] = _play(values[:, axis], half_width, state.carried.get(name, start))
    return out


def _play(inputs: FloatArray, half_width: float, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One channel, (n,). Memory: last input, input and place at the last turn, direction since then."""
    before = np.concatenate([memory[:1], inputs[:-1]])
    directions = np.empty(len(inputs) + 1, dtype=np.int8)
    directions[0] = memory[3]
    np.subtract((inputs > before).view(np.int8), (inputs < before).view(np.int8), out=directions[1:])
    if not directions.all():  # at a standstill the last one stays
        moved = np.maximum.accumulate(np.where(directions != 0, np.arange(len(directions)), 0))
        directions = directions[moved]
    turns = np.flatnonzero(directions[1:] != directions[:-1])
    turn_inputs = np.concatenate([memory[1:2], before[turns]])
    place = float(memory[2])
    places = [place]
    for step in (np.diff(turn_inputs) / half_width).tolist():
        place = min(max(place + step, -1.0), 1.0)
        places.append(place)
    lengths = np.diff(turns, prepend=0, append=len(inputs))
    result = inputs - np.repeat(turn_inputs, lengths)
    result /= half_width
    result += np.repeat(places, lengths)
    np.clip(result, -1.0, 1.0, out=result)
    return result, np.array([inputs[-1], turn_inputs[-1], place, directions[-1]])


def _elapsed_s(instants: FloatArray, left: NDArray[np.int64]) -> FloatArray:
    """(n,) from each sample to the next; infinite where time stands still, so that the first one's value is
    held there."""
    span = instants.take(left + 1) - instants.take(left)
    span[span <= 0] = np.inf
    return span


def straddling(
    values: FloatArray, stimulus: Stimulus, delay_s: FloatArray, state: EffectState
) -> tuple[FloatArray, NDArray[np.int64], FloatArray, FloatArray]:
    """Where t − d(t) lies among the samples, for delays (n,) up to `MAX_DELAY_S`.

    Before the first sample ever its value is held; ahead of the newest one the latest two count.

    Returns:
        the samples that are known, (m, k); which of them is before the instant, (n,) from 0 to k − 2; which
        share of the way to the next one it is, beyond 1 ahead of the newest, (n,); how long that is, (n,) s,
        infinite between samples of one instant.
    """
    period_s = stimulus.sample_period_s
    past, past_time = state.carried.get("past"), state.carried.get("past time")
    if past is None or past_time is None:
        past, past_time = values[:1].T, stimulus.time_s[:1] - period_s
    known, instants = np.concatenate([past, values.T], axis=1), np.concatenate([past_time, stimulus.time_s])
    limited_s = np.minimum(delay_s, MAX_DELAY_S)
    wanted = stimulus.time_s - limited_s
    newest = np.arange(len(past_time), len(instants)) - 1
    left = newest - np.maximum(limited_s / period_s, 0.0).astype(np.int64)  # if samples are a period apart
    np.maximum(left, 0, out=left)
    begin = instants.take(left)
    span = _elapsed_s(instants, left)
    share = (wanted - begin) / span
    astray = np.flatnonzero((share < -SAME_INSTANT) | (share > 1.0 + SAME_INSTANT) | np.isinf(span))
    if len(astray):
        found = np.searchsorted(instants, wanted[astray], side="left") - 1
        left[astray] = np.clip(found, 0, newest[astray])
        begin, span = instants[left], _elapsed_s(instants, left)
        share = (wanted - begin) / span
    keep = int(np.searchsorted(instants, float(instants[-1]) - MAX_DELAY_S - 2 * period_s))
    state.carried["past"], state.carried["past time"] = known[:, keep:].copy(), instants[keep:].copy()
    return known, left, share, span

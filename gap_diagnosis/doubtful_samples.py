# pyright: strict
"""Samples that are no measurements: at the end of the range, or frozen.

Saturated: at the believed range less a quantum (or less `RANGE_MARGIN`: full-scale words end a little inside
the nominal range, 32767 / 16.4 = 1998 of 2000 °/s); or, where the range is not believed or the stand says
nothing, in a run of equal extreme values. A channel that stops *below* its believed range although the
stand's report goes on is left as it is: this is a gap, and 'gyro.saturation' is its name.

Frozen: frames of a triad that repeat far longer than chance has it, or repeat while the prediction moves.
"""

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.observation import AXES, SetAside

RANGE_MARGIN = 0.002
LEAST_RUN = 4
LEAST_LEVELS = 20
"""A channel of fewer different values has runs of equal extremes by its quantum alone."""
FROZEN_CHANCE = 1e-9
LEAST_FROZEN = 10
MOVED_QUANTA = 20.0
MOVED_SHARE = 1e-3
"""The prediction moves if it goes through so many quanta, and through this share of its whole span."""

BoolArray = NDArray[np.bool_]


def runs_of(same: BoolArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First rows and lengths of the runs of equal rows; `same` (n − 1,): a row equals the one before."""
    begins = np.concatenate([[True], ~same])
    first = np.flatnonzero(begins)
    return first, np.diff(first, append=len(same) + 1)


def rows_of_runs(first: NDArray[np.int64], length: NDArray[np.int64], n: int) -> BoolArray:
    """(n,) True inside these runs."""
    edges = np.zeros(n + 1, dtype=np.int64)
    np.add.at(edges, first, 1)
    np.add.at(edges, first + length, -1)
    return np.cumsum(edges[:-1]) > 0


def saturated(
    values_si: FloatArray, predicted_si: FloatArray, range_si: float, quantum_si: float
) -> NDArray[np.bool_]:
    """(n, 3) samples at the end of the range; see the module."""
    at_end = np.zeros(values_si.shape, dtype=bool)
    if np.isfinite(range_si):
        last = min(range_si - quantum_si, range_si * (1.0 - RANGE_MARGIN))
        with np.errstate(invalid="ignore"):
            at_end |= np.abs(values_si) >= last - 1e-9 * range_si
    for axis in range(values_si.shape[1]):
        unseen = np.isnan(predicted_si[:, axis]) | (not np.isfinite(range_si))
        if unseen.any():
            at_end[:, axis] |= piled_up(values_si[:, axis]) & unseen
    return at_end


def piled_up(values: FloatArray) -> BoolArray:
    """(n,) runs of equal values at the largest or least, if these are too many for a tail."""
    found = np.zeros(len(values), dtype=bool)
    there = values[np.isfinite(values)]
    if not len(there):
        return found
    low, high = float(there.min()), float(there.max())
    if low == high:
        return found
    if (
        len(there) < 10 * LEAST_LEVELS
        or len(np.unique(there[:: max(1, len(there) // 20_000)])) < LEAST_LEVELS
    ):
        return found
    first, length = runs_of(values[1:] == values[:-1])
    for end in (low, high):
        runs = (values[first] == end) & (length >= LEAST_RUN)
        near = np.abs(there - end) < 0.02 * (high - low)
        if runs.any() and (there == end).sum() > 0.5 * near.sum():
            found |= rows_of_runs(first[runs], length[runs], len(values))
    return found


def frozen(values_si: FloatArray, predicted_si: FloatArray, quantum_si: float) -> BoolArray:
    """(n,) rows at which the whole triad repeats itself; the first row of such a run is good and stays."""
    n = len(values_si)
    there = ~np.isnan(values_si).all(axis=0)
    values = values_si[:, there]
    if n < LEAST_FROZEN or not values.shape[1]:
        return np.zeros(n, dtype=bool)
    first, length = runs_of((values[1:] == values[:-1]).all(axis=1))
    repeats = float(np.mean(length > 1))
    candidates = np.flatnonzero(length >= LEAST_FROZEN)
    wrong = [
        run
        for run in candidates.tolist()
        if n * repeats ** int(length[run] - 1) < FROZEN_CHANCE
        or _moves(predicted_si[first[run] : first[run] + length[run]], predicted_si, quantum_si)
    ]
    return rows_of_runs(first[wrong] + 1, length[wrong] - 1, n)


def _moves(stretch: FloatArray, whole: FloatArray, quantum_si: float) -> bool:
    seen = stretch[np.isfinite(stretch).all(axis=1)]
    if len(seen) < LEAST_FROZEN:
        return False
    all_seen = whole[np.isfinite(whole).all(axis=1)]
    span = np.ptp(seen, axis=0).max()
    return bool(span > MOVED_QUANTA * quantum_si and span > MOVED_SHARE * np.ptp(all_seen, axis=0).max() > 0)


def _where_saturated(largest: float, range_si: float) -> str:
    if largest > 0.99 * range_si:
        return "at the end of the range, which the simulator has too"
    return "at the largest value there is, again and again"


def set_aside_in(
    sensor: str, values_si: FloatArray, predicted_si: FloatArray, range_si: float, quantum_si: float
) -> tuple[FloatArray, list[SetAside]]:
    """The samples with what is saturated or frozen as NaN, and what that was."""
    clipped = saturated(values_si, predicted_si, range_si, quantum_si)
    stuck = frozen(values_si, predicted_si, quantum_si)
    said: list[SetAside] = []
    for axis, name in enumerate(AXES):
        if count := int(clipped[:, axis].sum()):
            largest = float(np.abs(values_si[clipped[:, axis], axis]).max())
            said.append(
                SetAside(f"{sensor}_{name}", count, f"saturated: {_where_saturated(largest, range_si)}")
            )
    if count := int(stuck.sum()):
        said.append(SetAside(sensor, count, "frozen: the same frame again and again"))
    if said:
        values_si = np.where(clipped | stuck[:, np.newaxis], np.nan, values_si)
    return values_si, said

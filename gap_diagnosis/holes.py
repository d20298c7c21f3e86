# pyright: strict
"""Where a report covers an instant, and which rows follow each other without a hole.

A hole is data: nothing is interpolated across a pause longer than `HOLE_PERIODS` of the report's own median
period. That is 35 ms for optics at 143 Hz and 0.5 s for rows at 10 Hz; single lost rows are bridged, a pause
between two poses is not.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from protocol.recording_facts import HOLE_PERIODS

ROUNDING_PERIODS = 1e-3
"""So far beyond a row, in periods, an instant still is that row's: stamps are rounded."""
MIXED_STEPS = 1.5
"""A step longer than so many periods is no step from one sample to the next."""


def median_period_s(time_s: FloatArray) -> float:
    """Of the steps that are longer than nothing; NaN with fewer than two times."""
    steps = np.diff(time_s)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else float("nan")


def sample_period_s(time_s: FloatArray) -> float:
    """Mean of the steps from one sample to the next, pauses left out: right for coarse stamps as well.

    NaN with fewer than two times.
    """
    steps = np.diff(time_s)
    if not len(steps) or steps.max() <= 0:
        return float("nan")
    single = steps[steps < MIXED_STEPS * np.median(steps[steps > 0])]
    coarse = float(single.mean())
    if coarse <= 0:
        return float(steps.mean())
    return float(steps[steps < MIXED_STEPS * coarse].mean())


def hole_s(time_s: FloatArray) -> float:
    """The longest pause that may be bridged."""
    return HOLE_PERIODS * median_period_s(time_s)


def covered(instants_s: FloatArray, known_s: FloatArray, longest_s: float) -> NDArray[np.bool_]:
    """(n,) instants with a known row on each side, not further apart than `longest_s`, or on a row.

    Args:
        instants_s: (n,).
        known_s: (m,) never decreasing.
        longest_s: the longest pause that is bridged; NaN: only instants on a row count.
    """
    if len(known_s) == 0:
        return np.zeros(len(instants_s), dtype=bool)
    rounding = ROUNDING_PERIODS * (longest_s / HOLE_PERIODS if np.isfinite(longest_s) else 0.0)
    after = np.searchsorted(known_s, instants_s, side="left")
    before = np.maximum(after - 1, 0)
    np.minimum(after, len(known_s) - 1, out=after)
    left, right = known_s[before], known_s[after]
    on_a_row = (np.abs(instants_s - left) <= rounding) | (np.abs(right - instants_s) <= rounding)
    between = (left <= instants_s) & (instants_s <= right) & (right - left <= longest_s)
    return on_a_row | between


def piece_numbers(time_s: FloatArray, usable: NDArray[np.bool_], period_s: float) -> NDArray[np.int64]:
    """(n,) number of the stretch that a row belongs to: no pause, and all of it usable or none."""
    breaks = np.zeros(len(time_s), dtype=np.int64)
    breaks[1:] = (np.diff(time_s) > MIXED_STEPS * period_s) | (usable[1:] != usable[:-1])
    return np.cumsum(breaks)


def stretches(piece: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First row and row behind the last of each piece, in order."""
    if not len(piece):
        return []
    begins = np.flatnonzero(np.diff(piece)) + 1
    edges = [0, *begins.tolist(), len(piece)]
    return list(itertools.pairwise(edges))

# pyright: strict
"""Which satellites a receiver tracks, and how well their geometry fixes a position. Pure functions of arrays.

A satellite is found after a search, and of use once its ephemeris has been heard: subframes 1 to 3 of 6 s
each, in a frame of 30 s (IS-GPS-200, 20.3.3), whole: 18 to 36 s. One that was tracked before comes back in a
second.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ACQUISITION_DBM, TRACKING_DBM = -148.0, -160.0
"""Weakest signals, cold and tracked or found again (u-blox NEO-M8 data sheet, UBX-13003366, 1.2)."""
REACQUISITION_S = 1.0
FRAME_S, SUBFRAME_S, SUBFRAMES = 30.0, 6.0, 3
NOISE_FLOOR_DBM_HZ = -174.0 + 2.0 + 2.0
"""Thermal noise at 290 K, noise figure, losses."""
RANGE_NOISE_M = 0.6
"""Of one satellite's range at 40 dB-Hz; in proportion to 1/√(C/N0) (E. D. Kaplan, C. J. Hegarty,
*Understanding GPS*, code tracking loop)."""


def ephemeris_wait_s(phase_s: FloatArray) -> FloatArray:
    """How long it takes to hear subframes 1 to 3 whole, begun at a phase in [0, 30) of the frame."""
    # the subframe that was cut, or the third, is the last to be heard in the next frame
    cut = np.minimum(np.ceil(phase_s / SUBFRAME_S), SUBFRAMES)
    last_s = np.where(phase_s > 0, FRAME_S + cut * SUBFRAME_S, SUBFRAMES * SUBFRAME_S)
    return last_s - phase_s


class Tracking:
    """Which satellites are tracked, from one call to the next. A new receiver knows no ephemeris."""

    def __init__(self, search_s: FloatArray, frame_offset_s: float, since_s: float) -> None:
        """`search_s` (s,): what finding each takes; `since_s`: a signal there now has been since then."""
        self._search_s, self._frame_offset_s = search_s, frame_offset_s
        self._weak_until_s = np.full(len(search_s), since_s)
        self._gone_until_s = np.full(len(search_s), since_s)
        self._known = np.zeros(len(search_s), dtype=bool)

    def tracked(self, times_s: FloatArray, power_dbm: FloatArray) -> BoolArray:
        """(n, s) at non-decreasing moments (n,), for signals of this power (n, s ≤ those searched)."""
        count = power_dbm.shape[1]
        weak_until = self._last(self._weak_until_s, times_s, power_dbm < ACQUISITION_DBM)
        gone_until = self._last(self._gone_until_s, times_s, power_dbm < TRACKING_DBM)
        found_s = weak_until + self._search_s[:count]
        ready_s = found_s + ephemeris_wait_s((found_s + self._frame_offset_s) % FRAME_S)
        now = times_s[:, np.newaxis]
        learnt = now >= ready_s
        known = np.logical_or.accumulate(np.concatenate([self._known[np.newaxis, :count], learnt]))[1:]
        if len(times_s):
            self._known[:count] = known[-1]
        return known & (power_dbm >= TRACKING_DBM) & (learnt | (now - gone_until >= REACQUISITION_S))

    def _last(self, before_s: FloatArray, times_s: FloatArray, missing: BoolArray) -> FloatArray:
        """(n, s) the last moment so far at which it was missing; kept for the next call."""
        count = missing.shape[1]
        seen = np.where(missing, times_s[:, np.newaxis], -np.inf)
        last = np.maximum.accumulate(np.concatenate([before_s[np.newaxis, :count], seen]))[1:]
        if len(times_s):
            before_s[:count] = last[-1]
        return last


@dataclass(frozen=True)
class Geometry:
    """What a set of satellites gives. `root`: its product with four standard normals is an error's sample."""

    fix_type: int
    root: FloatArray  # (3, 4), m
    deviation_m: FloatArray  # (3,)
    position_dop: float


NO_FIX = Geometry(0, np.zeros((3, 4)), np.full(3, np.nan), np.nan)


def geometry_of(line_of_sight: FloatArray, power_dbm: FloatArray) -> Geometry:
    """Of the tracked satellites (s, 3), (s,): weighted least squares of position and clock.

    With three satellites the height is held; with fewer, or all in one plane with the clock, there is no fix.
    (P. D. Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems*, 9.4.3.)
    """
    count = len(line_of_sight)
    unknowns = [0, 1, 2, 3] if count >= 4 else [0, 1, 3]
    if count < 3:
        return NO_FIX
    design = np.column_stack([-line_of_sight, np.ones(count)])[:, unknowns]
    weight = 10 ** ((power_dbm - NOISE_FLOOR_DBM_HZ - 40.0) / 10) / RANGE_NOISE_M**2
    normal, plain = design.T @ (weight[:, np.newaxis] * design), design.T @ design
    if np.linalg.cond(plain) > 1e8:
        return NO_FIX
    covariance = np.linalg.inv(normal)
    full = np.zeros((4, 4))
    full[np.ix_(unknowns, unknowns)] = np.linalg.cholesky(covariance)
    root = full[:3]
    dop = np.sqrt(np.diag(np.linalg.inv(plain))[: len(unknowns) - 1].sum())
    return Geometry(3 if count >= 4 else 2, root, np.sqrt((root**2).sum(axis=1)), float(dop))

# pyright: strict
"""What the three axes of a turntable are told over a whole run, exactly.

An axis' path is a row of pieces (`axis_pieces`) without a jump in angle or rate, at rest before the first
and after the last. A schedule is known before anything moves: its peaks are held against what the drives can
do, axis by axis. Angles are outer, middle, inner as in `gimbal_geometry`, in degrees.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dut_emulator.motion.axis_motion import FloatArray, Trapezoid
from dut_emulator.motion.axis_pieces import Constant, Motion, Piece, turn_pieces

Triple = tuple[float, float, float]

AXES = ("outer", "middle", "inner")
_JOINT_DEG = 1e-6
"""Neighbouring pieces meet within this angle (deg) and rate (deg/s): roundings, no steps."""
_LIMIT_TOLERANCE = 1e-9
"""Relative: a peak that is the limit up to roundings keeps it."""


@dataclass(frozen=True)
class Drives:
    """What the drives can do, by axis outer, middle, inner; an axis without a drive has the rate limit 0.

    Positioning is gentler than the limits. `home_deg`: the pose after homing; axes without a drive stay
    there.
    """

    rate_deg_s: Triple
    acceleration_deg_s2: Triple
    positioning_rate_deg_s: float = 90.0
    positioning_acceleration_deg_s2: float = 100.0
    home_deg: Triple = (0.0, 0.0, 0.0)

    def turns(self, axis: int) -> bool:
        """Whether this axis has a drive."""
        return self.rate_deg_s[axis] > 0


@dataclass(frozen=True)
class Excess:
    """An axis that was asked for more than its drive can do: 'rate' in deg/s or 'acceleration' in deg/s²."""

    axis: str
    quantity: str
    asked: float
    limit: float

    @property
    def unit(self) -> str:
        """Of both figures."""
        return "deg/s" if self.quantity == "rate" else "deg/s^2"

    def __str__(self) -> str:
        return (
            f"The {self.axis} axis would reach {self.asked:.4g} {self.unit}, "
            f"{self.asked - self.limit:.3g} {self.unit} above its limit of {self.limit:g} {self.unit}."
        )


class AxisPath:
    """One axis: pieces one after the other from 0 s on. The empty path is rest at `start_deg`."""

    def __init__(self, start_deg: float, pieces: tuple[Piece, ...] = ()) -> None:
        self._pieces = tuple(piece for piece in pieces if piece.duration_s > 0)
        lengths = [piece.duration_s for piece in self._pieces]
        self._starts_s = np.concatenate([[0.0], np.cumsum(lengths)])
        angle, rate = start_deg, 0.0
        for piece in self._pieces:
            angles, rates, _ = piece.at(np.array([0.0, piece.duration_s]))
            assert abs(angles[0] - angle) < _JOINT_DEG, "an axis may not jump"
            assert abs(rates[0] - rate) < _JOINT_DEG, "a rate may not jump"
            angle, rate = float(angles[1]), float(rates[1])
        assert abs(rate) < _JOINT_DEG, "a path ends at rest"
        self._start_deg, self._end_deg = start_deg, angle

    @property
    def peaks(self) -> tuple[float, float]:
        """Largest |rate| (deg/s) and |acceleration| (deg/s²)."""
        peaks = [piece.peaks for piece in self._pieces]
        return max((rate for rate, _ in peaks), default=0.0), max((a for _, a in peaks), default=0.0)

    @property
    def duration_s(self) -> float:
        """Until the last piece ends."""
        return float(self._starts_s[-1])

    def at(self, times_s: FloatArray) -> Motion:
        """Angle, rate, acceleration at non-decreasing times, (n,) each."""
        angle, rate, acceleration = (np.zeros(len(times_s)) for _ in range(3))
        cuts: list[int] = np.searchsorted(times_s, self._starts_s, side="left").tolist()
        angle[: cuts[0]], angle[cuts[-1] :] = self._start_deg, self._end_deg
        for piece, start_s, first, last in zip(
            self._pieces, self._starts_s.tolist(), cuts, cuts[1:], strict=False
        ):
            if first < last:
                part = slice(first, last)
                angle[part], rate[part], acceleration[part] = piece.at(times_s[part] - start_s)
        return angle, rate, acceleration


@dataclass(frozen=True)
class Schedule:
    """The paths of outer, middle and inner axis over `duration_s`."""

    duration_s: float
    paths: tuple[AxisPath, AxisPath, AxisPath]

    @property
    def moves(self) -> bool:
        """Whether any axis turns at all."""
        return any(path.peaks[0] for path in self.paths)

    def at(self, times_s: FloatArray) -> Motion:
        """Angles (deg), rates, accelerations at non-decreasing times, each (n, 3), columns contiguous."""
        motions = [path.at(times_s) for path in self.paths]
        angles, rates, accelerations = (np.stack(parts).T for parts in zip(*motions, strict=True))
        return angles, rates, accelerations

    def excess(self, drives: Drives) -> Excess | None:
        """The worst of what is beyond these drives, in relation to its limit; None if they can do it."""
        limits = zip(drives.rate_deg_s, drives.acceleration_deg_s2, strict=True)
        found = [
            Excess(axis, quantity, asked, limit)
            for axis, path, pair in zip(AXES, self.paths, limits, strict=True)
            for quantity, asked, limit in zip(("rate", "acceleration"), path.peaks, pair, strict=True)
            if asked > limit * (1 + _LIMIT_TOLERANCE)
        ]
        return max(found, key=lambda one: one.asked / one.limit if one.limit else math.inf, default=None)


class ScheduleBuilder:
    """Puts a schedule together step by step; each step begins when all axes have come to rest."""

    def __init__(self, drives: Drives) -> None:
        self._drives = drives
        self._pieces: tuple[list[Piece], ...] = ([], [], [])
        self._angles = list(drives.home_deg)
        self.now_s = 0.0

    def angle(self, axis: int) -> float:
        """Where an axis is now."""
        return self._angles[axis]

    def rest(self, duration_s: float) -> None:
        """All axes at rest."""
        self._append({}, duration_s)

    def go(self, axis: int, *pieces: Piece) -> None:
        """One axis moves, the others rest."""
        self.together({axis: pieces})

    def together(self, motions: Mapping[int, tuple[Piece, ...]]) -> None:
        """Several axes move at once, from rest to rest."""
        lengths = [sum(piece.duration_s for piece in pieces) for pieces in motions.values()]
        self._append(motions, max(lengths, default=0.0))

    def move(self, pose_deg: Mapping[int, float]) -> None:
        """Go to angles, each the nearest that differs by whole turns, at the positioning rate."""
        drives, motions = self._drives, dict[int, tuple[Piece, ...]]()
        for axis, target in pose_deg.items():
            way = math.remainder(target - self._angles[axis], 360.0)
            if way:
                turn = Trapezoid.fastest(
                    way, drives.positioning_rate_deg_s, drives.positioning_acceleration_deg_s2
                )
                motions[axis] = turn_pieces(turn, self._angles[axis])
        self.together(motions)

    def schedule(self) -> Schedule:
        """What has been put together."""
        home = self._drives.home_deg
        outer, middle, inner = (
            AxisPath(start, tuple(pieces)) for start, pieces in zip(home, self._pieces, strict=True)
        )
        return Schedule(self.now_s, (outer, middle, inner))

    def _append(self, motions: Mapping[int, tuple[Piece, ...]], duration_s: float) -> None:
        for axis, row in enumerate(self._pieces):
            used_s = 0.0
            for piece in motions.get(axis, ()):
                row.append(piece)
                used_s += piece.duration_s
                self._angles[axis] = float(piece.at(np.array([piece.duration_s]))[0][0])
            row.append(Constant(max(duration_s - used_s, 0.0), self._angles[axis]))
        self.now_s += duration_s

# pyright: strict
"""Rates on a single-axis table: eleven of them up and down, the table locked at zero (paper 4, table 1).

A table that holds no rate below its least one passes zero at rest: the middle point is taken locked. The
up stroke begins at the lowest rate and the down stroke at the highest, so the two ends are read twice in
a row, and what differs between the strokes elsewhere is hysteresis.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dut_emulator.motion.axis_motion import AxisMotion, FloatArray, Piece, Trapezoid
from dut_emulator.motion.profile import ProfileKind, ProfileParameter

POINTS = 11
UP, DOWN = 1, -1
TILT_RATE_DEG_S, TILT_ACCELERATION_DEG_S2 = 15.0, 30.0
"""Of the fixture."""
POSE_DEG: Mapping[int, tuple[float, float]] = {1: (-90.0, 0.0), 2: (0.0, 90.0), 3: (0.0, 0.0)}
"""Body axis 1, 2, 3 (x, y, z) up, along the table's axis: the fixture's angles (middle, inner)."""

ELEVEN_POINT = ProfileKind(
    "eleven_point",
    "scale factor, intercept, linearity, hysteresis, repeatability: one axis after the other",
    (
        ProfileParameter("full_scale_rate_deg_s", 100.0, "deg/s", 1.0, 5000.0, "of the outermost points"),
        ProfileParameter("dwell_s", 2.0, "s", 0.1, 600.0, "reading time at a point"),
        ProfileParameter("settle_s", 0.5, "s", 0.0, 60.0, "wait at a point before the reading"),
        ProfileParameter("cycles", 3.0, "1", 1.0, 20.0, "times up and down"),
        ProfileParameter("axis", 0.0, "1", 0.0, 3.0, "body axis 1, 2 or 3; 0: one after the other"),
        ProfileParameter("acceleration_deg_s2", 50.0, "deg/s^2", 0.1, 5000.0, "between points"),
        ProfileParameter("rest_s", 10.0, "s", 0.0, 7200.0, "locked, before the first stroke of each axis"),
    ),
)
KINDS: tuple[ProfileKind, ...] = (ELEVEN_POINT,)


@dataclass(frozen=True)
class Dwell:
    """One reading of a point. `stroke`: UP or DOWN; `cycle` counts from 1."""

    begin_s: float
    duration_s: float
    rate_deg_s: float
    axis: int
    cycle: int
    stroke: int


class RateAxis(AxisMotion):
    """An axis that is told rates instead of angles. `history`: pieces of the past that it keeps."""

    def __init__(self, history: int) -> None:
        super().__init__()
        self._pieces = deque(self._pieces, maxlen=history)

    def to_rate(self, rate: float, acceleration: float, now_s: float) -> float:
        """Go to a rate at an acceleration > 0; the time it takes. Limits are the stand's matter."""
        self._cut(now_s)
        angle, present = self.now(now_s)
        if rate == present:
            ramp_s = 0.0
        else:
            ramp_s = abs(rate - present) / acceleration
            self._pieces.append(Piece(now_s, angle, present, math.copysign(acceleration, rate - present)))
            angle += (present + rate) / 2 * ramp_s
        self._pieces.append(Piece(now_s + ramp_s, angle, rate, 0.0))
        self._table = None
        return ramp_s

    def now(self, now_s: float) -> tuple[float, float]:
        """Angle and rate at one moment, without making a table of all pieces."""
        piece = next((one for one in reversed(self._pieces) if one.start_s <= now_s), self._pieces[0])
        passed = now_s - piece.start_s
        return (
            piece.angle + (piece.rate + piece.acceleration * passed / 2) * passed,
            piece.rate + piece.acceleration * passed,
        )


@dataclass(frozen=True)
class TableSchedule:
    """What table (outer) and fixture (middle, inner) do, in degrees, and when points are read."""

    outer: RateAxis
    middle: AxisMotion
    inner: AxisMotion
    dwells: tuple[Dwell, ...]
    duration_s: float

    def pose_rad(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gimbal angles and rates, each (n, 3): outer, middle, inner."""
        return pose_rad((self.outer, self.middle, self.inner), times_s)


def pose_rad(axes: tuple[AxisMotion, ...], times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles (rad) and rates (rad/s) of axes that count in degrees, each (n, axes)."""
    poses = [axis.at(times_s) for axis in axes]
    angles = np.stack([angle for angle, _, _ in poses], axis=1)
    rates = np.stack([rate for _, rate, _ in poses], axis=1)
    return np.radians(angles), np.radians(rates)


def point_rates_deg_s(full_scale_deg_s: float) -> tuple[float, ...]:
    """Eleven equal steps from −FS to +FS, the middle one exactly 0."""
    half = POINTS // 2
    return tuple(full_scale_deg_s * step / half for step in range(-half, half + 1))


def eleven_point_schedule(values: Mapping[str, float]) -> TableSchedule:
    """The whole profile. `axis` and `cycles` are whole numbers."""
    axes = (1, 2, 3) if values["axis"] == 0 else (int(values["axis"]),)
    cycles = int(values["cycles"])
    points = point_rates_deg_s(values["full_scale_rate_deg_s"])
    outer = RateAxis(len(axes) * cycles * 2 * (2 * POINTS + 2) + 4)
    middle, inner = (AxisMotion(angle) for angle in POSE_DEG[axes[0]])
    dwells: list[Dwell] = []
    now_s = 0.0
    for number, axis in enumerate(axes):
        if number:
            now_s += tilt(middle, inner, axis, now_s)
        now_s += values["rest_s"]
        for cycle in range(1, cycles + 1):
            for stroke in (UP, DOWN):
                for rate in points[::stroke]:
                    now_s += outer.to_rate(rate, values["acceleration_deg_s2"], now_s) + values["settle_s"]
                    dwells.append(Dwell(now_s, values["dwell_s"], rate, axis, cycle, stroke))
                    now_s += values["dwell_s"]
        now_s += outer.to_rate(0.0, values["acceleration_deg_s2"], now_s)
    return TableSchedule(outer, middle, inner, tuple(dwells), now_s)


def locked_schedule(duration_s: float) -> TableSchedule:
    """Table locked, body z up."""
    middle, inner = (AxisMotion(angle) for angle in POSE_DEG[3])
    return TableSchedule(RateAxis(1), middle, inner, (), duration_s)


def tilt(middle: AxisMotion, inner: AxisMotion, axis: int, now_s: float) -> float:
    """Bring a body axis up, both fixture axes at once; the time it takes."""
    longest_s = 0.0
    for motion, target in zip((middle, inner), POSE_DEG[axis], strict=True):
        way = target - float(motion.at(np.array([now_s]))[0][0])
        if way:
            turn = Trapezoid.fastest(way, TILT_RATE_DEG_S, TILT_ACCELERATION_DEG_S2)
            motion.turn(turn, now_s)
            longest_s = max(longest_s, turn.duration_s)
    return longest_s

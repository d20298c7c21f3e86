# pyright: strict
"""The motion of one axis that is told step by step, exactly, in any units of angle.

A trapezoid of rate is accelerate, cruise, brake, rest: pieces of constant acceleration. A swing is whole
periods of a sine from one of its turning points. A new command cuts off what was still to come.
"""

import dataclasses
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MAX_PIECES = 512
"""Of one axis; older ones are forgotten: nobody asks about times so long past."""
_BEGINNING_S = -1e9


@dataclass(frozen=True)
class Trapezoid:
    """A turn by `angle` in `duration_s` with equal ramps; peak = angle / (duration − ramp)."""

    angle: float
    duration_s: float
    ramp_s: float

    @property
    def peak_rate(self) -> float:
        """Rate of the cruise, signed."""
        return self.angle / (self.duration_s - self.ramp_s)

    @property
    def acceleration(self) -> float:
        """Of the first ramp, signed."""
        return self.peak_rate / self.ramp_s

    @staticmethod
    def fastest(angle: float, rate: float, acceleration: float) -> "Trapezoid":
        """The quickest turn by `angle` ≠ 0 within a rate and an acceleration."""
        way = abs(angle)
        ramp_s = min(rate / acceleration, math.sqrt(way / acceleration))
        return Trapezoid(angle, way / (ramp_s * acceleration) + ramp_s, ramp_s)


@dataclass(frozen=True)
class Piece:
    """From `start_s` on, until the next: angle + rate t + acceleration t² / 2 + amplitude (1 − cos ωt)."""

    start_s: float
    angle: float
    rate: float
    acceleration: float
    amplitude: float = 0.0
    angular_frequency_rad_s: float = 0.0


class AxisMotion:
    """An axis at rest at an angle, then what it is told."""

    def __init__(self, angle: float = 0.0) -> None:
        self._pieces = deque([Piece(_BEGINNING_S, angle, 0.0, 0.0)], maxlen=MAX_PIECES)
        self._table: FloatArray | None = None  # the pieces as rows; None when they have changed

    def turn(self, trapezoid: Trapezoid, now_s: float) -> None:
        """Begin a trapezoid now; the axis is at rest."""
        self._cut(now_s)
        angle = float(self.at(np.array([now_s]))[0][0])
        peak, ramp_s = trapezoid.peak_rate, trapezoid.ramp_s
        cruise_s = trapezoid.duration_s - 2 * ramp_s
        after_ramp = angle + peak * ramp_s / 2
        self._pieces += [
            Piece(now_s, angle, 0.0, trapezoid.acceleration),
            Piece(now_s + ramp_s, after_ramp, peak, 0.0),
            Piece(now_s + ramp_s + cruise_s, after_ramp + peak * cruise_s, peak, -trapezoid.acceleration),
            # the commanded angle itself, not the sum of the pieces' roundings
            Piece(now_s + trapezoid.duration_s, angle + trapezoid.angle, 0.0, 0.0),
        ]
        self._table = None

    def swing(self, amplitude: float, angular_frequency_rad_s: float, cycles: int, now_s: float) -> float:
        """Begin whole periods between here and 2 amplitudes further; how long they take. At rest now."""
        self._cut(now_s)
        angle = float(self.at(np.array([now_s]))[0][0])
        duration_s = cycles * 2 * math.pi / angular_frequency_rad_s
        self._pieces += [
            Piece(now_s, angle, 0.0, 0.0, amplitude, angular_frequency_rad_s),
            Piece(now_s + duration_s, angle, 0.0, 0.0),
        ]
        self._table = None
        return duration_s

    def brake(self, acceleration: float, now_s: float) -> None:
        """To rest from whatever rate, at this acceleration."""
        angles, rates, _ = self.at(np.array([now_s]))
        angle, rate = float(angles[0]), float(rates[0])
        self._cut(now_s)
        if rate:
            self._pieces.append(Piece(now_s, angle, rate, -math.copysign(acceleration, rate)))
        braking_s = abs(rate) / acceleration
        self._pieces.append(Piece(now_s + braking_s, angle + rate * braking_s / 2, 0.0, 0.0))
        self._table = None

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at these times, each (n,)."""
        table = self._table
        if table is None:
            table = np.array([dataclasses.astuple(piece) for piece in self._pieces])
            self._table = table
        index = np.maximum(np.searchsorted(table[:, 0], times_s, side="right") - 1, 0)
        start_s, angle, rate, acceleration, amplitude, omega = table[index].T
        passed = times_s - start_s
        angles = angle + (rate + acceleration * passed / 2) * passed
        rates = rate + acceleration * passed
        if not amplitude.any():
            return angles, rates, acceleration
        wave = amplitude * np.cos(omega * passed)
        rates += amplitude * omega * np.sin(omega * passed)
        return angles + amplitude - wave, rates, acceleration + omega**2 * wave

    def _cut(self, now_s: float) -> None:
        """Forget what would have begun later than now. The first piece always stays."""
        while len(self._pieces) > 1 and self._pieces[-1].start_s > now_s:
            self._pieces.pop()
        self._table = None

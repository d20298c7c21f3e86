# pyright: strict
"""The even phase of a crank that starts, runs and stops: pieces of constant acceleration, forward only."""

import math

import numpy as np

from dut_emulator.motion.crank import FloatArray

MAX_PIECES = 256
"""Older ones are forgotten: nobody asks about times so long past."""
FULL_TURN = 2.0 * math.pi
SAME_PHASE_RAD = 1e-9
_BEGINNING_S = -1e9


class CrankDrive:
    """At rest at phase 0, then what it is told."""

    def __init__(self) -> None:
        self._pieces = np.array([[_BEGINNING_S, 0.0, 0.0, 0.0]])  # from when on, phase, rate, acceleration

    def accelerate(self, rate: float, acceleration: float, now_s: float) -> float:
        """From rest to a rate, which then stays; how long that takes."""
        phase, _ = self._cut(now_s)
        duration_s = rate / acceleration
        self._append(now_s, phase, 0.0, acceleration)
        self._append(now_s + duration_s, phase + 0.5 * rate * duration_s, rate, 0.0)
        return duration_s

    def brake(self, acceleration: float, now_s: float) -> float:
        """To rest; how long that takes."""
        phase, rate = self._cut(now_s)
        duration_s = rate / acceleration
        self._append(now_s, phase, rate, -acceleration)
        self._append(now_s + duration_s, phase + 0.5 * rate * duration_s, 0.0, 0.0)
        return duration_s

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Phase, rate and acceleration, each (n,)."""
        index = np.maximum(np.searchsorted(self._pieces[:, 0], times_s, side="right") - 1, 0)
        start_s, phase, rate, acceleration = self._pieces[index].T
        passed = times_s - start_s
        return (
            phase + (rate + 0.5 * acceleration * passed) * passed,
            rate + acceleration * passed,
            acceleration,
        )

    def next_pass_s(self, phases: FloatArray, after_s: float) -> float | None:
        """When the phase next is one of these (m,), modulo a turn; None if it comes to rest before."""
        ends_s = np.append(self._pieces[1:, 0], math.inf)
        for piece in np.flatnonzero(ends_s > after_s):
            begin_s = max(float(self._pieces[piece, 0]), after_s)
            at, rate, acceleration = (float(values[0]) for values in self.at(np.array([begin_s])))
            beyond = at + SAME_PHASE_RAD
            way = float(np.min(np.mod(phases - beyond, FULL_TURN))) + SAME_PHASE_RAD
            inside = rate * rate + 2.0 * acceleration * way
            if inside < 0.0 or rate + math.sqrt(inside) == 0.0:
                continue
            pass_s = begin_s + 2.0 * way / (rate + math.sqrt(inside))
            if pass_s < ends_s[piece]:
                return pass_s
        return None

    def _cut(self, now_s: float) -> tuple[float, float]:
        """Forget what would have begun later than now; phase and rate now."""
        phase, rate, _ = (float(values[0]) for values in self.at(np.array([now_s])))
        self._pieces = self._pieces[self._pieces[:, 0] <= now_s]
        return phase, rate

    def _append(self, start_s: float, phase: float, rate: float, acceleration: float) -> None:
        row = np.array([[start_s, phase, rate, acceleration]])
        self._pieces = np.concatenate([self._pieces, row])[-MAX_PIECES:]

# pyright: strict
"""The air of a chamber at its probe over a run, as it is told: straight between nodes.

That the unit's place is a little nearer to room temperature, and follows with a lag, are the chamber's
errors: 'stand.chamber_gradient' and 'stand.chamber_lag' of the catalogue.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dut_emulator.motion.axis_motion import FloatArray

ROOM_C = 23.0
MAX_NODES = 512
"""Of a path that is told step by step; older ones are forgotten."""
_NO_STEP_C = 1e-6


@dataclass(frozen=True)
class AirPath:
    """Nodes of the air's temperature at the probe; before the first and after the last it stays.

    Attributes:
        times_s: (k,) non-decreasing.
        temperatures_c: (k,).
    """

    times_s: tuple[float, ...]
    temperatures_c: tuple[float, ...]

    @staticmethod
    def steady(temperature_c: float) -> "AirPath":
        """Always the same."""
        return AirPath((0.0,), (temperature_c,))

    @staticmethod
    def through(start_c: float, legs: Sequence[tuple[float, float, float]]) -> "AirPath":
        """From `start_c` through legs of (temperature, ramp in °C/min, time to stay there in s)."""
        times, temperatures = [0.0], [start_c]
        for target, ramp_c_per_min, stay_s in legs:
            arrives_s = times[-1] + abs(target - temperatures[-1]) * 60.0 / ramp_c_per_min
            times += [arrives_s, arrives_s + stay_s]
            temperatures += [target, target]
        return AirPath(tuple(times), tuple(temperatures))

    @property
    def range_c(self) -> tuple[float, float]:
        """Lowest and highest."""
        return min(self.temperatures_c), max(self.temperatures_c)

    @property
    def fastest_ramp_c_per_min(self) -> float:
        """Largest |slope|; infinite for a step."""
        steps = np.abs(np.diff(self.temperatures_c))
        lengths = np.diff(self.times_s)
        slopes = [
            60.0 * step / length if length else math.inf
            for step, length in zip(steps.tolist(), lengths.tolist(), strict=True)
            if step > _NO_STEP_C
        ]
        return max(slopes, default=0.0)

    def told(self, target_c: float, ramp_c_per_min: float, now_s: float) -> "AirPath":
        """This path until now, then a ramp to another temperature, which stays."""
        present_c = float(self.at(np.array([now_s]))[0])
        past = [node for node in zip(self.times_s, self.temperatures_c, strict=True) if node[0] < now_s]
        arrives_s = now_s + abs(target_c - present_c) * 60.0 / ramp_c_per_min
        nodes = [*past[-MAX_NODES:], (now_s, present_c), (arrives_s, target_c)]
        return AirPath(tuple(time_s for time_s, _ in nodes), tuple(value for _, value in nodes))

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n,) temperature of the air."""
        return np.interp(times_s, self.times_s, self.temperatures_c)

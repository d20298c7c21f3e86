# pyright: strict
"""A run at an even mean speed: from an outer dead centre, so many whole cycles beyond the first zero mark.

The grating's zero mark stands where the slide does not accelerate: mid-stroke for a scotch yoke, λ r / 2 or
so beside it for a slider-crank. There the specific force along the stroke changes its sign, both ways at the
same place; the two passes of a cycle are the edges of the trigger line, the first half between two of them
has the positive force.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.crank import FloatArray, SlideState
from dut_emulator.motion.run import EventStream
from dut_emulator.stands.sinusoidal_overload_rig.carriage import READING_UNITS, Carriage

READING_RATE_HZ = 1000.0
LEAD_OUT_TURNS = 0.5
"""After the last whole cycle, so that its end lies inside whatever the crank."""


@dataclass(frozen=True)
class OverloadRun:
    """See `Run`. `mark_rad`: crank angle of the first pass over the zero mark, in (0, π)."""

    carriage: Carriage
    speed_rad_s: float
    cycles: int
    mark_rad: float

    @property
    def period_s(self) -> float:
        """T of a cycle."""
        return 2.0 * math.pi / self.speed_rad_s

    @property
    def duration_s(self) -> float:
        """To half a cycle after the last whole one."""
        return float(self.trigger_times_s[0]) + (self.cycles + LEAD_OUT_TURNS) * self.period_s

    def slide(self, times_s: FloatArray) -> SlideState:
        """Crank and slide, (n,)."""
        rate = np.full_like(times_s, self.speed_rad_s)
        return self.carriage.turn.at(self.speed_rad_s * times_s, rate, np.zeros_like(times_s))

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit."""
        return self.carriage.stimulus(times_s, self.slide(times_s))

    @property
    def reading_units(self) -> Mapping[str, str]:
        """Body axes; `position` is the grating's, `angle_crank` is no gimbal angle."""
        return READING_UNITS

    @property
    def reading_rate_hz(self) -> float:
        """Of grating and encoder."""
        return READING_RATE_HZ

    def reading(self, times_s: FloatArray) -> Mapping[str, NDArray[Any]]:
        """What grating and encoder say."""
        return self.carriage.reading(self.slide(times_s))

    def events(self) -> tuple[EventStream, ...]:
        """Passes over the zero mark, with their direction along the stroke, and dead centres."""
        marks_s, centres_s = self.trigger_times_s, self._passes_s((0.0, math.pi))
        centres_s = centres_s[centres_s <= self.duration_s]
        towards = np.where(np.arange(len(marks_s)) % 2 == 0, -1, 1)
        return (
            self._event("zero_mark", marks_s, {"direction": towards.astype(np.int8)}),
            self._event("dead_centre", centres_s, {}),
        )

    @property
    def trigger_times_s(self) -> FloatArray:
        """(2 cycles + 1,) passes over the zero mark: the half after the first has the positive force."""
        passes = self._passes_s((self.mark_rad, 2.0 * math.pi - self.mark_rad))
        return passes[: 2 * self.cycles + 1]

    def _passes_s(self, angles_rad: tuple[float, float]) -> FloatArray:
        """When the crank is at these angles, in every turn of the run."""
        phases = self.carriage.turn.phase(np.array(angles_rad))
        turns = 2.0 * math.pi * np.arange(self.cycles + 2)[:, np.newaxis]
        return ((phases + turns) / self.speed_rad_s).ravel()

    def _event(self, name: str, times_s: FloatArray, more: dict[str, NDArray[Any]]) -> EventStream:
        grating = self.carriage.grating
        positions = grating.read_m(self.slide(times_s).position_m)
        stamped = np.rint(times_s / grating.clock_s) * grating.clock_s
        units = {"t": "s", "position": "m", **dict.fromkeys(more, "1")}
        return EventStream(name, units, {"t": stamped, "position": positions, **more})

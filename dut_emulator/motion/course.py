# pyright: strict
"""One way from start to end: a path, its phases, and what shakes and cools the unit on it."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import Stimulus
from dut_emulator.gimbal_geometry import FIELD_EAST_NORTH_UP_T, lever_arm_force_m_s2
from dut_emulator.motion.path import STEEPEST, Motion, Path, Step, Steps

FloatArray = NDArray[np.float64]

PHASES: tuple[str, ...] = (
    "rest",
    "take_off",
    "climb",
    "cruise",
    "turn",
    "circling",
    "pitch_manoeuvre",
    "descent",
    "landing",
    "accelerate",
    "straight",
    "slalom",
    "hill",
    "stop",
)
"""Of flights and drives; a recording has the place in this list."""
BRAKING_M_S2, LEAST_STOP_S = 4.0, 3.0
"""Of a stop on command."""
LAPSE_C_PER_M = -0.0065
"""Of the air's temperature with height (ISO 2533)."""


@dataclass(frozen=True)
class Phase:
    """A part of the way, until the next one begins."""

    name: str
    begin_s: float


@dataclass(frozen=True)
class Vibration:
    """A sum of tones of specific force, the same at every point of a stiff body; its angles are left out.

    Attributes:
        frequencies_hz: (k,).
        amplitudes_m_s2: (k, 3), body axes.
        phases_rad: (k, 3).
        with_speed: in proportion to the speed over this one, in m/s (a road); None: always there (an engine).
    """

    frequencies_hz: FloatArray
    amplitudes_m_s2: FloatArray
    phases_rad: FloatArray
    with_speed: float | None = None

    @staticmethod
    def drawn(
        frequencies_hz: Sequence[float],
        weights: Sequence[float],
        rms_m_s2: float,
        seed: int,
        with_speed: float | None = None,
    ) -> "Vibration":
        """Tones with amplitudes as the weights and all phases drawn, most of it upwards.

        `rms_m_s2`: of the whole, √⟨|f|²⟩.
        """
        rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, 0x71B])))
        shape = np.outer(weights, (0.5, 0.5, 1.0))
        amplitudes = shape * rms_m_s2 / math.sqrt(float(np.sum(shape**2)) / 2.0)
        phases = rng.uniform(0.0, 2.0 * np.pi, shape.shape)
        return Vibration(np.array(frequencies_hz), amplitudes, phases, with_speed)

    def force_m_s2(self, times_s: FloatArray, speed_m_s: FloatArray) -> FloatArray:
        """(n, 3)."""
        total = np.zeros((len(times_s), 3))
        for frequency, amplitude, phase in zip(
            self.frequencies_hz, self.amplitudes_m_s2, self.phases_rad, strict=True
        ):
            total += amplitude * np.cos((2.0 * np.pi * frequency) * times_s[:, np.newaxis] + phase)
        if self.with_speed is not None:
            total *= (speed_m_s / self.with_speed)[:, np.newaxis]
        return total


@dataclass(frozen=True)
class Course:
    """See the module. `arm_m`: from the centre of turning to the unit, body axes."""

    path: Path
    phases: tuple[Phase, ...]
    duration_s: float
    vibration: Vibration
    ground_temperature_c: float
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit, at its place on the arm."""
        motion = self.path.motion(times_s)
        speed = np.sqrt(np.sum(motion.velocity_local_m_s**2, axis=1))
        dcm = motion.dcm_local_from_body
        arm = np.asarray(self.arm_m, dtype=np.float64)
        force = motion.specific_force_m_s2 + self.vibration.force_m_s2(times_s, speed)
        if arm.any():
            force += _arm_force_m_s2(motion, arm)
        return Stimulus(
            time_s=times_s,
            temperature_c=self.temperature_c(motion.position_local_m),
            sample_period_s=math.nan,
            rate_rad_s=motion.rate_rad_s + motion.earth_rate_rad_s,
            specific_force_m_s2=force,
            field_t=np.einsum("nij,i->nj", dcm, np.array(FIELD_EAST_NORTH_UP_T)),
            earth_rate_rad_s=motion.earth_rate_rad_s,
            position_m=motion.position_local_m + dcm @ arm,
            dcm_local_from_body=dcm,
        )

    def ended(self, now_s: float) -> "Course":
        """The same until now, then braked to rest."""
        duration_s = max(LEAST_STOP_S, STEEPEST * self.path.speed.level_after(now_s) / BRAKING_M_S2)
        path = self.path.ended(now_s, duration_s)
        phases = (*(phase for phase in self.phases if phase.begin_s < now_s), Phase("stop", now_s))
        return dataclasses.replace(self, path=path, phases=phases, duration_s=path.end_s())

    def temperature_c(self, position_local_m: FloatArray) -> FloatArray:
        """(n,) of the air at these places, which the plate follows."""
        return self.ground_temperature_c + LAPSE_C_PER_M * position_local_m[:, 2]


def _arm_force_m_s2(motion: Motion, arm_m: FloatArray) -> FloatArray:
    """ω̇ × r + ω × (ω × r), and the Coriolis force 2 Ω × (ω × r) of what the arm's end moves."""
    turning = np.cross(motion.rate_rad_s, np.broadcast_to(arm_m, motion.rate_rad_s.shape))
    coriolis = 2.0 * np.cross(motion.earth_rate_rad_s, turning)
    return coriolis + lever_arm_force_m_s2(motion.rate_rad_s, motion.angular_acceleration_rad_s2, arm_m)


class Timetable:
    """Writes the steps of a way one after the other. `now_s` is where the next one begins."""

    def __init__(self, *quantities: str) -> None:
        self.now_s = 0.0
        self.phases: list[Phase] = []
        self._levels = dict.fromkeys(quantities, 0.0)
        self._steps: dict[str, list[Step]] = {quantity: [] for quantity in quantities}

    def phase(self, name: str) -> None:
        """A phase begins now."""
        self.phases.append(Phase(PHASES[PHASES.index(name)], self.now_s))

    def hold(self, duration_s: float) -> None:
        """Nothing changes."""
        self.now_s += duration_s

    def change(self, duration_s: float, **targets: float) -> None:
        """Go to these levels, all within the same time."""
        for quantity, target in targets.items():
            amount = target - self._levels[quantity]
            if amount:
                self._steps[quantity].append(Step(self.now_s, duration_s, amount))
                self._levels[quantity] = target
        self.now_s += duration_s

    def steps(self, quantity: str) -> Steps:
        """All steps of one quantity."""
        return Steps(0.0, tuple(self._steps[quantity]))

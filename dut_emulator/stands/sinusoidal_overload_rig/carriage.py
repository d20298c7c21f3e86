# pyright: strict
"""What acts on the unit on the slide, and what the rig's own grating and encoder say.

Laboratory frame of `gimbal_geometry`: the stroke is along x, z is up. The unit sits with the named body axis
along the stroke and, as in paper 5, 5.2, y up (x along the stroke) or x up (y or z along it).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.crank import CrankTurn, FloatArray, SlideState
from dut_emulator.stands.level_board import ROOM_TEMPERATURE_C
from protocol.bench_description import Site

BODY_FROM_LAB: dict[int, tuple[tuple[int, int, int], ...]] = {
    1: ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    2: ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    3: ((0, 0, 1), (0, -1, 0), (1, 0, 0)),
}
"""Body axis along the stroke → rows of the rotation."""

READING_UNITS: dict[str, str] = {
    **{f"rate_{axis}": "rad/s" for axis in "xyz"},
    **{f"acc_{axis}": "m/s^2" for axis in "xyz"},
    "position": "m",
    "angle_crank": "rad",
    "temp": "degC",
}


@dataclass(frozen=True)
class Grating:
    """The rig's own measuring: `length_error` is relative; the rig does not know it."""

    length_error: float = 0.0
    quantum_m: float = 1e-7
    angle_quantum_rad: float = 2.0 * math.pi / 2**22
    clock_s: float = 1e-7

    def read_m(self, position_m: FloatArray) -> FloatArray:
        """(n,) → (n,)."""
        return np.rint(position_m * (1.0 + self.length_error) / self.quantum_m) * self.quantum_m + 0.0


@dataclass(frozen=True)
class Carriage:
    """A unit on the slide of a crank. `axis`: the body axis along the stroke, 1 to 3."""

    turn: CrankTurn
    site: Site
    axis: int
    grating: Grating
    temperature_c: float = ROOM_TEMPERATURE_C

    def stimulus(self, times_s: FloatArray, slide: SlideState) -> Stimulus:
        """Gravity and the slide's acceleration, Earth rate, field; the crank's angle is the inner one."""
        count = len(times_s)
        earth = np.tile(self._into_body(geometry.earth_rate_lab_rad_s(self.site)), (count, 1))
        angles = np.zeros((count, 3))
        angles[:, 2] = slide.angle_rad
        return Stimulus(
            time_s=times_s,
            temperature_c=np.full(count, self.temperature_c),
            sample_period_s=math.nan,
            rate_rad_s=earth,
            specific_force_m_s2=self._force(slide.acceleration_m_s2),
            field_t=np.tile(self._into_body(geometry.field_lab_t(self.site)), (count, 1)),
            angles_rad=angles,
            earth_rate_rad_s=earth,
        )

    def reading(self, slide: SlideState) -> Mapping[str, NDArray[Any]]:
        """What the rig says, in `READING_UNITS`: rates are relative to the laboratory."""
        grating = self.grating
        force = self._force(slide.acceleration_m_s2 * (1.0 + grating.length_error))
        still = np.zeros_like(slide.angle_rad)
        turned = np.rint(slide.angle_rad / grating.angle_quantum_rad) * grating.angle_quantum_rad
        return {
            **{f"rate_{axis}": still for axis in "xyz"},
            **{f"acc_{axis}": force[:, column] for column, axis in enumerate("xyz")},
            "position": grating.read_m(slide.position_m),
            "angle_crank": turned,
            "temp": np.full_like(still, self.temperature_c),
        }

    def _force(self, acceleration_m_s2: FloatArray) -> FloatArray:
        force = np.tile(
            self._into_body(geometry.specific_force_lab_m_s2(self.site)), (len(acceleration_m_s2), 1)
        )
        force[:, self.axis - 1] += acceleration_m_s2
        return force

    def _into_body(self, vector_lab: FloatArray) -> FloatArray:
        return np.array(BODY_FROM_LAB[self.axis], dtype=np.float64) @ vector_lab

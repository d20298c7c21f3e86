# pyright: strict
"""Where a unit sits when nothing moves: a level socket board."""

import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.chamber import ROOM_C
from protocol.bench_description import Site

FloatArray = NDArray[np.float64]

ROOM_TEMPERATURE_C = ROOM_C


class LevelBoard:
    """A socket board on a bench: at rest, level but for a small tilt. Body z is up."""

    def __init__(
        self,
        site: Site,
        tilt_rad: tuple[float, float] = (0.0, 0.0),
        temperature_c: float = ROOM_TEMPERATURE_C,
    ) -> None:
        """`tilt_rad`: rotation of the board about its x and y axes."""
        about_x, about_y = tilt_rad
        angles = np.array([[0.0, about_y, about_x]])
        self._rate = geometry.into_body(geometry.earth_rate_lab_rad_s(site), angles)
        self._force = geometry.into_body(geometry.specific_force_lab_m_s2(site), angles)
        self._field = geometry.into_body(geometry.field_lab_t(site), angles)
        self._temperature_c = np.array([temperature_c])

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """None: it does what it says."""
        return ()

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """The same at all times; the arrays are views that cannot be written."""
        n = len(times_s)
        rate = _repeated(self._rate, n)
        return Stimulus(
            time_s=times_s,
            temperature_c=_repeated(self._temperature_c, n)[:, 0],
            sample_period_s=math.nan,
            rate_rad_s=rate,
            specific_force_m_s2=_repeated(self._force, n),
            field_t=_repeated(self._field, n),
            angles_rad=np.zeros((n, 3)),
            earth_rate_rad_s=rate,
        )


def _repeated(row: FloatArray, n: int) -> FloatArray:
    """(m,) → (n, m) without a copy, not to be written; in half of `np.broadcast_to`'s time."""
    return np.ndarray((n, row.size), np.float64, buffer=row.tobytes(), strides=(0, row.itemsize))

# pyright: strict
"""Where the units of a bench sit: on a level socket board, or on a stand's table."""

import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.interfaces import Environment, Surroundings
from dut_emulator.server.bench_model import StandModel
from dut_emulator.server.configuration import BenchServerConfiguration

EARTH_RATE_RAD_S = 7.292115e-5


class LevelBoard:
    """A level board, body axes x east and y north before the heading is applied, z up."""

    def __init__(self, latitude_deg: float, gravity_m_s2: float, heading_deg: float) -> None:
        latitude, heading = math.radians(latitude_deg), math.radians(heading_deg)
        north = np.array([-math.sin(heading), math.cos(heading), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        self._rate = EARTH_RATE_RAD_S * (math.cos(latitude) * north + math.sin(latitude) * up)
        self._force = gravity_m_s2 * up
        self._field = 28e-6 * north - 45e-6 * up

    def environment(self, times_s: NDArray[np.float64]) -> Environment:
        """Constant in time."""
        ones = np.ones((len(times_s), 1))
        return Environment(
            ones * self._rate, ones * self._force, ones * self._field, np.full(len(times_s), 23.0)
        )


def surroundings_of(configuration: BenchServerConfiguration) -> tuple[StandModel | None, Surroundings]:
    """The bench's stand, if it has one, and what acts on its units."""
    return None, LevelBoard(configuration.latitude_deg, configuration.gravity_m_s2, configuration.heading_deg)

# pyright: strict
"""What the firmware runs on: sensors, crystal, surroundings and flash of one power-on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import Stimulus
from dut_emulator.interfaces import Surroundings
from dut_emulator.products.gnc_module.flash import Flash
from dut_emulator.products.gnc_module.gnss_receiver import GnssReceiver
from dut_emulator.products.gnc_module.inertial_sensors import InertialSensors
from dut_emulator.products.gnc_module.unit_truth import UnitTruth


@dataclass
class Hardware:
    """What the firmware runs on, from power-on to power-off. `routed_v`: AD channel → its input voltage."""

    truth: UnitTruth
    surroundings: Surroundings
    sensors: InertialSensors
    receiver: GnssReceiver
    rng: np.random.Generator
    power_on_s: float
    flash: Flash
    supply_v: float
    routed_v: dict[int, float]

    @property
    def second_s(self) -> float:
        """True duration of a second by the unit's crystal."""
        return 1.0 / (1.0 + self.truth.crystal_error)

    def unit_time_us(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) the unit's clock since power-on."""
        return np.rint((times_s - self.power_on_s) / self.second_s * 1e6)

    def acting_at(self, time_s: float) -> Stimulus:
        """What acts at one moment, n = 1."""
        return self.surroundings.stimulus(np.array([time_s]))

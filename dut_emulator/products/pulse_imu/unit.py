# pyright: strict
"""A pulse IMU on a bench: it puts out pulses from power-on to power-off and takes no commands."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.interfaces import LinkOutput, Surroundings
from dut_emulator.lot import LotDraw
from dut_emulator.products.pulse_imu.population import NAME, draw_twin
from dut_emulator.products.pulse_imu.product import triad_effects
from dut_emulator.products.pulse_imu.pulse_sensors import PulseSensors, SampleGrid, whole_pulses
from dut_emulator.products.stand_unit import StandUnit
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError

PERIOD_S = 5e-3
"""Of the integration: at 12 g it errs by 3e-4 of a pulse in a half-cycle; noise is held over it."""
RUNNING_POWER_W = 12.0
_POWER_ON_NOISE = 1


def make_unit(
    seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
) -> "PulseImu":
    """The unit of this serial number in the lot of this seed; `twin` in place of its own effects.

    Raises:
        TestloomError: the twin is another product's, or has an effect that this product cannot have.
    """
    if twin is not None and twin.product not in ("", NAME):
        raise TestloomError(
            f"The twin is one of a {twin.product}, not of a {NAME}.",
            where="twin, product",
            fault=Fault.DATA,
            remedy="give a twin of this product.",
        )
    return PulseImu(LotDraw(seed, serial), twin or draw_twin(seed, serial), flash)


class PulseImu(StandUnit):
    """See `EmulatedUnit`. Its noise follows from unit, number of the power-on and its moment."""

    turn_on_v = 9.0
    brown_out_v = 8.0

    def __init__(self, draw: LotDraw, twin: Twin, flash: dict[str, Any] | None = None) -> None:
        super().__init__(draw.serial)
        triad_effects(twin, (), np.random.SeedSequence(0))  # refuses what a unit cannot have
        self._draw, self._twin = draw, twin
        self._power_cycles = int((flash or {}).get("power_cycles", 0))
        self._sensors: PulseSensors | None = None
        self._at: Surroundings | None = None
        self._sent = np.zeros((6, 2), dtype=np.int64)

    def pulse_totals(self, now_s: float) -> NDArray[np.int64]:
        """Pulses since power-on, exactly at this moment: (6, 2), `scale.CHANNELS` by positive, negative."""
        self._advance_to(now_s)
        if self._sensors is None or self._at is None:
            return np.zeros((6, 2), dtype=np.int64)
        totals = whole_pulses(self._sensors.integrals(self._at.stimulus, now_s))
        # part of a period is integrated a little otherwise than all of it; a pulse that is out stays out
        self._sent = np.maximum(self._sent, totals)
        return self._sent.copy()

    def flash_image(self) -> dict[str, Any]:
        """How often it was powered."""
        return {"power_cycles": self._power_cycles}

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """The voltage at the supply pins; what came before was taken at the voltage before."""
        super().set_supply(voltage_v, now_s)
        if self._sensors is not None:
            self._sensors.supply_v = voltage_v

    def _power_on(self, surroundings: Surroundings, now_s: float) -> None:
        self._power_cycles += 1
        seed = self._draw.seed_for(_POWER_ON_NOISE, self._power_cycles, round(abs(now_s) * 1e6))
        effects = triad_effects(self._twin, surroundings.effects, seed)
        self._at, self._sent = surroundings, np.zeros((6, 2), dtype=np.int64)
        self._sensors = PulseSensors(effects, SampleGrid(now_s, PERIOD_S, now_s), seed)

    def _power_off(self, now_s: float) -> None:
        del now_s
        self._sensors = self._at = None

    def _run_to(self, now_s: float) -> list[LinkOutput]:
        """Nothing leaves on a link; the sensors keep up, so that the stand may forget its past."""
        if self._sensors is not None and self._at is not None:
            self._sensors.advance_to(self._at.stimulus, now_s)
        return []

    def _running_current_a(self) -> float:
        return RUNNING_POWER_W / self._supply_v

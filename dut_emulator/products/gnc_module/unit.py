# pyright: strict
"""A GNC module in a socket: power, circuit and firmware behind the interface that a server asks of."""

import dataclasses
from typing import Any

import numpy as np

from dut_emulator.interfaces import EmulatedUnit, LinkOutput, Surroundings
from dut_emulator.products.gnc_module import electrical
from dut_emulator.products.gnc_module.firmware import Firmware
from dut_emulator.products.gnc_module.flash import Flash
from dut_emulator.products.gnc_module.gnss_receiver import GnssReceiver
from dut_emulator.products.gnc_module.hardware import Hardware
from dut_emulator.products.gnc_module.inertial_sensors import InertialSensors
from dut_emulator.products.gnc_module.population import draw_unit, unit_seed
from dut_emulator.products.gnc_module.power import PowerEvent, PowerState, next_state
from dut_emulator.products.gnc_module.unit_truth import UnitTruth
from dut_emulator.products.gnc_module.unit_twin import check_product, crystal_error, sensor_unit
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError
from protocol.gnc_module import (
    AD_CHANNEL_OF_SOURCE,
    RIPPLE_TEST_POINT,
    TIMER_TEST_POINT,
)

_SENSOR_NOISE, _OTHER_NOISE, _RECEIVER_NOISE = 1, 2, 3
_RAIL_OF_POINT = {f"{rail}_{number}": rail for rail in ("5V", "3V3", "1V2") for number in (1, 2)}


def make_unit(
    seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
) -> EmulatedUnit:
    """The unit of this serial number in the lot of this seed, with what its flash kept (None: new).

    `twin`: other effects of its sensors, receiver and crystal than the drawn ones.

    Raises:
        TestloomError: the twin is another product's.
    """
    return GncModule(draw_unit(seed, serial), flash, twin)


class GncModule:
    """See `EmulatedUnit`. Noise differs from power-on to power-on and depends on nothing else but the unit
    and the bench time of the power-on, so that the same day at a bench gives the same bytes."""

    def __init__(
        self, truth: UnitTruth, flash: dict[str, Any] | None = None, twin: Twin | None = None
    ) -> None:
        if twin is not None:
            check_product(twin)
            truth = dataclasses.replace(truth, crystal_error=crystal_error(twin))
        self._truth, self._twin = truth, twin
        self._flash = Flash.from_image(flash) if flash is not None else Flash()
        self._surroundings: Surroundings | None = None
        self._state = PowerState.OFF
        self._firmware: Firmware | None = None
        self._supply_v = 0.0
        self._routed_v: dict[int, float] = {}
        self._left: list[LinkOutput] = []
        self._now_s = -np.inf

    def insert(self, surroundings: Surroundings, now_s: float) -> None:
        """The unit is put into a socket, unpowered."""
        self._switch_off(now_s)
        self._supply_v, self._surroundings = 0.0, surroundings
        self._routed_v.clear()

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """The voltage at the supply pins. Between brown-out and turn-on voltage the state stays."""
        self._run_to(now_s)
        self._supply_v = voltage_v
        if self._firmware is not None:
            self._firmware.hardware.supply_v = voltage_v
        if self._state is PowerState.OFF and voltage_v >= electrical.TURN_ON_V:
            self._switch_on(now_s)
        elif voltage_v < electrical.BROWN_OUT_V:
            self._switch_off(now_s)

    def receive(self, link: str, data: bytes, now_s: float, can_id: int | None = None) -> None:
        """Bytes on RS-422, or one CAN frame, arrive; an unpowered unit hears nothing."""
        self._run_to(now_s)
        if self._firmware is None:
            return
        if link == "rs422":
            self._firmware.receive_rs422(data, now_s)
        elif can_id is not None:
            self._firmware.receive_can(can_id, data, now_s)

    def next_event_s(self) -> float | None:
        """When the unit will next do something by itself."""
        if self._left:
            return self._left[0].time_s
        return self._firmware.next_event_s() if self._firmware is not None else None

    def advance(self, to_s: float) -> list[LinkOutput]:
        """Everything that has left the unit since the last call, in order of time."""
        self._run_to(to_s)
        left, self._left = self._left, []
        return left

    def supply_current_a(self, now_s: float) -> float:
        """True current drawn at the present supply voltage."""
        self._run_to(now_s)
        return electrical.supply_current_a(self._truth.electrical, self._supply_v, self._running_a())

    def resistance_ohm(self, high: str, low: str) -> float:
        """True resistance between two test points, unpowered; inf when open."""
        return electrical.resistance_ohm(self._truth.electrical, high, low)

    def point_voltage_v(self, point: str, now_s: float) -> float:
        """True DC voltage of a test point against GND_1; points that are no rail are at 0 V."""
        self._run_to(now_s)
        rail = _RAIL_OF_POINT.get(point)
        if rail is None:
            return 0.0
        return electrical.rail_v(self._truth.electrical, rail, self._supply_v, self._running_a())

    def point_ripple_v(self, point: str, now_s: float) -> float:
        """True peak-to-peak AC voltage of a test point: the converters' at the supply while they run."""
        self._run_to(now_s)
        running = self._state is not PowerState.OFF
        return self._truth.electrical.ripple_v if running and point == RIPPLE_TEST_POINT else 0.0

    def point_period_s(self, point: str, now_s: float) -> float | None:
        """True period of a square wave at a test point; None when there is none."""
        self._run_to(now_s)
        if point != TIMER_TEST_POINT or self._firmware is None:
            return None
        return self._firmware.timer_period_s

    def set_ad_source(self, source: str, voltage_v: float) -> None:
        """The board's AD switch routes this source, and no other, to its channel."""
        self._routed_v.clear()
        if source in AD_CHANNEL_OF_SOURCE:
            self._routed_v[AD_CHANNEL_OF_SOURCE[source]] = voltage_v

    def flash_image(self) -> dict[str, Any]:
        """What the unit keeps without power, JSON-able."""
        return self._flash_now().as_image()

    # --- power

    def _switch_on(self, now_s: float) -> None:
        if self._surroundings is None:
            raise TestloomError(
                "A unit was powered before it was put into a socket.",
                where=f"emulated unit {self._truth.serial}",
                fault=Fault.TESTLOOM,
                remedy="call insert() first.",
            )
        self._flash = self._flash.after_power_on()
        occasion = (self._flash.power_cycles, round(now_s * 1e6))
        truth = self._truth
        seed = unit_seed(truth.seed, truth.serial, _SENSOR_NOISE, *occasion)
        made_of, place = sensor_unit(truth, self._twin), self._surroundings
        sensors = InertialSensors(made_of, seed, now_s, place.effects)
        seed = unit_seed(truth.seed, truth.serial, _RECEIVER_NOISE, *occasion)
        receiver = GnssReceiver(truth.gnss, made_of.twin, seed, now_s, place, place.effects)
        rng = np.random.Generator(
            np.random.SFC64(unit_seed(truth.seed, truth.serial, _OTHER_NOISE, *occasion))
        )
        hardware = Hardware(
            truth, place, sensors, receiver, rng, now_s, self._flash, self._supply_v, self._routed_v
        )
        self._boot(hardware, PowerEvent.SUPPLY_GOOD, now_s)

    def _boot(self, hardware: Hardware, event: PowerEvent, now_s: float) -> None:
        self._state = next_state(self._state, event)
        self._firmware = Firmware(hardware, now_s, on_booted=self._booted, on_reset=self._reset)

    def _booted(self) -> None:
        self._state = next_state(self._state, PowerEvent.BOOTED)

    def _reset(self, now_s: float) -> None:
        assert self._firmware is not None
        self._boot(self._firmware.hardware, PowerEvent.RESET, now_s)

    def _switch_off(self, now_s: float) -> None:
        self._run_to(now_s)
        if self._firmware is None:
            return
        self._state = next_state(self._state, PowerEvent.SUPPLY_LOST)
        self._flash = self._flash_now()
        self._firmware = None

    def _flash_now(self) -> Flash:
        return self._firmware.hardware.flash if self._firmware is not None else self._flash

    def _running_a(self) -> float:
        circuit = self._truth.electrical
        return {
            PowerState.OFF: 0.0,
            PowerState.BOOT: circuit.current_boot_a,
            PowerState.READY: circuit.current_running_a,
        }[self._state]

    def _run_to(self, now_s: float) -> None:
        if now_s < self._now_s:
            raise TestloomError(
                f"A unit was asked about {now_s} s after {self._now_s} s.",
                where=f"emulated unit {self._truth.serial}",
                fault=Fault.TESTLOOM,
                remedy="keep the bench's clock from going back.",
            )
        self._now_s = now_s
        while self._firmware is not None:
            firmware = self._firmware
            self._left += firmware.run_to(now_s)
            if firmware is self._firmware:  # a reset has put another one in its place
                return

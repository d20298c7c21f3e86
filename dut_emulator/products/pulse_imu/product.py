# pyright: strict
"""The pulse IMU as a product: where it is tested, its streams, and what is believed of a unit."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stage, name_of
from dut_emulator.lot import LotDraw
from dut_emulator.lot_defects import defects_of
from dut_emulator.products.product import (
    Mounting,
    StreamShape,
    UnitOnStand,
    chain_effects,
    sample_times_s,
)
from dut_emulator.products.pulse_imu.belief import believed
from dut_emulator.products.pulse_imu.population import DEFECTS, NAME, draw_twin, with_turn_on
from dut_emulator.products.pulse_imu.pulse_sensors import PulseSensors, SampleGrid, whole_pulses
from dut_emulator.products.pulse_imu.scale import CHANNELS, TRIADS
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError

OVERLOAD_RATE_HZ, STATIC_RATE_HZ = 1000.0, 100.0
COLUMNS: tuple[str, ...] = tuple(f"pulse_{channel}_{sign}" for channel in CHANNELS for sign in ("pos", "neg"))
"""Pulses of the sample period that ends at t; the first sample has none."""


def triad_effects(
    twin: Twin, stand_effects: tuple[CatalogueEffect, ...], seed: np.random.SeedSequence
) -> dict[str, tuple[CatalogueEffect, ...]]:
    """Triad → effects of one power-on: the stand's, then the unit's.

    Raises:
        TestloomError: an effect that a unit without field sensor, receiver and data link cannot have.
    """
    for effect in twin.effects:
        if effect.sensor not in TRIADS or effect.stage is Stage.TRANSPORT or effect.word == "quantization":
            raise TestloomError(
                f"A {NAME} cannot have the effect '{name_of(effect)}' of its {effect.sensor}.",
                where="twin",
                fault=Fault.DATA,
                remedy="use effects of its gyros and accelerometers: it counts whole pulses, without a link.",
            )
    return {triad: with_turn_on(chain_effects(twin, stand_effects, triad), seed) for triad in TRIADS}


class PulseStream:
    """See `UnitStreams`."""

    def __init__(self, unit: UnitOnStand) -> None:
        self._unit = unit
        self._sensors = PulseSensors(
            triad_effects(unit.twin, unit.stand_effects, unit.seed),
            SampleGrid(0.0, 1.0 / unit.rate_hz, unit.power_on_s),
            unit.seed,
        )
        self._taken = 0
        self._totals = np.zeros((1, len(COLUMNS)), dtype=np.int64)

    @property
    def shapes(self) -> tuple[StreamShape, ...]:
        """One stream: time and twelve counters."""
        units, types = dict.fromkeys(COLUMNS, "1"), dict.fromkeys(COLUMNS, "int32")
        return (StreamShape("dut", {"t": "s", **units}, {"t": "float64", **types}),)

    def advance(self, to_s: float) -> Mapping[str, Mapping[str, NDArray[Any]]]:
        """Samples of (last advance, to_s]; the first of all at 0 s, with no pulse yet."""
        times_s = sample_times_s(self._taken, to_s, self._unit.rate_hz)
        first = int(self._taken == 0 and len(times_s) > 0)
        integrals = self._sensors.advance(self._unit.run.stimulus, len(times_s) - first)
        totals = whole_pulses(integrals).reshape(-1, len(COLUMNS))
        before = np.repeat(self._totals, 1 + first, axis=0)
        pulses = np.diff(np.concatenate([before, totals]), axis=0).astype(np.int32)
        if len(totals):
            self._totals = totals[-1:]
        self._taken += len(times_s)
        return {"dut": {"t": times_s, **{name: pulses[:, at] for at, name in enumerate(COLUMNS)}}}


class PulseImuProduct:
    """See `Product`."""

    name = NAME
    profiles: Mapping[str, Mounting] = {
        "overload": Mounting("sinusoidal_overload_rig", OVERLOAD_RATE_HZ),
        "static": Mounting("three_axis_turntable", STATIC_RATE_HZ),
        "multi_position": Mounting("three_axis_turntable", STATIC_RATE_HZ),
    }

    def twin(self, seed: int, serial: str) -> Twin:
        """The unit of this serial number in the lot of this seed."""
        return draw_twin(seed, serial)

    def defects(self, seed: int, serial: str) -> tuple[str, ...]:
        """See `Product`."""
        return tuple(defect.name for defect in defects_of(LotDraw(seed, serial), DEFECTS))

    def believed(self, twin: Twin) -> dict[str, Any]:
        """What the simulator knows of a unit with this twin."""
        return believed(twin)

    def begin(self, unit: UnitOnStand) -> PulseStream:
        """Power the unit on this stand.

        Raises:
            TestloomError: the twin has an effect that this product cannot have.
        """
        return PulseStream(unit)


PRODUCT = PulseImuProduct()

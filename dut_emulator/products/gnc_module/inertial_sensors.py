# pyright: strict
"""Gyros, accelerometers and magnetometer of one unit from power-on to power-off, as integers.

Each triad is a chain: what the stand adds, then the unit's own effects. Range and quantum are the product's,
whatever a twin says. The temperature is the surroundings' plus the unit's own warming up.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.deterministic import REFERENCE_TEMPERATURE_C, Bias, ScaleFactorError
from dut_emulator.effects.effect import EffectChain, SensorName, Stimulus
from dut_emulator.products.gnc_module.flash import Coefficients
from dut_emulator.products.gnc_module.unit_truth import UnitTruth
from dut_emulator.products.gnc_module.unit_twin import (
    ACC_LSB_M_S2,
    ACC_RANGE_COUNTS,
    GYRO_LSB_RAD_S,
    GYRO_RANGE_COUNTS,
    MAG_LSB_T,
    MAG_NOISE_RATE_HZ,
    MAG_RANGE_COUNTS,
    SensorUnit,
    sensor_unit,
    without_crystal,
)
from dut_emulator.products.product import chain_effects
from dut_emulator.seeds import child_seed
from protocol.gnc_module import SUPPLY_CURRENT_NOMINAL_A, TEMPERATURE_LSB_C, SampleStatus

SUPPLY_NOMINAL_V = 5.0
SELF_HEATING_TIME_S = 30.0
"""Time constant of the warming up after power-on."""
WARM_AFTER = 40
"""So many of them."""

_GYRO, _ACC, _MAG, _TURN_ON, _TEMPERATURE, _AD = range(6)

IntegerArray = NDArray[np.int32]


@dataclass(frozen=True)
class SensorSamples:
    """n samples as the converters give them: counts of the product's quanta, (n, 3); temperature (n,).

    `lost` (n,): samples whose frame does not arrive; their counts are 0.
    """

    gyro: IntegerArray
    acc: IntegerArray
    mag: IntegerArray
    temperature: NDArray[np.int16]
    status: NDArray[np.uint16]
    lost: NDArray[np.bool_]

    def at(self, rows: slice) -> "SensorSamples":
        """Some of them, as views."""
        return SensorSamples(
            gyro=self.gyro[rows],
            acc=self.acc[rows],
            mag=self.mag[rows],
            temperature=self.temperature[rows],
            status=self.status[rows],
            lost=self.lost[rows],
        )

    def compensated(self, gyro: Coefficients, acc: Coefficients) -> "SensorSamples":
        """With both triads' coefficients applied and rounded to quanta again."""
        return SensorSamples(
            gyro=_compensated(self.gyro, gyro, GYRO_LSB_RAD_S),
            acc=_compensated(self.acc, acc, ACC_LSB_M_S2),
            mag=self.mag,
            temperature=self.temperature,
            status=self.status | np.uint16(SampleStatus.COMPENSATED),
            lost=self.lost,
        )


def _compensated(counts: IntegerArray, coefficients: Coefficients, quantum_si: float) -> IntegerArray:
    inputs_si = coefficients.compensate(counts.astype(np.float64) * quantum_si)
    return np.rint(inputs_si / quantum_si).astype(np.int32)


class InertialSensors:
    """The sensors from one power-on to the next power-off.

    Args:
        unit: a drawn unit, or what its sensors are made of.
        seed: of this power-on: turn-on biases and noise.
        power_on_s: when.
        stand_effects: what the place adds (`chain_effects`).
    """

    def __init__(
        self,
        unit: UnitTruth | SensorUnit,
        seed: np.random.SeedSequence,
        power_on_s: float,
        stand_effects: tuple[CatalogueEffect, ...] = (),
    ) -> None:
        self._unit = unit if isinstance(unit, SensorUnit) else sensor_unit(unit)
        self._power_on_s = power_on_s
        twin = self._unit.twin
        turn_on = np.random.Generator(np.random.SFC64(child_seed(seed, _TURN_ON)))

        def effects(sensor: SensorName) -> tuple[CatalogueEffect, ...]:
            return without_crystal(chain_effects(twin, stand_effects, sensor), twin)

        gyro = with_turn_on(effects("gyro"), "gyro", self._unit.gyro_turn_on_si, turn_on)
        acc = with_turn_on(effects("acc"), "acc", self._unit.acc_turn_on_si, turn_on)
        self._gyro, self._acc = EffectChain(gyro), EffectChain(acc)
        self._mag, self._probe = EffectChain(effects("mag")), EffectChain(effects("temperature"))
        self._gyro_memory = self._gyro.begin(child_seed(seed, _GYRO))
        self._acc_memory = self._acc.begin(child_seed(seed, _ACC))
        self._mag_memory = self._mag.begin(child_seed(seed, _MAG))
        self._ad_memory = self._mag.begin(child_seed(seed, _AD))
        self._probe_memory = self._probe.begin(child_seed(seed, _TEMPERATURE))

    def temperature_c(
        self, surrounding_c: NDArray[np.float64], times_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(n,) true temperature of the sensors."""
        since = np.maximum(times_s - self._power_on_s, 0.0)
        return surrounding_c - self._unit.self_heating_c * np.expm1(-since / SELF_HEATING_TIME_S)

    def sample(self, times_s: NDArray[np.float64], period_s: float, acting: Stimulus) -> SensorSamples:
        """Raw samples at these instants, spaced by `period_s`; calls go forward in time."""
        stimulus = self._as_felt(times_s, period_s, acting)
        gyro = self._gyro.apply(acting.true_input("gyro"), stimulus, self._gyro_memory)
        acc = self._acc.apply(acting.true_input("acc"), stimulus, self._acc_memory)
        mag = self._mag.apply(acting.true_input("mag"), stimulus, self._mag_memory)
        lost = ~np.isfinite(gyro[:, 0] + acc[:, 0] + mag[:, 0])
        gyro_counts = _counts(gyro, GYRO_LSB_RAD_S, GYRO_RANGE_COUNTS)
        acc_counts = _counts(acc, ACC_LSB_M_S2, ACC_RANGE_COUNTS)
        status = np.zeros(len(times_s), dtype=np.uint16)
        for counts, limit, bit in (
            (gyro_counts, GYRO_RANGE_COUNTS, SampleStatus.GYRO_SATURATED),
            (acc_counts, ACC_RANGE_COUNTS, SampleStatus.ACC_SATURATED),
        ):
            status[(np.abs(counts) >= limit).any(axis=1)] |= np.uint16(bit)
        felt = stimulus.true_input("temperature") + self._unit.temperature_error_c
        probe = self._probe.apply(felt, stimulus, self._probe_memory)[:, 0]
        return SensorSamples(
            gyro=gyro_counts,
            acc=acc_counts,
            mag=_counts(mag, MAG_LSB_T, MAG_RANGE_COUNTS),
            temperature=np.rint(probe / TEMPERATURE_LSB_C).astype(np.int16),
            status=status,
            lost=lost,
        )

    def field_t(self, field_t: NDArray[np.float64], acting: Stimulus | None = None) -> NDArray[np.float64]:
        """The magnetometer's analogue outputs (n, 3) in a field (n, 3), each of a moment of its own.

        `acting`: what else acts there; without it, nothing, and the sensors are warm, at 25 °C.
        """
        if acting is None:
            warm_s = self._power_on_s + WARM_AFTER * SELF_HEATING_TIME_S
            times_s = warm_s + np.arange(len(field_t)) / MAG_NOISE_RATE_HZ
            around_c = REFERENCE_TEMPERATURE_C - self._unit.self_heating_c
            acting = Stimulus(times_s, np.full(len(field_t), around_c), math.nan, field_t=field_t)
        times_s = acting.time_s
        stimulus = self._as_felt(times_s, 1 / MAG_NOISE_RATE_HZ, acting)
        return self._mag.apply(field_t, stimulus, self._ad_memory)

    def _as_felt(self, times_s: NDArray[np.float64], period_s: float, acting: Stimulus) -> Stimulus:
        """With the sensors' own temperature, and a supply where the place does not say."""
        n = len(times_s)
        voltage, current = acting.supply_v, acting.supply_current_a
        return dataclasses.replace(
            acting,
            time_s=times_s,
            temperature_c=self.temperature_c(acting.temperature_c, times_s),
            sample_period_s=period_s,
            supply_v=np.full(n, SUPPLY_NOMINAL_V) if voltage is None else voltage,
            supply_current_a=np.full(n, SUPPLY_CURRENT_NOMINAL_A) if current is None else current,
            power_on_s=self._power_on_s,
        )


def with_turn_on(
    effects: tuple[CatalogueEffect, ...],
    sensor: SensorName,
    deviation_si: float,
    turn_on: np.random.Generator,
) -> tuple[CatalogueEffect, ...]:
    """A triad's effects with the part of the bias that a power-on draws anew; none on a dead axis."""
    drawn = deviation_si * turn_on.standard_normal(3)
    bias = np.zeros(3)
    for effect in effects:
        if isinstance(effect, ScaleFactorError):
            drawn = drawn * (np.asarray(effect.scale_factor_error) > -1.0)
        elif isinstance(effect, Bias):
            bias = np.asarray(effect.bias_si)
    x, y, z = (float(value) for value in bias + drawn)
    return (*(effect for effect in effects if not isinstance(effect, Bias)), Bias(sensor, (x, y, z)))


def _counts(values: NDArray[np.float64], quantum_si: float, limit: int) -> IntegerArray:
    """Whole quanta inside the range; 0 for what is lost."""
    counts = np.clip(np.rint(values / quantum_si), -limit, limit)
    return np.nan_to_num(counts, copy=False, nan=0.0).astype(np.int32)

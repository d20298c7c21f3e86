# pyright: strict
"""Gyros, accelerometers and magnetometer of one unit from power-on to power-off, as integers.

Each triad is a chain of effects on what acts on the unit; its range and quantum are the product's. The
temperature is the surroundings' plus the unit's own warming up.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Quantisation,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.effect import ChainState, Effect, EffectChain, SensorName, Stimulus
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.products.gnc_module.flash import Coefficients
from dut_emulator.products.gnc_module.unit_truth import TriadTruth, UnitTruth
from protocol.gnc_module import (
    ACC_LSB_G,
    ACC_RANGE_G,
    GYRO_LSB_DEG_S,
    GYRO_RANGE_DEG_S,
    MAG_LSB_GAUSS,
    MAG_RANGE_GAUSS,
    TEMPERATURE_LSB_C,
    SampleStatus,
)
from protocol.units_of_measure import factor_to_si

GYRO_LSB_RAD_S = GYRO_LSB_DEG_S * factor_to_si("deg/s")
ACC_LSB_M_S2 = ACC_LSB_G * factor_to_si("g")
GYRO_RANGE_COUNTS = round(GYRO_RANGE_DEG_S / GYRO_LSB_DEG_S)
ACC_RANGE_COUNTS = round(ACC_RANGE_G / ACC_LSB_G)
MAG_LSB_T = MAG_LSB_GAUSS * factor_to_si("gauss")
MAG_RANGE_T = MAG_RANGE_GAUSS * factor_to_si("gauss")

SELF_HEATING_TIME_S = 30.0
"""Time constant of the warming up after power-on."""

_GYRO, _ACC, _MAG, _TURN_ON = range(4)

IntegerArray = NDArray[np.int32]


@dataclass(frozen=True)
class SensorSamples:
    """n samples as the converters give them: counts of the product's quanta, (n, 3); temperature (n,)."""

    gyro: IntegerArray
    acc: IntegerArray
    mag: IntegerArray
    temperature: NDArray[np.int16]
    status: NDArray[np.uint16]

    def compensated(self, gyro: Coefficients, acc: Coefficients) -> "SensorSamples":
        """With both triads' coefficients applied and rounded to quanta again."""
        return SensorSamples(
            gyro=_compensated(self.gyro, gyro, GYRO_LSB_RAD_S),
            acc=_compensated(self.acc, acc, ACC_LSB_M_S2),
            mag=self.mag,
            temperature=self.temperature,
            status=self.status | np.uint16(SampleStatus.COMPENSATED),
        )


def _compensated(counts: IntegerArray, coefficients: Coefficients, quantum_si: float) -> IntegerArray:
    inputs_si = coefficients.compensate(counts.astype(np.float64) * quantum_si)
    return np.rint(inputs_si / quantum_si).astype(np.int32)


class InertialSensors:
    """The sensors from one power-on to the next power-off."""

    def __init__(self, truth: UnitTruth, seed: np.random.SeedSequence, power_on_s: float) -> None:
        self._truth = truth
        self._power_on_s = power_on_s
        turn_on = np.random.Generator(np.random.SFC64(_child(seed, _TURN_ON)))
        self._gyro = EffectChain(
            triad_effects("gyro", truth.gyro, turn_on, GYRO_RANGE_COUNTS * GYRO_LSB_RAD_S, GYRO_LSB_RAD_S)
        )
        self._acc = EffectChain(
            triad_effects("acc", truth.acc, turn_on, ACC_RANGE_COUNTS * ACC_LSB_M_S2, ACC_LSB_M_S2)
        )
        self._gyro_memory: ChainState = self._gyro.begin(_child(seed, _GYRO))
        self._acc_memory: ChainState = self._acc.begin(_child(seed, _ACC))
        self._mag_rng = np.random.Generator(np.random.SFC64(_child(seed, _MAG)))

    def temperature_c(
        self, surrounding_c: NDArray[np.float64], times_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(n,) true temperature of the sensors."""
        since = np.maximum(times_s - self._power_on_s, 0.0)
        return surrounding_c - self._truth.self_heating_c * np.expm1(-since / SELF_HEATING_TIME_S)

    def sample(self, times_s: NDArray[np.float64], period_s: float, acting: Stimulus) -> SensorSamples:
        """Raw samples at these instants, spaced by `period_s`; calls go forward in time."""
        temperature = self.temperature_c(acting.temperature_c, times_s)
        stimulus = dataclasses.replace(
            acting,
            time_s=times_s,
            temperature_c=temperature,
            sample_period_s=period_s,
            power_on_s=self._power_on_s,
        )
        gyro = self._gyro.apply(acting.true_input("gyro"), stimulus, self._gyro_memory)
        acc = self._acc.apply(acting.true_input("acc"), stimulus, self._acc_memory)
        gyro_counts = np.rint(gyro / GYRO_LSB_RAD_S).astype(np.int32)
        acc_counts = np.rint(acc / ACC_LSB_M_S2).astype(np.int32)
        status = np.zeros(len(times_s), dtype=np.uint16)
        status |= np.where(
            (np.abs(gyro_counts) >= GYRO_RANGE_COUNTS).any(axis=1),
            np.uint16(SampleStatus.GYRO_SATURATED),
            np.uint16(0),
        )
        status |= np.where(
            (np.abs(acc_counts) >= ACC_RANGE_COUNTS).any(axis=1),
            np.uint16(SampleStatus.ACC_SATURATED),
            np.uint16(0),
        )
        reading = (temperature + self._truth.temperature_error_c) / TEMPERATURE_LSB_C
        return SensorSamples(
            gyro=gyro_counts,
            acc=acc_counts,
            mag=np.rint(self.field_t(acting.true_input("mag")) / MAG_LSB_T).astype(np.int32),
            temperature=np.rint(reading).astype(np.int16),
            status=status,
        )

    def field_t(self, field_t: NDArray[np.float64]) -> NDArray[np.float64]:
        """The magnetometer's reading (n, 3) of a field (n, 3)."""
        truth = self._truth.magnetometer
        noise = truth.noise_t * self._mag_rng.standard_normal(field_t.shape)
        output = field_t * (1 + np.asarray(truth.scale_factor_error)) + np.asarray(truth.bias_t) + noise
        return np.clip(output, -MAG_RANGE_T, MAG_RANGE_T)


def triad_effects(
    sensor: SensorName,
    truth: TriadTruth,
    turn_on: np.random.Generator,
    range_si: float,
    quantum_si: float,
) -> tuple[Effect, ...]:
    """The effects of a triad; `turn_on` draws the part of the bias that differs from power-on to power-on."""
    alive = np.asarray(truth.noise_density_si) > 0
    bias = np.asarray(truth.bias_si) + alive * truth.turn_on_deviation_si * turn_on.standard_normal(3)
    x, y, z = (float(value) for value in bias)
    return (
        Misalignment(sensor, truth.misalignment_rad),
        ScaleFactorError(sensor, truth.scale_factor_error),
        Bias(sensor, (x, y, z)),
        BiasTemperature(sensor, (truth.bias_temperature_si_per_c,)),
        WhiteNoise(sensor, truth.noise_density_si),
        BiasInstability(sensor, truth.bias_instability_si, truth.correlation_time_s),
        Saturation(sensor, range_si if range_si > 0 else math.inf),
        Quantisation(sensor, quantum_si),
    )


def _child(seed: np.random.SeedSequence, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, purpose))

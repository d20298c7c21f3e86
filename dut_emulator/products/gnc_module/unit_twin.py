# pyright: strict
"""A drawn unit as effects of the catalogue, and what of a unit is none: its warmth, its turn-on, its crystal.

The crystal is 'link.clock_drift' of the three triads in a twin. The unit does not shift finished samples by
it, it samples by it: so that a common one of the three is the crystal's, and no part of a chain.
"""

from dataclasses import dataclass

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Quantisation,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.dynamics import ClockDrift, GnssLatency
from dut_emulator.effects.effect import SensorName
from dut_emulator.effects.fields_and_tones import AntennaLeverArm, HardIron, SoftIron
from dut_emulator.effects.slow_noise import Multipath
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.effects.thermal import ScaleFactorTemperature
from dut_emulator.lot import LotDraw, Spread
from dut_emulator.products.gnc_module.unit_truth import GnssTruth, MagnetometerTruth, TriadTruth, UnitTruth
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError
from protocol.gnc_module import (
    ACC_LSB_G,
    ACC_RANGE_G,
    GYRO_LSB_DEG_S,
    GYRO_RANGE_DEG_S,
    MAG_LSB_GAUSS,
    MAG_RANGE_GAUSS,
)
from protocol.units_of_measure import factor_to_si

PRODUCT_NAME = "gnc_module"
GYRO_LSB_RAD_S = GYRO_LSB_DEG_S * factor_to_si("deg/s")
ACC_LSB_M_S2 = ACC_LSB_G * factor_to_si("g")
MAG_LSB_T = MAG_LSB_GAUSS * factor_to_si("gauss")
GYRO_RANGE_COUNTS = round(GYRO_RANGE_DEG_S / GYRO_LSB_DEG_S)
ACC_RANGE_COUNTS = round(ACC_RANGE_G / ACC_LSB_G)
MAG_RANGE_COUNTS = round(MAG_RANGE_GAUSS / MAG_LSB_GAUSS)
MAG_NOISE_RATE_HZ = 200.0
"""The magnetometer's noise is stated for a sample at this rate."""
MULTIPATH_TIME_S = 120.0
_SAMPLED: tuple[SensorName, ...] = ("gyro", "acc", "mag")


@dataclass(frozen=True)
class SensorUnit:
    """What a unit's sensors are made of. Turn-on: standard deviation of the part drawn at each power-on."""

    twin: Twin
    self_heating_c: float
    temperature_error_c: float
    gyro_turn_on_si: float
    acc_turn_on_si: float


def sensor_unit(truth: UnitTruth, twin: Twin | None = None) -> SensorUnit:
    """A drawn unit; with another's effects if a twin is given."""
    return SensorUnit(
        twin or twin_of(truth),
        truth.self_heating_c,
        truth.temperature_error_c,
        truth.gyro.turn_on_deviation_si,
        truth.acc.turn_on_deviation_si,
    )


def sensor_unit_of_serial(
    twin: Twin, serial: str, gyro_turn_on_si: float, acc_turn_on_si: float
) -> SensorUnit:
    """A unit of which only the effects are known; its warmth is drawn by its serial number."""
    draw = LotDraw(0, serial)
    return SensorUnit(
        twin,
        draw.around("self_heating", 2.0, Spread(unit=0.1)),
        draw.normal("temperature_error", 0.0, Spread(unit=0.5)),
        gyro_turn_on_si,
        acc_turn_on_si,
    )


def twin_of(truth: UnitTruth) -> Twin:
    """The effects of a drawn unit."""
    return Twin(
        PRODUCT_NAME,
        (
            *triad_effects("gyro", truth.gyro, GYRO_RANGE_COUNTS, GYRO_LSB_RAD_S),
            ClockDrift("gyro", truth.crystal_error),
            *triad_effects("acc", truth.acc, ACC_RANGE_COUNTS, ACC_LSB_M_S2),
            ClockDrift("acc", truth.crystal_error),
            *_magnetometer_effects(truth.magnetometer),
            ClockDrift("mag", truth.crystal_error),
            *_receiver_effects(truth.gnss),
        ),
    )


def check_product(twin: Twin) -> None:
    """Raises TestloomError: the twin is another product's."""
    if twin.product not in ("", PRODUCT_NAME):
        raise TestloomError(
            f"The twin is one of a {twin.product}, not of a {PRODUCT_NAME}.",
            where="twin, product",
            fault=Fault.OPERATOR,
            remedy="give a twin of this product.",
        )


def crystal_error(twin: Twin) -> float:
    """How much faster the unit's clock runs: the drift that all triads share; 0 if they do not."""
    found = {effect.sensor: effect.relative_rate for effect in twin.effects if isinstance(effect, ClockDrift)}
    rates = {found.get(sensor) for sensor in _SAMPLED}
    common = rates.pop() if len(rates) == 1 else None
    return common or 0.0


def without_crystal(effects: tuple[CatalogueEffect, ...], twin: Twin) -> tuple[CatalogueEffect, ...]:
    """A chain's effects, less the drift that is the crystal's."""
    error = crystal_error(twin)
    return tuple(
        effect
        for effect in effects
        if not (error and isinstance(effect, ClockDrift) and effect.relative_rate == error)
    )


def triad_effects(
    sensor: SensorName, truth: TriadTruth, range_counts: int, quantum_si: float
) -> tuple[CatalogueEffect, ...]:
    """The effects of gyros or accelerometers."""
    return (
        Misalignment(sensor, truth.misalignment_rad),
        ScaleFactorError(sensor, truth.scale_factor_error),
        ScaleFactorTemperature(sensor, (truth.scale_factor_temperature_per_c,)),
        Bias(sensor, truth.bias_si),
        BiasTemperature(sensor, (truth.bias_temperature_si_per_c,)),
        WhiteNoise(sensor, truth.noise_density_si),
        BiasInstability(sensor, truth.bias_instability_si, truth.correlation_time_s),
        Saturation(sensor, range_counts * quantum_si),
        Quantisation(sensor, quantum_si),
    )


def _magnetometer_effects(truth: MagnetometerTruth) -> tuple[CatalogueEffect, ...]:
    density = truth.noise_t / MAG_NOISE_RATE_HZ**0.5
    return (
        SoftIron("mag", truth.soft_iron),
        ScaleFactorError("mag", truth.scale_factor_error),
        ScaleFactorTemperature("mag", (truth.scale_factor_temperature_per_c,)),
        HardIron("mag", truth.bias_t),
        WhiteNoise("mag", (density, density, density)),
        Saturation("mag", MAG_RANGE_COUNTS * MAG_LSB_T),
        Quantisation("mag", MAG_LSB_T),
    )


def _receiver_effects(truth: GnssTruth) -> tuple[CatalogueEffect, ...]:
    level = truth.multipath_m
    return (
        AntennaLeverArm("gnss", truth.antenna_arm_m),
        Multipath("gnss", (level, level, 1.5 * level), MULTIPATH_TIME_S),
        GnssLatency("gnss", truth.latency_s),
    )

# pyright: strict
"""The true effects of a unit of a lot: MEMS sensors that differ, most of all over temperature (paper 2, 1.1).

"Errors of one sensor repeat over −40 to 80 °C, less well for accelerometers; from unit to unit their form and
parameters differ much, and they are far from linear." So the bias over temperature has four powers, each with
parts of lot, wafer and unit. It is drawn as what it makes at 55 °C from the reference, which is 80 °C and
−30 °C. Magnitudes are those of tactical-to-industrial MEMS sensors of ±400 °/s and ±10 g.
"""

import math
from collections.abc import Callable

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.couplings import GSensitivity
from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Quantisation,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.dynamics import Bandwidth, FixedDelay
from dut_emulator.effects.nonlinearity import (
    QuadraticNonlinearity,
    ScaleFactorAsymmetry,
    ScaleFactorNonlinearity,
)
from dut_emulator.effects.parameters import Matrix, Triple
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.effects.thermal import (
    MisalignmentTemperature,
    ScaleFactorTemperature,
    TemperatureRate,
    ThermalHysteresis,
    WarmUp,
)
from dut_emulator.lot import LotDraw, Spread
from dut_emulator.lot_defects import LotDefect, with_defects
from dut_emulator.twin import Twin
from protocol.mems_ahrs import ACC_LSB_G, ACC_RANGE_G, GYRO_LSB_DEG_S, GYRO_RANGE_DEG_S
from protocol.units_of_measure import factor_to_si

DEG = math.radians(1.0)
MG = factor_to_si("mg")
GYRO_LSB_RAD_S, GYRO_RANGE_RAD_S = GYRO_LSB_DEG_S * DEG, GYRO_RANGE_DEG_S * DEG
ACC_LSB_M_S2, ACC_RANGE_M_S2 = ACC_LSB_G * factor_to_si("g"), ACC_RANGE_G * factor_to_si("g")

NOISE_UNIT_SPREAD = 0.25
"""Of the logarithm of every noise level, wafer and unit together."""
BIAS_CORRELATION_TIME_S = 300.0
TURN_ON_DEVIATION = {"gyro": 0.01 * DEG, "acc": 0.5 * MG}
"""Bias from power-on to power-on, for sensors that have one."""

_SPAN_C = 55.0
_NOISE = Spread(unit=0.2, wafer=0.15)

DEFECTS = (
    LotDefect("dead_gyro", 0.01, "gyro.scale_factor_error", "gyro", "scale_factor_error", 0.0, -1.0),
    LotDefect("leaking_package", 0.015, "gyro.angle_random_walk", "gyro", "density_si_per_sqrt_hz", 6.0),
    LotDefect("cracked_die_bond", 0.015, "acc.thermal_hysteresis", "acc", "amplitude_si", 15.0),
    LotDefect("lifted_sensor", 0.01, "acc.bias", "acc", "bias_si", 1.0, 60 * MG),
)
"""What goes wrong with such units, and how often: stated by this project."""


def draw_twin(seed: int, serial: str) -> Twin:
    """The unit of this serial number in the lot of this seed."""
    draw = LotDraw(seed, serial)
    delay_s = draw.around("delay", 1.5e-3, Spread(unit=0.05))
    return with_defects(Twin("mems_ahrs", (*_gyro(draw, delay_s), *_acc(draw, delay_s))), draw, DEFECTS)


def _gyro(draw: LotDraw, delay_s: float) -> tuple[CatalogueEffect, ...]:
    def triple(name: str, spread: Spread) -> Triple:
        return draw.triple(f"gyro_{name}", 0.0, spread)

    cubic = 300e-6 / GYRO_RANGE_RAD_S**2
    return (
        Misalignment("gyro", _matrix(draw, "gyro_misalignment", Spread(unit=3e-3))),
        MisalignmentTemperature("gyro", _matrix(draw, "gyro_misalignment_temperature", Spread(unit=2e-5))),
        ScaleFactorError("gyro", triple("scale", Spread(unit=4e-3, wafer=2e-3, lot=2e-3))),
        ScaleFactorTemperature("gyro", _scale_over_temperature(triple)),
        ScaleFactorAsymmetry("gyro", triple("asymmetry", Spread(unit=150e-6, wafer=80e-6))),
        ScaleFactorNonlinearity("gyro", triple("cubic", Spread(unit=cubic, wafer=0.5 * cubic))),
        Bias("gyro", triple("bias", Spread(unit=0.12 * DEG, wafer=0.06 * DEG, lot=0.05 * DEG))),
        BiasTemperature("gyro", _over_temperature(triple, (0.05 * DEG, 0.04 * DEG, 0.03 * DEG, 0.02 * DEG))),
        TemperatureRate("gyro", triple("rate", Spread(unit=0.15 * DEG, lot=0.1 * DEG))),
        ThermalHysteresis("gyro", triple("hysteresis", Spread(unit=0.008 * DEG)), 15.0),
        WarmUp("gyro", triple("warm_up", Spread(unit=0.015 * DEG, lot=0.01 * DEG)), 150.0),
        GSensitivity("gyro", _g_sensitivity(draw)),
        WhiteNoise("gyro", draw.triple_around("gyro_noise", 0.3 * DEG / 60, _NOISE)),
        BiasInstability(
            "gyro", draw.triple_around("gyro_instability", 10 * DEG / 3600, _NOISE), BIAS_CORRELATION_TIME_S
        ),
        Bandwidth("gyro", draw.around("gyro_bandwidth", 1 / (2 * math.pi * 80.0), Spread(wafer=0.05))),
        Saturation("gyro", GYRO_RANGE_RAD_S),
        Quantisation("gyro", GYRO_LSB_RAD_S),
        FixedDelay("gyro", delay_s),
    )


def _acc(draw: LotDraw, delay_s: float) -> tuple[CatalogueEffect, ...]:
    def triple(name: str, spread: Spread) -> Triple:
        return draw.triple(f"acc_{name}", 0.0, spread)

    square = 100e-6 / factor_to_si("g")
    return (
        Misalignment("acc", _matrix(draw, "acc_misalignment", Spread(unit=3e-3))),
        MisalignmentTemperature("acc", _matrix(draw, "acc_misalignment_temperature", Spread(unit=2e-5))),
        ScaleFactorError("acc", triple("scale", Spread(unit=2e-3, wafer=1e-3, lot=1e-3))),
        ScaleFactorTemperature("acc", _scale_over_temperature(triple)),
        QuadraticNonlinearity("acc", triple("square", Spread(unit=square, wafer=0.5 * square))),
        Bias("acc", triple("bias", Spread(unit=3 * MG, wafer=2 * MG, lot=1 * MG))),
        BiasTemperature("acc", _over_temperature(triple, (8 * MG, 4 * MG, 3 * MG, 2 * MG))),
        ThermalHysteresis("acc", triple("hysteresis", Spread(unit=0.5 * MG)), 15.0),
        WarmUp("acc", triple("warm_up", Spread(unit=0.4 * MG, lot=0.2 * MG)), 150.0),
        WhiteNoise("acc", draw.triple_around("acc_noise", 0.06 / 60, _NOISE)),
        BiasInstability(
            "acc", draw.triple_around("acc_instability", 0.1 * MG, _NOISE), BIAS_CORRELATION_TIME_S
        ),
        Bandwidth("acc", draw.around("acc_bandwidth", 1 / (2 * math.pi * 80.0), Spread(wafer=0.05))),
        Saturation("acc", ACC_RANGE_M_S2),
        Quantisation("acc", ACC_LSB_M_S2),
        FixedDelay("acc", delay_s),
    )


def _over_temperature(
    triple: Callable[[str, Spread], Triple], at_span_si: tuple[float, ...]
) -> tuple[Triple, ...]:
    """Rows for the powers 1, 2, …: `at_span_si` is each one's deviation at `_SPAN_C` from the reference."""
    rows: list[Triple] = []
    for power, deviation in enumerate(at_span_si, start=1):
        each = Spread(unit=0.8 * deviation, wafer=0.45 * deviation, lot=0.4 * deviation)
        x, y, z = triple(f"bias_temperature_{power}", each)
        rows.append((x / _SPAN_C**power, y / _SPAN_C**power, z / _SPAN_C**power))
    return tuple(rows)


def _scale_over_temperature(triple: Callable[[str, Spread], Triple]) -> tuple[Triple, ...]:
    """100 ppm/K with a bend."""
    return (
        triple("scale_temperature_1", Spread(unit=80e-6, wafer=50e-6, lot=40e-6)),
        triple("scale_temperature_2", Spread(unit=4e-7, wafer=2e-7, lot=2e-7)),
    )


def _matrix(draw: LotDraw, name: str, spread: Spread) -> Matrix:
    """Off-diagonal elements."""

    def at(row: int, column: int) -> float:
        return 0.0 if row == column else draw.normal(f"{name}_{'xyz'[row]}{'xyz'[column]}", 0.0, spread)

    return (
        (at(0, 0), at(0, 1), at(0, 2)),
        (at(1, 0), at(1, 1), at(1, 2)),
        (at(2, 0), at(2, 1), at(2, 2)),
    )


def _g_sensitivity(draw: LotDraw) -> Matrix:
    spread = Spread(unit=0.004 * DEG / factor_to_si("g"))
    x, y, z = (draw.triple(f"gyro_g_sensitivity_{axis}", 0.0, spread) for axis in "xyz")
    return (x, y, z)

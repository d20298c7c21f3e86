# pyright: strict
"""The true effects of a rate gyro triad, drawn by lot, wafer and unit.

The medians are the one unit that paper 4 gives: K = 0.050698 V/(°/s), Y0 = −0.001116 V. The spreads keep a
unit inside its class: linearity below 0.2 % of the full scale, rate accuracy 0.2 %; the paper's own
residuals are some 0.03 % of the full scale and its readings repeat to 1.5 mV. Temperature, supply and force
are those of gyros of this class; the paper holds them constant.
"""

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.couplings import GSensitivity, SupplySensitivity
from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.dynamics import Bandwidth
from dut_emulator.effects.nonlinearity import (
    EvenNonlinearity,
    RateHysteresis,
    ScaleFactorAsymmetry,
    ScaleFactorNonlinearity,
)
from dut_emulator.effects.parameters import Matrix, Triple
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.effects.thermal import ScaleFactorTemperature, WarmUp
from dut_emulator.lot import LotDraw, Spread
from dut_emulator.lot_defects import LotDefect, with_defects
from dut_emulator.twin import Twin
from protocol.units_of_measure import factor_to_si

PRODUCT_NAME = "rate_gyro_triad"
DEG_S = factor_to_si("deg/s")
DEG_S_PER_G = factor_to_si("deg/s/g")
DEG_PER_SQRT_S = factor_to_si("deg/s/sqrt(Hz)")

SENSITIVITY_V_PER_RAD_S = 0.050698 / DEG_S
"""K of paper 4: what the outputs are converted with; a unit's own scale factors are its effects."""
INTERCEPT_V = -0.001116
"""Y0 of paper 4."""
NOMINAL_SUPPLY_V = 15.0
OUTPUT_STAGE_V = 10.8
"""Where the output stage ends, above 10.14 V at the greatest rate of ±200 °/s."""
TURN_ON_RAD_S = 0.01 * DEG_S
"""Standard deviation of the part of the bias that each power-on draws; a unit without bias has none."""

HYSTERESIS_WIDTH_RAD_S = 2.0 * DEG_S
WARM_UP_TIME_S = 40.0
CORRELATION_TIME_S = 300.0

DEFECTS = (
    LotDefect("dead_axis", 0.01, "gyro.scale_factor_error", "gyro", "scale_factor_error", 0.0, -1.0),
    LotDefect("worn_bearing", 0.015, "gyro.rate_hysteresis", "gyro", "amplitude_si", 12.0),
    LotDefect("unequal_halves", 0.01, "gyro.scale_factor_asymmetry", "gyro", "asymmetry", 1.0, 5e-3),
    LotDefect("zero_not_set", 0.015, "gyro.bias", "gyro", "bias_si", 1.0, 1.0 * DEG_S),
)
"""What goes wrong with such gyros, and how often: stated by this project."""


def drawn_twin(seed: int, serial: str) -> Twin:
    """The unit of this serial number in the lot of this seed."""
    draw = LotDraw(seed, serial)
    effects = (_misalignment(draw), *_scale(draw), *_bias(draw), *_noise(draw), *_output(draw))
    return with_defects(Twin(PRODUCT_NAME, effects), draw, DEFECTS)


def _misalignment(draw: LotDraw) -> CatalogueEffect:
    return Misalignment("gyro", _off_diagonal(_matrix(draw, "misalignment", Spread(unit=1.5e-3, lot=5e-4))))


def _scale(draw: LotDraw) -> tuple[CatalogueEffect, ...]:
    """What belongs to the scale factor, and how it depends on the rate."""
    per_c = draw.triple("scale_temperature", 0.0, Spread(unit=2e-5, wafer=1e-5, lot=2e-5))
    x, y, z = draw.triple_around("hysteresis", 0.022 * DEG_S, Spread(unit=0.3, lot=0.15))
    lagging = (-x, -y, -z)  # friction keeps the output back: up strokes read less
    return (
        ScaleFactorError("gyro", draw.triple("scale", 0.0, Spread(unit=2e-3, wafer=1e-3, lot=1e-3))),
        ScaleFactorTemperature("gyro", (per_c,)),
        ScaleFactorAsymmetry("gyro", draw.triple("asymmetry", 0.0, Spread(unit=2e-4, lot=1e-4))),
        ScaleFactorNonlinearity("gyro", draw.triple("cubic", 0.0, Spread(unit=1.5e-5, lot=1e-5))),
        EvenNonlinearity("gyro", draw.triple("square", 0.0, Spread(unit=5e-4, lot=2e-4))),
        RateHysteresis("gyro", lagging, HYSTERESIS_WIDTH_RAD_S),
    )


def _bias(draw: LotDraw) -> tuple[CatalogueEffect, ...]:
    """What the output holds at rest, and what moves it."""
    intercept = INTERCEPT_V / SENSITIVITY_V_PER_RAD_S
    per_c = draw.triple("bias_temperature", 0.0, Spread(unit=1e-3 * DEG_S, lot=5e-4 * DEG_S))
    g_spread = Spread(unit=4e-3 * DEG_S_PER_G, lot=1e-3 * DEG_S_PER_G)
    per_volt = draw.triple("supply", 0.0, Spread(unit=2e-3 * DEG_S, lot=1e-3 * DEG_S))
    warm_up = draw.triple("warm_up", 0.03 * DEG_S, Spread(unit=0.01 * DEG_S, lot=0.01 * DEG_S))
    return (
        GSensitivity("gyro", _matrix(draw, "g_sensitivity", g_spread)),
        SupplySensitivity("gyro", per_volt, NOMINAL_SUPPLY_V),
        Bias("gyro", draw.triple("bias", intercept, Spread(unit=0.03 * DEG_S, lot=0.01 * DEG_S))),
        BiasTemperature("gyro", (per_c,)),
        WarmUp("gyro", warm_up, WARM_UP_TIME_S),
    )


def _noise(draw: LotDraw) -> tuple[CatalogueEffect, ...]:
    white = draw.triple_around("noise", 0.004 * DEG_PER_SQRT_S, Spread(unit=0.2, lot=0.1))
    slow = draw.triple_around("slow_noise", 0.007 * DEG_S, Spread(unit=0.3, lot=0.1))
    return (WhiteNoise("gyro", white), BiasInstability("gyro", slow, CORRELATION_TIME_S))


def _output(draw: LotDraw) -> tuple[CatalogueEffect, ...]:
    """Bandwidth of the sensors, end of the output stage."""
    bandwidth_hz = draw.around("bandwidth", 40.0, Spread(unit=0.05))
    end_v = draw.normal("output_stage", OUTPUT_STAGE_V, Spread(unit=0.03))
    return (
        Bandwidth("gyro", 1 / (2 * np.pi * bandwidth_hz)),
        Saturation("gyro", end_v / SENSITIVITY_V_PER_RAD_S),
    )


def _matrix(draw: LotDraw, name: str, spread: Spread) -> Matrix:
    x, y, z = (draw.triple(f"{name}_{axis}", 0.0, spread) for axis in "xyz")
    return x, y, z


def _off_diagonal(matrix: Matrix) -> Matrix:
    def cleared(row: int) -> Triple:
        x, y, z = (0.0 if row == column else matrix[row][column] for column in range(3))
        return x, y, z

    return cleared(0), cleared(1), cleared(2)

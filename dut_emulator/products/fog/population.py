# pyright: strict
"""The lot: each gyro's effects, drawn by lot seed and serial number.

Two types, A and B, as the two gyros of paper 3: 242.23 and 347.55 µs of pure lag. A serial number that
begins with 'B' is one of type B, any other of type A. All figures are those of a tactical gyro. Only body z
has a sensor: the scale factor errors of x and y are −1, and nothing of theirs leaves the unit.

Sources: P3 paper 3 · IEEE 952 for the terms · TL stated by this project inside the usual spans.
"""

import math

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Quantisation,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.dynamics import Bandwidth, FixedDelay
from dut_emulator.effects.nonlinearity import ScaleFactorAsymmetry
from dut_emulator.effects.parameters import ZERO, Triple
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.effects.thermal import ScaleFactorTemperature, TemperatureRate
from dut_emulator.lot import LotDraw, Spread
from dut_emulator.lot_defects import LotDefect, with_defects
from dut_emulator.twin import Twin
from protocol.fog import COUNTS_PER_DEG_S, NOISE_COUNTS_AT_2_KHZ, RANGE_DEG_S

PRODUCT_NAME = "fog"
PURE_LAG_S = {"A": 242.23e-6, "B": 347.55e-6}
"""P3, eqs (30), (36): at 2 kHz, here for 25 °C."""

DEG = math.pi / 180
DEG_H = DEG / 3600
COUNT_RAD_S = DEG / COUNTS_PER_DEG_S

BANDWIDTH_HZ = 3000.0
"""TL: −3 dB of the closed loop with its filter, above 1 kHz."""
NOISE_DENSITY_RAD_SQRT_S = NOISE_COUNTS_AT_2_KHZ * COUNT_RAD_S / math.sqrt(2000.0)
"""P3, figure 1: σ = 200 counts at 2 kHz; 0.0134 °/√h with this scale."""
CORRELATION_TIME_S = 300.0
BIAS_INSTABILITY_DEG_H = 0.2
NOISE_UNIT_SPREAD = 0.05
INSTABILITY_UNIT_SPREAD = 0.3

_Z = (2,)
DEFECTS = (
    LotDefect("light_loss", 0.015, "gyro.angle_random_walk", "gyro", "density_si_per_sqrt_hz", 4.0, axes=_Z),
    LotDefect(
        "coil_wound_unevenly", 0.01, "gyro.temperature_rate", "gyro", "coefficient_rad_per_c", 8.0, axes=_Z
    ),
    LotDefect("scale_not_set", 0.01, "gyro.scale_factor_error", "gyro", "scale_factor_error", 1.0, 0.01, _Z),
    LotDefect("slow_firmware", 0.01, "link.fixed_delay", "gyro", "delay_s", 1.0, 400e-6),
)
"""TL: what goes wrong with such gyros, and how often. A slow firmware is behind by most of a 2 kHz frame."""


def unit_type(serial: str) -> str:
    """'A' or 'B'."""
    return "B" if serial.upper().startswith("B") else "A"


def draw_twin(seed: int, serial: str) -> Twin:
    """The gyro of this serial number in the lot of this seed."""
    draw = LotDraw(seed, serial)
    kind = unit_type(serial)
    lag_s = draw.normal(f"pure_lag_{kind}", PURE_LAG_S[kind], Spread(unit=1.5e-6, lot=1e-6))
    bandwidth_hz = draw.around("bandwidth", BANDWIDTH_HZ, Spread(unit=0.05, lot=0.02))
    per_c_minute = DEG_H * 60  # °/h for each °C/min
    effects: tuple[CatalogueEffect, ...] = (
        Misalignment("gyro", (ZERO, ZERO, _input_axis(draw))),
        ScaleFactorError(
            "gyro", (-1.0, -1.0, draw.normal("scale_factor", 0.0, Spread(unit=150e-6, lot=50e-6)))
        ),
        Bias("gyro", _z(DEG_H * draw.normal("bias", 0.0, Spread(unit=3.0, lot=1.0)))),
        BiasTemperature(
            "gyro",
            (
                _z(DEG_H * draw.normal("bias_c1", 0.0, Spread(unit=0.04, lot=0.01))),
                _z(DEG_H * draw.normal("bias_c2", 0.0, Spread(unit=4e-4, lot=1e-4))),
            ),
        ),
        ScaleFactorTemperature("gyro", (_z(draw.normal("scale_c1", 20e-6, Spread(unit=6e-6, lot=3e-6))),)),
        TemperatureRate("gyro", _z(per_c_minute * draw.normal("shupe", 1.0, Spread(unit=0.4, lot=0.2)))),
        ScaleFactorAsymmetry("gyro", _z(draw.normal("asymmetry", 0.0, Spread(unit=8e-6, lot=3e-6)))),
        WhiteNoise(
            "gyro",
            _z(draw.around("angle_random_walk", NOISE_DENSITY_RAD_SQRT_S, Spread(unit=NOISE_UNIT_SPREAD))),
        ),
        BiasInstability(
            "gyro",
            _z(
                DEG_H
                * draw.around(
                    "bias_instability", BIAS_INSTABILITY_DEG_H, Spread(unit=INSTABILITY_UNIT_SPREAD)
                )
            ),
            CORRELATION_TIME_S,
        ),
        Bandwidth("gyro", 1.0 / (2 * math.pi * bandwidth_hz)),
        Saturation("gyro", RANGE_DEG_S * DEG),
        Quantisation("gyro", COUNT_RAD_S),
        FixedDelay("gyro", lag_s),
    )
    return with_defects(Twin(PRODUCT_NAME, effects), draw, DEFECTS)


def _input_axis(draw: LotDraw) -> Triple:
    """How the input axis leans towards body x and y."""
    towards_x, towards_y, _ = draw.triple("input_axis", 0.0, Spread(unit=3e-4, lot=1e-4))
    return (towards_x, towards_y, 0.0)


def _z(value: float) -> Triple:
    return (0.0, 0.0, value)

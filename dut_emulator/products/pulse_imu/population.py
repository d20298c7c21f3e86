# pyright: strict
"""A lot of pulse IMUs: the true effects of each unit, in the terms of paper 5.

    N_x = K1x (1 + Kax sgn A_x) (K0x + A_x + K2x A_x |A_x| + Kyx A_y + Kzx A_z)      eq (4), per unit of time
    W_x = E1x (D0x + ω_x + Eyx ω_y + Ezx ω_z + D1x A_x + D2x A_y + D3x A_z)

as effects in this order: the two quadratic terms, cross-axis sensitivity, bias, asymmetry, scale factor. The
signs are those of the whole sum, not of A alone: they differ where |A| is below a milli-g. The paper shows
its coefficients in normalised units; the sizes here are of the order of quartz-flexure accelerometers and
tuned-rotor gyros: Kax about 1e-4, K2 about 1e-5 / g, D about 5e-4 °/s/g.
"""

import dataclasses

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.couplings import CrossAxisSensitivity, GSensitivity
from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.nonlinearity import (
    OddQuadraticNonlinearity,
    QuadraticNonlinearity,
    ScaleFactorAsymmetry,
)
from dut_emulator.effects.parameters import Matrix, Triple
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise
from dut_emulator.effects.thermal import ScaleFactorTemperature
from dut_emulator.lot import LotDraw, Spread
from dut_emulator.lot_defects import LotDefect, with_defects
from dut_emulator.products.pulse_imu.scale import ACC_RANGE_G, GYRO_RANGE_DEG_S
from dut_emulator.seeds import child_seed
from dut_emulator.twin import Twin
from protocol.units_of_measure import factor_to_si

NAME = "pulse_imu"
G, DEG_S, DEG_H = factor_to_si("g"), factor_to_si("deg/s"), factor_to_si("deg/h")
CORRELATION_TIME_S = 300.0
TURN_ON_ACC_SI, TURN_ON_GYRO_SI = 20e-6 * G, 0.1 * DEG_H
"""Of the biases, from one power-on to the next (paper 5, 5.3.2: a drift from turn-on to turn-on)."""

DEFECTS = (
    LotDefect("dead_gyro", 0.01, "gyro.scale_factor_error", "gyro", "scale_factor_error", 0.0, -1.0),
    LotDefect("unequal_currents", 0.015, "acc.scale_factor_asymmetry", "acc", "asymmetry", 1.0, 1e-3),
    LotDefect("pendulum_rubs", 0.01, "acc.velocity_random_walk", "acc", "density_si_per_sqrt_hz", 10.0),
    LotDefect("rotor_out_of_balance", 0.015, "gyro.g_sensitivity", "gyro", "acc", 8.0),
)
"""What goes wrong with such units, and how often: stated by this project."""


def draw_twin(seed: int, serial: str) -> Twin:
    """The unit of this serial number in the lot of this seed."""
    draw = LotDraw(seed, serial)
    return with_defects(Twin(NAME, (*_acc_effects(draw), *_gyro_effects(draw))), draw, DEFECTS)


def with_turn_on(
    effects: tuple[CatalogueEffect, ...], seed: np.random.SeedSequence
) -> tuple[CatalogueEffect, ...]:
    """The effects of one power-on: each bias is moved by what differs from turn-on to turn-on."""
    moved: list[CatalogueEffect] = []
    for effect in effects:
        if isinstance(effect, Bias):
            acc = effect.sensor == "acc"
            own = child_seed(seed, 2, int(acc))
            steps = np.random.Generator(np.random.PCG64(own)).standard_normal(3)
            shift = steps * (TURN_ON_ACC_SI if acc else TURN_ON_GYRO_SI)
            x, y, z = (float(value) for value in np.asarray(effect.bias_si) + shift)
            effect = dataclasses.replace(effect, bias_si=(x, y, z))
        moved.append(effect)
    return tuple(moved)


def _acc_effects(draw: LotDraw) -> tuple[CatalogueEffect, ...]:
    def triple(name: str, mean: float, unit: float, lot: float = 0.0) -> Triple:
        return draw.triple(f"acc_{name}", mean, Spread(unit=unit, lot=lot))

    return (
        OddQuadraticNonlinearity("acc", triple("odd_square", 1e-5 / G, 3e-6 / G, 2e-6 / G)),
        QuadraticNonlinearity("acc", triple("square", 0.0, 1e-6 / G, 5e-7 / G)),
        CrossAxisSensitivity("acc", _off_diagonal(draw, "acc_cross", 2e-4)),
        BiasTemperature("acc", (triple("bias_temperature", 0.0, 1e-5 * G, 1e-5 * G),)),
        Bias("acc", triple("bias", 0.0, 8e-4 * G, 4e-4 * G)),
        ScaleFactorAsymmetry("acc", triple("asymmetry", 1e-4, 3e-5, 2e-5)),
        ScaleFactorTemperature("acc", (triple("scale_temperature", 2e-5, 5e-6, 5e-6),)),
        ScaleFactorError("acc", triple("scale", 0.0, 3e-4, 1e-4)),
        WhiteNoise("acc", draw.triple_around("acc_noise", 5e-6 * G, Spread(unit=0.2))),
        BiasInstability(
            "acc", draw.triple_around("acc_instability", 3e-6 * G, Spread(unit=0.2)), CORRELATION_TIME_S
        ),
        Saturation("acc", ACC_RANGE_G * G),
    )


def _gyro_effects(draw: LotDraw) -> tuple[CatalogueEffect, ...]:
    def triple(name: str, mean: float, unit: float, lot: float = 0.0) -> Triple:
        return draw.triple(f"gyro_{name}", mean, Spread(unit=unit, lot=lot))

    g_sensitivity = draw_matrix(draw, "gyro_g", 5e-4 * DEG_S / G, 1.5e-4 * DEG_S / G)
    return (
        Misalignment("gyro", _off_diagonal(draw, "gyro_misalignment", 2e-4)),
        GSensitivity("gyro", g_sensitivity),
        BiasTemperature("gyro", (triple("bias_temperature", 0.0, 0.02 * DEG_H),)),
        Bias("gyro", triple("bias", 0.0, 5e-3 * DEG_S, 3e-3 * DEG_S)),
        ScaleFactorTemperature("gyro", (triple("scale_temperature", 2e-5, 5e-6),)),
        ScaleFactorError("gyro", triple("scale", 0.0, 3e-4, 1e-4)),
        WhiteNoise(
            "gyro", draw.triple_around("gyro_noise", 0.003 * factor_to_si("deg/sqrt(h)"), Spread(unit=0.2))
        ),
        BiasInstability(
            "gyro", draw.triple_around("gyro_instability", 0.01 * DEG_H, Spread(unit=0.2)), CORRELATION_TIME_S
        ),
        Saturation("gyro", GYRO_RANGE_DEG_S * DEG_S),
    )


def draw_matrix(draw: LotDraw, name: str, diagonal: float, deviation: float) -> Matrix:
    """Rows of sensors: a mean on the diagonal, none beside it, each number with a part of its own."""
    x, y, z = (draw.triple(f"{name}_{row}", 0.0, Spread(unit=deviation)) for row in "xyz")
    return ((x[0] + diagonal, x[1], x[2]), (y[0], y[1] + diagonal, y[2]), (z[0], z[1], z[2] + diagonal))


def _off_diagonal(draw: LotDraw, name: str, deviation: float) -> Matrix:
    x, y, z = draw_matrix(draw, name, 0.0, deviation)
    return ((0.0, x[1], x[2]), (y[0], 0.0, y[2]), (z[0], z[1], 0.0))

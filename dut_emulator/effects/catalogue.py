# pyright: strict
"""Every effect there is, by its word. The conformance suite runs over this table."""

from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Quantisation,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.effect import Effect
from dut_emulator.effects.stochastic import BiasInstability, WhiteNoise

CATALOGUE: dict[str, type[Effect]] = {
    effect.word: effect
    for effect in (
        Misalignment,
        ScaleFactorError,
        Bias,
        BiasTemperature,
        WhiteNoise,
        BiasInstability,
        Saturation,
        Quantisation,
    )
}

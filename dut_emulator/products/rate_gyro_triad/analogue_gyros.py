# pyright: strict
"""Three gyros and their output stages from power-on to power-off: what acts on the unit → volts.

    V_i = K y_i        y the chain of effects on the inertial rate, rad/s; K of paper 4

The chain is the stand's effects, then the unit's. Each power-on draws its part of the bias anew. A sample is
the mean over the period before it as far as noise goes, and the moment's value as far as motion goes.
"""

import dataclasses

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.deterministic import Bias
from dut_emulator.effects.effect import EffectChain, FloatArray, Stimulus, name_of
from dut_emulator.products.product import chain_effects
from dut_emulator.products.rate_gyro_triad.population import SENSITIVITY_V_PER_RAD_S, TURN_ON_RAD_S
from dut_emulator.seeds import child_seed
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError

SELF_HEATING_C, SELF_HEATING_TIME_S = 3.0, 150.0
IMPOSSIBLE = ("link.frame_loss", "link.duplicate_frames", "link.counter_wrap")
"""Of a unit without a digital link."""

_GYRO, _TEMPERATURE, _TURN_ON = range(3)


class AnalogueGyros:
    """One power-on.

    Raises:
        TestloomError: the twin has an effect that a triad of analogue gyros cannot have.
    """

    def __init__(
        self,
        twin: Twin,
        stand_effects: tuple[CatalogueEffect, ...],
        seed: np.random.SeedSequence,
        power_on_s: float,
    ) -> None:
        refuse_impossible(twin)
        self._power_on_s = power_on_s
        effects = chain_effects(twin, stand_effects, "gyro")
        turn_on = np.random.Generator(np.random.SFC64(child_seed(seed, _TURN_ON)))
        self._gyro = EffectChain(_with_turn_on(effect, turn_on) for effect in effects)
        self._temperature = EffectChain(chain_effects(twin, stand_effects, "temperature"))
        self._gyro_memory = self._gyro.begin(child_seed(seed, _GYRO))
        self._temperature_memory = self._temperature.begin(child_seed(seed, _TEMPERATURE))

    def sample(
        self, times_s: FloatArray, period_s: float, acting: Stimulus, supply_v: float
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 3) V at the outputs and (n,) °C at the unit's probe, at these instants `period_s` apart."""
        since_s = np.maximum(times_s - self._power_on_s, 0.0)
        temperature_c = acting.temperature_c - SELF_HEATING_C * np.expm1(-since_s / SELF_HEATING_TIME_S)
        stimulus = dataclasses.replace(
            acting,
            time_s=times_s,
            sample_period_s=period_s,
            supply_v=np.full(len(times_s), supply_v),
            power_on_s=self._power_on_s,
        )
        probe_c = self._temperature.apply(
            np.repeat(temperature_c[:, np.newaxis], 3, axis=1), stimulus, self._temperature_memory
        )
        stimulus = dataclasses.replace(stimulus, temperature_c=temperature_c)
        rate_rad_s = self._gyro.apply(acting.true_input("gyro"), stimulus, self._gyro_memory)
        return SENSITIVITY_V_PER_RAD_S * rate_rad_s, probe_c[:, 0]


def refuse_impossible(twin: Twin) -> None:
    """Raises TestloomError for an effect of another sensor, or of a digital link."""
    for effect in twin.effects:
        if effect.sensor not in ("gyro", "temperature") or name_of(effect) in IMPOSSIBLE:
            raise TestloomError(
                f"A rate gyro triad cannot have '{name_of(effect)}' of {effect.sensor}: it has three gyros "
                "with analogue outputs.",
                where="twin of a rate_gyro_triad",
                fault=Fault.OPERATOR,
                remedy="leave this effect out of the twin.",
            )


def _with_turn_on(effect: CatalogueEffect, rng: np.random.Generator) -> CatalogueEffect:
    if not isinstance(effect, Bias):
        return effect
    part = TURN_ON_RAD_S * rng.standard_normal(3)
    x, y, z = (bias + float(drawn) for bias, drawn in zip(effect.bias_si, part, strict=True))
    return dataclasses.replace(effect, bias_si=(x, y, z))

"""Repeatability over power-ons of emulated gyros: 68 and 95 % intervals hold what the turn-ons differ by.

A scale factor does not change with a unit's power-on in the recorder, so each run gets a chain of effects
whose scale factors are drawn anew. Biases that the recorder draws at power-on are not held here.
"""

import itertools
import math

import numpy as np
import pytest

from calibration.algorithms.bias_figures import Repeatability, repeatability
from dut_emulator.effects.deterministic import ScaleFactorError
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.stochastic import WhiteNoise

UNITS, RUNS = 200, 6


def check_intervals(found: Repeatability, expected: np.ndarray) -> None:
    count = len(expected)
    for probability in (0.6827, 0.95):
        low, high = found.interval(probability).T
        covered = float(np.mean((low < expected) & (expected < high)))
        margin = 3.5 * math.sqrt(probability * (1.0 - probability) / count)
        assert abs(covered - probability) < margin, (probability, covered)
    # the mean of s^2 is the variance itself: a spread that is wrong by a tenth is seen
    ratio = float(np.mean((found.repeatability / expected) ** 2))
    assert abs(ratio - 1.0) < 3.5 * math.sqrt(2.0 / (RUNS - 1) / count)


@pytest.mark.slow
def test_turn_on_scale_factors_of_emulated_chains_are_covered() -> None:
    """200 triads, six power-ons each: dwells of 5 s at +-1, 2 and 3 rad/s; noise is a small part of it."""
    spread, density, period_s = 3e-5, 1e-4, 0.02
    rate = np.repeat([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0], 250)
    times_s = period_s * np.arange(len(rate), dtype=np.float64)
    stimulus = Stimulus(times_s, np.full(len(rate), 25.0), period_s)
    of_noise = density / math.sqrt(period_s * float(rate @ rate))
    rng = np.random.default_rng(7)
    noise = WhiteNoise("gyro", density_si_per_sqrt_hz=(density, density, density))
    values = np.empty((RUNS, 3 * UNITS))
    for unit, run in itertools.product(range(UNITS), range(RUNS)):
        x, y, z = (1e-3 + spread * float(one) for one in rng.standard_normal(3))
        chain = EffectChain((ScaleFactorError("gyro", (x, y, z)), noise))
        memory = chain.begin(np.random.SeedSequence([unit, run]))
        output = chain.apply(np.repeat(rate[:, None], 3, axis=1), stimulus, memory)
        values[run, 3 * unit : 3 * unit + 3] = rate @ output / float(rate @ rate) - 1.0
    found = repeatability(values, np.full_like(values, of_noise), "each_power_on")
    check_intervals(found, np.full(3 * UNITS, math.hypot(spread, of_noise)))
    beyond = float(np.sqrt(np.mean(found.beyond_noise**2)))
    assert beyond == pytest.approx(spread, rel=0.08)

"""One suite over the whole catalogue: whatever is in it passes all of this."""

import dataclasses
import functools
import itertools
from typing import Any

import numpy as np
import pytest

from dut_emulator.effects.catalogue import CATALOGUE, candidate, effect_named
from dut_emulator.effects.effect import EffectState, Stage, Stimulus, name_of
from dut_emulator.effects.parameters import check_ranges, scalars, with_values
from protocol.errors import TestloomError
from tests.dut_emulator.effect_examples import (
    DETERMINISTIC,
    EXAMPLES,
    STOCHASTIC,
    applied,
    at_neutral,
    motion,
    part,
)
from tests.dut_emulator.effect_oracles import ORACLES

CUTS = (
    (0, 1, 2, 50, 50, 133, 399, 400),
    (0, 200, 201, 400),
    (0, 0, 37, 38, 300, 400),
    (*range(0, 400, 7), 400),
)
WHOLE = motion()

# names that recordings and gap reports use
NAMES_IN_USE = """
gyro. bias_temperature scale_factor_temperature scale_factor_asymmetry scale_factor_nonlinearity
 even_nonlinearity g_sensitivity g2_sensitivity thermal_hysteresis rate_hysteresis temperature_rate warm_up
 misalignment_temperature bandwidth dead_band saturation angle_random_walk bias_instability
 rate_random_walk quantization supply_sensitivity magnetic_sensitivity
acc. bias_temperature scale_factor_temperature scale_factor_asymmetry quadratic_nonlinearity
 odd_quadratic_nonlinearity cubic_nonlinearity vibration_rectification cross_axis_sensitivity size_effect
 shock_bias_shift warm_up thermal_hysteresis velocity_random_walk bias_instability quantization
mag. white_noise hard_iron soft_iron scale_factor_temperature current_coupling mains_interference
gnss. latency clock_step antenna_lever_arm multipath
link. fixed_delay clock_drift timestamp_jitter frame_loss duplicate_frames counter_wrap aliasing
stand. wobble rate_ripple encoder_eccentricity remount_misalignment earth_rate lever_arm motor_field
 chamber_gradient chamber_lag level_drift non_orthogonality rate_scale_factor crank_geometry
"""


def true_input(effect: Any, stimulus: Stimulus = WHOLE) -> np.ndarray:
    values = stimulus.true_input(effect.sensor)
    values.flags.writeable = False
    return values


@functools.cache
def oracle_of(effect: Any) -> np.ndarray:
    return np.array(ORACLES[effect.word](effect, true_input(effect), WHOLE))


def assert_agrees_with_oracle(effect: Any, of: Any) -> None:
    """`effect` (perhaps a broken one) gives what the oracle gives for `of`."""
    samples = true_input(of)
    expected = oracle_of(of)
    contribution = np.abs(expected - samples).max()
    rounding = 1e-12 * np.abs(samples).max()
    np.testing.assert_allclose(
        applied(effect, samples, WHOLE), expected, rtol=0, atol=1e-7 * contribution + rounding
    )


def test_every_name_in_use_has_its_effect_and_example() -> None:
    wanted, prefix = [], ""
    for word in NAMES_IN_USE.split():
        if word.endswith("."):
            prefix = word
        else:
            wanted.append(prefix + word)
    assert len(wanted) == 66
    assert [name for name in wanted if name not in CATALOGUE] == []
    assert {effect.word for effect in EXAMPLES.values() if not effect.stochastic} == set(ORACLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_neutral_parameters_change_nothing(name: str) -> None:
    effect = EXAMPLES[name]
    neutral = effect_named(name_of(effect), effect.sensor)
    assert neutral.is_neutral
    assert not effect.is_neutral
    np.testing.assert_array_equal(applied(neutral, true_input(effect), WHOLE), true_input(effect))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_effect_leaves_its_input_and_says_what_it_is(name: str) -> None:
    effect = EXAMPLES[name]
    samples = np.array(true_input(effect))
    kept = samples.copy()
    samples.flags.writeable = False
    out = applied(effect, samples, WHOLE)
    np.testing.assert_array_equal(samples, kept)
    assert out.shape == samples.shape
    assert not np.array_equal(out, samples)
    check_ranges(effect, name)
    assert isinstance(effect.stage, Stage)
    assert effect.__doc__
    assert len(effect.__doc__) > 40
    assert with_values(effect, {s.name: s.value for s in scalars(effect)}) == effect
    with pytest.raises(dataclasses.FrozenInstanceError):
        effect.sensor = "gyro"  # type: ignore[misc]


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_seed_decides_and_nothing_else(name: str) -> None:
    effect = EXAMPLES[name]
    samples = true_input(effect)
    np.testing.assert_array_equal(applied(effect, samples, WHOLE, 5), applied(effect, samples, WHOLE, 5))
    same = np.array_equal(
        applied(effect, samples, WHOLE, 5), applied(effect, samples, WHOLE, 6), equal_nan=True
    )
    assert same != effect.stochastic


def assert_chunks_make_the_whole(effect: Any) -> None:
    samples = true_input(effect)
    expected = applied(effect, samples, WHOLE, 3)
    for edges in CUTS:
        rng, state = np.random.Generator(np.random.SFC64(3)), EffectState()
        pieces = [
            effect.apply(samples[a:b], part(WHOLE, a, b), rng, state) for a, b in itertools.pairwise(edges)
        ]
        np.testing.assert_array_equal(np.concatenate(pieces), expected)


@pytest.mark.parametrize("name", EXAMPLES)
def test_chunks_make_the_whole(name: str) -> None:
    assert_chunks_make_the_whole(EXAMPLES[name])


def test_the_longest_delay_keeps_enough_of_the_past() -> None:
    for delay_s in (1.993, 2.0):
        effect = effect_named("link.fixed_delay", "gyro", delay_s=delay_s)
        assert_chunks_make_the_whole(effect)
        assert_agrees_with_oracle(effect, effect)


@pytest.mark.parametrize("name", DETERMINISTIC)
def test_a_deterministic_effect_is_what_its_definition_says(name: str) -> None:
    assert_agrees_with_oracle(EXAMPLES[name], EXAMPLES[name])


class Negated:
    """An effect whose contribution has the wrong sign."""

    def __init__(self, effect: Any) -> None:
        self._effect = effect

    def apply(self, samples: Any, *rest: Any) -> Any:
        return 2 * samples - self._effect.apply(samples, *rest)


@pytest.mark.parametrize("name", DETERMINISTIC)
def test_one_wrong_sign_in_an_effect_is_noticed(name: str) -> None:
    effect = EXAMPLES[name]
    with pytest.raises(AssertionError):
        assert_agrees_with_oracle(Negated(effect), effect)
    for scalar in scalars(effect, free_only=True):
        if scalar.value and scalar.low < 0:
            with pytest.raises(AssertionError):
                assert_agrees_with_oracle(with_values(effect, {scalar.name: -scalar.value}), effect)


SMALL_STEPS = {"quantization": 1e-8}  # a larger one takes samples into the next code


@pytest.mark.parametrize("name", DETERMINISTIC)
def test_basis_is_the_derivative_of_apply(name: str) -> None:
    effect = EXAMPLES[name]
    samples = true_input(effect)
    columns = effect.basis(WHOLE)
    free = scalars(effect, free_only=True)
    assert list(columns) == [scalar.name for scalar in free]
    largest = max(abs(scalar.value) for scalar in free)
    for scalar in free:
        step = SMALL_STEPS.get(effect.word, 1e-5) * largest
        up, down = (
            applied(with_values(effect, {scalar.name: scalar.value + sign * step}), samples, WHOLE)
            for sign in (1, -1)
        )
        column = columns[scalar.name]
        tolerance = 1e-4 * np.abs(column).max() + 1e-14 * np.abs(samples).max() / step
        np.testing.assert_allclose((up - down) / (2 * step), column, rtol=0, atol=tolerance)


NOT_NEUTRAL_AT_0 = {"saturation", "quantization", "counter_wrap"}
NEUTRAL_AT_0 = [name for name in DETERMINISTIC if EXAMPLES[name].word not in NOT_NEUTRAL_AT_0]


@pytest.mark.parametrize("name", NEUTRAL_AT_0)
def test_basis_is_the_derivative_where_the_effect_begins(name: str) -> None:
    effect = at_neutral(EXAMPLES[name])
    samples = true_input(effect)
    assert effect.is_neutral
    step = 1e-5 * max(abs(scalar.value) for scalar in scalars(EXAMPLES[name], free_only=True))
    for scalar, column in effect.basis(WHOLE).items():
        change = applied(with_values(effect, {scalar: step}), samples, WHOLE) - samples
        tolerance = 1e-4 * np.abs(column).max() + 1e-14 * np.abs(samples).max() / step
        np.testing.assert_allclose(change / step, column, rtol=0, atol=tolerance)


# where samples lie apart, a width or a threshold is known no better than from one sample to the next
BETWEEN_SAMPLES = {"dead_band": 0.05, "shock_bias_shift": 0.05, "clock_step": 0.01}


@pytest.mark.parametrize("name", DETERMINISTIC)
def test_guess_recovers_the_parameters_from_its_own_data(name: str) -> None:
    effect = EXAMPLES[name]
    samples = true_input(effect)
    out = applied(effect, samples, WHOLE)
    start: Any = candidate(name_of(effect), effect.sensor)
    known = {
        s.field: getattr(effect, s.field) for s in scalars(effect) if s.held and s.name not in effect.scanned
    }
    if hasattr(effect, "axis"):
        known["axis"] = effect.axis  # type: ignore[attr-defined]
    found = dataclasses.replace(start, **known).guess(out - samples, WHOLE)
    loose = BETWEEN_SAMPLES.get(effect.word)
    left = np.sqrt(np.mean((applied(found, samples, WHOLE) - out) ** 2) / np.mean((out - samples) ** 2))
    assert left < (loose or 1e-4)
    largest = max(abs(s.value) for s in scalars(effect, free_only=True))
    for got, true in zip(scalars(found), scalars(effect), strict=True):
        scale = abs(true.value) if true.held else largest
        assert got.value == pytest.approx(true.value, abs=(loose or 1e-3) * scale), true.name


@pytest.mark.parametrize("name", STOCHASTIC)
def test_guess_finds_the_level_of_a_random_effect(name: str) -> None:
    effect = EXAMPLES[name]
    stimulus = motion(40_000)
    samples = true_input(effect, stimulus)
    out = applied(effect, samples, stimulus, 7)
    start: Any = candidate(name_of(effect), effect.sensor)
    if effect.word == "flicker_noise":
        start = dataclasses.replace(start, shortest_time_s=0.05, longest_time_s=51.2)
    found = start.guess(out - samples, stimulus)
    for got, true in zip(scalars(found), scalars(effect), strict=True):
        assert got.value == pytest.approx(true.value, rel=0.12), true.name
    assert effect.basis(stimulus) == {}


def test_what_is_missing_from_a_stimulus_is_named() -> None:
    bare = Stimulus(WHOLE.time_s, WHOLE.temperature_c, WHOLE.sample_period_s)
    with pytest.raises(TestloomError, match="specific_force_m_s2"):
        applied(EXAMPLES["gyro.g_sensitivity on gyro"], np.zeros((400, 3)), bare)


def test_an_unknown_effect_and_a_wrong_triad_are_refused() -> None:
    with pytest.raises(TestloomError, match=r"gyro\.wobbling"):
        effect_named("gyro.wobbling")
    with pytest.raises(TestloomError, match="gyro or acc or mag"):
        effect_named("stand.wobble")
    with pytest.raises(TestloomError, match="not on mag"):
        effect_named("stand.lever_arm", "mag")


def test_a_missing_sample_does_not_spoil_a_guess() -> None:
    effect = EXAMPLES["gyro.g_sensitivity on gyro"]
    residual = applied(effect, true_input(effect), WHOLE) - true_input(effect)
    residual[10:20] = np.nan
    found = candidate("gyro.g_sensitivity").guess(residual, WHOLE)
    for got, true in zip(scalars(found), scalars(effect), strict=True):
        assert got.value == pytest.approx(true.value, abs=1e-9)

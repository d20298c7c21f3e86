"""One suite over the whole catalogue, hand oracles for each deterministic effect, statistics for noise."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from dut_emulator.effects.deterministic import (
    Bias,
    BiasTemperature,
    Misalignment,
    Quantisation,
    Saturation,
    ScaleFactorError,
)
from dut_emulator.effects.effect import Effect, EffectChain, EffectState, Stage, Stimulus, name_of
from dut_emulator.effects.stochastic import ALLAN_MAXIMUM_OF_GAUSS_MARKOV, BiasInstability, WhiteNoise
from protocol.errors import TestloomError

PERIOD_S = 0.005
EXAMPLES: dict[str, Effect] = {
    effect.word: effect
    for effect in (
        Misalignment("gyro", ((0.0, 0.01, -0.02), (0.003, 0.0, 0.004), (-0.005, 0.006, 0.0))),
        ScaleFactorError("gyro", (0.01, -0.02, 0.03)),
        Bias("gyro", (0.1, -0.2, 0.3)),
        BiasTemperature("gyro", ((1e-3, -2e-3, 0.0), (1e-5, 0.0, -2e-5))),
        WhiteNoise("gyro", (1e-3, 2e-3, 3e-3)),
        BiasInstability("gyro", (1e-3, 2e-3, 3e-3), 2.0),
        Saturation("gyro", 1.5),
        Quantisation("gyro", 0.01),
    )
}
WORDS = sorted(EXAMPLES)


def stimulus(count: int, begin: int = 0) -> Stimulus:
    """Uniform samples and a temperature ramp from 0 to 60 °C over the first thousand."""
    instants = (begin + np.arange(1, count + 1)) * PERIOD_S
    return Stimulus(instants, 0.06 * (begin + np.arange(count, dtype=np.float64)), PERIOD_S)


def part(whole: Stimulus, start: int, stop: int) -> Stimulus:
    """A chunk of it."""
    return Stimulus(whole.time_s[start:stop], whole.temperature_c[start:stop], PERIOD_S)


def generator(seed: int = 1) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def samples(count: int) -> np.ndarray:
    return generator(99).normal(size=(count, 3))


def apply(effect: Effect, values: np.ndarray, seed: int = 1) -> np.ndarray:
    return effect.apply(values, stimulus(len(values)), generator(seed), EffectState())


@pytest.mark.parametrize("word", WORDS)
def test_neutral_parameters_change_nothing(word: str) -> None:
    neutral = type(EXAMPLES[word])(sensor="acc")  # type: ignore[call-arg]
    assert neutral.is_neutral
    assert not EXAMPLES[word].is_neutral
    values = samples(50)
    np.testing.assert_array_equal(apply(neutral, values), values)


@pytest.mark.parametrize("word", WORDS)
def test_input_is_not_changed_and_output_is_another(word: str) -> None:
    values = samples(200)
    kept = values.copy()
    values.flags.writeable = False
    out = apply(EXAMPLES[word], values)
    np.testing.assert_array_equal(values, kept)
    assert not np.array_equal(out, kept)
    assert out.shape == kept.shape


@pytest.mark.parametrize("word", WORDS)
def test_seed_decides_and_nothing_else(word: str) -> None:
    values = samples(100)
    effect = EXAMPLES[word]
    np.testing.assert_array_equal(apply(effect, values, 5), apply(effect, values, 5))
    stochastic = isinstance(effect, WhiteNoise | BiasInstability)
    assert stochastic != np.array_equal(apply(effect, values, 5), apply(effect, values, 6))


@pytest.mark.parametrize("word", WORDS)
@given(cuts=st.lists(st.integers(0, 300), max_size=6))
def test_chunks_make_the_whole(word: str, cuts: list[int]) -> None:
    effect, values, whole = EXAMPLES[word], samples(300), stimulus(300)
    rng, state = generator(3), EffectState()
    edges = [0, *sorted(cuts), 300]
    pieces = [effect.apply(values[a:b], part(whole, a, b), rng, state) for a, b in itertools.pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate(pieces), apply(effect, values, 3))


@given(cuts=st.lists(st.integers(0, 300), max_size=6))
def test_a_chain_in_chunks_is_the_chain(cuts: list[int]) -> None:
    chain, values, whole = EffectChain(EXAMPLES.values()), samples(300), stimulus(300)
    seed = np.random.SeedSequence(4)
    memory = chain.begin(seed)
    edges = [0, *sorted(cuts), 300]
    pieces = [chain.apply(values[a:b], part(whole, a, b), memory) for a, b in itertools.pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate(pieces), chain.apply(values, whole, chain.begin(seed)))


def test_one_effect_less_leaves_the_others_noise() -> None:
    seed, zeros, whole = np.random.SeedSequence(8), np.zeros((100, 3)), stimulus(100)
    white, slow = EXAMPLES["white_noise"], EXAMPLES["bias_instability"]
    both, alone = EffectChain([white, slow]), EffectChain([slow])
    difference = both.apply(zeros, whole, both.begin(seed)) - alone.apply(zeros, whole, alone.begin(seed))
    only_white = EffectChain([white])
    np.testing.assert_allclose(difference, only_white.apply(zeros, whole, only_white.begin(seed)), atol=1e-15)


def test_a_chain_goes_by_stages_and_is_of_one_sensor() -> None:
    chain = EffectChain([EXAMPLES["quantization"], EXAMPLES["bias"], EXAMPLES["misalignment"]])
    assert [effect.stage for effect in chain.effects] == [Stage.MOUNTING, Stage.TRANSDUCER, Stage.QUANTISER]
    replaced = chain.with_effect(Bias("gyro", (9.0, 9.0, 9.0)))
    assert len(replaced.effects) == 3
    assert len(chain.with_effect(Saturation("gyro", 1.0)).effects) == 4
    for wrong in ([Bias("gyro"), Bias("acc")], [Bias("gyro"), Bias("gyro", (1.0, 0.0, 0.0))]):
        with pytest.raises(TestloomError):
            EffectChain(wrong)


def test_names_are_the_field_terms() -> None:
    assert name_of(WhiteNoise("gyro")) == "gyro.angle_random_walk"
    assert name_of(WhiteNoise("acc")) == "acc.velocity_random_walk"
    assert name_of(WhiteNoise("mag")) == "mag.white_noise"
    assert name_of(BiasInstability("acc")) == "acc.bias_instability"


# Each oracle is a loop over one sample, written from the definition and nothing else.
def _turn(u: np.ndarray, _temperature_c: float) -> list[float]:
    return [
        u[0] + 0.01 * u[1] - 0.02 * u[2],
        0.003 * u[0] + u[1] + 0.004 * u[2],
        -0.005 * u[0] + 0.006 * u[1] + u[2],
    ]


def _with_temperature(u: np.ndarray, temperature_c: float) -> list[float]:
    d = temperature_c - 25.0
    return [u[0] + 1e-3 * d + 1e-5 * d * d, u[1] - 2e-3 * d, u[2] - 2e-5 * d * d]


ORACLES: dict[str, Callable[[np.ndarray, float], list[float]]] = {
    "misalignment": _turn,
    "scale_factor_error": lambda u, _: [1.01 * u[0], 0.98 * u[1], 1.03 * u[2]],
    "bias": lambda u, _: [u[0] + 0.1, u[1] - 0.2, u[2] + 0.3],
    "bias_temperature": _with_temperature,
    "saturation": lambda u, _: [min(max(v, -1.5), 1.5) for v in u],
    "quantization": lambda u, _: [round(v * 100) / 100 for v in u],
}


@pytest.mark.parametrize("word", sorted(ORACLES))
def test_deterministic_effects_agree_with_their_definition(word: str) -> None:
    values, whole = 2 * samples(400), stimulus(400)
    expected = [ORACLES[word](u, float(t)) for u, t in zip(values, whole.temperature_c, strict=True)]
    np.testing.assert_allclose(apply(EXAMPLES[word], values), expected, atol=1e-12)


def test_bias_temperature_is_held_outside_its_validity() -> None:
    effect = BiasTemperature("acc", ((1.0, 1.0, 1.0),))
    hot = Stimulus(np.array([1.0, 2.0]), np.array([85.0, 200.0]), 1.0)
    out = effect.apply(np.zeros((2, 3)), hot, generator(), EffectState())
    np.testing.assert_array_equal(out, np.full((2, 3), 60.0))


def test_white_noise_has_its_density_and_no_memory() -> None:
    count = 200_000
    noise = apply(EXAMPLES["white_noise"], np.zeros((count, 3)), 11)
    for axis, density in enumerate((1e-3, 2e-3, 3e-3)):
        ratio = np.var(noise[:, axis]) * PERIOD_S / density**2 * count
        assert stats.chi2.ppf(1e-4, count) < ratio < stats.chi2.ppf(1 - 1e-4, count)
        lag_one = np.corrcoef(noise[1:, axis], noise[:-1, axis])[0, 1]
        assert abs(lag_one) < 4 / math.sqrt(count)
    assert abs(np.corrcoef(noise[:, 0], noise[:, 1])[0, 1]) < 4 / math.sqrt(count)


def allan_deviation(values: np.ndarray, span: int) -> float:
    """Non-overlapping Allan deviation by its definition."""
    means = values[: len(values) // span * span].reshape(-1, span).mean(axis=1)
    return math.sqrt(float(np.mean(np.diff(means) ** 2)) / 2)


def test_white_noise_walks_with_slope_minus_one_half() -> None:
    noise = apply(WhiteNoise("gyro", (1e-3, 1e-3, 1e-3)), np.zeros((2**17, 3)), 12)[:, 0]
    for span in (1, 16, 256):
        pairs = len(noise) // span
        expected = 1e-3 / math.sqrt(span * PERIOD_S)
        assert allan_deviation(noise, span) == pytest.approx(expected, rel=4 / math.sqrt(pairs))


def test_bias_instability_is_stationary_from_the_first_sample() -> None:
    effect = BiasInstability("gyro", (1.0, 1.0, 1.0), 2.0)
    runs = 3000
    first, late = np.empty((runs, 3)), np.empty((runs, 3))
    whole, zeros = stimulus(400), np.zeros((400, 3))
    rng = generator(13)
    for run in range(runs):
        process = effect.apply(zeros, whole, rng, EffectState())
        first[run], late[run] = process[0], process[-1]
    degrees = 3 * runs
    for ensemble in (first, late):
        total = float(np.sum(ensemble**2))
        assert stats.chi2.ppf(1e-4, degrees) < total < stats.chi2.ppf(1 - 1e-4, degrees)
    # 399 periods of 5 ms later, T = 2 s
    expected = math.exp(-399 * PERIOD_S / 2.0)
    assert float(np.mean(first * late)) == pytest.approx(expected, abs=4 / math.sqrt(degrees))


def test_bias_instability_has_its_allan_maximum_where_theory_says() -> None:
    time_s, count = 0.5, 2**20
    process = BiasInstability("gyro", (1.0, 1.0, 1.0), time_s).apply(
        np.zeros((count, 3)), stimulus(count), generator(14), EffectState()
    )
    ratios = []
    for span in (10, round(1.89 * time_s / PERIOD_S), 2000):
        tau = span * PERIOD_S
        x = tau / time_s
        # IEEE 952, eq. (C.18) for variance 1
        theory = math.sqrt(2 / x * (1 - (3 - 4 * math.exp(-x) + math.exp(-2 * x)) / (2 * x)))
        # an independent value about every max(tau, T), on three axes
        measured = np.mean([allan_deviation(process[:, axis], span) for axis in range(3)])
        assert measured == pytest.approx(theory, rel=4 / math.sqrt(3 * count * min(1.0, x) / span))
        ratios.append(theory)
    assert max(ratios) == ratios[1] == pytest.approx(ALLAN_MAXIMUM_OF_GAUSS_MARKOV, abs=1e-3)


def test_bias_instability_moves_on_while_nothing_is_sampled() -> None:
    effect = BiasInstability("gyro", (1.0, 1.0, 1.0), 2.0)
    before, after = [], []
    rng = generator(15)
    for _ in range(3000):
        state = EffectState()
        before.append(effect.apply(np.zeros((1, 3)), stimulus(1), rng, state)[0])
        after.append(effect.apply(np.zeros((1, 3)), stimulus(1, begin=200), rng, state)[0])
    products = np.array(before) * np.array(after)
    assert float(products.mean()) == pytest.approx(math.exp(-1.0 / 2.0), abs=4 / math.sqrt(9000))
    assert float(np.mean(np.square(after))) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 9000))

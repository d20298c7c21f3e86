"""Random effects against their Allan, PSD and variance theory; stand effects against exact geometry."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.catalogue_effect import LinearEffect
from dut_emulator.effects.effect import SensorName, Stimulus
from dut_emulator.effects.parameters import scalars
from dut_emulator.effects.slow_noise import ALLAN_FLOOR_OF_FLICKER, FlickerNoise, RateRandomWalk
from dut_emulator.gimbal_geometry import body_rate_rad_s, dcm_body_from_lab
from tests.dut_emulator.effect_examples import DETERMINISTIC, EXAMPLES, PERIOD_S, applied, at_neutral, motion

ONE = (1.0, 1.0, 1.0)
FLICKER = FlickerNoise("gyro", ONE, 0.02, 327.68)
LONG = 2**18


def at_rest(count: int) -> Stimulus:
    return Stimulus(np.arange(1, count + 1) * PERIOD_S, np.full(count, 25.0), PERIOD_S)


def noise(effect: Any, count: int, seed: int) -> np.ndarray:
    return applied(effect, np.zeros((count, 3)), at_rest(count), seed)


def allan_deviation(values: np.ndarray, span: int) -> float:
    """Non-overlapping, by its definition, over all axes."""
    means = values[: len(values) // span * span].reshape(-1, span, 3).mean(axis=1)
    return math.sqrt(float(np.mean(np.diff(means, axis=0) ** 2)) / 2)


@pytest.fixture(scope="module")
def flicker() -> np.ndarray:
    return noise(FLICKER, LONG, 21)


def test_flicker_noise_is_flat_at_the_stated_value(flicker: np.ndarray) -> None:
    assert math.sqrt(2 * math.log(2) / math.pi) == pytest.approx(ALLAN_FLOOR_OF_FLICKER, abs=1e-4)
    spans = np.geomspace(1.0, 20.0, 30)
    theory = FLICKER.allan_deviation(spans, PERIOD_S)[:, 0]
    np.testing.assert_allclose(theory, ALLAN_FLOOR_OF_FLICKER, rtol=0.01)
    for span in (100, 300, 900):
        allowed = 0.01 + 4 / math.sqrt(3 * LONG / span)
        assert allan_deviation(flicker, span) == pytest.approx(ALLAN_FLOOR_OF_FLICKER, rel=allowed)


def test_flicker_noise_has_a_spectrum_of_one_over_f(flicker: np.ndarray) -> None:
    length = 2**14
    frequencies, one_sided = signal.welch(flicker, fs=1 / PERIOD_S, nperseg=length, axis=0, detrend=False)
    for low, high in ((0.03, 0.06), (0.1, 0.2), (0.3, 0.6)):
        band = (frequencies >= low) & (frequencies < high)
        level = float(np.mean(one_sided[band] * frequencies[band, np.newaxis]))
        independent = 3 * (LONG / length) * band.sum()  # axes, segments, lines of a Hann window: at least
        # two-sided B² / (2πf) is one-sided B² / (πf)
        assert level == pytest.approx(1 / math.pi, rel=0.02 + 4 / math.sqrt(independent / 1.5))


def test_flicker_noise_begins_in_its_stationary_state() -> None:
    effect = FlickerNoise("gyro", ONE, 0.1, 25.6)
    rng_runs = [noise(effect, 30, seed)[[0, -1]] for seed in range(700)]
    first, last = np.array(rng_runs).transpose(1, 0, 2)
    variance = 5 * math.log(4) / math.pi  # of five terms
    for ensemble in (first, last):
        total = float(np.sum(ensemble**2)) / variance
        assert stats.chi2.ppf(1e-4, 2100) < total < stats.chi2.ppf(1 - 1e-4, 2100)


def test_rate_random_walk_grows_as_it_should() -> None:
    effect, count = RateRandomWalk("gyro", ONE), 2**18
    values = noise(effect, count, 23)
    assert not values[0].any()
    steps = np.diff(values, axis=0)
    total = float(np.sum(steps**2)) / PERIOD_S
    assert stats.chi2.ppf(1e-4, steps.size) < total < stats.chi2.ppf(1 - 1e-4, steps.size)
    for span in (1, 4, 64, 1024):
        theory = effect.allan_deviation(np.array([span * PERIOD_S]), PERIOD_S)[0, 0]
        assert allan_deviation(values, span) == pytest.approx(theory, rel=4 / math.sqrt(3 * count / span))
    assert effect.allan_deviation(np.array([3e4]), PERIOD_S)[0, 0] == pytest.approx(100.0)


NOT_SCANNED = [
    name for name in DETERMINISTIC if isinstance(EXAMPLES[name], LinearEffect) and not EXAMPLES[name].scanned
]


def test_a_guess_from_noisy_data_is_as_good_as_the_noise_allows() -> None:
    errors = []
    for number, name in enumerate(NOT_SCANNED):
        effect: Any = EXAMPLES[name]
        whole = motion()
        samples = whole.true_input(effect.sensor)
        made = applied(effect, samples, whole) - samples
        sigma = 0.01 * float(np.abs(made).max())
        rng = np.random.Generator(np.random.SFC64(number))
        found = at_neutral(effect).guess(made + sigma * rng.standard_normal(made.shape), whole)
        design = np.stack([column.ravel() for column in effect.basis(whole).values()], axis=1)
        bound = sigma * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))  # Cramér–Rao
        both = zip(scalars(found, free_only=True), scalars(effect, free_only=True), bound, strict=True)
        errors += [
            (got.value - true.value) / limit for got, true, limit in both if true.low < true.value < true.high
        ]
    assert len(errors) > 150
    assert np.abs(errors).max() < 4.5
    total = float(np.sum(np.square(errors)))
    assert stats.chi2.ppf(1e-4, len(errors)) < total < stats.chi2.ppf(1 - 1e-4, len(errors))


def test_jitter_shows_as_much_as_the_input_moves() -> None:
    effect: Any = EXAMPLES["link.timestamp_jitter on gyro"]
    whole = motion(20_000)
    inputs = whole.true_input("gyro")
    made = applied(effect, inputs, whole, 24) - inputs
    expected = effect.variance(whole)
    standard = made[expected > 0] / np.sqrt(expected[expected > 0])
    # one jitter for the three axes: a third of the values is independent
    assert np.mean(standard**2) == pytest.approx(1.0, abs=4 * math.sqrt(2 / len(whole.time_s)))
    slope = np.gradient(inputs, PERIOD_S, axis=0)
    np.testing.assert_allclose(np.sqrt(expected[1:]), 1e-3 * np.abs(slope[1:]), atol=1e-3)


@pytest.mark.parametrize("name", ["frame_loss", "duplicate_frames"])
def test_frames_are_spoilt_at_the_stated_rate(name: str) -> None:
    whole = motion(20_000)
    inputs = whole.true_input("gyro")
    out = applied(effect_named(f"link.{name}", "gyro", probability=0.1), inputs, whole, 25)
    if name == "frame_loss":
        spoilt = np.isnan(out).any(axis=1)
        np.testing.assert_array_equal(np.isnan(out).all(axis=1), spoilt)
    else:
        spoilt = np.concatenate([[False], (out[1:] == out[:-1]).all(axis=1)])
    np.testing.assert_array_equal(out[~spoilt], inputs[~spoilt])
    low, high = stats.binom.ppf([1e-4, 1 - 1e-4], len(out), 0.1)
    assert low <= spoilt.sum() <= high
    assert abs(np.corrcoef(spoilt[1:], spoilt[:-1])[0, 1]) < 4 / math.sqrt(len(out))


def table_motion(count: int = 4000) -> Stimulus:
    """A table that turns and nods, densely sampled; what an exact stand would give to the unit."""
    t = np.arange(count) * 1e-3
    angles = np.stack([0.8 * t, 0.5 * np.sin(1.3 * t) + 0.1, 1.9 * t + 0.2 * np.cos(t)], axis=1)
    rates = np.stack([0.8 + 0 * t, 0.65 * np.cos(1.3 * t), 1.9 - 0.2 * np.sin(t)], axis=1)
    gravity = dcm_body_from_lab(angles) @ np.array([0.0, 0.0, 9.8])
    return Stimulus(
        t,
        np.full(count, 25.0),
        1e-3,
        rate_rad_s=body_rate_rad_s(angles, rates),
        specific_force_m_s2=gravity,
        angles_rad=angles,
    )


def rate_of(attitudes: np.ndarray, period_s: float) -> np.ndarray:
    """Body rate from body-from-laboratory matrices, central difference of Ċ = −[ω×] C; ends left out."""
    derivative = (attitudes[2:] - attitudes[:-2]) / (2 * period_s)
    skew = -derivative @ attitudes[1:-1].transpose(0, 2, 1)
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def rotation_x(angle: Any) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    one, nil = np.ones_like(c), np.zeros_like(c)
    return np.moveaxis(np.array([[one, nil, nil], [nil, c, s], [nil, -s, c]]), -1, 0)


def rotation_y(angle: Any) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    one, nil = np.ones_like(c), np.zeros_like(c)
    return np.moveaxis(np.array([[c, nil, -s], [nil, one, nil], [s, nil, c]]), -1, 0)


def rotation_z(angle: Any) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    one, nil = np.ones_like(c), np.zeros_like(c)
    return np.moveaxis(np.array([[c, s, nil], [-s, c, nil], [nil, nil, one]]), -1, 0)


def true_attitudes(effect: Any, stimulus: Stimulus) -> np.ndarray:
    """Body from laboratory of a stand that has the error in fact, with whole rotation matrices."""
    outer, middle, inner = stimulus.angles_rad.T  # type: ignore[union-attr]
    some = np.ones_like(outer)
    if effect.word == "encoder_eccentricity":  # read = true + error(true): solved by iteration
        true = middle.copy()
        for _ in range(20):
            true = middle - effect.cosine_rad * np.cos(true) - effect.sine_rad * np.sin(true)
        return rotation_x(inner) @ rotation_y(true) @ rotation_z(outer)
    if effect.word == "non_orthogonality":
        return (
            rotation_x(inner)
            @ rotation_z(effect.middle_inner_rad * some)
            @ rotation_y(middle)
            @ rotation_x(effect.outer_middle_rad * some)
            @ rotation_z(outer)
        )
    assert effect.word == "wobble"
    at = effect.harmonic * middle[:, np.newaxis]
    small = np.asarray(effect.cosine_rad) * np.cos(at) + np.asarray(effect.sine_rad) * np.sin(at)
    turn = rotation_x(small[:, 0]) @ rotation_y(small[:, 1]) @ rotation_z(small[:, 2])
    return turn @ dcm_body_from_lab(stimulus.angles_rad)  # type: ignore[arg-type]


SENSORS: tuple[SensorName, ...] = ("gyro", "acc")


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("word", ["wobble", "encoder_eccentricity", "non_orthogonality"])
def test_a_stand_effect_is_what_an_imperfect_stand_does(word: str, sensor: SensorName) -> None:
    effect: Any = EXAMPLES[f"stand.{word} on {sensor}"]
    small = {s.field: 0.1 for s in scalars(effect, free_only=True)}
    effect = dataclasses.replace(
        effect, **{field: _times(getattr(effect, field), share) for field, share in small.items()}
    )
    stimulus = table_motion()
    attitudes = true_attitudes(effect, stimulus)
    said = stimulus.true_input(sensor)
    out = applied(effect, said, stimulus)
    exact = (
        rate_of(attitudes, stimulus.sample_period_s)
        if sensor == "gyro"
        else (attitudes @ np.array([0.0, 0.0, 9.8]))[1:-1]
    )
    size = np.abs(exact - said[1:-1]).max()
    # what is left is of second order in the angles, and of the backward difference
    assert size > 1e-4
    assert np.abs(out[1:-1] - exact).max() < 0.02 * size


def _times(value: Any, factor: float) -> Any:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor


def test_a_slider_crank_gives_paper_5_the_half_cycles_that_it_warns_of() -> None:
    count, ratio, speed = 20_000, 0.2, 8.0
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    period = float(angle[1]) / speed
    angles = np.stack([0 * angle, 0 * angle, angle], axis=1)
    ideal = np.stack([-0.15 * speed**2 * np.cos(angle), 0 * angle, 0 * angle], axis=1)
    stimulus = Stimulus(
        np.arange(count) * period, 0 * angle, period, specific_force_m_s2=ideal, angles_rad=angles
    )
    crank = effect_named("stand.crank_geometry", "acc", ratio=ratio, radius_m=0.15)
    made = applied(crank, ideal, stimulus)[1:, 0]
    # exact slider-crank: x = r cos θ + b √(1 − λ² sin² θ), differentiated twice numerically
    place = 0.15 * np.cos(angle) + 0.75 * np.sqrt(1 - ratio**2 * np.sin(angle) ** 2)
    exact = (np.roll(place, -1) - 2 * place + np.roll(place, 1)) / period**2
    assert np.abs(made - exact[1:]).max() < 0.025 * ratio * 0.15 * speed**2
    positive, negative = made[made > 0], made[made < 0]
    assert positive.sum() == pytest.approx(-negative.sum(), rel=2e-3)
    assert np.sum(positive**2) / np.sum(negative**2) == pytest.approx(0.72, abs=0.01)

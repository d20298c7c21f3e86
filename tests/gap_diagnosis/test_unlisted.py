"""Causes that the catalogue does not list, made by hand: they are said to be none, and no noise either."""

import numpy as np
import pytest

from gap_diagnosis.candidates import trials_for
from gap_diagnosis.diagnosis import diagnose_observations
from gap_diagnosis.fitting import fit_set
from gap_diagnosis.jumps import CLEARLY_P, clearest_step
from gap_diagnosis.noise_model import SlowShape, knots_for
from gap_diagnosis.prepared import prepare
from gap_diagnosis.search import search
from tests.gap_diagnosis.synthetic_observations import (
    DEG,
    SLOW,
    TAU_S,
    WHITE,
    gauss_markov,
    generator,
    motion,
    observed,
)

MOTION = motion(300)
WARMER = (MOTION.temperature_c - 25.0) / 20.0


def on_x(column):
    added = np.zeros((len(column), 3))
    added[:, 0] = column
    return added


def report(added, *, without=frozenset(), seed=31):
    observations = [observed(generator(seed + run), MOTION, added, run=str(run)) for run in range(2)]
    return diagnose_observations(observations, frozenset(without), 40).document


SCALE_OVER_TEMPERATURE = on_x(0.002 * DEG * WARMER * MOTION.rate_rad_s[:, 0] * 3.0)
SETTLING = on_x(0.05 * DEG * np.exp(-MOTION.time_s / 40.0))


def test_what_the_catalogue_has_is_named_beside_anything_unlisted():
    found = report(SCALE_OVER_TEMPERATURE)
    assert found["sets"][0]["effects"] == ["gyro.scale_factor_temperature"]
    assert found["verdict"] == "attributed"


@pytest.mark.parametrize(
    ("added", "withheld", "follows"),
    [
        (
            SCALE_OVER_TEMPERATURE,
            {"gyro.scale_factor_temperature", "gyro.misalignment_temperature"},
            "gyro_x follows temperature times rate",
        ),
        (SETTLING, {"gyro.warm_up"}, "gyro_x follows time_since_power_on"),
    ],
)
def test_without_its_effect_a_gap_is_neither_another_effect_nor_noise(added, withheld, follows):
    found = report(added, without=withheld)
    assert found["verdict"] == "unattributed"
    assert found["unattributed"]["description"].startswith(follows)
    assert sum(one["probability"] for one in found["sets"]) < 0.1


QUICK_S = 30.0


def test_a_very_clear_effect_is_no_white_noise_nor_a_second_effect():
    """It changes from row to row by more than the noise, and no regressor is exact."""
    column = MOTION.specific_force_m_s2[:, 1] / 9.8
    found = report(on_x(3.0 * DEG * column * (1.0 + 0.004 * WARMER)))
    assert found["verdict"] == "attributed"
    assert found["sets"][0]["effects"] == ["gyro.g_sensitivity"]


def test_noise_that_is_the_only_cause_leaves_nothing():
    """The levels of all channels are claimed then, and none is left to be tested: that is no p of nought."""
    for seed in (163, 177):
        observations = [observed(generator(seed), MOTION, slow=25 * SLOW)]
        assert diagnose_observations(observations, frozenset(), 60).document["unattributed"]["p"] > 1e-3


def knots_of(seconds):
    shape = SlowShape((1.0,), (QUICK_S,), SLOW, 0.3)
    time_s = np.arange(seconds, dtype=float)
    return time_s, knots_for(time_s, (shape,))


def test_normal_noise_does_not_jump_whatever_its_level_and_time():
    """Also where the level is three quarters of what it should be, and the noise is quicker than believed."""
    time_s, knots = knots_of(400)
    rng = generator(5)
    chances = []
    for number in range(120):
        level, tau_s = (20 * SLOW, QUICK_S) if number % 2 else (27 * SLOW, 0.4 * QUICK_S)
        noise = gauss_markov(rng, len(time_s), level, tau_s) + WHITE * rng.standard_normal(len(time_s))
        chances.append(clearest_step(knots, 0, 20 * SLOW, WHITE, noise, np.ones((len(noise), 1)))[1])
    assert np.count_nonzero(np.array(chances) < CLEARLY_P) <= 1


def test_a_step_is_a_jump_and_where():
    time_s, knots = knots_of(800)
    noise = gauss_markov(generator(6), len(time_s), SLOW, QUICK_S) + WHITE * generator(7).standard_normal(800)
    residual = noise + 20 * SLOW * (time_s > 250.0)
    at_s, p = clearest_step(knots, 0, 3 * SLOW, WHITE, residual, np.ones((len(residual), 1)))
    assert p < 1e-4
    assert at_s == pytest.approx(251.0, abs=4.0)


def test_signal_to_noise_ratio_is_that_of_the_noise_that_is_there():
    """An effect as slow as the noise: before it is known, a larger level of noise is the likeliest."""
    added = on_x(0.06 * DEG * WARMER)
    observations = [observed(generator(41 + run), MOTION, added, run=str(run)) for run in range(2)]
    trials = [one for one in trials_for(observations) if one.name == "gyro.bias_temperature"]
    prepared = prepare(observations, trials, 0, generator(0), cells=False)
    best = search(prepared.systems(), prepared.design, []).sets[0]
    fit = fit_set(observations, prepared, best.causes)
    lags = np.abs(MOTION.time_s[:, np.newaxis] - MOTION.time_s)
    covariance = WHITE**2 * np.eye(300) + SLOW**2 * np.exp(-lags / TAU_S)
    columns = np.column_stack([np.ones(300), MOTION.rate_rad_s, added[:, 0]])
    gram = columns.T @ np.linalg.solve(covariance, columns)
    inner = gram[4, 4] - gram[4, :4] @ np.linalg.solve(gram[:4, :4], gram[:4, 4])
    assert fit.effects[0].signal == pytest.approx(np.sqrt(2 * inner), rel=0.25)

"""Sufficient statistics, noise and evidence against dense matrices, sampling and numerical integration."""

import numpy as np
import pytest
from scipy import integrate, optimize

from gap_diagnosis.evidence import SIGNALS, STEPS_OF_DATA, Terms, log_bayes_factor, profile
from gap_diagnosis.noise_model import (
    SlowShape,
    knots_for,
    levels_of,
    shapes_for,
    slow_shape,
    white_noise_of_rows,
)
from gap_diagnosis.observation import NoiseBelief
from gap_diagnosis.whitened import NullNoise, channel_system, moments
from tests.gap_diagnosis.synthetic_observations import BELIEF, WHITE, gauss_markov, generator

TIME_S = np.r_[np.arange(0.0, 60.0), np.arange(75.0, 130.0)]  # with a hole
PRIOR = 0.05


def made(nulls=0, seed=1):
    """Two runs of one mount: (matrices, residuals, knots, levels, their moments)."""
    rng = generator(seed)
    shapes = shapes_for(BELIEF, 130.0, 1.0)
    levels = levels_of(shapes, WHITE)
    matrices, residuals, knots, statistics = [], [], [], {}
    for run in range(2):
        matrix = np.column_stack([np.ones(len(TIME_S)), rng.standard_normal((len(TIME_S), 6))])
        residual = (
            WHITE * rng.standard_normal(len(TIME_S)) + gauss_markov(rng, 200, 2e-4, 60.0)[: len(TIME_S)]
        )
        knots.append(knots_for(TIME_S, shapes))
        matrices.append(matrix)
        residuals.append(residual)
        noise = NullNoise(np.full(nulls, 1.5e-4))
        statistics[run] = moments(matrix, residual, knots[run], WHITE, noise, rng)
    return matrices, residuals, knots, levels, statistics


def dense(knots, level, shape):
    hats = knots.hats.toarray()
    slow = level**2 * hats @ knots.shapes[shape].covariance(knots.time_s) @ hats.T
    return WHITE**2 * np.eye(len(hats)) + slow


def test_gram_cross_and_likelihood_are_those_of_the_dense_covariance_with_nuisances_of_normal_prior():
    """ln N(r; 0, C + N P Nᵀ) for both runs at once, bias nearly free, matrix common with its prior."""
    matrices, residuals, knots, levels, statistics = made()
    found = channel_system(statistics, ["m1", "m1"], {0: WHITE, 1: WHITE}, levels, PRIOR)
    effects = np.vstack([m[:, 4:] for m in matrices])
    residual = np.concatenate(residuals)
    count = len(TIME_S)
    bias = np.zeros((2 * count, 2))
    bias[:count, 0] = bias[count:, 1] = 1.0
    inputs = np.vstack([m[:, 1:4] for m in matrices])
    bias_variance = WHITE**2 / (1e-9 * count)
    exact = []
    for level, shape in zip(levels.level_si, levels.shape, strict=True):
        covariance = np.zeros((2 * count, 2 * count))
        covariance[:count, :count] = dense(knots[0], level, shape)
        covariance[count:, count:] = dense(knots[1], level, shape)
        covariance += bias_variance * bias @ bias.T + PRIOR**2 * inputs @ inputs.T
        solved = np.linalg.solve(covariance, np.column_stack([effects, residual]))
        likelihood = -0.5 * np.linalg.slogdet(covariance)[1] - 0.5 * residual @ solved[:, -1]
        exact.append((effects.T @ solved[:, :-1], effects.T @ solved[:, -1], likelihood))
    assert found.gram == pytest.approx(np.array([g for g, _, _ in exact]), rel=1e-5, abs=1e-2)
    cross = np.array([c for _, c, _ in exact])
    assert found.cross[..., 0] == pytest.approx(cross, rel=1e-4, abs=1e-4 * np.abs(cross).max())
    likelihoods = np.array([x for _, _, x in exact])
    assert np.diff(found.log_likelihood[:, 0]) == pytest.approx(np.diff(likelihoods), abs=1e-3)


def test_simulated_nulls_have_the_covariance_of_what_they_stand_for():
    """Cov(Xᵀn, Bᵀn) = [X B]ᵀ C [X B] at the level drawn, over 4,000 nulls."""
    matrices, _, knots, _, statistics = made(nulls=4000)
    one = statistics[0]
    both = np.column_stack([matrices[0], knots[0].hats.toarray()]) / WHITE
    theory = both.T @ dense(knots[0], 1.5e-4, 0) @ both
    drawn = np.vstack([one.cross[:, 1:], one.summed_cross[:, 1:] / WHITE])
    theory = theory / WHITE**2
    scale = np.sqrt(np.diag(theory))
    assert drawn.std(axis=1) / scale == pytest.approx(np.ones(len(scale)), abs=0.06)
    correlation = (drawn @ drawn.T / 4000) / scale / scale[:, np.newaxis]
    assert correlation == pytest.approx(theory / scale / scale[:, np.newaxis], abs=0.09)


def test_flicker_of_a_coefficient_has_the_spectrum_of_ieee_952():
    """Two-sided density B² / (2π f) (IEEE 952: S(f) = B² / (2π f)) over the middle two decades."""
    shape = slow_shape(NoiseBelief(slow_coefficient_si=1.0), 10_000.0, 0.1)
    frequency = np.geomspace(1e-4, 1e-2, 40)
    density = sum(
        v * 2.0 * tau / (1.0 + (2.0 * np.pi * frequency * tau) ** 2)
        for v, tau in zip(shape.variances, shape.correlation_times_s, strict=True)
    )
    assert density == pytest.approx(1.0 / (2.0 * np.pi * frequency), rel=0.06)


def test_white_noise_is_found_beneath_slow_noise_and_a_burst():
    rng = generator(4)
    residual = 2.0 * rng.standard_normal(20_000) + 5.0 * np.sin(np.arange(20_000) / 300.0)
    residual[3000:5000] += 20.0 * rng.standard_normal(2000)
    assert white_noise_of_rows(residual) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("signal", [0.0, 4.0, 15.0])
def test_gain_is_the_largest_there_is(signal):
    """Against a general maximiser; levels summed over; a slow shape, which slow noise is a rival to."""
    _, _, knots, levels, _ = made()
    rng = generator(6)
    shape = np.exp(-TIME_S / 30.0)
    for _ in range(4):
        noise = WHITE * rng.standard_normal(len(TIME_S)) + gauss_markov(rng, 200, 7e-5, 100.0)[: len(TIME_S)]
        tail = rng.standard_normal((len(TIME_S), 5))
        matrix = np.column_stack([np.ones(len(TIME_S)), tail[:, :3], shape - shape.mean(), tail[:, 3]])
        residual = noise + signal * WHITE / np.linalg.norm(shape - shape.mean()) * shape
        one = moments(matrix, residual, knots[0], WHITE, NullNoise(np.zeros(0)), rng)
        system = channel_system({0: one}, ["m1"], {0: WHITE}, levels, PRIOR)
        believed = slice(0, levels.believed)
        weighted = (system.log_likelihood + system.log_weight[:, np.newaxis])[believed]
        gram, cross = system.gram[believed], system.cross[believed]

        def lost(scaled, gram=gram, cross=cross, weighted=weighted[:, 0]):
            a = scaled * WHITE
            gained = cross[:, :, 0] @ a - 0.5 * np.einsum("k,hkl,l->h", a, gram, a)
            return -2.0 * np.log(np.sum(np.exp(weighted + gained)) / np.sum(np.exp(weighted)))

        gain, amplitude = profile([Terms(gram[np.newaxis], cross[np.newaxis], weighted)], STEPS_OF_DATA)
        assert lost(amplitude[0, 0] / WHITE) == pytest.approx(-gain[0, 0], abs=1e-4)
        best = min(optimize.minimize(lost, start).fun for start in (np.zeros(2), amplitude[0, 0] / WHITE))
        assert gain[0, 0] == pytest.approx(-best, abs=0.1)


@pytest.mark.parametrize("gain", [0.0, 9.0, 60.0])
def test_evidence_is_the_integral_of_likelihood_over_the_prior(gain):
    """One amplitude of information 1: a ~ N(0, g), the likelihood ratio exp(a c − a²/2) with c² = Q."""
    c = np.sqrt(gain)
    total = 0.0
    for d in SIGNALS:

        def density(a, g=d**2):
            return np.exp(a * c - 0.5 * a * a - 0.5 * a * a / g) / np.sqrt(2.0 * np.pi * g)

        total += integrate.quad(density, -12.0 + c, 12.0 + c)[0] / len(SIGNALS)
    assert log_bayes_factor(np.array(gain), 1) == pytest.approx(np.log(total), abs=1e-6)


@pytest.mark.parametrize("k", [1, 3, 9])
def test_evidence_of_noise_averages_to_one(k):
    """E B = 1 where there is no effect (so that p ≤ 1 / B by Markov): Q is a chi square of k."""
    gain = generator(9).chisquare(k, 200_000)
    log_b = log_bayes_factor(gain, k)
    assert np.mean(np.exp(log_b[log_b < 4.0])) < 1.0  # the rare large ones carry the rest
    for factor in (3.0, 10.0, 30.0):
        assert np.mean(log_b > np.log(factor)) < 1.0 / factor


def test_levels_of_the_belief_are_its_log_normal():
    levels = levels_of((SlowShape((1.0,), (100.0,), 2.0, 0.4),), 1.0)
    inside = slice(0, levels.believed)
    weight = np.exp(levels.log_weight[inside])
    logs = np.log(levels.level_si[inside] / 2.0)
    assert weight.sum() == pytest.approx(1.0)
    assert weight @ logs == pytest.approx(0.0, abs=1e-12)
    assert np.sqrt(weight @ logs**2) == pytest.approx(0.4, rel=0.02)
    assert np.all(levels.level_si[levels.believed :] > levels.level_si[inside].max())

"""Wavelet variances against explicit filters, and coefficients that a ramp does not move."""

import numpy as np
import pytest

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.wavelet_variance import fit_wavelet_coefficients, wavelet_variance
from protocol.errors import CalibrationError

RATE_HZ = 20.0
ROOT_3 = np.sqrt(3)


def _noise(count: int, seed: int, white: float, walk: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    samples = white * np.sqrt(RATE_HZ) * rng.standard_normal(count)
    return samples + walk / np.sqrt(RATE_HZ) * np.cumsum(rng.standard_normal(count))


def test_the_first_two_scales_are_the_printed_filters() -> None:
    samples = _noise(400, 1, 1.0, 0.1)
    wavelet = np.array([1 - ROOT_3, -3 + ROOT_3, 3 + ROOT_3, -1 - ROOT_3]) / 8
    scaling = np.array([1 + ROOT_3, 3 + ROOT_3, 3 - ROOT_3, 1 - ROOT_3]) / 8
    found = wavelet_variance(samples, RATE_HZ)
    first = np.convolve(samples, wavelet, mode="valid")
    apart = np.zeros(7)
    apart[::2] = wavelet
    second = np.convolve(np.convolve(samples, scaling, mode="valid"), apart, mode="valid")
    np.testing.assert_allclose(found.variance[:2], [(first**2).mean(), (second**2).mean()], rtol=1e-12)
    np.testing.assert_allclose(found.tau_s[:3], [0.05, 0.1, 0.2])
    ramp = wavelet_variance(samples + 3.0 + 0.5 * np.arange(400), RATE_HZ)
    np.testing.assert_allclose(ramp.variance, found.variance, rtol=1e-8)


def test_coefficients_cover_and_agree_with_the_allan_plot() -> None:
    seeds, count, white, walk = 60, 2**14, 0.05, 0.01
    truth = np.array([0.0, white**2, 0.0, walk**2])
    pulls = []
    for seed in range(seeds):
        fit = fit_wavelet_coefficients(wavelet_variance(_noise(count, seed, white, walk), RATE_HZ))
        pulls.append((fit.squares[:4] - truth) / np.sqrt(np.diag(fit.covariance)[:4]))
    pulls = np.array(pulls)
    for sigmas, stated in ((1.0, 0.683), (1.96, 0.95)):
        covered = (np.abs(pulls) <= sigmas).mean(axis=0)
        assert (covered >= stated - 4 * np.sqrt(stated * (1 - stated) / seeds)).all(), covered
    assert np.abs(pulls.mean(axis=0)).max() < 0.7
    by_allan = fit_allan_coefficients(overlapping_allan_deviation(_noise(count, 7, white, walk), RATE_HZ))
    by_wavelet = fit_wavelet_coefficients(wavelet_variance(_noise(count, 7, white, walk), RATE_HZ))
    assert by_wavelet.model.random_walk == pytest.approx(by_allan.model.random_walk, rel=0.03)
    low, high = by_wavelet.interval("rate_random_walk")
    assert low <= by_allan.model.rate_random_walk <= high


def test_a_ramp_is_taken_for_no_noise_and_bad_records_are_refused() -> None:
    samples = _noise(2**13, 3, 0.05, 0.0)
    ramped = samples + 0.002 * np.arange(len(samples)) / RATE_HZ
    plain = fit_wavelet_coefficients(wavelet_variance(samples, RATE_HZ))
    found = fit_wavelet_coefficients(wavelet_variance(ramped, RATE_HZ))
    np.testing.assert_allclose(found.squares, plain.squares, rtol=1e-5, atol=1e-10)
    terms = ("random_walk", "rate_random_walk")
    misled = fit_allan_coefficients(overlapping_allan_deviation(ramped, RATE_HZ), terms)
    assert misled.model.rate_random_walk > 10 * found.model.rate_random_walk
    with pytest.raises(CalibrationError, match="do not carry one scale"):
        wavelet_variance(np.ones(10), RATE_HZ)
    with pytest.raises(CalibrationError, match="missing"):
        wavelet_variance(np.r_[samples, np.nan], RATE_HZ)
    with pytest.raises(CalibrationError, match="do not carry 4"):
        fit_wavelet_coefficients(wavelet_variance(samples[:150], RATE_HZ))
    with pytest.raises(CalibrationError, match="terms of a wavelet"):
        fit_wavelet_coefficients(wavelet_variance(samples, RATE_HZ), ("rate_ramp",))

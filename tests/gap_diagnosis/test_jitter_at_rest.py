"""Noise seen at rest bounds what jitter of the sample times can explain, as noise seen in motion does."""

import numpy as np
import pytest

from gap_diagnosis.jitter_fit import fitted_jitter

DEVIATION_S = 2e-3


def residual_and_slope(deviation_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A tumble: one steady rate most of the time, rests between."""
    rng = np.random.default_rng(5)
    moving = (np.arange(20_000) // 2000) % 4 != 0
    slope = np.stack([moving * 1.0, moving * 0.3, np.zeros(20_000)], axis=1)
    late = deviation_s * rng.standard_normal((20_000, 1))
    return 1e-3 * rng.standard_normal((20_000, 3)) + late * slope, slope


def test_rests_between_turns_of_one_rate_are_no_jitter() -> None:
    residual, slope = residual_and_slope(0.0)
    fit = fitted_jitter(residual, slope, np.zeros(20_000, dtype=np.int64))
    assert fit is not None
    assert fit.log_likelihood_ratio < 5.0


def test_jitter_beside_rests_is_found() -> None:
    residual, slope = residual_and_slope(DEVIATION_S)
    fit = fitted_jitter(residual, slope, np.zeros(20_000, dtype=np.int64))
    assert fit is not None
    assert fit.log_likelihood_ratio > 100.0
    assert np.sqrt(fit.variance_s2) == pytest.approx(DEVIATION_S, rel=0.03)

"""Allan deviations beside allantools and beside the printed sums."""

import allantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.algorithms.allan_variance import (
    BLOCK,
    logarithmic_taus,
    modified_allan_deviation,
    overlapping_allan_deviation,
)
from protocol.errors import CalibrationError

RATE_HZ = 200.0
FORMS = {
    "overlapping": (overlapping_allan_deviation, allantools.oadev),
    "modified": (modified_allan_deviation, allantools.mdev),
}


def _samples(count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 3.0 + rng.standard_normal(count) + 1e-3 * np.cumsum(rng.standard_normal(count))


@pytest.mark.parametrize("kind", FORMS)
@pytest.mark.parametrize("count", [17, BLOCK - 1, BLOCK, 6 * BLOCK + 5])
def test_agrees_with_allantools(kind: str, count: int) -> None:
    ours, peer = FORMS[kind]
    samples = _samples(count)
    found = ours(samples, RATE_HZ)
    tau_s, expected, _errors, terms = peer(samples, RATE_HZ, "freq", logarithmic_taus(count, RATE_HZ))
    np.testing.assert_allclose(found.tau_s, tau_s, rtol=1e-15)
    np.testing.assert_array_equal(found.terms, terms)
    np.testing.assert_allclose(found.deviation, expected, rtol=1e-12)


def test_every_tau_that_a_record_carries_is_the_printed_sum() -> None:
    """Means of neighbouring stretches, differenced: IEEE 952 annex C, written without an integral."""
    samples = _samples(60, seed=2)
    found = overlapping_allan_deviation(samples, RATE_HZ, np.arange(1, 30) / RATE_HZ)
    assert len(found.factors) == 29
    for m, deviation, terms in zip(found.factors, found.deviation, found.terms, strict=True):
        means = np.array([samples[i : i + m].mean() for i in range(60 - m + 1)])
        steps = means[m:] - means[:-m]
        assert terms == len(steps)
        assert deviation == pytest.approx(np.sqrt((steps**2).mean() / 2), rel=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(16, 300), st.floats(1e-9, 1e6), st.floats(-1e3, 1e3), st.integers(0, 2**32 - 1))
def test_scales_with_the_samples_and_does_not_see_a_constant(
    count: int, scale: float, constant: float, seed: int
) -> None:
    samples = np.random.default_rng(seed).standard_normal(count)
    for ours, _ in FORMS.values():
        plain = ours(samples, RATE_HZ)
        changed = ours(scale * (samples + constant), RATE_HZ)
        np.testing.assert_allclose(changed.deviation, scale * plain.deviation, rtol=1e-9)
        backwards = ours(samples[::-1], RATE_HZ)
        np.testing.assert_allclose(backwards.deviation, plain.deviation, rtol=1e-9)


def test_order_and_doubles_among_the_taus_do_not_matter() -> None:
    samples = _samples(500)
    mixed = overlapping_allan_deviation(samples, RATE_HZ, np.array([0.2, 0.005, 0.0501, 0.05, 0.2]))
    np.testing.assert_array_equal(mixed.factors, [1, 10, 40])
    tau_s, deviation = mixed.minimum()
    assert deviation == mixed.deviation.min()
    assert tau_s in mixed.tau_s


@pytest.mark.parametrize(
    ("samples", "taus", "words"),
    [
        (np.ones(15), None, "at least 16 samples"),
        (np.ones((30, 3)), None, "one channel"),
        (np.r_[np.ones(20), np.nan], None, "1 of 21 samples are missing"),
        (np.ones(20), [0.06], "outside"),
        (np.ones(20), [0.001], "outside"),
        (np.ones(20), [], "averaging times"),
    ],
)
def test_what_a_record_does_not_carry_is_refused(samples: np.ndarray, taus: object, words: str) -> None:
    wanted = None if taus is None else np.array(taus, dtype=np.float64)
    with pytest.raises(CalibrationError, match=words):
        overlapping_allan_deviation(samples, RATE_HZ, wanted)
    with pytest.raises(CalibrationError, match="sample rate"):
        modified_allan_deviation(np.ones(20), 0.0)

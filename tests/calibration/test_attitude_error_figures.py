"""1 sigma of errors with a memory: closed forms of what they are worth, and whether intervals hold."""

import math

import numpy as np
import pytest

from calibration.algorithms.attitude_error_figures import (
    OVERALL,
    effective_samples,
    error_figure,
    figures_by_phase,
    wrapped_rad,
)
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import exponential, white


def test_what_errors_are_worth_by_their_memory() -> None:
    rng = np.random.default_rng(2)
    assert effective_samples(np.full(500, 0.3)) == pytest.approx(1.0)
    assert effective_samples(white(rng, 5000, 1, 1.0, 1.0)[:, 0]) == pytest.approx(5000, rel=0.05)
    # exp(-|t| / tau): 1 + 2 sum rho^2 = coth(1 / tau)
    long = exponential(rng, 40_000, 1, 1.0, 40.0, 1.0)[:, 0]
    assert effective_samples(long) == pytest.approx(40_000 * math.tanh(1.0 / 40.0), rel=0.15)
    # a sine: about one for each quarter of a period, as if the next period could be another
    assert effective_samples(np.sin(2.0 * np.pi * np.arange(2000) / 200.0)) < 20.0


def test_figures_of_a_phase_and_of_all() -> None:
    error = np.concatenate([np.full(100, 0.01), 0.03 * (-1.0) ** np.arange(300)])
    phase = np.array(["rest"] * 100 + ["turn"] * 300)
    usable = np.ones(400, dtype=bool)
    usable[390:] = False
    found = figures_by_phase(error, phase, usable)
    assert list(found) == ["rest", "turn", OVERALL]
    assert (found["rest"].sigma, found["rest"].mean) == pytest.approx((0.01, 0.01))
    assert found["turn"].samples == 290
    assert found["turn"].sigma == pytest.approx(0.03)
    assert found[OVERALL].sigma == pytest.approx(math.sqrt((100 * 0.01**2 + 290 * 0.03**2) / 390))
    # chi-square of one degree of freedom: 95.45 % from its tables, 5.18 and 0.000813
    assert found["rest"].interval(0.9545)[0] == pytest.approx(0.01 / math.sqrt(5.1795), rel=1e-3)
    assert found["rest"].interval(0.9545)[1] == pytest.approx(0.01 / math.sqrt(0.000813), rel=2e-2)
    assert found["rest"].standard_uncertainty() == pytest.approx(0.01 / math.sqrt(2.0))
    assert found["rest"].standard_uncertainty(0.02) > 0.02
    assert found["rest"].interval(0.9545, 0.001)[0] < found["rest"].interval(0.9545)[0]
    np.testing.assert_allclose(
        wrapped_rad(np.array([3.5, -3.5, 0.1])), [3.5 - 2 * np.pi, 2 * np.pi - 3.5, 0.1]
    )
    with pytest.raises(CalibrationError, match="too few"):
        error_figure(np.zeros(5))


@pytest.mark.parametrize("spans", [2.0, 10.0, 40.0])
@pytest.mark.parametrize("kind", ["exponential", "damped swing", "white"])
def test_intervals_hold_the_true_1_sigma_as_often_as_they_say(kind: str, spans: float) -> None:
    """200 records of each kind, from generators that share nothing with emulator or calibration."""
    rng = np.random.default_rng(int(spans))
    count, records = 1000, 200
    if kind == "white":
        errors = white(rng, count, records, 1.0, 1.0)
    else:
        errors = exponential(rng, count, records, 1.0, count / spans, 1.0)
        if kind == "damped swing":  # in-phase and quadrature parts: exp(-|t| / tau) cos(w t)
            other = exponential(rng, count, records, 1.0, count / spans, 1.0)
            angle = (2.0 * np.pi * spans / count * np.arange(count))[:, None]
            errors = errors * np.cos(angle) + other * np.sin(angle)
    for stated, least, most in ((0.6827, 0.57, 0.87), (0.9545, 0.89, 1.0)):
        held = 0
        for error in errors.T:
            lower, upper = error_figure(error).interval(stated)
            held += lower <= 1.0 <= upper
        assert least <= held / records <= most, (kind, spans, stated, held)

"""Threshold and resolution: a dead band made by hand and one of the emulator, coverage, damage."""

import dataclasses

import numpy as np
import pytest

from calibration.algorithms.resolution_threshold import Stretch, smallest_step
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.nonlinearity import DeadBand
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, white

PERIOD_S, STAY_S, BASE, BAND = 0.1, 20.0, 3e-3, 1e-4
SIZES = BAND * np.array([0.25, 0.5, 0.8, 1.25, 2.0])
ORDER = [0.0, *(value for size in SIZES for value in (size, 0.0, -size, 0.0))]


def session(seed: int, density: float, sigma: float = 0.0, answer=None) -> list[Stretch]:
    """Base and steps in turn; the unit answers only beyond its dead band."""
    rng, per = np.random.default_rng(seed), round(STAY_S / PERIOD_S)
    count = per * len(ORDER)
    noise = white(rng, count, 1, density, PERIOD_S) + exponential(rng, count, 1, sigma, 100.0, PERIOD_S)
    answer = answer or (lambda step: step if abs(step) >= BAND else 0.0)
    return [
        Stretch(
            f"stretch {n}",
            PERIOD_S * np.arange(n * per, (n + 1) * per),
            BASE + 1.01 * answer(step) + noise[n * per : (n + 1) * per, 0],
            step,
        )
        for n, step in enumerate(ORDER)
    ]


def test_the_threshold_lies_in_its_bracket() -> None:
    found = smallest_step(session(0, 1e-12), 1.01)
    assert found.above == pytest.approx(0.8 * BAND)
    assert found.at_most == found.value == pytest.approx(1.25 * BAND)
    assert found.standard_uncertainty == pytest.approx(0.45 * BAND / np.sqrt(12))
    np.testing.assert_allclose(found.ratio, [1, 1, 0, 0, 0, 0, 0, 0, 1, 1], atol=0.15)
    assert not found.undecided
    fine = smallest_step(session(0, 1e-14, answer=lambda step: step), 1.01)
    assert (fine.above, fine.at_most) == (0.0, pytest.approx(0.25 * BAND))


def test_noise_widens_the_bracket_instead_of_moving_it() -> None:
    found = smallest_step(session(1, 2e-9), 1.01, known_slow=())
    assert found.undecided
    assert found.above <= BAND <= found.at_most


@pytest.mark.parametrize("seeds", [60, pytest.param(200, marks=pytest.mark.slow)])
def test_ratios_hold_their_intervals_in_slow_noise(seeds: int) -> None:
    truth = (np.abs(np.sort(np.concatenate([SIZES, -SIZES]))) >= BAND).astype(float)
    pulls, inside = [], 0
    for seed in range(seeds):
        found = smallest_step(session(seed, 1e-10, 2e-5), 1.01, known_slow=((2e-5, 100.0),))
        pulls.append((found.ratio - truth) / np.sqrt(np.diag(found.covariance)))
        inside += found.above <= BAND <= found.at_most
    check_coverage(np.array(pulls))
    assert inside >= 0.93 * seeds


def test_an_emulated_dead_band_is_found_where_it_is() -> None:
    chain = EffectChain((DeadBand("gyro", (1.0, 1.0, 1.0), half_width_si=BAND),))

    def answer(step: float) -> float:
        rate = np.zeros((4, 3))
        rate[:, 0] = step
        acting = Stimulus(np.arange(4) * PERIOD_S, np.full(4, 25.0), PERIOD_S, rate_rad_s=rate)
        return float(chain.apply(rate, acting, chain.begin(np.random.SeedSequence(0)))[-1, 0])

    found = smallest_step(session(2, 1e-12, answer=answer), 1.01)
    assert found.above == pytest.approx(0.8 * BAND)
    assert found.at_most == pytest.approx(1.25 * BAND)


def test_what_is_missing_is_named() -> None:
    whole = session(3, 1e-12)
    with pytest.raises(CalibrationError, match="one side only"):
        smallest_step([one for one in whole if one.step >= 0], 1.01)
    with pytest.raises(CalibrationError, match="without the base"):
        smallest_step([one for one in whole if one.step], 1.01)
    with pytest.raises(CalibrationError, match="is not surely answered"):
        smallest_step(session(3, 1e-12, answer=lambda _: 0.0), 1.01)
    torn = whole[5].output.copy()
    torn[3] = 1.0
    found = smallest_step(
        [*whole[:5], dataclasses.replace(whole[5], output=torn), *whole[6:]], 1.01, range_limit=0.5
    )
    assert any(note.why.startswith("whole stretch") for note in found.not_used)

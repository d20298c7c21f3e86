"""What a stand reports of an axis at rest is its own noise; what it reports of motion is motion."""

import dataclasses

import numpy as np
import pytest

from dut_emulator.recording.recorder import recorded
from gap_diagnosis.observation import Observation
from gap_diagnosis.observing import observe
from gap_diagnosis.stillness import stilled

NOISE_RAD_S = 3.5e-6
RATE_HZ = 100.0


@pytest.fixture(scope="module")
def observed() -> Observation:
    return observe(
        recorded("gnc_module", "rate_staircase", rate_hz=RATE_HZ, values={"dwell_s": 2.0, "steps": 3.0})
    )


def reported(observed: Observation, rate_rad_s: np.ndarray) -> np.ndarray:
    """(n, 3) rates after `stilled` where the stand reports these, with noise."""
    noise = NOISE_RAD_S * np.random.default_rng(1).standard_normal(rate_rad_s.shape)
    stimulus = dataclasses.replace(observed.stimulus, rate_rad_s=rate_rad_s + noise)
    held = stilled(dataclasses.replace(observed, stimulus=stimulus)).stimulus.rate_rad_s
    assert held is not None
    return held


def times_s(observed: Observation) -> np.ndarray:
    return np.arange(len(observed.usable)) / RATE_HZ


def test_noise_at_rest_is_held_and_motion_stays(observed: Observation) -> None:
    """Earth's share in a rest stays; between rests every row is as reported."""
    earth = 5e-5
    rate = np.full((len(observed.usable), 3), earth)
    moves = slice(len(rate) // 3, len(rate) // 2)
    rate[moves, 1] = 0.4 * np.sin(times_s(observed)[moves])
    held = reported(observed, rate)
    still = np.ones(len(rate), dtype=bool)
    still[moves.start - 50 : moves.stop + 50] = False
    assert (held[still] - earth).std() < NOISE_RAD_S / 20
    assert abs((held[still] - earth).mean()) < NOISE_RAD_S / 5
    moving = np.zeros(len(rate), dtype=bool)
    moving[moves.start + 50 : moves.stop - 50] = True
    moved = held[moving, 1] - rate[moving, 1]
    assert moved.std() == pytest.approx(NOISE_RAD_S, rel=0.1)


def test_a_rate_that_creeps_through_nought_is_not_flattened(observed: Observation) -> None:
    """A dead band is looked for there."""
    rate = np.zeros((len(observed.usable), 3))
    rate[:, 0] = np.linspace(-1.4e-4, 1.4e-4, len(rate))
    held = reported(observed, rate)
    assert np.abs(held[:, 0] - rate[:, 0]).max() < 4e-6


def test_a_vibration_about_nought_is_no_rest(observed: Observation) -> None:
    """Every half second holds whole periods: the mean is nought, the scatter the same everywhere."""
    rate = np.zeros((len(observed.usable), 3))
    rate[:, 2] = 0.01 * np.sin(2 * np.pi * 8.0 * times_s(observed))
    held = reported(observed, rate)
    assert np.abs(held[:, 2] - rate[:, 2]).max() < 6 * NOISE_RAD_S

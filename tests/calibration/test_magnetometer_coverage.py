"""Intervals of magnetometer figures, over many records: by the emulator, and on noise of our own."""

import dataclasses

import numpy as np
import pytest

from calibration.algorithms.magnetometer import UPPER, hard_and_soft_iron
from calibration.algorithms.roll_error import Spin, roll_latency
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.evaluations.magnetometer import evaluate_magnetometer
from dut_emulator.effects.dynamics import ClockDrift
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from protocol.recordings import Recording, Stream
from tests.calibration.shaped_noise import check_coverage, exponential, white
from tests.calibration.test_method_evaluations import quantity, with_columns

PERIOD_S = 0.02
COMPENSATION = np.array([[1.1, 0.05, -0.02], [0.05, 0.8, 0.03], [-0.02, 0.03, 1.3]])
HARD_IRON = np.array([2.0, -1.0, 0.3])


def tumbled(seed: int, slow: float, count: int = 6000) -> np.ndarray:
    """Outputs of a unit turned all ways by hand, smoothly, with white noise and a slow one."""
    rng = np.random.default_rng(seed)
    time_s = PERIOD_S * np.arange(count)
    first, second = 2 * np.pi * rng.uniform(0.2, 0.4), 2 * np.pi * rng.uniform(0.05, 0.09)
    angles = np.stack([first * time_s + rng.uniform(0, 6), second * time_s + rng.uniform(0, 6)])
    directions = np.stack(
        [np.cos(angles[0]) * np.sin(angles[1]), np.sin(angles[0]) * np.sin(angles[1]), np.cos(angles[1])],
        axis=1,
    )
    noise = white(rng, count, 3, 0.01**2 * PERIOD_S, PERIOD_S)
    if slow:
        noise += exponential(rng, count, 3, slow, 0.4, PERIOD_S)
    return directions @ np.linalg.inv(COMPENSATION) + HARD_IRON + noise


def iron_pulls(seed: int, slow: float) -> np.ndarray:
    found = hard_and_soft_iron(tumbled(seed, slow))
    values = np.concatenate([[found.compensation[i] for i in UPPER], found.hard_iron])
    truth = np.concatenate([[COMPENSATION[i] for i in UPPER], HARD_IRON])
    return (values - truth) / np.sqrt(np.diag(found.covariance))


@pytest.mark.slow
@pytest.mark.parametrize("slow", [0.0, 0.004])
def test_iron_is_covered_also_on_coloured_noise(slow: float) -> None:
    """Two minutes of turning. A slow field of 0.4 of the white noise widens the covariance by what its block
    means show: all parameters alike, so that some are covered more often and some a little less."""
    pulls = np.array([iron_pulls(seed, slow) for seed in range(200)])
    check_coverage(pulls, less=0.03 if slow else 0.0, more=0.2)


def spins(seed: int, latency_s: float, drift: float) -> list[Spin]:
    rng, begun, found = np.random.default_rng(seed), 5.0, []
    for rate in (30.0, 60.0, 94.0):
        time_s = begun + 0.005 * np.arange(1200)
        reference = rate * time_s
        roll = reference - rate * (latency_s + drift * time_s) + 0.3 + 0.01 * rng.standard_normal(1200)
        found.append(Spin(rate, np.angle(np.exp(1j * roll)), reference, time_s))
        begun += 10.0
    return found


@pytest.mark.parametrize(("drift", "seeds"), [(-8e-6, 200), (-2.4e-3, 40)])
def test_a_drift_of_the_clocks_is_not_taken_for_latency(drift: float, seeds: int) -> None:
    """A crystal's, and a clock so far off that the phase goes round within a spin."""
    latency_s = 4e-4
    pulls = []
    for seed in range(seeds):
        found = roll_latency(spins(seed, latency_s, drift))
        assert found.clock_drift is not None
        pulls.append(
            [
                (found.latency_s - latency_s) / found.latency_standard_uncertainty_s,
                (found.mounting_rad - 0.3) / np.sqrt(found.covariance[1, 1]),
                (found.clock_drift[0] - drift) / found.clock_drift[1],
            ]
        )
    if seeds < 200:
        assert np.sqrt(np.mean(np.square(pulls), axis=0)) == pytest.approx(1.0, abs=0.4)
        return
    check_coverage(np.array(pulls))
    misled = roll_latency([dataclasses.replace(spin, time_s=None) for spin in spins(0, latency_s, drift)])
    assert abs(misled.latency_s - latency_s) > 1e-4


def spin_pulls(seed: int) -> list[float]:
    """Of the latency (the twin has none), the clock, the zeros, the orthogonality."""
    values = {"max_rate_rev_s": 15.0, "steps": 2.0, "dwell_s": 2.5}
    recording = recorded("gnc_module", "spin", values=values, seed=seed, stand_seed=seed)
    (result,) = evaluate_by_profile([recording]).results
    found = {one.name: one for one in result.content.quantities}
    matrix = np.array(recording.believed["mag"]["matrix"])
    bias = np.array(recording.believed["mag"]["bias"]) * 1e-4
    along = float(recording.streams["stand"].columns["mag_z"].mean()) * 1e-6
    plane = matrix[:2, :2] @ matrix[:2, :2].T
    effects = product_named("gnc_module").twin(seed, "U-0001").effects
    (drift,) = [one.relative_rate for one in effects if isinstance(one, ClockDrift) and one.sensor == "mag"]
    truth = {
        "roll_latency": 0.0,
        "clock_drift": drift,
        "hard_iron_x": bias[0] + matrix[0, 2] * along,
        "hard_iron_y": bias[1] + matrix[1, 2] * along,
        "nonorthogonality_xy": np.arcsin(plane[0, 1] / np.sqrt(plane[0, 0] * plane[1, 1])),
    }
    return [(found[name].value - true) / found[name].standard_uncertainty for name, true in truth.items()]


@pytest.mark.slow
def test_spins_of_emulated_units_are_covered() -> None:
    """The stand's own field is stated with 10 nT for any stand: zeros may be covered more often."""
    check_coverage(np.array([spin_pulls(seed) for seed in range(200)]), more=0.33)


def test_a_clock_that_no_crystal_has_is_said() -> None:
    """A clock that is 300 ppm fast stamps late; it is found, taken out, and a person is told to look."""
    values = {"max_rate_rev_s": 15.0, "steps": 2.0, "dwell_s": 2.5}
    recording = recorded("gnc_module", "spin", values=values, seed=2)
    fast = with_columns(recording, "dut", t=recording.stream("dut").time_s() * (1.0 + 3e-4))
    usual, found = evaluate_by_profile([recording]), evaluate_by_profile([fast])
    (before, _), (value, u) = quantity(usual, "mag", "clock_drift"), quantity(found, "mag", "clock_drift")
    assert value - before == pytest.approx(3e-4, abs=2.0 * u)
    assert any("fast by the spins, taken out" in words for words in usual.assumptions)
    assert not any("no crystal" in words for words in usual.assumptions)
    assert any("no crystal is 100 ppm off" in words for words in found.assumptions)


def in_counts(output: np.ndarray, **test: object) -> Recording:
    columns = {"t": PERIOD_S * np.arange(len(output))} | {
        f"mag_{x}": output[:, k] for k, x in enumerate("xyz")
    }
    stream = Stream("dut", "d", "t", {"t": "s", "mag_x": "1", "mag_y": "1", "mag_z": "1"}, columns)
    return Recording("r", {"serial": "M", "product": "p"}, {"profile": "by_hand", **test}, {"dut": stream})


def test_a_magnetometer_alone_is_evaluated_and_its_outliers_are_said() -> None:
    output = tumbled(1, 0.0, 1500)
    output[::50] += 0.5
    output[7] = np.nan
    found = evaluate_by_profile([in_counts(output)])
    said = {item.why: item.count for item in found.not_used}
    assert said["missing (NaN)"] == 1
    assert 20 <= said["far from the ellipsoid"] <= 40
    (result,) = found.results
    assert len(result.content.quantities) == 9
    assert result.content.method == "magnetometer"
    for one, true in zip(result.content.quantities[6:], HARD_IRON, strict=True):
        assert abs(one.value - true) < 4 * (one.standard_uncertainty or 0.0)
    flat = output.copy()
    flat[:, 2] = 0.3 + 1e-3 * np.random.default_rng(1).standard_normal(len(flat))
    with pytest.raises(CalibrationError, match=r"turn|far from"):
        evaluate_magnetometer((in_counts(flat),))

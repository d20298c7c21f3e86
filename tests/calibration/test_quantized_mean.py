"""What a quantum hides of a mean: brute-force rounding, samples that toggle, and a unit at 1 Hz."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtri

from calibration.algorithms.quantized_mean import lattice_step, mean_uncertainty, rms_error
from calibration.evaluations.by_profile import evaluate_by_profile
from dut_emulator.recording.recorder import recorded
from protocol.recordings import Recording
from tests.calibration.test_inertial_evaluations import figures
from tests.calibration.test_method_evaluations import with_columns


def error_of_rounding(places: np.ndarray, sigma: float, quantum: float) -> np.ndarray:
    """Mean of many rounded normal values less the true mean, for each mean of `places`."""
    normal = sigma * ndtri((np.arange(4000) + 0.5) / 4000)
    rounded = quantum * np.rint((places[:, None] + normal) / quantum)
    return rounded.mean(axis=1) - places


@settings(max_examples=20, deadline=None)
@given(sigma=st.floats(0.0, 0.6), quantum=st.floats(1e-6, 1e3))
def test_the_rms_is_that_of_rounding_by_brute_force(sigma: float, quantum: float) -> None:
    places = quantum * (np.arange(200) + 0.5) / 200
    found = error_of_rounding(places, sigma * quantum, quantum)
    told = float(rms_error(np.array(sigma * quantum), quantum))
    assert told == pytest.approx(float(np.sqrt(np.mean(found**2))), rel=0.02, abs=2e-4 * quantum)


@settings(max_examples=20, deadline=None)
@given(step=st.floats(1e-6, 1e3), origin=st.integers(-1000, 1000), seed=st.integers(0, 100))
def test_the_lattice_is_seen_whatever_it_is_called(step: float, origin: int, seed: int) -> None:
    places = origin + np.random.default_rng(seed).integers(0, 12, 300)
    assert lattice_step(np.asarray(step * places, dtype=np.float64)) == pytest.approx(step, rel=1e-9)
    single = np.asarray(np.asarray(step * places, dtype=np.float32), dtype=np.float64)
    assert lattice_step(single) == pytest.approx(step, rel=0.01)
    between = np.append(step * places, step * (origin + 0.5 + math.pi / 100))
    assert lattice_step(np.asarray(between, dtype=np.float64)) is None
    assert lattice_step(np.full(5, step)) is None


@pytest.mark.parametrize(
    ("sigma", "least"), [(0.0, 0.9), (0.1, 0.95), (0.2, 0.95), (0.3, 0.93), (0.4, 0.93), (0.5, 0.93)]
)
def test_what_is_hidden_is_within_its_uncertainty(sigma: float, least: float) -> None:
    """150 means anywhere between quanta, 200 samples each: toggling samples are not taken for noise."""
    rng = np.random.default_rng(int(100 * sigma))
    places = rng.uniform(0.0, 1.0, 150)
    hidden = error_of_rounding(places, sigma, 1.0)
    samples = np.rint(places[:, None] + sigma * rng.standard_normal((150, 200)))
    told = np.array([mean_uncertainty(one, 1.0) for one in samples])
    covered = np.abs(hidden) <= 1.96 * told + 1e-12
    assert covered.mean() >= least - 3.5 * math.sqrt(0.05 * 0.95 / 150)
    assert np.median(told) < 2.5 * float(rms_error(np.array(sigma), 1.0)) + 1e-9
    assert mean_uncertainty(np.rint(rng.standard_normal(200)), 1.0) == 0.0


def test_a_ramp_over_the_record_does_not_pass_for_noise() -> None:
    """Two quanta of drift and no noise: what the samples spread by is not there at each instant."""
    samples = np.rint(np.linspace(0.2, 2.2, 2000))
    assert mean_uncertainty(samples, 1.0) > 0.15


def module_at_rest(rate_hz: float, duration_s: float) -> Recording:
    return recorded("gnc_module", "static", serial="Q-1", values={"duration_s": duration_s}, rate_hz=rate_hz)


def test_a_rest_at_1_hz_says_what_the_quantum_hides() -> None:
    """Its accelerometers' noise is then a fifth of a quantum; at 10 Hz it is over half of one."""
    slowly, fast = (evaluate_by_profile([module_at_rest(rate_hz, 3600.0)]) for rate_hz in (1.0, 10.0))
    assert [words[:5] for words in slowly.assumptions if "hardly blurs" in words] == [
        "acc_x",
        "acc_y",
        "acc_z",
    ]
    assert not any("hardly blurs" in words for words in fast.assumptions)
    told = {name: (figures(slowly)[name], figures(fast)[name]) for name in ("bias_x", "bias_y", "bias_z")}
    for (_, u_slowly), (_, u_fast) in told.values():
        assert u_slowly == pytest.approx(u_fast, rel=0.2)  # the gyros' noise is ample at both rates


@pytest.mark.parametrize("stated", [True, False])
def test_a_bias_of_samples_written_coarsely_holds_the_fine_one(stated: bool) -> None:
    """Written to 0.05 deg/s, twenty times the quantum that is stated: sentence, budget and uncertainty."""
    fine = module_at_rest(10.0, 200.0)
    step = 0.05
    dut = fine.stream("dut")
    columns = {f"gyro_{axis}": step * np.rint(dut.columns[f"gyro_{axis}"] / step) for axis in "xyz"}
    coarse = with_columns(fine, "dut", **columns)
    if not stated:
        gyro = {key: value for key, value in fine.believed["gyro"].items() if key != "quantum"}
        coarse = dataclasses.replace(coarse, believed={**fine.believed, "gyro": gyro})
    known, found = figures(evaluate_by_profile([fine])), evaluate_by_profile([coarse])
    assert sum("hardly blurs its quantum" in words for words in found.assumptions) == 3
    (result,) = [one for one in found.results if one.sensor == "gyro"]
    for axis, budget in zip("xyz", result.content.budgets, strict=True):
        value, u = figures(found)[f"bias_{axis}"]
        (row,) = [one for one in budget.rows if one.quantity == "quantum of the samples"]
        assert math.sqrt(sum(one.standard_uncertainty**2 for one in budget.rows)) == pytest.approx(u)
        off = abs(value - known[f"bias_{axis}"][0])
        assert off < 2.0 * row.standard_uncertainty
        assert row.standard_uncertainty < math.radians(step)

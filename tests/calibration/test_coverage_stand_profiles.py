"""Recordings 'multi_position' and 'rotation' of emulated units, together: the truth at the stated rate.

Truth is the unit's own at the temperature it had. A mounting turns the unit's axes by 0.1 mrad: what is held
is what no mounting changes, scale factors, non-orthogonalities and biases.
"""

import dataclasses
import json

import numpy as np
import pytest

from calibration.clock_of_turns import clock_rate_of_turns
from calibration.evaluation import Evaluation
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.stand_recordings import evaluate_stand_profiles
from dut_emulator.effects.dynamics import Bandwidth, FixedDelay
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import Twin, twin_text
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, flicker, white

BEYOND_THE_MODEL = {
    *("scale_factor_nonlinearity", "scale_factor_asymmetry", "quadratic_nonlinearity"),
    *("thermal_hysteresis", "temperature_rate", "warm_up", "g_sensitivity", "misalignment_temperature"),
}
"""A line through rests and turns of one size has no words for these; its assumptions say so."""
REFERENCE_C = 25.0
VALUES = {"multi_position": {"dwell_s": 5.0}, "rotation": {"rest_s": 3.0}}


def unit(product: str, seed: int) -> Twin:
    whole = product_named(product).twin(seed, "U-0001")
    kept = tuple(one for one in whole.effects if one.word not in BEYOND_THE_MODEL)
    return dataclasses.replace(whole, effects=kept)


def true_triad(twin: Twin, kind: str, temperature_c: float) -> tuple[np.ndarray, np.ndarray]:
    """M and b from the twin's own document: scale (1 + misalignment), polynomials of T - 25 degC."""
    told = {
        (effect["effect"], name): one["value"]
        for effect in json.loads(twin_text(twin))["effects"]
        for name, one in effect["parameters"].items()
    }
    warmer = temperature_c - REFERENCE_C

    def series(effect: str, stem: str, axis: str) -> float:
        return sum(told.get((f"{kind}.{effect}", f"{stem}_{k}_{axis}"), 0.0) * warmer**k for k in range(1, 5))

    matrix, bias = np.eye(3), np.zeros(3)
    for row, axis in enumerate("xyz"):
        for column, other in enumerate("xyz"):
            matrix[row, column] += told.get((f"{kind}.misalignment", f"misalignment_rad_{axis}{other}"), 0.0)
        scale = 1.0 + told[f"{kind}.scale_factor_error", f"scale_factor_error_{axis}"]
        matrix[row] *= scale * (1.0 + series("scale_factor_temperature", "coefficients_per_c", axis))
        bias[row] = told[f"{kind}.bias", f"bias_si_{axis}"]
        bias[row] += series("bias_temperature", "coefficients_si_per_c", axis)
    return matrix, bias


def pulls_of(found: Evaluation, twin: Twin, temperature_c: float) -> list[float]:
    """Of gyros, then of accelerometers: three scale factors, three sums m_ij + m_ji, three biases."""
    pulls: list[float] = []
    for kind, triad in (("gyro", found.gyro), ("acc", found.acc)):
        assert triad is not None
        matrix, bias = true_triad(twin, kind, temperature_c)
        off = triad.matrix - matrix
        pulls += (np.diag(off) / triad.scale_factor_standard_uncertainty()).tolist()
        for i, j in ((0, 1), (0, 2), (1, 2)):
            both = np.zeros(12)
            both[[3 * i + j, 3 * j + i]] = 1.0
            pulls.append((off[i, j] + off[j, i]) / np.sqrt(both @ triad.covariance @ both))
        pulls += ((triad.bias - bias) / triad.bias_standard_uncertainty()).tolist()
    return pulls


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("product", ["gnc_module", "mems_ahrs"])
def test_sessions_of_emulated_units_are_covered(product: str) -> None:
    """200 units of 200 lots, each on a stand of its own."""
    pulls: list[list[float]] = []
    seed = 0
    while len(pulls) < 200:
        seed += 1
        twin = unit(product, seed)
        order = {"seed": seed, "stand_seed": 100 + seed, "rate_hz": 25.0, "powered_before_s": 3600.0}
        both = [recorded(product, name, twin=twin, values=VALUES[name], **order) for name in VALUES]
        found = evaluate_stand_profiles(both)
        if found.gyro is None or found.acc is None:  # a lot has units with a dead axis: said, not evaluated
            assert any(word in note.why for note in found.not_used for word in ("dead", "excites"))
            continue
        pulls.append(pulls_of(found, twin, float(both[0].streams["dut"].columns["temp"].mean())))
    assert seed < 230
    # what a table's data sheet leaves open enters whole
    check_coverage(np.array(pulls), more=0.33)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_delays_of_swept_units_are_covered() -> None:
    """200 units up to 8 Hz, where straight lines between their samples of 5 ms are no other dynamics."""
    pulls: list[float] = []
    for seed in range(1, 201):
        twin = product_named("mems_ahrs").twin(seed, "U-0001")
        own = {(one.sensor, one.word): one for one in twin.effects}
        link, filtered = own["gyro", "fixed_delay"], own["gyro", "bandwidth"]
        assert isinstance(link, FixedDelay)
        assert isinstance(filtered, Bandwidth)
        values = {"axis": 1.0, "high_hz": 8.0, "peak_acceleration_deg_s2": 490.0}
        order = {"seed": seed, "stand_seed": 100 + seed, "powered_before_s": 3600.0, "values": values}
        try:
            found = evaluate_by_profile([recorded("mems_ahrs", "sweep", twin=twin, **order)])
        except CalibrationError:  # a dead axis
            continue
        told = {one.name: one for one in found.results[0].content.quantities}
        if "total_delay_x" in told:
            one = told["total_delay_x"]
            pulls.append(
                (one.value - link.delay_s - filtered.time_constant_s) / (one.standard_uncertainty or 0.0)
            )
    assert len(pulls) >= 180
    check_coverage(np.array(pulls), more=0.2)


def turned(seed: int, colour: str) -> float:
    """Pull of a clock's rate: six turns of smooth ramps, each axis with a lag of its own, coloured noise."""
    rng = np.random.default_rng(seed)
    period_s, fast = 0.02, rng.normal(0.0, 3e-5)
    time_s = period_s * np.arange(4500, dtype=np.float64)  # as the unit stamps them
    lags_s = rng.uniform(0.0, 5e-3, 3)

    def rates(at_s: np.ndarray, axis: int) -> np.ndarray:
        found = np.zeros(len(at_s))
        for number in range(6):
            if number // 2 == axis:
                since = np.clip((at_s - 15.0 * number - 4.0) / 7.0, 0.0, 1.0)
                found += (-1) ** number * 6.0 * np.sin(np.pi * since) ** 2
        return found

    true_s = time_s / (1.0 + fast)
    seen = np.stack([rates(true_s - lags_s[k], k) for k in range(3)], axis=1) * 1.003 + 0.002
    seen += white(rng, len(time_s), 3, 1e-8, period_s)
    if colour == "flicker":
        seen += flicker(rng, len(time_s), 3, 3e-5, period_s)
    elif colour == "exponential":
        seen += exponential(rng, len(time_s), 3, 5e-5, 60.0, period_s)
    stand = np.stack([rates(time_s, k) for k in range(3)], axis=1)
    turns = [slice(int((15.0 * n + 3.0) / period_s), int((15.0 * n + 12.0) / period_s)) for n in range(6)]
    found = clock_rate_of_turns(time_s, stand, seen, turns)
    assert found is not None
    return (found.rate - fast) / found.standard_uncertainty


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["white", "flicker", "exponential"])
def test_a_clock_is_told_by_turns_also_on_coloured_noise(colour: str) -> None:
    """What a stand's shape may add is in each uncertainty, and this stand has none."""
    check_coverage(np.array([turned(seed, colour) for seed in range(200)]), more=0.33)


def test_turns_that_cannot_tell_a_clock_tell_none() -> None:
    time_s = 0.02 * np.arange(1000, dtype=np.float64)
    rate = np.zeros((1000, 3))
    rate[:, 2] = 3.0 * np.sin(np.pi * np.clip((time_s - 5.0) / 7.0, 0.0, 1.0)) ** 2
    assert clock_rate_of_turns(time_s, rate, rate, [slice(100, 900)]) is None
    assert clock_rate_of_turns(time_s, rate, rate, []) is None
    assert clock_rate_of_turns(time_s, rate, np.zeros((1000, 3)), [slice(100, 500), slice(500, 900)]) is None
    assert abs(turned(3, "white")) < 4.0

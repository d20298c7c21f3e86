"""Sine sweeps: a delay and a lag made by Fourier sums, coverage, damage, an emulated module with a filter."""

import math

import numpy as np
import pytest

from calibration.algorithms.frequency_response import delay_and_lag, frequency_response
from dut_emulator.effects.dynamics import Bandwidth, ClockDrift, FixedDelay
from dut_emulator.recording.recorder import RecordingOrder, RecordingSession, recorded
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, white

RATE_HZ, REFERENCE_HZ, LENGTH_S = 200.0, 1000.0, 40.0
LOW_HZ, HIGH_HZ, SWEEP_S, GAIN = 0.2, 40.0, 36.0, 1.01
TIME_S = np.arange(round(LENGTH_S * RATE_HZ)) / RATE_HZ
REFERENCE_S = np.arange(round(LENGTH_S * REFERENCE_HZ)) / REFERENCE_HZ


def acted() -> np.ndarray:
    """A logarithmic sweep between two rests, its amplitude bounded in rate and in acceleration."""
    grown = math.log(HIGH_HZ / LOW_HZ) / SWEEP_S
    since = np.clip(REFERENCE_S - 2.0, 0.0, SWEEP_S)
    phase = 2 * math.pi * LOW_HZ * np.expm1(grown * since) / grown
    inside = (REFERENCE_S >= 2.0) & (REFERENCE_S <= 2.0 + SWEEP_S)
    return inside * np.sin(phase) * np.minimum(1.5, 3.0 / (LOW_HZ * np.exp(grown * since)))


def answered(delay_s: float, tau_s: float) -> np.ndarray:
    """Of a unit with this delay and lag, at its sampling times."""
    frequency = np.fft.rfftfreq(4 * len(REFERENCE_S), 1 / REFERENCE_HZ)
    turn = GAIN * np.exp(-2j * math.pi * frequency * delay_s) / (1 + 2j * math.pi * frequency * tau_s)
    whole = np.fft.irfft(np.fft.rfft(acted(), 4 * len(REFERENCE_S)) * turn, 4 * len(REFERENCE_S))
    return whole[: len(REFERENCE_S) : round(REFERENCE_HZ / RATE_HZ)] + 0.02


def true_response(frequency_hz: np.ndarray, delay_s: float, tau_s: float) -> np.ndarray:
    omega = 2 * math.pi * frequency_hz
    return GAIN * np.exp(-1j * omega * delay_s) / (1 + 1j * omega * tau_s)


def noise(seeds: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    slow = exponential(rng, len(TIME_S), seeds, 0.02, 5.0, 1 / RATE_HZ)
    return white(rng, len(TIME_S), seeds, 1e-5, 1 / RATE_HZ) + slow


def test_without_noise_delay_lag_and_bandwidth_are_exact() -> None:
    found = frequency_response(TIME_S, answered(2e-3, 6e-3), REFERENCE_S, acted())
    expected = true_response(found.frequency_hz, 2e-3, 6e-3)
    assert np.abs(found.response / expected - 1).max() < 2e-3
    told = delay_and_lag(found)
    assert told.separated
    assert told.delay_s[0] == pytest.approx(2e-3, abs=3e-5)
    assert told.time_constant_s[0] == pytest.approx(6e-3, abs=3e-5)
    assert told.total_delay_s[0] == pytest.approx(8e-3, abs=1e-5)
    assert told.bandwidth_hz is not None
    assert told.bandwidth_hz[0] == pytest.approx(1 / (2 * math.pi * 6e-3), rel=5e-3)
    assert told.gain[0] == pytest.approx(GAIN, rel=1e-4)


@pytest.mark.parametrize("seeds", [60, pytest.param(200, marks=pytest.mark.slow)])
def test_intervals_hold_in_white_and_slow_noise(seeds: int) -> None:
    clean, reference, disturbed = answered(2e-3, 6e-3), acted(), noise(seeds)
    bands, figures = [], []
    for number in range(seeds):
        found = frequency_response(TIME_S, clean + disturbed[:, number], REFERENCE_S, reference)
        off = found.response - true_response(found.frequency_hz, 2e-3, 6e-3)
        doubt = np.sqrt(found.covariance[:, 0, 0])
        bands.append(np.concatenate([off.real / doubt, off.imag / doubt]))
        told = delay_and_lag(found)
        assert told.separated
        pairs = ((told.total_delay_s, 8e-3), (told.delay_s, 2e-3), (told.time_constant_s, 6e-3))
        pulls = [(value - true) / u for (value, u), true in (*pairs, (told.gain, GAIN))]
        if told.bandwidth_hz is not None:
            pulls.append((told.bandwidth_hz[0] - 26.526) / told.bandwidth_hz[1])
        figures.append(pulls[:4])
    check_coverage(np.array(bands).reshape(-1, 1), less=0.02)
    check_coverage(np.array(figures))


def test_where_a_lag_cannot_be_told_from_a_delay_that_is_said_and_the_sum_holds() -> None:
    """A pure delay of 4 ms: the sum is right; the lag is bounded, not claimed."""
    clean, reference, disturbed = answered(4e-3, 0.0), acted(), noise(40)
    told = [
        delay_and_lag(frequency_response(TIME_S, clean + disturbed[:, n], REFERENCE_S, reference))
        for n in range(40)
    ]
    assert sum(one.separated for one in told) <= 2
    assert all("not told apart" in one.words for one in told if not one.separated)
    assert all(one.bandwidth_hz is None for one in told)
    assert all("where the sweep ends" in one.words for one in told)
    pulls = [(one.total_delay_s[0] - 4e-3) / one.total_delay_s[1] for one in told]
    assert np.mean(np.abs(pulls) < 1.96) > 0.8
    later = delay_and_lag(
        frequency_response(TIME_S, clean, REFERENCE_S, reference), clock_standard_uncertainty_s=1e-3
    )
    assert later.delay_s[1] == pytest.approx(1e-3, rel=0.01)


def test_lost_samples_are_predicted_and_counted_and_damage_is_refused() -> None:
    output, reference = answered(2e-3, 6e-3) + noise(1)[:, 0], acted()
    whole = delay_and_lag(frequency_response(TIME_S, output, REFERENCE_S, reference))
    torn = output.copy()
    torn[[1000, 4000, 4001]] = np.nan
    torn[6000] = 30.0
    kept = np.delete(np.arange(len(TIME_S)), np.arange(2000, 2005))
    found = frequency_response(TIME_S[kept], torn[kept], REFERENCE_S, reference)
    assert [(note.count, note.why.split(",")[0]) for note in found.not_used] == [
        (8, "missing (gaps in time or NaN)"),
        (1, "outliers beyond 8 standard deviations"),
    ]
    again = delay_and_lag(found)
    assert abs(again.total_delay_s[0] - whole.total_delay_s[0]) < whole.total_delay_s[1]
    with pytest.raises(CalibrationError, match="saturated"):
        frequency_response(TIME_S, np.clip(output, -1, 1), REFERENCE_S, reference, range_limit=1.0)
    torn[:200] = np.nan
    with pytest.raises(CalibrationError, match="missing or outliers"):
        frequency_response(TIME_S, torn, REFERENCE_S, reference)
    with pytest.raises(CalibrationError, match="reference has gaps"):
        frequency_response(TIME_S, output, np.delete(REFERENCE_S, 500), np.delete(reference, 500))
    tone = np.sin(2 * math.pi * 5 * REFERENCE_S)
    with pytest.raises(CalibrationError, match="bands"):
        frequency_response(TIME_S, tone[::5], REFERENCE_S, tone)


def test_an_emulated_module_with_a_filter_and_a_late_link() -> None:
    """5 ms of lag, 3 ms of delay and the scale factor of gyro x."""
    order = {
        "values": {"axis": 1.0, "high_hz": 40.0, "peak_acceleration_deg_s2": 490.0},
        "powered_before_s": 3600.0,
    }
    twin = RecordingSession(RecordingOrder("gnc_module", "sweep", **order)).twin
    # its crystal would run 0.5 ms away from the stand's clock in this minute: here they share one
    for effect in (Bandwidth("gyro", 5e-3), FixedDelay("gyro", 3e-3), ClockDrift("gyro", 0.0)):
        twin = twin.with_effect(effect)
    recording = recorded("gnc_module", "sweep", twin=twin, **order)
    dut, stand = recording.stream("dut"), recording.stream("stand")
    found = frequency_response(dut.time_s(), dut.si("gyro_x"), stand.time_s(), stand.si("rate_x"))
    told = delay_and_lag(found)
    assert told.separated
    assert told.total_delay_s[0] == pytest.approx(8e-3, abs=1e-4)
    # The emulated lag and delay run straight between samples 5 ms apart: its transfer function by hand.
    period, tau = 5e-3, 5e-3
    z, kept = np.exp(-2j * math.pi * found.frequency_hz * period), math.exp(-period / tau)
    ramp = (1 - kept) * tau / period
    gain = recording.believed["gyro"]["matrix"][0][0]
    expected = gain * ((1 - ramp) + (ramp - kept) * z) / (1 - kept * z) * (0.4 + 0.6 * z)
    off, doubt = found.response - expected, np.sqrt(found.covariance[:, 0, 0]) + 1e-4
    assert np.sqrt(np.mean(np.abs(off / doubt) ** 2)) < 1.8
    assert told.bandwidth_hz is not None
    falls = np.interp(-gain / math.sqrt(2), -np.abs(expected), found.frequency_hz)
    assert abs(told.bandwidth_hz[0] - falls) < 3.5 * told.bandwidth_hz[1]
    assert told.gain[0] == pytest.approx(gain, abs=4 * told.gain[1] + 3e-4)

"""Bias, bias stability and repeatability: closed forms, coverage in coloured noise, a whole unit."""

import math

import numpy as np
import pytest

from calibration.algorithms.bias_figures import (
    TrueInput,
    bias,
    bias_stability,
    earth_rate_at_rest,
    unknown_earth_rate,
)
from calibration.algorithms.repeatability import bias_repeatability, repeatability
from dut_emulator.recording.recorder import RecordingOrder, RecordingSession, recorded
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, white

SEEDS = 200  # one channel is one record of its own
PERIOD_S, DENSITY = 0.1, 1e-2
EARTH_RAD_S = 7.292115e-5


def nothing(channels: int) -> TrueInput:
    return TrueInput(np.zeros(channels), np.zeros(channels), "nothing acts")


def clock(duration_s: float, period_s: float = PERIOD_S) -> np.ndarray:
    return period_s * np.arange(round(duration_s / period_s))


@pytest.mark.parametrize(("sigma", "tau_s"), [(0.0, 1.0), (0.02, 20.0), (0.03, 300.0)])
def test_the_bias_holds_its_interval_where_the_slow_noise_is_stated(sigma: float, tau_s: float) -> None:
    rng, time_s = np.random.default_rng(1), clock(180.0)
    output = 0.7 + white(rng, len(time_s), SEEDS, DENSITY, PERIOD_S)
    output += exponential(rng, len(time_s), SEEDS, sigma, tau_s, PERIOD_S)
    terms = ((sigma, tau_s),) if sigma else ()
    found = bias(time_s, output, nothing(SEEDS), known_slow=terms)
    check_coverage((found.bias - 0.7) / found.standard_uncertainty)
    # closed form: S / T and the variance of a Gauss-Markov process's mean
    ratio = 180.0 / tau_s
    own = 2 / ratio * (1 - (1 - math.exp(-ratio)) / ratio)
    expected = math.sqrt(DENSITY / 180.0 + sigma**2 * own)
    assert np.sqrt((found.standard_uncertainty**2).mean()) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("sigma", "tau_s"),
    [(0.03, 300.0), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((0.05, 10.0), (0.02, 60.0)))],
)
def test_intervals_hold_where_nobody_stated_the_slow_noise(sigma: float, tau_s: float) -> None:
    """Also with a wander slower than the record, which the data only bound: wide rather than narrow."""
    rng, time_s = np.random.default_rng(2), clock(180.0)
    output = white(rng, len(time_s), SEEDS, DENSITY, PERIOD_S)
    output += exponential(rng, len(time_s), SEEDS, sigma, tau_s, PERIOD_S)
    found = bias(time_s, output, nothing(SEEDS))
    check_coverage(found.bias / found.standard_uncertainty, more=0.3)
    assert np.median(found.standard_uncertainty) < 8 * math.sqrt(DENSITY / 180.0 + sigma**2)


@pytest.mark.parametrize(
    ("sigma", "tau_s"),
    [(0.05, 60.0), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((0.0, 1.0), (0.01, 300.0)))],
)
def test_bias_stability_of_an_hour(sigma: float, tau_s: float) -> None:
    """Expected s^2 of averages: S / 10 s and the slow part's own, less what 360 averages share."""
    rng, period_s = np.random.default_rng(3), 1.0
    time_s = clock(3600.0, period_s)
    output = white(rng, len(time_s), SEEDS, DENSITY, period_s)
    output += exponential(rng, len(time_s), SEEDS, sigma, tau_s, period_s)
    found = bias_stability(time_s, output)
    assert found.averages == 360
    lags = period_s * np.subtract.outer(np.arange(3600), np.arange(3600))
    slow = sigma**2 * np.exp(-np.abs(lags) / tau_s)
    of_averages = slow.reshape(360, 10, 360, 10).mean(axis=(1, 3)) + np.eye(360) * DENSITY / 10.0
    expected = math.sqrt((np.trace(of_averages) - of_averages.sum() / 360) / 359)
    for probability in (0.6827, 0.95):
        low, high = found.interval(probability).T
        covered = np.mean((low < expected) & (expected < high))
        margin = 3.5 * math.sqrt(probability * (1 - probability) / SEEDS)
        assert probability - margin <= covered <= probability + margin + 0.1, (probability, covered)
    if not sigma:
        assert np.median(found.degrees_of_freedom) == pytest.approx(359, rel=0.03)


def test_the_channels_and_the_average_are_those_of_a_hand_computation() -> None:
    time_s = clock(3600.0, 1.0)
    steps = np.repeat(np.where(np.arange(360) % 2, 1.0, -1.0), 10)
    found = bias_stability(time_s, np.column_stack([steps, np.full(3600, 5.0)]), known_slow=())
    np.testing.assert_allclose(found.stability, [math.sqrt(360 / 359), 0.0], atol=1e-12)


def test_repeatability_of_six_runs() -> None:
    values = np.array([[1.0], [2.0], [3.0], [4.0], [5.0], [6.0]])
    found = repeatability(values, np.full((6, 1), 0.1), "each_power_on")
    assert found.repeatability[0] == pytest.approx(math.sqrt(3.5))
    assert found.standard_uncertainty[0] == pytest.approx(math.sqrt(3.5 / 10))
    assert found.beyond_noise[0] == pytest.approx(math.sqrt(3.5 - 0.01))
    assert found.beyond_noise_resolved[0]
    # chi-square with 5 degrees of freedom: 0.8312 and 12.8325 at 2.5 and 97.5 %
    np.testing.assert_allclose(found.interval(0.95)[0], np.sqrt([17.5 / 12.8325, 17.5 / 0.8312]), rtol=1e-4)
    with pytest.raises(CalibrationError, match="5 runs"):
        repeatability(values[:5], np.full((5, 1), 0.1), "same_power_on")


def test_turn_on_repeatability_is_found_behind_the_noise() -> None:
    """Six runs of ten minutes: 95 % intervals of the spread hold the truth; without a spread none is seen."""
    rng, time_s, spread = np.random.default_rng(4), clock(600.0, 1.0), 0.02
    turn_on = rng.standard_normal((6, SEEDS)) * spread
    quiet, turned = (
        [(time_s, part * on + white(rng, 600, SEEDS, DENSITY, 1.0)) for part in turn_on] for on in (0.0, 1.0)
    )
    found, figures = bias_repeatability(turned, nothing(SEEDS), "each_power_on")
    assert len(figures) == 6
    low, high = found.interval(0.95).T
    total = math.hypot(spread, math.sqrt(DENSITY / 600.0))
    assert np.mean((low < total) & (total < high)) == pytest.approx(0.95, abs=3.5 * math.sqrt(0.0475 / SEEDS))
    assert found.beyond_noise_resolved.mean() > 0.95
    alike, _ = bias_repeatability(quiet, nothing(SEEDS), "each_power_on")
    assert alike.beyond_noise_resolved.mean() < 0.12


def test_three_minutes_at_1_hz_are_enough() -> None:
    """Their sixtieth holds three samples; blocks are of four then."""
    rng, time_s = np.random.default_rng(9), clock(180.0, 1.0)
    found = bias(time_s, 0.7 + white(rng, 180, SEEDS, DENSITY, 1.0), nothing(SEEDS), known_slow=())
    check_coverage((found.bias - 0.7) / found.standard_uncertainty)


def test_earth_rate_is_taken_out_or_is_the_uncertainty() -> None:
    time_s, latitude = clock(180.0), math.radians(40.0)
    up = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # x east, y north, z up
    earth = EARTH_RAD_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])
    output = np.random.default_rng(5).normal(size=(len(time_s), 3)) * 1e-7 + earth + 1e-3
    known = bias(time_s, output, earth_rate_at_rest(up, latitude, 1e-3), known_slow=())
    np.testing.assert_allclose(known.bias, 1e-3, atol=1e-7)
    assert known.standard_uncertainty[0] == pytest.approx(EARTH_RAD_S * 1e-3, rel=0.02)
    unknown = bias(time_s, output, unknown_earth_rate(), known_slow=())
    np.testing.assert_allclose(unknown.standard_uncertainty, EARTH_RAD_S / math.sqrt(3), rtol=1e-3)


def test_damage_is_named_and_not_averaged_away() -> None:
    rng, time_s = np.random.default_rng(6), clock(200.0)
    output = rng.normal(size=(len(time_s), 2))
    output[100, 0] = np.nan
    output[300, 1] = 1e4
    output[500, 0] = 50.0
    cut = np.r_[0:700, 705 : len(time_s)]
    found = bias(time_s[cut], output[cut], nothing(2), known_slow=())
    assert np.abs(found.bias).max() < 0.1
    told = {(note.count, note.why) for note in found.not_used}
    assert (1, "missing values (NaN)") in told
    assert (2, "outliers beyond 8 standard deviations") in told
    assert (5, "never came: gaps in time") in told
    clipped = bias(time_s, np.minimum(output, 40.0), nothing(2), range_limit=40.0, known_slow=())
    taken = [note.count for note in clipped.not_used if "saturated" in note.why]
    assert taken[0] == 2  # two samples, and what their blocks hold besides
    assert taken[1] > 50
    with pytest.raises(CalibrationError, match="lasts 179"):
        bias(time_s[:1790], output[:1790], nothing(2))
    with pytest.raises(CalibrationError, match="cannot be used"):
        bias(time_s, np.where(np.arange(2000)[:, None] % 10 < 2, np.nan, output), nothing(2))
    with pytest.raises(CalibrationError, match="does not run forward"):
        bias(time_s[::-1] + 500.0, output, nothing(2), duration_s=-1e9)


def test_an_emulated_module_at_rest() -> None:
    """Bias at 24.8 degC less the Earth rate, in three units; its instability and turn-on are stated."""
    pulls = []
    for number in range(3):
        order = {"serial": f"B-{number}", "values": {"duration_s": 200.0}, "powered_before_s": 3600.0}
        recording = recorded("gnc_module", "static", **order)
        twin = RecordingSession(RecordingOrder("gnc_module", "static", **order)).twin
        effects = {effect.word: effect for effect in twin.effects if effect.sensor == "gyro"}
        stream = recording.stream("dut")
        attitude = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # heading 0: x is east
        earth = earth_rate_at_rest(attitude, math.radians(recording.site["latitude_deg"]))
        sigma = max(effects["bias_instability"].standard_deviation_si)
        found = bias(
            stream.time_s(), stream.si("gyro_x", "gyro_y", "gyro_z"), earth, known_slow=((sigma, 300.0),)
        )
        warm = stream.si("temp").mean() - 25.0
        slope = np.array(effects["bias_temperature"].coefficients_si_per_c)
        pulls.append((found.bias - effects["bias"].bias_si - slope[0] * warm) / found.standard_uncertainty)
    assert np.abs(pulls).max() < 3.5
    assert np.sqrt(np.mean(np.square(pulls))) < 1.6

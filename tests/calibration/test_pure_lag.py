"""Pure lag against figures computed independently from the physics (paper 3 and what it should say)."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.algorithms.impact_detection import (
    detect_impact,
    detection_delay_s,
    false_alarm_probability,
)
from calibration.algorithms.pure_lag import PAPER_STAMPS, TimeStamps, paper_bounds, pure_lag
from calibration.algorithms.pure_lag_shots import (
    confidence,
    next_frame_after_impact_s,
    paper_confidence,
    paper_rule_confidence,
    paper_shots_needed,
    programmed_shots_needed,
    shots_needed,
)
from protocol.errors import CalibrationError

FRAME_S = 500e-6
US = 1e-6
# K, delta (us), eq (22) as printed, P(half width <= delta), P(|error| <= delta)
CLOSED_FORM = [
    (2, 25.0, 0.01, 0.01, 0.19),
    (20, 25.0, 0.851855008, 0.608253002, 0.878423345),
    (31, 25.0, 0.9906596, 0.830435367, 0.961847958),
    (44, 25.0, 0.999925716, 0.942891103, 0.990302263),
    (65, 25.0, 0.999999999, 0.991275263, 0.998938883),
    (100, 5.0, 0.861985442, 0.596728289, 0.867380444),
    (6993, 0.1085, 0.989996688, 0.806077632, 0.951955172),
    (6994, 0.1085, 0.990009855, 0.806140943, 0.951976023),
]
# delta (us): as printed, for the half width, for the mid-point
SHOTS_FOR_99 = {25.0: (31, 64, 44), 5.0: (153, 330, 228), 0.1085: (6994, 15293, 10609)}
# K, delta, lag (us): a million simulated sessions: paper's rule, the range's, no bracket, mid-point's error
MONTE_CARLO = [
    (31, 25.0, 242.23, 0.83056, 0.83056, 0.0, 0.96175),
    (31, 25.0, 5.0, 0.25494, 0.83074, 0.7319, 0.96183),
    (31, 25.0, 495.0, 0.25479, 0.8302, 0.73196, 0.96202),
    (31, 25.0, 1742.23, 0.8306, 0.8306, 0.0, 0.96193),
    (20, 25.0, 347.55, 0.60725, 0.60725, 0.00072, 0.87809),
    (100, 5.0, 242.23, 0.59678, 0.59678, 0.0, 0.86762),
]
# the lag's part of a frame: paper's rule, no bracket, for K = 31 and 25 us
STRICT = {
    0.0: (0.0, 1.0),
    0.01: (0.25455537, 0.73230337),
    0.02: (0.43914285, 0.53457463),
    0.05: (0.73038688, 0.20390683),
    0.1: (0.83043537, 0.03815204),
    0.3: (0.83043537, 1.578e-05),
    0.5: (0.83043537, 0.0),
    0.99: (0.25455537, 0.73230337),
}


def _stamps(rng: np.random.Generator, lag_s: float, shots: int) -> tuple[np.ndarray, np.ndarray]:
    """First frame at or after the lag, frames at phase b after the impact: stamps and frame numbers."""
    phase = rng.uniform(0.0, FRAME_S, shots)
    number = np.ceil((lag_s - phase) / FRAME_S).clip(min=0).astype(int)
    return phase + number * FRAME_S, number + 1


def test_bounds_hold_for_shots_of_both_classes_and_of_one() -> None:
    delays = np.array([612.4, 251.1, 733.9, 402.55, 245.17, 739.3, 498.8, 560.01]) * US
    found = pure_lag(delays, FRAME_S, None)
    assert (found.upper_s, found.lower_s) == pytest.approx((245.17 * US, 239.30 * US), rel=1e-9)
    assert (found.lag_s, found.half_width_s) == pytest.approx((242.235 * US, 2.935 * US), rel=1e-9)
    beside = paper_bounds(delays, FRAME_S, np.where(delays < FRAME_S, 1, 2))
    assert beside.half_width_s == pytest.approx(2.935 * US)  # printed: 2.96 (eq (29))
    one_class = np.array([1251.1, 1402.55, 1245.17, 1498.8, 1320.0]) * US
    found = pure_lag(one_class, FRAME_S, None)
    assert (found.upper_s, found.lower_s) == pytest.approx((1245.17 * US, 998.8 * US), rel=1e-9)
    assert (found.lag_s, found.half_width_s) == pytest.approx((1121.985 * US, 123.185 * US), rel=1e-9)
    assert paper_bounds(one_class, FRAME_S, np.full(5, 3)).lag_s is None
    # Gyro B: eq (32)-(36)
    found = pure_lag(np.array([358.26, 836.84]) * US, FRAME_S, None)
    assert (found.lag_s, found.half_width_s) == pytest.approx((347.55 * US, 10.71 * US), rel=1e-9)


@pytest.mark.parametrize(("shots", "delta_us", "printed", "half_width", "mid_point"), CLOSED_FORM)
def test_confidence_of_shots(
    shots: int, delta_us: float, printed: float, half_width: float, mid_point: float
) -> None:
    assert confidence(shots, delta_us * US, FRAME_S) == pytest.approx(half_width, abs=1e-9)
    assert confidence(shots, delta_us * US, FRAME_S, "mid_point") == pytest.approx(mid_point, abs=1e-9)
    assert paper_confidence(shots, delta_us * US, FRAME_S) == pytest.approx(printed, abs=1e-9)


def test_number_of_shots() -> None:
    for delta_us, (printed, half_width, mid_point) in SHOTS_FOR_99.items():
        assert paper_shots_needed(delta_us * US, FRAME_S) == printed
        assert shots_needed(delta_us * US, FRAME_S) == half_width
        assert shots_needed(delta_us * US, FRAME_S, aim="mid_point") == mid_point
    # Printed eq (38) says 6993: with the stamp's exact resolution, 108.53 ns, eq (22) gives that.
    assert PAPER_STAMPS.resolution_s == pytest.approx(0.10853022858363598 * US, rel=1e-12)
    assert paper_confidence(6993, PAPER_STAMPS.resolution_s, FRAME_S) == pytest.approx(0.9900223255, abs=1e-9)
    assert programmed_shots_needed(25 * US, FRAME_S) == 5
    assert programmed_shots_needed(0.1085 * US, FRAME_S) == 13
    assert programmed_shots_needed(25 * US, FRAME_S, 5 * US) == 5
    with pytest.raises(CalibrationError, match="for certain"):
        programmed_shots_needed(25 * US, FRAME_S, 25 * US)
    with pytest.raises(CalibrationError, match="More than"):
        shots_needed(1e-15, FRAME_S)
    with pytest.raises(CalibrationError, match="between 0 and 1"):
        shots_needed(25 * US, FRAME_S, 1.0)
    with pytest.raises(CalibrationError, match="no plan"):
        confidence(0, 25 * US, FRAME_S)


def test_what_the_papers_rule_truly_reaches_near_a_frame_edge() -> None:
    for part, expected in STRICT.items():
        found = paper_rule_confidence(31, 25 * US, FRAME_S, part * FRAME_S)
        assert found == pytest.approx(expected, abs=1e-8)
    for shots, delta_us, lag_us, paper_rule, by_range, empty, within in MONTE_CARLO:
        tolerance = 5 * 0.5 / math.sqrt(1e6)
        found = paper_rule_confidence(shots, delta_us * US, FRAME_S, lag_us * US)
        assert found == pytest.approx((paper_rule, empty), abs=tolerance)
        assert confidence(shots, delta_us * US, FRAME_S) == pytest.approx(by_range, abs=tolerance)
        of_mid_point = confidence(shots, delta_us * US, FRAME_S, "mid_point")
        assert of_mid_point == pytest.approx(within, abs=tolerance)


def test_sessions_reach_what_is_stated_and_intervals_cover() -> None:
    """2000 sessions of 31 shots at a lag near a frame's edge, where the printed rule fails."""
    rng, sessions, lag_s = np.random.default_rng(3), 2000, 5 * US
    narrow = covered = within = no_bracket = 0
    for _ in range(sessions):
        delays, numbers = _stamps(rng, lag_s, 31)
        found = pure_lag(delays, FRAME_S, None)
        assert found.lower_s <= lag_s <= found.upper_s
        # A lower bound cut at 0 is better than the uncut one that the closed form is for.
        half = (delays.min() - delays.max() + FRAME_S) / 2
        narrow += half <= 25 * US
        within += abs((delays.min() + delays.max() - FRAME_S) / 2 - lag_s) <= 25 * US
        no_bracket += paper_bounds(delays, FRAME_S, numbers).lag_s is None
        other = pure_lag(_stamps(rng, 242.23 * US, 31)[0], FRAME_S, None)
        covered += abs(other.lag_s - 242.23 * US) <= 0.95 * math.sqrt(3) * other.standard_uncertainty_s
    for count, expected in ((narrow, 0.8304), (within, 0.9618), (no_bracket, 0.7323), (covered, 0.95)):
        assert count / sessions == pytest.approx(expected, abs=4 * math.sqrt(0.25 / sessions))


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.0, 3000e-6),
    st.integers(2, 40),
    st.sampled_from(["down", "nearest"]),
    st.integers(0, 2**32 - 1),
)
def test_bounds_hold_the_lag_through_counted_stamps(lag_s: float, shots: int, way: str, seed: int) -> None:
    stamps = TimeStamps(rounding=way)
    delays, _ = _stamps(np.random.default_rng(seed), lag_s, shots)
    counts = delays / stamps.resolution_s
    counted = stamps.seconds((np.floor(counts) if way == "down" else np.round(counts)).astype(np.int64))
    found = pure_lag(counted, FRAME_S, stamps)
    assert found.lower_s <= lag_s <= found.upper_s
    assert found.half_width_s <= FRAME_S / 2 + stamps.resolution_s
    more = pure_lag(np.append(counted, counted[0]), FRAME_S, stamps)
    assert (more.upper_s, more.lower_s) == (found.upper_s, found.lower_s)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.0, 3000e-6), st.integers(0, 2**32 - 1))
def test_programmed_instants_halve_the_bracket(lag_s: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted, error_s = 10 * US, 2 * US
    delays, _ = _stamps(rng, lag_s, 1)
    shots = programmed_shots_needed(wanted, FRAME_S, error_s)
    bounds = pure_lag(np.repeat(delays, 2), FRAME_S, None)
    for _ in range(shots - 1):
        phase = (next_frame_after_impact_s(bounds, FRAME_S) + rng.uniform(-error_s, error_s)) % FRAME_S
        later = phase + FRAME_S * max(math.ceil((lag_s - phase) / FRAME_S), 0)
        delays = np.append(delays, later)
        bounds = pure_lag(delays, FRAME_S, None)
    assert bounds.half_width_s <= wanted * (1 + 1e-9)
    assert bounds.lower_s - 1e-15 <= lag_s <= bounds.upper_s + 1e-15


def test_stamps_that_bound_nothing_are_refused() -> None:
    full = PAPER_STAMPS.seconds(np.array([32767, 31000, 30000]))
    with pytest.raises(CalibrationError, match=r"1 of 3 stamps are at the end of the timer, 3\.556 ms"):
        pure_lag(full, FRAME_S)
    with pytest.raises(CalibrationError, match="no single lag fits"):
        pure_lag(np.array([240.0, 760.0]) * US, FRAME_S)
    with pytest.raises(CalibrationError, match="missing or negative"):
        pure_lag(np.array([240 * US, np.nan]), FRAME_S)
    with pytest.raises(CalibrationError, match="not 1"):
        pure_lag(np.array([240 * US]), FRAME_S)
    with pytest.raises(CalibrationError, match="frame period"):
        pure_lag(np.array([240, 300]) * US, 0.0)


def test_five_sigma_and_what_it_adds_to_the_lag() -> None:
    rng = np.random.default_rng(1)
    outputs = 2000 + 200 * rng.standard_normal(400)
    outputs[300:] += 8000 * (1 - np.exp(-np.arange(100) / 2.0))
    found = detect_impact(outputs, 290)
    assert found.frame == 301
    assert found.rest_deviation == pytest.approx(200, rel=0.15)
    assert found.early_probability == pytest.approx(11 * 5.733e-7, rel=1e-3)
    assert found.late_probability < 0.5
    assert false_alarm_probability(2_000_000) == pytest.approx(0.682, abs=1e-3)
    assert detection_delay_s(10_000, 200, 1e-3) == pytest.approx(-1e-3 * math.log(0.9))
    assert detection_delay_s(-2_000, 200, 1e-3) == pytest.approx(1e-3 * math.log(2))
    for broken, frame, words in (
        (outputs[:300], 290, "strike harder"),
        (outputs, 5, "start recording earlier"),
        (np.where(np.arange(400) < 290, 2000.0, outputs), 290, "stuck"),
        (np.append(outputs, np.nan), 290, "not all there"),
    ):
        with pytest.raises(CalibrationError, match=words):
            detect_impact(broken, frame)
    with pytest.raises(CalibrationError, match="does not pass"):
        detection_delay_s(1000, 200, 1e-3)

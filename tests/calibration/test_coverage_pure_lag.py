"""Pure lag: bounds that hold, the lag evenly between them: emulated gyros, and noise of another code."""

import json

import numpy as np
import pytest

from calibration.algorithms.impact_detection import detect_impact, latest_detection_s
from calibration.algorithms.pure_lag import TimeStamps, pure_lag
from calibration.evaluations.impact import evaluate_impact
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import twin_text
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import exponential, flicker, white

FRAME_S, TAU_S, LATENCY_S = 500e-6, 53e-6, 0.1e-6
"""Latency: of a rig's trigger; nothing in a recording tells it."""


def check_even(error_parts: np.ndarray) -> None:
    """(lag - mid-point) / half width: within p of the bounds with probability p, at all p."""
    number = len(error_parts)
    for stated in (0.6827, 0.95):
        covered = (np.abs(error_parts) <= stated).mean()
        assert abs(covered - stated) < 3.5 * np.sqrt(stated * (1 - stated) / number), (stated, covered)


@pytest.mark.slow
def test_emulated_gyros_are_covered() -> None:
    """200 gyros of both types, each on a rig of its own; 8 shots each."""
    parts = []
    for seed in range(1, 201):
        serial = f"{'UB'[seed % 2]}-0001"
        values = {"shots": 8, "spacing_s": 1.2}
        recording = recorded("fog", "impact", values=values, seed=seed, stand_seed=500 + seed, serial=serial)
        twin = json.loads(twin_text(product_named("fog").twin(seed, serial)))
        (lag_s,) = (
            effect["parameters"]["delay_s"]["value"]
            for effect in twin["effects"]
            if effect["effect"] == "link.fixed_delay"
        )
        (one,) = evaluate_impact((recording,)).results[0].content.quantities
        assert one.interval is not None
        low, high = one.interval.lower, one.interval.upper
        assert low - LATENCY_S <= lag_s <= high + LATENCY_S
        assert one.standard_uncertainty == pytest.approx((high - low) / np.sqrt(12))
        parts.append((lag_s - one.value) / (0.5 * (high - low)))
    check_even(np.array(parts))


def shots(
    rng: np.random.Generator, lag_s: float, count: int, step: float, colour: str
) -> tuple[np.ndarray, float]:
    """Stamps of the frames that show the impact, and the weakest peak; noise of 200 counts."""
    stamps = TimeStamps()
    delays, peaks = [], []
    for _ in range(count):
        frames = 200
        if colour == "white":
            noise = white(rng, frames, 1, FRAME_S, FRAME_S)[:, 0]
        elif colour == "flicker":
            noise = flicker(rng, frames, 1, 0.7, FRAME_S)[:, 0]
            noise += 0.7 * white(rng, frames, 1, FRAME_S, FRAME_S)[:, 0]
        else:
            noise = exponential(rng, frames, 1, 1.0, 4 * FRAME_S, FRAME_S)[:, 0]
        first = 150
        since = rng.uniform(0.0, FRAME_S) + FRAME_S * (np.arange(frames) - first)  # of the trigger
        response = step * -np.expm1(-np.maximum(since - lag_s, 0.0) / TAU_S)
        seen = detect_impact(np.rint(2000 + 200 * noise + response), first)
        count_of_stamp = np.floor(since[seen.frame] / stamps.resolution_s)
        delays.append(count_of_stamp * stamps.resolution_s)
        peaks.append(seen.peak / seen.rest_deviation)
    return np.array(delays), min(peaks)


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["white", "flicker", "exponential"])
def test_bounds_are_covered_on_coloured_noise(colour: str) -> None:
    """Impacts from 25 to 1000 standard deviations; lags of up to five frames."""
    rng = np.random.default_rng(5)
    parts = []
    for _ in range(200):
        lag_s, step = rng.uniform(0.0, 5 * FRAME_S), 200 * 10 ** rng.uniform(np.log10(60), 3)
        delays, weakest = shots(rng, lag_s, 8, step, colour)
        found = pure_lag(delays, FRAME_S, TimeStamps(), latest_detection_s(weakest, TAU_S))
        assert found.lower_s <= lag_s <= found.upper_s
        parts.append((lag_s - found.lag_s) / found.half_width_s)
    check_even(np.array(parts))


def test_a_weak_impact_is_allowed_its_rise() -> None:
    """22 standard deviations: without the allowance a bound that is 'for certain' would not hold."""
    rng = np.random.default_rng(9)
    outside = 0
    for _ in range(10):
        lag_s = rng.uniform(0.0, 3 * FRAME_S)
        delays, weakest = shots(rng, lag_s, 60, 200 * 24, "white")
        found = pure_lag(delays, FRAME_S, TimeStamps(), latest_detection_s(weakest, TAU_S))
        assert found.lower_s <= lag_s <= found.upper_s
        try:
            bare = pure_lag(delays, FRAME_S, TimeStamps())
            outside += not bare.lower_s <= lag_s <= bare.upper_s
        except CalibrationError:
            outside += 1
    assert outside > 2

"""Stated intervals of the overload test: emulated units, and counters of coloured noise from code of its own.

What is stated of the rig (level, scale factors) enters as a bound on the whole of it, so intervals may hold
more than they say; they must never hold less.
"""

import json
import math

import numpy as np
import pytest

from calibration.algorithms.overload_g_sensitivity import GyroRun, response_of_run
from calibration.algorithms.overload_motion import half_cycles_from_grating, pulses_of_halves
from calibration.algorithms.pulse_timing import PulseCounters, SlideMotion, response_by_pulse_times
from calibration.evaluations.overload import evaluate_overload
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from dut_emulator.twin import twin_text
from tests.calibration.shaped_noise import check_coverage, exponential, flicker, white

G, RADIUS_M, PERIOD_S = 9.80665, 0.15, 1e-3
ARC_SECOND = math.radians(1 / 3600)
PULSE_RAD = ARC_SECOND
D_TRUE = math.radians(5e-4) / G


def slide(overload_g: float, cycles: float, ratio: float, phase: float, fine: int):
    """Times, position, speed and acceleration of a slider-crank, by complex steps of its own geometry."""
    omega = math.sqrt(overload_g * G / RADIUS_M)
    time_s = np.arange(0.0, cycles * 2 * math.pi / omega, PERIOD_S / fine)
    angle = omega * time_s + phase
    sin, cos = np.sin(angle), np.cos(angle)
    rod = np.sqrt(1.0 - (ratio * sin) ** 2)
    position = RADIUS_M * (cos + (rod - 1.0) / ratio)
    speed = -RADIUS_M * omega * (sin + ratio * sin * cos / rod)
    bend = np.cos(2 * angle) / rod + (ratio * sin * cos) ** 2 / rod**3
    return time_s, position, speed, -RADIUS_M * omega**2 * (cos + ratio * bend)


def gyro_pulses(rng: np.random.Generator, cycles: float, rate: float, guide_rad: float, fine: int = 4):
    """Grating and counters of one gyro: white, flicker and exponential noise, cut to whole pulses."""
    time_s, position, speed, acceleration = slide(
        12.0, cycles, rng.uniform(0.05, 0.3), rng.uniform(0, 6.28), fine
    )
    step_s = PERIOD_S / fine
    count = len(time_s)
    noise = white(rng, count, 1, (5e-5 * math.pi / 180) ** 2, step_s)
    noise += flicker(rng, count, 1, math.radians(0.02 / 3600), step_s)
    noise += exponential(rng, count, 1, math.radians(0.01 / 3600), 0.3, step_s)
    turning = guide_rad * (1.0 + 0.5 * position / RADIUS_M) * speed / RADIUS_M
    pulse_rate = (rate + D_TRUE * acceleration + turning + noise[:, 0]) / PULSE_RAD
    up = np.floor(np.cumsum(np.maximum(pulse_rate, 0.0)) * step_s + rng.uniform())
    down = np.floor(np.cumsum(np.maximum(-pulse_rate, 0.0)) * step_s + rng.uniform())
    read = slice(0, None, fine)
    grating = position[read] + rng.normal(0.0, 3e-8, len(position[read]))
    return time_s[read], grating, up[read], down[read]


def pulls_of(rng: np.random.Generator, cycles: float, guide_rad: float) -> tuple[float, float]:
    """By the instants of the pulses, and by their sums."""
    rate = math.radians(rng.normal(0.0, 6e-3))
    time_s, grating, up, down = gyro_pulses(rng, cycles, rate, guide_rad)
    motion = half_cycles_from_grating(time_s[4:-4], grating[4:-4])
    inside = (time_s >= motion.cut_s[0]) & (time_s <= motion.cut_s[-1])
    at = time_s[inside]
    half_way = at[0] + 0.5 * PERIOD_S * np.arange(2 * len(at) - 1)
    position, speed, acceleration = motion.slide(half_way)
    timed = response_by_pulse_times(
        PulseCounters(
            PERIOD_S, up[inside], down[inside], np.searchsorted(motion.cut_s[::2], at, side="right")
        ),
        SlideMotion(acceleration, speed, position / motion.amplitude_m, motion.amplitude_m),
    )
    net = np.repeat((up - down)[:, None], 3, axis=1)
    sums = response_of_run(
        GyroRun(np.array([1.0, 0, 0]), motion.half_cycles, pulses_of_halves(motion.cut_s, time_s, net)),
        np.full(3, 1.0 / PULSE_RAD),
    )
    by_sums = (sums.response[0] - D_TRUE) / math.sqrt(sums.variance[0])
    if timed is None:
        return math.nan, by_sums
    # one pole in which the readings of this generator lag: half of a fine step
    variance = timed.response_variance + (timed.response_per_delay * PERIOD_S / 8) ** 2
    return (timed.response_pulse_s_m * PULSE_RAD - D_TRUE) / (math.sqrt(variance) * PULSE_RAD), by_sums


@pytest.mark.parametrize("guide_rad", [0.0, 2.5 * ARC_SECOND])
def test_instants_of_pulses_tell_g_sensitivity_and_sums_do_not_understate(guide_rad: float) -> None:
    rng = np.random.default_rng(5)
    pulls = np.array([pulls_of(rng, 10.5, guide_rad) for _ in range(10)])
    told = pulls[np.isfinite(pulls[:, 0]), 0]
    assert len(told) >= 7
    assert np.abs(told).max() < 4.0
    assert 0.4 < np.sqrt(np.mean(told**2)) < 1.8
    assert np.abs(pulls[:, 1]).max() < 3.0


@pytest.mark.slow
def test_g_sensitivity_is_covered_on_coloured_noise() -> None:
    rng = np.random.default_rng(11)
    pulls = np.array([pulls_of(rng, 10.5, rng.normal(0.0, 3.0 * ARC_SECOND)) for _ in range(200)])
    told = pulls[np.isfinite(pulls[:, 0]), 0]
    assert len(told) > 150
    check_coverage(told)
    check_coverage(pulls[:, 1], more=1.0)


def test_pulses_in_step_with_the_cycles_do_not_pass_for_certain() -> None:
    """Three pulses a cycle, cut at the same place of a pulse each time: no scatter at all."""
    time_s, position, _, acceleration = slide(12.0, 40.3, 0.2, 0.4, 8)
    omega = math.sqrt(12.0 * G / RADIUS_M)
    pulse_rate = 3.0 * omega / (2 * math.pi) + D_TRUE / PULSE_RAD * acceleration
    whole = np.floor(np.cumsum(pulse_rate) * PERIOD_S / 8 + 0.37)
    read = slice(0, None, 8)
    motion = half_cycles_from_grating(time_s[read], position[read])
    net = np.repeat(whole[read][:, None], 3, axis=1)
    halves = pulses_of_halves(motion.cut_s, time_s[read], net)
    assert np.ptp(halves[:, 0, 0]) < 0.2
    found = response_of_run(
        GyroRun(np.array([1.0, 0, 0]), motion.half_cycles, halves), np.full(3, 1.0 / PULSE_RAD)
    )
    error = abs(float(found.response[0]) - D_TRUE)
    scatter = halves[:, 0, 0].std() / math.sqrt(40) * PULSE_RAD / motion.half_cycles.speed_change_m_s[0, 0]
    assert error > 10 * scatter
    assert error < 2 * math.sqrt(found.variance[0])


@pytest.mark.slow
def test_emulated_units_are_covered() -> None:
    """200 units on 200 rigs; a third of them along each axis, half of them on a slider-crank."""
    pulls: dict[str, list[float]] = {"acc_asymmetry": [], "acc_odd": [], "gyro": []}
    for seed in range(1, 201):
        axis = seed % 3 + 1
        values = {"overload_g": 12.0, "cycles": 8.0, "axis": float(axis), "crank": float(seed % 2)}
        recording = recorded("pulse_imu", "overload", values=values, seed=seed, stand_seed=1000 + seed)
        twin = json.loads(twin_text(product_named("pulse_imu").twin(seed, "U-0001")))
        true = {
            (effect["effect"], name): one["value"]
            for effect in twin["effects"]
            for name, one in effect["parameters"].items()
        }
        letter = "xyz"[axis - 1]
        named = {
            "scale_factor_asymmetry": (
                "acc_asymmetry",
                true["acc.scale_factor_asymmetry", f"asymmetry_{letter}"],
            ),
            "odd_quadratic_nonlinearity": (
                "acc_odd",
                true["acc.odd_quadratic_nonlinearity", f"odd_square_{letter}"],
            ),
        }
        for row in "xyz":
            named[f"g_sensitivity_{row}{letter}"] = ("gyro", true["gyro.g_sensitivity", f"acc_{row}{letter}"])
        for result in evaluate_overload((recording,)).results:
            for one in result.content.quantities:
                kind, value = named[one.name]
                assert one.standard_uncertainty is not None
                pulls[kind].append((one.value - value) / one.standard_uncertainty)
    assert len(pulls["gyro"]) > 570
    for kind, each in pulls.items():
        check_coverage(np.array(each), more=0.2), kind


@pytest.mark.slow
def test_one_g_on_the_rig_agrees_with_a_static_tumble() -> None:
    """Paper 5, 5.3.2: x up, down and level from the counters of six positions; the rig at 1 g beside it."""
    for seed in range(1, 7):
        rest = recorded("pulse_imu", "multi_position", values={"dwell_s": 10.0}, seed=seed)
        dut, stand = rest.streams["dut"], rest.streams["stand"]
        at = dut.time_s()
        still = (
            np.interp(at, stand.time_s(), np.abs(stand.si("rate_x", "rate_y", "rate_z")).max(axis=1)) < 1e-6
        )
        force = np.stack([np.interp(at, stand.time_s(), stand.si(f"acc_{axis}")) for axis in "xyz"])
        net = dut.si("pulse_acc_x_pos") - dut.si("pulse_acc_x_neg")
        up, down = (net[still & (way * force[0] > 9.7)].mean() for way in (1, -1))
        level = np.mean([net[still & (way * force[axis] > 9.7)].mean() for axis in (1, 2) for way in (1, -1)])
        tumbled = (up + down - 2 * level) / (up - down)
        twin = json.loads(twin_text(product_named("pulse_imu").twin(seed, "U-0001")))
        (true,) = (
            effect["parameters"]["asymmetry_x"]["value"]
            for effect in twin["effects"]
            if effect["effect"] == "acc.scale_factor_asymmetry"
        )
        values = {"overload_g": 1.0, "cycles": 5.0, "axis": 1.0}
        found = evaluate_overload((recorded("pulse_imu", "overload", values=values, seed=seed),))
        shaken = found.results[0].content.quantities[0]
        assert shaken.standard_uncertainty is not None
        assert tumbled == pytest.approx(true, abs=3e-5)
        assert abs(shaken.value - tumbled) < 2.5 * shaken.standard_uncertainty

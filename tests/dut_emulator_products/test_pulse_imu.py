"""The pulse IMU against paper 5's oracle before pulses are cut, and back through the calibration after.

The vectors were computed from the physics by a program of their own; their K1 is 1000 pulses per (g s).
"""

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from calibration.algorithms.sinusoidal_overload import (
    HalfCycles,
    KnownAccelerometer,
    joint_solve,
)
from dut_emulator.effects.catalogue import effect_named
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.products.product import UnitOnStand
from dut_emulator.products.pulse_imu.half_waves import half_wave_integrals
from dut_emulator.products.pulse_imu.product import COLUMNS, PRODUCT
from dut_emulator.products.pulse_imu.pulse_sensors import PulseSensors, SampleGrid
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.sinusoidal_overload_rig.drive import Drive
from dut_emulator.stands.sinusoidal_overload_rig.rig import SinusoidalOverloadRig
from dut_emulator.twin import Twin
from protocol.bench_description import Site

VECTORS = json.loads((Path(__file__).parent / "vectors_sinusoidal_overload.json").read_text(encoding="utf-8"))
TRUTH = VECTORS["params"]
SLIDER_CRANKS = {row["lam"]: row for row in VECTORS["traps"]["slider_crank_A0_10g"]}
G, DEG = 9.80665, math.pi / 180
SITE = Site(latitude_deg=40.0, gravity_m_s2=G)
ACC_PULSES_PER_G_S, GYRO_PULSES_PER_DEG = 10_000.0, 3600.0  # the product's data sheet
TO_VECTORS = TRUTH["K1"] / ACC_PULSES_PER_G_S


EVEN = Drive(inertia_kg_m2=1e12)
"""A flywheel that lets no slide change its speed, as in the vectors."""


def overload_run(drive: Drive = EVEN, **given):
    return SinusoidalOverloadRig(SITE, drive=drive).run("overload", profile_named("overload").values(given))


def sensors_of(rate_hz: float, *effects) -> PulseSensors:
    chains = {triad: tuple(e for e in effects if e.sensor == triad) for triad in ("acc", "gyro")}
    return PulseSensors(chains, SampleGrid(0.0, 1.0 / rate_hz, 0.0), np.random.SeedSequence(1))


def net_at(sensors: PulseSensors, run, times_s) -> np.ndarray:
    """Uncut positive less negative pulses at these moments, (n, 6)."""
    return np.array([sensors.integrals(run.stimulus, t) @ [1.0, -1.0] for t in times_s])


def paper_accelerometer():
    """Coefficients of the vectors on all three axes."""
    return (
        effect_named("acc.odd_quadratic_nonlinearity", odd_square=(TRUTH["K2"] / G,) * 3),
        effect_named("acc.bias", bias_si=(TRUTH["K0"] * G,) * 3),
        effect_named("acc.scale_factor_asymmetry", asymmetry=(TRUTH["Kax"],) * 3),
    )


@pytest.mark.parametrize("case", VECTORS["cases"], ids=lambda case: f"{case['A0_g']}g")
@pytest.mark.parametrize("axis", [1, 2, 3])
def test_half_cycle_sums_before_they_are_cut(case, axis: int) -> None:
    run = overload_run(overload_g=case["A0_g"], axis=axis, cycles=1)
    sums = np.diff(net_at(sensors_of(1000.0, *paper_accelerometer()), run, run.trigger_times_s), axis=0)
    sums = sums[:, axis - 1] * TO_VECTORS
    np.testing.assert_allclose(sums, [case["Nplus"], case["Nminus"]], rtol=1e-8, atol=1e-6)
    change, squared = case["dV_gs"], case["S_g2s"]
    asymmetry = (sums.sum() / TRUTH["K1"] - TRUTH["K0"] * case["T_s"]) / (2 * change)
    assert asymmetry == pytest.approx(case["Kax_est"], rel=2e-5)
    assert (sums[0] - sums[1]) / TRUTH["K1"] - 2 * change == pytest.approx(
        2 * squared * case["K2_est"], rel=1e-3
    )


def test_gyro_half_cycle_sums_before_they_are_cut() -> None:
    case = VECTORS["gyro"]
    run = overload_run(overload_g=case["A0_g"], cycles=1)
    earth = run.stimulus(np.zeros(1)).channel("rate_rad_s")[0, 0]
    matrix = ((case["D1x"] * DEG / G, case["D2x"] * DEG / G, 0.0), (0.0,) * 3, (0.0,) * 3)
    constant = (case["D0x"] + case["omega_x"]) * DEG - earth
    sensors = sensors_of(
        1000.0,
        effect_named("gyro.g_sensitivity", acc=matrix),
        effect_named("gyro.bias", bias_si=(constant,) * 3),
    )
    sums = np.diff(net_at(sensors, run, run.trigger_times_s), axis=0)[:, 3]
    np.testing.assert_allclose(sums, [case["Wplus"], case["Wminus"]], rtol=1e-6)


def exact_half_cycles(run) -> HalfCycles:
    """T, V, S of the first cycle by adaptive quadrature of the slider-crank's textbook form at even speed."""
    edges = run.trigger_times_s[:3]
    omega, r, ratio = run.speed_rad_s, 0.15, 0.2

    def position(t):
        return r * np.cos(omega * t) + r / ratio * np.sqrt(1 - (ratio * np.sin(omega * t)) ** 2)

    def force(t):
        h = 2e-2 / omega  # eighth-order central difference
        c = (-205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560)
        pairs = [position(t + k * h) + position(t - k * h) for k in range(5)]
        return (c[0] * pairs[0] / 2 + np.dot(c[1:], pairs[1:])) / h**2

    halves = list(itertools.pairwise(edges))
    change = [abs(quad(force, *half, epsabs=1e-12)[0]) for half in halves]
    squared = [quad(lambda t: force(t) ** 2, *half, epsabs=1e-10)[0] for half in halves]
    return HalfCycles(np.diff(edges)[np.newaxis], np.array([change]), np.array([squared]))


def test_a_slider_crank_is_no_sinusoid() -> None:
    row = SLIDER_CRANKS[0.2]
    run = overload_run(overload_g=10.0, crank=1, rod_ratio=0.2, cycles=1)
    halves = exact_half_cycles(run)
    assert halves.duration_s[0, 0] / halves.duration_s.sum() == pytest.approx(row["Tp_over_T"], abs=2e-5)
    np.testing.assert_allclose(halves.squared_m2_s3[0] / G**2, [row["Sp"], row["Sm"]], rtol=1e-5)
    sensors = sensors_of(1000.0, *paper_accelerometer())
    pulses = np.diff(net_at(sensors, run, run.trigger_times_s), axis=0)[:, :1].T
    known = KnownAccelerometer(ACC_PULSES_PER_G_S / G, TRUTH["K0"] * G, 0.0, 0.0, 0.0)
    asymmetry, odd_square = joint_solve(halves, pulses, known)[0]
    assert asymmetry == pytest.approx(TRUTH["Kax"], abs=2e-9)
    assert odd_square * G == pytest.approx(TRUTH["K2"], abs=2e-9)


@given(st.lists(st.floats(-5, 5), min_size=3, max_size=3), st.floats(1e-4, 10.0))
@settings(max_examples=60, deadline=None)
def test_half_waves_of_a_parabola(nodes, panel_s: float) -> None:
    """Against the same parabola summed on a fine grid; the difference is Simpson's rule."""
    y = np.array(nodes)
    u = (np.arange(4_000) + 0.5) / 2_000 - 1.0
    curve = y[1] + 0.5 * (y[2] - y[0]) * u + (0.5 * (y[0] + y[2]) - y[1]) * u**2
    positive, negative = (float(half[0]) for half in half_wave_integrals(y[:1], y[1:2], y[2:], panel_s))
    assert positive - negative == pytest.approx(panel_s * (y[0] + 4 * y[1] + y[2]) / 6, abs=1e-13 * panel_s)
    if (y > 0).any() and (y < 0).any():
        assert positive == pytest.approx(panel_s * np.maximum(curve, 0).mean(), abs=1e-6 * panel_s)


def begun(twin: Twin, run, rate_hz: float = 1000.0, seed: int = 3):
    unit = UnitOnStand(twin, (), run, rate_hz, np.random.SeedSequence(seed), "U-0001")
    return PRODUCT.begin(unit)


def all_columns(chunks) -> np.ndarray:
    return np.concatenate([np.column_stack([chunk["dut"][c] for c in ("t", *COLUMNS)]) for chunk in chunks])


@given(st.lists(st.floats(0.0, 0.8), max_size=5))
@settings(max_examples=8, deadline=None)
def test_chunks_are_the_whole(cuts) -> None:
    run = overload_run(cycles=2, crank=1)
    twin = PRODUCT.twin(1, "U-0001")
    whole = all_columns([begun(twin, run).advance(0.8)])
    parts = begun(twin, run)
    np.testing.assert_array_equal(all_columns([parts.advance(to) for to in [*sorted(cuts), 0.8]]), whole)
    assert len(whole) == 801
    assert not whole[0, 1:].any()
    assert (all_columns([begun(twin, run, seed=4).advance(0.8)]) != whole).any()


def test_counts_carry_what_is_left_of_a_pulse() -> None:
    """Ten minutes at rest at 100 Hz: 1 g up, and a level axis of 8.7 pulses a second, to within one pulse."""
    bias = 0.87e-3 * G
    lean = ((0.0,) * 3, (0.0, 0.0, bias / G), (0.0,) * 3)
    twin = Twin("pulse_imu", (effect_named("acc.cross_axis_sensitivity", cross=lean),))
    counted = all_columns([begun(twin, LevelRun(), 100.0).advance(600.0)])[:, 1:].sum(axis=0)
    named = dict(zip(COLUMNS, counted, strict=True))
    assert named["pulse_acc_z_pos"] == pytest.approx(600 * ACC_PULSES_PER_G_S, abs=1)
    assert named["pulse_acc_y_pos"] == pytest.approx(600 * ACC_PULSES_PER_G_S * bias / G, abs=1)
    assert named["pulse_acc_x_pos"] == named["pulse_acc_z_neg"] == 0


def test_noise_integrates_to_its_density() -> None:
    """The scatter of net counts over 1 s is N per √s, whatever panels there are."""
    density = 200e-6 * G
    noise = effect_named("acc.velocity_random_walk", density_si_per_sqrt_hz=(density,) * 3)
    twin = Twin("pulse_imu", (noise,))
    columns = all_columns([begun(twin, LevelRun(), 100.0).advance(400.0)])[1:, 1:7]
    net = (columns[:, 0::2] - columns[:, 1::2]).reshape(400, 100, 3).sum(axis=1)
    expected = density / G * ACC_PULSES_PER_G_S  # pulses
    np.testing.assert_allclose(net.std(axis=0), math.hypot(expected, math.sqrt(1 / 6)), rtol=0.12)


def test_one_g_on_the_rig_and_a_static_tumble_agree() -> None:
    """Paper 5, 5.3.2 (2). A tumble: K0 from level, Kax from up and down; before cutting, to 1e-9."""
    rate = {
        position: net_at(sensors_of(100.0, *paper_accelerometer()), LevelRun(force), [10.0])[0, 0] / 10.0
        for position, force in {"up": 1.0, "down": -1.0, "level": 0.0}.items()
    }
    bias = rate["level"] / (1 + TRUTH["Kax"])
    tumble = (rate["up"] + rate["down"] - 2 * bias) / (2 * ACC_PULSES_PER_G_S * (1 + TRUTH["K2"]))
    run = overload_run(overload_g=1.0, cycles=1)
    pulses = np.diff(net_at(sensors_of(1000.0, *paper_accelerometer()), run, run.trigger_times_s), axis=0)
    omega = run.speed_rad_s
    change, squared = 2 * G / omega, G**2 * math.pi / (2 * omega)
    halves = HalfCycles(*(np.full((1, 2), value) for value in (math.pi / omega, change, squared)))
    known = KnownAccelerometer(ACC_PULSES_PER_G_S / G, TRUTH["K0"] * G, 0.0, 0.0, 0.0)
    assert joint_solve(halves, pulses[:, :1].T, known)[0, 0] == pytest.approx(tumble, rel=3e-5)
    assert tumble == pytest.approx(TRUTH["Kax"], rel=2e-5)


class LevelRun:
    """At rest; `up_g`: what the x axis feels, or None for a level unit with z up."""

    duration_s = 3600.0

    def __init__(self, up_g: float | None = None) -> None:
        self.up_g = up_g

    def stimulus(self, times_s):
        stimulus = LevelBoard(SITE).stimulus(times_s)
        if self.up_g is not None:
            force = np.broadcast_to([self.up_g * G, 0.0, 0.0], (len(times_s), 3))
            stimulus = dataclasses.replace(stimulus, specific_force_m_s2=force)
        return stimulus

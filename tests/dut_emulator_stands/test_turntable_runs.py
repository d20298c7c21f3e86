"""Turntables as recordings use them: hand matrices, closed forms, limits, errors inside their data sheets."""

import math
from dataclasses import replace
from datetime import date, datetime, timedelta
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dut_emulator.effects.effect import EffectChain, Stimulus, name_of
from dut_emulator.effects.parameters import check_ranges
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.run import Run
from dut_emulator.recording.order import STARTED_AT, RecordingOrder
from dut_emulator.recording.recorder import RecordingSession
from dut_emulator.stands.catalogue import recording_stand
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=30.0)
EARTH_RATE_RAD_S = 7.292115e-5
KINDS = ("three_axis_turntable", "two_axis_turntable", "thermal_turntable", "non_magnetic_turntable")
RUNS = (
    ("three_axis_turntable", "rotation"),
    ("three_axis_turntable", "sweep"),
    ("two_axis_turntable", "multi_position"),
    ("two_axis_turntable", "swing"),
    ("three_axis_turntable", "tumble"),
    ("thermal_turntable", "thermal_positions"),
    ("non_magnetic_turntable", "spin"),
)


def run_of(kind: str, profile: str, **values: float) -> Run:
    return recording_stand(kind, 5, SITE).run(profile, profile_named(profile).values(values))


def about(axis: int, angle: np.ndarray) -> np.ndarray:
    """(n, 3, 3) passive elementary rotations, written out."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = {
        0: [[one, zero, zero], [zero, c, s], [zero, -s, c]],
        1: [[c, zero, -s], [zero, one, zero], [s, zero, c]],
        2: [[c, s, zero], [-s, c, zero], [zero, zero, one]],
    }
    return np.moveaxis(np.array(rows[axis]), -1, 0)


def attitude(acting: Stimulus) -> np.ndarray:
    outer, middle, inner = acting.channel("angles_rad").T
    return about(0, inner) @ about(1, middle) @ about(2, outer)


@pytest.mark.parametrize(("kind", "profile"), RUNS)
def test_what_acts_follows_from_the_attitude_by_hand(kind: str, profile: str) -> None:
    run = run_of(kind, profile)
    times = np.random.default_rng(1).uniform(0.01, run.duration_s - 0.01, 2000)
    times.sort()
    step_s = 2e-6
    acting = run.stimulus(times)
    before, after = attitude(run.stimulus(times - step_s)), attitude(run.stimulus(times + step_s))
    here = attitude(acting)
    heading, latitude = math.radians(30.0), math.radians(34.2)
    # the laboratory's y looks 30° east of north
    to_lab = np.array(
        [[math.cos(heading), -math.sin(heading), 0], [math.sin(heading), math.cos(heading), 0], [0, 0, 1]]
    )
    earth = here @ (to_lab @ (EARTH_RATE_RAD_S * np.array([0, math.cos(latitude), math.sin(latitude)])))
    turn = (after - before) / (2 * step_s) @ np.swapaxes(here, 1, 2)  # −[ω ×]
    turning = np.stack([turn[:, 1, 2], turn[:, 2, 0], turn[:, 0, 1]], axis=1)
    np.testing.assert_allclose(acting.channel("rate_rad_s"), turning + earth, atol=3e-5)
    np.testing.assert_allclose(acting.channel("earth_rate_rad_s"), earth, atol=1e-12)
    np.testing.assert_allclose(acting.channel("specific_force_m_s2"), here @ [0, 0, 9.797], atol=1e-9)
    field = here @ (to_lab @ np.array([-1.5e-6, 27e-6, -45e-6]))
    np.testing.assert_allclose(acting.channel("field_t"), field, atol=1e-15)


@pytest.mark.parametrize(("kind", "profile"), RUNS)
def test_the_report_is_the_truth_in_quanta_without_the_earth(kind: str, profile: str) -> None:
    run = run_of(kind, profile)
    times = np.linspace(0.0, run.duration_s, 3001)
    acting, said = run.stimulus(times), run.reading(times)
    assert set(said) == set(run.reading_units)
    relative = np.degrees(acting.channel("rate_rad_s") - acting.channel("earth_rate_rad_s"))
    for index, axis in enumerate("xyz"):
        largest = np.abs(relative).max()
        # an angle's quantum of 0.1″ turns a rate of one axis a little into another
        np.testing.assert_allclose(said[f"rate_{axis}"], relative[:, index], atol=1e-5 + 3e-7 * largest)
        force = acting.channel("specific_force_m_s2")[:, index] / 9.80665
        np.testing.assert_allclose(said[f"acc_{axis}"], force, atol=1e-6)
        np.testing.assert_allclose(said[f"mag_{axis}"], acting.channel("field_t")[:, index] * 1e6, atol=1e-4)
    for index, axis in enumerate(("outer", "middle", "inner")):
        angle = np.degrees(acting.channel("angles_rad")[:, index])
        np.testing.assert_allclose(said[f"angle_{axis}"], angle, atol=0.051 / 3600)
    np.testing.assert_allclose(said["temp"], acting.temperature_c, atol=0.0051)
    np.testing.assert_array_equal(run.trigger_times_s, [0.0])


@settings(max_examples=20)
@given(st.sampled_from(RUNS), st.lists(st.floats(0.0, 1.0), max_size=6))
def test_chunks_give_what_the_whole_gives(pair: tuple[str, str], cuts: list[float]) -> None:
    run = run_of(*pair)
    times = np.linspace(0.0, run.duration_s, 701)
    edges = sorted({0, 701, *(round(cut * 701) for cut in cuts)})
    whole_acting, whole_said = run.stimulus(times), run.reading(times)
    for first, last in pairwise(edges):
        part = run.stimulus(times[first:last])
        for name in ("rate_rad_s", "specific_force_m_s2", "field_t", "angles_rad"):
            np.testing.assert_array_equal(part.channel(name), whole_acting.channel(name)[first:last])
        np.testing.assert_array_equal(part.temperature_c, whole_acting.temperature_c[first:last])
        for name, column in run.reading(times[first:last]).items():
            np.testing.assert_array_equal(column, whole_said[name][first:last])


def test_whole_turns_sum_up() -> None:
    run = run_of("three_axis_turntable", "rotation", axis=2)
    times = np.arange(0.0, 10.0 + 1e-9, 1e-3)  # rest, turn; the turn back has not begun
    said = run.reading(times)
    assert np.trapezoid(said["rate_y"], times) == pytest.approx(1080.0, abs=1e-3)
    assert said["angle_middle"][-1] == pytest.approx(1080.0, abs=1e-4)
    assert np.abs(said["rate_y"]).max() == pytest.approx(1080 / 2.8, rel=1e-4)


@pytest.mark.parametrize(("kind", "count"), [("two_axis_turntable", 12), ("three_axis_turntable", 24)])
def test_every_axis_points_up_and_down_and_no_position_comes_twice(kind: str, count: int) -> None:
    run = run_of(kind, "multi_position", positions=count, dwell_s=1000.0)
    times = np.arange(0.0, run.duration_s, 5.0)
    acting = run.stimulus(times)
    still = np.abs(acting.channel("rate_rad_s") - acting.channel("earth_rate_rad_s")).max(axis=1) < 1e-12
    poses = np.round(attitude(acting)[still], 6)
    different = np.unique(poses.reshape(-1, 9), axis=0)
    assert len(different) == count
    vertical = different.reshape(-1, 3, 3)[:, :, 2]  # the laboratory's z in body axes
    for axis in range(3):
        for sign in (1.0, -1.0):
            assert (vertical[:, axis] == sign).sum() == count // 6


def test_mounts_in_the_chamber_reach_two_axes_each() -> None:
    reached = {}
    for mount, along in ((1, 0), (2, 1), (3, 2)):
        run = run_of("thermal_turntable", "thermal_positions", mount=mount)
        times = np.arange(0.0, run.duration_s, 1.0)
        force = run.stimulus(times).channel("specific_force_m_s2") / 9.797
        np.testing.assert_allclose(force[:, along], 0.0, atol=1e-9)
        reached[mount] = {
            (axis, sign) for axis in range(3) for sign in (-1, 1) if np.any(force[:, axis] * sign > 1 - 1e-12)
        }
    assert all(len(places) == 4 for places in reached.values())
    assert len(reached[1] | reached[2]) == 6


def test_rates_at_soak_temperatures_are_turned_both_ways() -> None:
    run = run_of("thermal_turntable", "thermal_positions", mount=2, levels=3, dwell_s=20.0, rate_deg_s=300.0)
    times = np.arange(0.0, run.duration_s, 0.5)
    said = run.reading(times)
    for rate in (300.0, -300.0):
        at_rate = np.abs(said["rate_y"] - rate) < 1e-4
        assert at_rate.sum() == pytest.approx(3 * 40, abs=6)
        assert np.unique(np.round(said["temp"][at_rate], 6)) == pytest.approx([-40.0, 15.0, 70.0])


def test_positions_are_taken_when_the_air_has_stood_long_enough() -> None:
    run = run_of("thermal_turntable", "thermal_positions", levels=2, soak_s=900.0)
    times = np.arange(0.0, run.duration_s, 0.5)
    turning = np.abs(run.reading(times)["rate_x"]) > 0
    temperature = run.stimulus(times).temperature_c
    assert set(np.round(temperature[turning], 9)) == {-40.0, 70.0}
    # 63 °C at 3 °C/min, then the soak; the first quarter turn follows the first dwell
    assert times[turning][0] == pytest.approx(63 / 3 * 60 + 900 + 10, abs=1.0)


def test_the_ramp_goes_both_ways_over_all_temperatures() -> None:
    run = run_of("thermal_turntable", "temperature_ramp", ramp_c_per_min=2.0, soak_s=600.0)
    assert run.duration_s == pytest.approx((63 + 110 + 47) / 2 * 60 + 3 * 600)
    times = np.linspace(0.0, run.duration_s, 10_001)
    slope = np.gradient(run.stimulus(times).temperature_c, times) * 60
    ramping = np.abs(slope) > 1e-6
    assert np.abs(slope[ramping]).max() == pytest.approx(2.0)
    temperature = run.stimulus(times).temperature_c
    for sign in (-1, 1):
        covered = temperature[slope * sign > 1.9]
        assert covered.max() - covered.min() > 100.0


def test_the_unit_lags_the_air_of_a_ramp_by_rate_times_time_constant() -> None:
    stand = recording_stand("thermal_turntable", 5, SITE)
    values = profile_named("temperature_ramp").values({"soak_s": 60.0})
    run = stand.run("temperature_ramp", values)
    times = np.arange(0.0, 1260.0, 0.5)
    acting = run.stimulus(times)
    lag = next(effect for effect in stand.effects if name_of(effect) == "stand.chamber_lag")
    chain = EffectChain([lag])
    stimulus = replace(acting, sample_period_s=0.5)
    felt = chain.apply(stimulus.true_input("temperature"), stimulus, chain.begin(np.random.SeedSequence(1)))
    tau: Any = lag
    expected = 3.0 / 60 * tau.time_constant_s * (1 - math.exp(-times[-1] / tau.time_constant_s))
    assert felt[-1, 0] - acting.temperature_c[-1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, -75.0])
def test_the_non_magnetic_axis_lies_along_north(heading_deg: float) -> None:
    site = SITE.model_copy(update={"heading_deg": heading_deg})
    stand = recording_stand("non_magnetic_turntable", 5, site)
    run = stand.run("spin", profile_named("spin").values({}))
    times = np.arange(0.0, run.duration_s, 1 / 977)
    acting = run.stimulus(times)
    field = acting.channel("field_t") * 1e6
    np.testing.assert_allclose(field[:, 2], 27.0, atol=1e-9)
    np.testing.assert_allclose(np.hypot(field[:, 0], field[:, 1]), math.hypot(45.0, 1.5), atol=1e-9)
    rate = np.degrees(acting.channel("rate_rad_s")[:, 2])
    assert rate.max() == pytest.approx(5400.0, abs=0.01)  # 15 rev/s: 5.4° in a millisecond
    fastest = times[rate > 5399.9]
    assert fastest[-1] - fastest[0] == pytest.approx(20.0, abs=0.01)
    roll = np.unwrap(np.arctan2(field[:, 1], field[:, 0]))[rate > 5399.9]
    assert abs(np.polyfit(fastest, roll, 1)[0]) == pytest.approx(30 * math.pi, rel=1e-6)


@pytest.mark.parametrize(
    ("kind", "profile", "values", "told"),
    [
        ("three_axis_turntable", "rotation", {"ramp_s": 2.5, "axis": 3}, "432 deg/s, 32 deg/s above"),
        ("three_axis_turntable", "rotation", {"ramp_s": 2.5, "axis": 3}, "below 2.3 s"),
        ("three_axis_turntable", "swing", {"axis": 3}, "250 deg/s^2 above"),
        ("three_axis_turntable", "rate_staircase", {"max_rate_deg_s": 500}, "at most 400"),
        ("three_axis_turntable", "spin", {}, "at most 1.111"),
        ("two_axis_turntable", "sweep", {"peak_acceleration_deg_s2": 300, "axis": 2}, "at most about 24"),
        ("two_axis_turntable", "temperature_ramp", {}, "no chamber"),
        ("non_magnetic_turntable", "spin", {"max_rate_rev_s": 20}, "at most 15"),
        ("thermal_turntable", "temperature_ramp", {"ramp_c_per_min": 8}, "at most 5 °C/min"),
        ("thermal_turntable", "thermal_positions", {"levels": 2.5}, "whole number"),
        ("thermal_turntable", "eleven_point", {}, "cannot do"),
    ],
)
def test_beyond_a_limit_nothing_runs_and_what_fits_is_said(
    kind: str, profile: str, values: dict[str, float], told: str
) -> None:
    given_values = profile_named(profile).values(values)
    with pytest.raises(TestloomError) as refused:
        recording_stand(kind, 5, SITE).run(profile, given_values)
    assert told in str(refused.value)
    assert refused.value.fault is Fault.OPERATOR
    assert refused.value.remedy


def test_every_default_can_be_done_where_products_use_it() -> None:
    for kind, profiles in {
        "three_axis_turntable": "static multi_position rotation rate_staircase tumble swing sweep",
        "two_axis_turntable": "static multi_position rate_staircase swing sweep",
        "thermal_turntable": "temperature_ramp thermal_positions",
        "non_magnetic_turntable": "spin",
    }.items():
        for profile in profiles.split():
            assert run_of(kind, profile).duration_s >= 30.0


@pytest.mark.parametrize("kind", KINDS)
def test_errors_are_inside_the_data_sheet_and_alike_in_kind(kind: str) -> None:
    lists = [recording_stand(kind, seed, SITE).effects for seed in range(8)]
    for effects in lists:
        assert [(e.sensor, name_of(e)) for e in effects] == [(e.sensor, name_of(e)) for e in lists[0]]
        assert "stand.earth_rate" not in {name_of(effect) for effect in effects}
        mounted = {e.rotation_rad for e in effects if name_of(e) == "stand.remount_misalignment"}
        assert len(mounted) == 1
        for effect in effects:
            assert not effect.is_neutral or name_of(effect) == "stand.chamber_lag"
            check_ranges(effect, "stand")
    assert lists[0] != lists[1]
    assert lists[0] == recording_stand(kind, 0, SITE).effects
    size = [
        np.linalg.norm(next(e for e in row if e.word == "remount_misalignment").rotation_rad) for row in lists
    ]
    most = {"three": 1e-4, "two_a": 2e-4, "therm": 1e-3, "non_m": 5e-4}[kind[:5]]
    assert 0.3 * most <= min(size) < max(size) <= most


def test_a_stand_knows_who_it_is_and_until_when_it_is_calibrated() -> None:
    stands = [recording_stand(kind, 7, SITE).identity for kind in KINDS]
    assert [stand.kind for stand in stands] == list(KINDS)
    assert len({stand.stand_id for stand in stands}) == 4
    dues = [date.fromisoformat(stand.calibration_due) for stand in stands]
    started = datetime.fromisoformat(STARTED_AT).date()
    assert all(timedelta(days=365) <= due - started < timedelta(days=731) for due in dues)


@pytest.mark.parametrize(("mount", "turning"), [(1.0, "inner"), (2.0, "middle"), (3.0, "middle")])
def test_the_errors_of_a_chamber_axis_follow_the_axis_that_turns(mount: float, turning: str) -> None:
    session = RecordingSession(RecordingOrder("mems_ahrs", "thermal_positions", values={"mount": mount}))
    moving = session.unit.run.stimulus(np.linspace(0.0, session.duration_s, 10_000)).channel("angles_rad")
    turned = {
        name for name, angle in zip(("outer", "middle", "inner"), moving.T, strict=True) if np.ptp(angle)
    }
    assert turned == {turning}
    about = {effect.axis for effect in session.unit.stand_effects if hasattr(effect, "axis")}
    assert about == {turning}
    names = [(effect.sensor, name_of(effect)) for effect in session.unit.stand_effects]
    assert names == [(effect.sensor, name_of(effect)) for effect in session.stand.effects]

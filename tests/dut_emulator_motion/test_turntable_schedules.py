"""Schedules against numerical derivatives, closed forms and the figures of the papers."""

import itertools
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dut_emulator.motion.axis_pieces import Sweep
from dut_emulator.motion.profile import ProfileKind
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.schedule import AxisPath, Drives, Schedule
from dut_emulator.motion.turntable_profiles import KINDS, what_fits
from dut_emulator.motion.turntable_schedules import schedule_of
from protocol.errors import TestloomError

THREE = Drives((400.0, 400.0, 1000.0), (250.0, 250.0, 500.0))
TWO = Drives((0.0, 400.0, 600.0), (0.0, 250.0, 500.0))
ONE_FAST = Drives(
    (0.0, 5400.0, 0.0),
    (0.0, 1000.0, 0.0),
    positioning_acceleration_deg_s2=1000.0,
    home_deg=(0.0, 0.0, -90.0),
)


def scheduled(profile: str, drives: Drives = THREE, **values: float) -> Schedule:
    return schedule_of(profile, profile_named(profile).values(values), drives)


@pytest.mark.parametrize("kind", [kind.name for kind in KINDS])
def test_rate_and_acceleration_are_the_derivatives_of_the_angle(kind: str) -> None:
    schedule = scheduled(kind, ONE_FAST if kind == "spin" else THREE)
    assert 30.0 <= schedule.duration_s <= 300.0
    step_s = 1e-4
    times = np.arange(0.0, schedule.duration_s, 0.0137)
    angle, rate, acceleration = schedule.at(times)
    before, after = schedule.at(times - step_s)[0], schedule.at(times + step_s)[0]
    # at corners the acceleration is one-sided: half a jump over one step of time
    corner = np.abs(acceleration).max() * step_s
    np.testing.assert_allclose((after - before) / (2 * step_s), rate, atol=corner + 1e-4)
    rate_before, rate_after = schedule.at(times - step_s)[1], schedule.at(times + step_s)[1]
    slope = (rate_after - rate_before) / (2 * step_s)
    smooth = np.abs(slope - acceleration) < 0.02 * (1 + np.abs(acceleration))
    assert smooth.mean() > 0.99  # all but the corners
    assert np.all(np.abs(np.diff(angle, axis=0)) <= np.abs(rate).max() * 0.0137 + 1e-9)


@settings(max_examples=30)
@given(
    st.floats(0.05, 1.0),
    st.floats(2.0, 30.0),
    st.floats(10.0, 40.0),
    st.floats(1.0, 300.0),
    st.floats(10.0, 400.0),
    st.booleans(),
)
def test_a_sweep_stays_inside_its_peaks(
    low_hz: float, high_hz: float, duration_s: float, rate: float, acceleration: float, logarithmic: bool
) -> None:
    sweep = Sweep(duration_s, 0.0, low_hz, high_hz, rate, acceleration, logarithmic)
    _, rates, accelerations = sweep.at(np.linspace(0.0, duration_s, 20_001))
    for reached, peak in zip((rates, accelerations), sweep.peaks, strict=True):
        assert np.abs(reached).max() <= peak * (1 + 1e-6)


@pytest.mark.parametrize("kind", ["rotation", "swing", "sweep", "rate_staircase", "tumble", "multi_position"])
def test_peaks_are_what_is_reached(kind: str) -> None:
    schedule = scheduled(kind)
    _, rate, acceleration = schedule.at(np.linspace(0.0, schedule.duration_s, 50_001))
    for axis, path in enumerate(schedule.paths):
        reached = (np.abs(rate[:, axis]).max(), np.abs(acceleration[:, axis]).max())
        assert reached == pytest.approx(path.peaks, rel=1e-2)


WHOLE = ("steps", "axis", "cycles", "logarithmic", "positions")


@settings(max_examples=60)
@given(st.sampled_from(KINDS), st.data())
def test_angle_and_rate_go_on_whatever_is_asked(kind: ProfileKind, data: st.DataObject) -> None:
    values = {}
    for one in kind.parameters:
        if one.name in WHOLE:
            values[one.name] = one.default
        else:
            drawn = one.default * data.draw(st.floats(0.4, 1.6), label=one.name) if one.default else one.high
            values[one.name] = min(max(drawn, one.low), one.high)
    if kind.name == "rotation":
        values["ramp_s"] = min(values["ramp_s"], values["duration_s"] / 2)
    # a path asserts that it has no jumps; here its samples say so too
    schedule = schedule_of(kind.name, kind.values(values), ONE_FAST if kind.name == "spin" else THREE)
    times = np.linspace(-1.0, schedule.duration_s + 1.0, 4001)
    step_s = times[1] - times[0]
    angles, rates, _ = schedule.at(times)
    for axis, path in enumerate(schedule.paths):
        rate, acceleration = path.peaks
        assert np.abs(np.diff(angles[:, axis])).max() <= rate * step_s * (1 + 1e-6) + 1e-6
        assert np.abs(np.diff(rates[:, axis])).max() <= acceleration * step_s * (1 + 1e-6) + 1e-6
        assert rates[0, axis] == rates[-1, axis] == 0.0


def test_a_tumble_can_spin_the_other_axis_meanwhile() -> None:
    schedule = scheduled("tumble", spin_deg_s=50.0)
    times = np.arange(0.0, schedule.duration_s, 0.01)
    rates = schedule.at(times)[1]
    both = np.abs(rates[:, 1] - 12.0) < 1e-9
    assert both.sum() * 0.01 == pytest.approx(30.0, abs=0.2)  # 360° at 12 °/s
    # all but the inner axis' own ramps of half a second
    assert (np.abs(rates[both, 2] - 50.0) < 1e-9).sum() * 0.01 == pytest.approx(29.2, abs=0.2)


def test_an_axis_that_jumps_is_refused() -> None:
    with pytest.raises(AssertionError, match="jump"):
        AxisPath(0.0, (Sweep(60.0, 1.0, 0.1, 20.0, 100.0, 200.0),))


def test_three_turns_of_paper_1() -> None:
    schedule = scheduled("rotation", axis=3, rest_s=0.0)
    assert schedule.duration_s == pytest.approx(10.0)
    assert schedule.paths[0].peaks == pytest.approx((1080 / 2.8, 1080 / 2.8 / 2.2))
    assert schedule.excess(THREE) is None
    angles = schedule.at(np.array([0.0, 2.2, 5.0, 10.0]))[0][:, 0]
    assert angles == pytest.approx([0.0, 1080 / 2.8 * 1.1, 1080.0, 0.0])


def test_a_triangle_of_rate_is_too_fast_and_is_told_what_fits() -> None:
    values = profile_named("rotation").values({"ramp_s": 2.5, "axis": 2.0})
    excess = schedule_of("rotation", values, THREE).excess(THREE)
    assert excess is not None
    assert str(excess) == "The middle axis would reach 432 deg/s, 32 deg/s above its limit of 400 deg/s."
    assert "below 2.3 s" in what_fits("rotation", values, excess, THREE)
    fits = values | {"ramp_s": 2.3 - 1e-6}
    assert schedule_of("rotation", fits, THREE).excess(THREE) is None


def test_a_steep_ramp_is_told_how_long_it_must_be() -> None:
    values = profile_named("rotation").values({"ramp_s": 0.5, "axis": 3.0})
    excess = schedule_of("rotation", values, THREE).excess(THREE)
    assert excess is not None
    assert excess.quantity == "acceleration"
    # r (5 − r) = 1080 / 250
    ramp_s = (5 - math.sqrt(25 - 4 * 1080 / 250)) / 2
    assert f"above {ramp_s:.4g} s" in what_fits("rotation", values, excess, THREE)


@settings(max_examples=50)
@given(st.floats(100.0, 3000.0), st.floats(1.0, 20.0), st.floats(0.05, 0.5), st.sampled_from([1.0, 3.0]))
def test_what_is_told_to_fit_does_fit(angle: float, duration_s: float, share: float, axis: float) -> None:
    values = profile_named("rotation").values(
        {"angle_deg": angle, "duration_s": duration_s, "ramp_s": share * duration_s, "axis": axis}
    )
    excess = schedule_of("rotation", values, THREE).excess(THREE)
    if excess is None:
        return
    told = [
        float(text) for text in re.findall(r"(\d[\d.e+]*) s", what_fits("rotation", values, excess, THREE))
    ]
    if "at least" in what_fits("rotation", values, excess, THREE):
        fits = {"duration_s": told[0] * 1.001, "ramp_s": told[1]}
    else:
        fits = {"ramp_s": (told[0] + told[1]) / 2}
    nearly = schedule_of("rotation", values | fits, THREE).excess(THREE)
    assert nearly is None or nearly.asked < nearly.limit * 1.005  # four digits are told


def test_swing_of_paper_2() -> None:
    schedule = scheduled("swing")
    times = np.linspace(0.0, schedule.duration_s, 100_001)
    angle, rate, acceleration = (part[:, 2] for part in schedule.at(times))
    assert np.abs(angle).max() == pytest.approx(80.0, abs=1e-6)
    assert np.abs(rate).max() == pytest.approx(200.0, rel=1e-6)
    assert np.abs(acceleration).max() == pytest.approx(80 * 2.5**2, rel=1e-6)
    values = profile_named("swing").values({"axis": 2.0})
    excess = schedule_of("swing", values, THREE).excess(THREE)
    assert excess is not None  # 500 deg/s² on an axis of 250
    remedy = what_fits("swing", values, excess, THREE)
    assert f"{math.sqrt(250 * 80):.4g}" in remedy
    assert "160" in remedy


@pytest.mark.parametrize("logarithmic", [0.0, 1.0])
def test_sweep_runs_from_low_to_high_at_rest_on_both_ends(logarithmic: float) -> None:
    sweep = Sweep(60.0, 10.0, 0.1, 20.0, 100.0, 200.0, logarithmic=bool(logarithmic))
    ends = np.array([0.0, 60.0])
    angle, rate, _ = sweep.at(ends)
    np.testing.assert_allclose(angle, 10.0, atol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)
    cycles = np.diff(sweep.phase_rad(ends))[0] / (2 * math.pi)
    expected = 19.9 * 60 / math.log(200) if logarithmic else 60 * 20.1 / 2
    assert cycles == pytest.approx(expected)
    times = np.linspace(0.0, 60.0, 600_001)
    crossings = times[1:][np.diff(np.sign(sweep.at(times)[0] - 10.0)) != 0]
    middle = (crossings > 20) & (crossings < 40)
    # between crossings lies half a period of the frequency there
    frequency = 0.5 / np.diff(crossings[middle])
    at = (crossings[middle][1:] + crossings[middle][:-1]) / 2
    said = 0.1 * 200 ** (at / 60) if logarithmic else 0.1 + 19.9 * at / 60
    np.testing.assert_allclose(frequency, said, rtol=0.01)


def test_staircase_dwells_at_every_level_both_ways() -> None:
    schedule = scheduled("rate_staircase", max_rate_deg_s=300.0, steps=3, dwell_s=2.0, axis=1)
    times = np.arange(0.0, schedule.duration_s, 0.01)
    _, rate, acceleration = (part[:, 2] for part in schedule.at(times))
    still = np.round(rate[acceleration == 0], 6)
    levels = still[np.insert(np.diff(still) != 0, 0, True)]
    np.testing.assert_allclose(
        levels, [0, 100, 200, 300, 200, 100, 0, -100, -200, -300, -200, -100, 0], atol=1e-9
    )
    assert (still == 300).sum() == pytest.approx(200, abs=1)
    assert schedule.at(np.array([schedule.duration_s]))[0][0, 2] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("drives", "profile", "values", "told"),
    [
        (TWO, "multi_position", {"positions": 24}, "outer axis"),
        (TWO, "multi_position", {"positions": 7}, "give 6, 12 or 24"),
        (ONE_FAST, "multi_position", {}, "choose another stand"),
        (ONE_FAST, "swing", {}, "give axis 3"),
        (TWO, "swing", {"axis": 1.5}, "whole number"),
        (ONE_FAST, "tumble", {"spin_deg_s": 10.0}, "horizontal axes"),
        (THREE, "sweep", {"low_hz": 30.0}, "raise high_hz"),
        (THREE, "rotation", {"ramp_s": 3.0}, "do not fit in 5 s"),
    ],
)
def test_what_cannot_be_done_is_refused(
    drives: Drives, profile: str, values: dict[str, float], told: str
) -> None:
    with pytest.raises(TestloomError) as refused:
        scheduled(profile, drives, **values)
    assert told in str(refused.value)


def test_a_two_axis_table_turns_body_z_with_its_horizontal_axis() -> None:
    schedule = scheduled("rotation", TWO, axis=3)
    angles = schedule.at(np.array([schedule.duration_s - 12.0]))[0][0]
    assert angles[0] == 0.0
    assert angles[2] == pytest.approx(-90.0)
    assert schedule.paths[1].peaks[0] == pytest.approx(1080 / 2.8)


@given(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=40))
def test_chunks_give_what_the_whole_gives(cuts: list[float]) -> None:
    schedule = scheduled("sweep", axis=1, duration_s=20.0)
    times = np.linspace(0.0, schedule.duration_s, 997)
    edges = sorted({0, len(times), *(int(cut / 100 * len(times)) for cut in cuts)})
    parts = [schedule.at(times[a:b]) for a, b in itertools.pairwise(edges)]
    for whole, pieces in zip(schedule.at(times), zip(*parts, strict=True), strict=True):
        np.testing.assert_array_equal(np.concatenate(pieces), whole)

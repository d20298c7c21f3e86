"""Truth from encoders, clocks from turns, lost samples: against hand figures and another library."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation as OtherRotation

from protocol.bench_description import Site
from protocol.gnc_module import SAMPLE_DTYPE
from stations.imu_stand.alignment import MIN_SEEN_ANGLE, align, turn_centroid_s
from stations.imu_stand.capture import lost_samples
from stations.imu_stand.truth import (
    EARTH_RATE_RAD_S,
    POSES_DEG,
    dcm_body_from_lab,
    earth_rate_lab,
    static_truth,
    turn_truth,
)

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=30.0)
DEG_PER_HOUR = math.radians(1) / 3600


@given(*(st.floats(-180, 180) for _ in range(3)))
def test_attitude_is_that_of_an_independent_library(outer: float, middle: float, inner: float) -> None:
    """A passive rotation is the transpose of scipy's active one; intrinsic z, y, x in this order."""
    ours = dcm_body_from_lab(np.radians([[outer, middle, inner]]))[0]
    other = OtherRotation.from_euler("ZYX", [outer, middle, inner], degrees=True).as_matrix().T
    assert_allclose(ours, other, atol=1e-12)


@pytest.mark.parametrize("name", POSES_DEG)
def test_each_pose_puts_gravity_on_its_axis(name: str) -> None:
    force, earth = static_truth(np.radians([POSES_DEG[name]]), SITE)
    sign = 1.0 if name.endswith("up") else -1.0
    expected = np.zeros(3)
    expected["xyz".index(name[0])] = sign
    assert_allclose(force / SITE.gravity_m_s2, expected, atol=1e-12)
    vertical = EARTH_RATE_RAD_S * math.sin(math.radians(34.2))
    assert_allclose(earth @ expected, vertical, rtol=1e-12)
    assert_allclose(np.linalg.norm(earth), EARTH_RATE_RAD_S, rtol=1e-12)


def test_earth_rate_in_the_laboratory_by_hand() -> None:
    """y looks 30° east of north, so x looks 30° south of east."""
    north = EARTH_RATE_RAD_S * math.cos(math.radians(34.2))
    up = EARTH_RATE_RAD_S * math.sin(math.radians(34.2))
    assert_allclose(earth_rate_lab(SITE), [-0.5 * north, math.sqrt(0.75) * north, up], rtol=1e-12)


def test_a_rest_left_in_a_turn_leaks_earth_rate_as_the_paper_is_corrected_to() -> None:
    """Three turns in 5 s and 10 s of rest: 8.3 deg/h across the axis, not zero."""
    time = np.arange(0, 15.0005, 0.005)
    angles = np.zeros((len(time), 3))
    angles[:, 0] = np.radians(np.minimum(time / 5, 1) * 1080)
    turn, earth = turn_truth(time, np.angle(np.exp(1j * angles)), SITE)
    assert_allclose(turn, [0, 0, 6 * math.pi], atol=1e-9)
    assert np.hypot(earth[0], earth[1]) / 15 / DEG_PER_HOUR == pytest.approx(8.3, abs=0.05)


def test_a_turn_about_all_three_gimbals_is_the_integral_of_the_attitude_s_own_rate() -> None:
    time = np.linspace(0, 2, 20_001)
    angles = np.stack([1.5 * np.sin(time), 0.7 * np.sin(2 * time), 0.9 * np.sin(3 * time)], axis=1)
    turn, _ = turn_truth(time, angles, SITE)
    attitude = dcm_body_from_lab(angles)
    middle = (attitude[1:] + attitude[:-1]) / 2
    skew = -(attitude[1:] - attitude[:-1]) @ middle.transpose(0, 2, 1)  # [ω×] dt = −dC Cᵀ
    expected = np.array([skew[:, 2, 1].sum(), skew[:, 0, 2].sum(), skew[:, 1, 0].sum()])
    assert_allclose(turn, expected, atol=1e-6)


def _turn_rate(time_s: NDArray[np.float64], start_s: float) -> NDArray[np.float64]:
    peak = math.radians(1080) / 2.8
    since = time_s - start_s
    return peak * np.clip(np.minimum(since / 2.2, (5 - since) / 2.2), 0, 1)


def test_the_unit_s_clock_is_found_through_scale_bias_noise_and_lag() -> None:
    rng = np.random.default_rng(3)
    skew, offset = 150e-6, 12.345678
    unit_s, bench_s = [], []
    for run in range(6):
        bench = np.asarray(20.0 * run + np.arange(0, 16, 0.005), dtype=np.float64)
        start = 20.0 * run + 0.5 + 0.1234
        instants = np.asarray(20.0 * run + 0.0021 + np.arange(0, 15.9, 0.005), dtype=np.float64)
        sign = (1.0, -1.0)[run % 2]
        seen = 1.02 * sign * _turn_rate(instants, start) + math.radians(0.9)
        seen += math.radians(0.05) * rng.standard_normal(len(seen))
        bench_s.append(turn_centroid_s(bench, sign * _turn_rate(bench, start))[0])
        unit_time = np.asarray((instants - offset) / (1 + skew), dtype=np.float64)
        centroid, angle = turn_centroid_s(unit_time, seen)
        unit_s.append(centroid)
        assert angle == pytest.approx(1.02 * sign * math.radians(1080), rel=1e-3)
    found = align(np.array(unit_s), np.array(bench_s), np.ones(6), fallback=(0.0, 0.0))
    assert found.skew == pytest.approx(skew, abs=2e-6)
    moments = np.array([3.0, 90.0])
    assert_allclose(found.bench_time_s((moments - offset) / (1 + skew)), moments, atol=1e-4)
    assert found.is_plausible


def test_dead_axes_tell_no_time_and_a_jumping_clock_is_no_clock() -> None:
    still = np.zeros(2000)
    assert turn_centroid_s(np.linspace(0, 10, 2000), still)[1] == 0.0
    centroids = np.array([10.0, 30.0, 50.0])
    one_alive = align(centroids, centroids, np.array([1.0, MIN_SEEN_ANGLE / 2, 0.0]), fallback=(1.0, 2.0))
    assert (one_alive.turns, one_alive.skew, one_alive.bench_time_s(np.array([1.5]))[0]) == (0, 0.0, 2.5)
    jumped = align(centroids, centroids + np.array([0, 0.01, 0]), np.ones(3), fallback=(0.0, 0.0))
    assert not jumped.is_plausible


@pytest.mark.parametrize(
    ("counters", "lost"),
    [
        (range(2000), 0),
        (range(1997), 0),  # start and stop leave a few open
        ([*range(900), *range(903, 2000)], 3),
        (range(5, 2000), 5),
        (range(1500), 495),  # the link went silent before the end
        ([*range(1000), 999, *range(1000, 2000)], 1),  # a duplicate
        ([], 2000),
    ],
)
def test_lost_samples_are_counted(counters: list[int], lost: int) -> None:
    samples = np.zeros(len(counters), SAMPLE_DTYPE)
    samples["counter"] = counters
    assert lost_samples(samples, 10.0, 200) == lost

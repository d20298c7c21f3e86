"""The session on a stand: round trips with an independent generator, and honest uncertainties."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.algorithms.noise_covariance import gauss_markov_covariance
from calibration.imu_session import SlowNoise, calibrate_imu, verify_imu
from protocol.errors import CalibrationError

SEEDS = 100
PER_POSE_GYRO = 5e-4 / np.sqrt(1500)  # white noise of the mean of one pose
PER_POSE_ACC = 0.01 / np.sqrt(1500)


def test_stated_uncertainties_cover_the_truth_under_white_noise(synthetic_imu, pulls) -> None:
    gyro, acc = [], []
    for seed in range(SEEDS):
        found = calibrate_imu(*synthetic_imu.session(seed))
        gyro.append(pulls(found.gyro, synthetic_imu.gyro_m, synthetic_imu.gyro_b))
        acc.append(pulls(found.acc, synthetic_imu.acc_m, synthetic_imu.acc_b))
    for kind in (np.array(gyro), np.array(acc)):
        assert 0.8 < (kind**2).mean() < 1.25
        assert 0.8 < (kind[:, :9] ** 2).mean() < 1.25
        # The bias keeps a share for slow noise that a session this short cannot exclude.
        assert 0.3 < (kind[:, 9:] ** 2).mean() < 1.25
        assert (np.abs(kind) < 2.0).mean() > 0.93


def test_stated_slow_noise_is_covered_in_every_coefficient(synthetic_imu, pulls) -> None:
    """A bias that wanders more than a pose's white noise, with the correlation time of a session."""
    unit = synthetic_imu.but(slow_gyro=2.5 * PER_POSE_GYRO, slow_acc=2.5 * PER_POSE_ACC)
    known = {
        "gyro_slow_noise": SlowNoise(unit.slow_gyro, unit.correlation_s),
        "acc_slow_noise": SlowNoise(unit.slow_acc, unit.correlation_s),
    }
    gyro, acc = [], []
    for seed in range(SEEDS):
        found = calibrate_imu(*unit.session(seed), **known)
        gyro.append(pulls(found.gyro, unit.gyro_m, unit.gyro_b))
        acc.append(pulls(found.acc, unit.acc_m, unit.acc_b))
    for kind in (np.array(gyro), np.array(acc)):
        assert 0.8 < (kind[:, :9] ** 2).mean() < 1.25
        assert 0.7 < (kind[:, 9:] ** 2).mean() < 1.4  # 3 biases a session: a wider band for the same chance


def test_turn_on_repeatability_goes_to_the_bias_and_nowhere_else(synthetic_imu) -> None:
    session = synthetic_imu.session(9)
    wander = SlowNoise(2e-5, 300.0)
    without = calibrate_imu(*session, gyro_slow_noise=wander).gyro
    with_it = calibrate_imu(*session, gyro_slow_noise=(wander, SlowNoise(1.5e-5, math.inf))).gyro
    np.testing.assert_allclose(with_it.matrix, without.matrix, atol=1e-12)
    np.testing.assert_allclose(with_it.covariance[:9, :9], without.covariance[:9, :9], rtol=1e-6, atol=1e-18)
    added = with_it.bias_standard_uncertainty() ** 2 - without.bias_standard_uncertainty() ** 2
    np.testing.assert_allclose(added, 1.5e-5**2, rtol=1e-6)


def test_covariance_of_gauss_markov_means_is_that_of_the_process_itself() -> None:
    """Closed form against the double sum over a finely sampled exponential covariance."""
    middle_s, duration_s, correlation_s = np.array([5.0, 40.0, 43.5]), np.array([10.0, 4.0, 3.0]), 12.0
    points = [m + d * ((np.arange(400) + 0.5) / 400 - 0.5) for m, d in zip(middle_s, duration_s, strict=True)]
    expected = [
        [np.exp(-np.abs(a[:, None] - b[None, :]) / correlation_s).mean() for b in points] for a in points
    ]
    found = gauss_markov_covariance(middle_s, duration_s, correlation_s)
    np.testing.assert_allclose(found, expected, rtol=2e-5)


def test_slow_noise_that_nobody_stated_is_seen_in_the_data(synthetic_imu, pulls) -> None:
    """Without knowledge, a strong wander still leaves the matrix covered and the bias not averaged away."""
    unit = synthetic_imu.but(slow_gyro=10 * PER_POSE_GYRO, slow_acc=10 * PER_POSE_ACC)
    gyro, acc = [], []
    for seed in range(SEEDS // 2):
        found = calibrate_imu(*unit.session(seed))
        gyro.append(pulls(found.gyro, unit.gyro_m, unit.gyro_b))
        acc.append(pulls(found.acc, unit.acc_m, unit.acc_b))
        assert found.gyro_noise.startswith("bias instability")
    for kind in (np.array(gyro), np.array(acc)):
        assert 0.7 < (kind[:, :9] ** 2).mean() < 1.3
        assert (kind[:, 9:] ** 2).mean() < 2.0


def test_poses_without_times_are_taken_one_after_another(synthetic_imu) -> None:
    poses, rotations = synthetic_imu.session(1)
    timed = calibrate_imu(poses, rotations)
    untimed = calibrate_imu([replace(pose, time_s=None) for pose in poses], rotations)
    np.testing.assert_allclose(untimed.gyro.matrix, timed.gyro.matrix, atol=1e-5)
    np.testing.assert_allclose(untimed.acc.bias, timed.acc.bias, atol=1e-4)


def test_what_is_spoilt_is_named_and_left_out(synthetic_imu) -> None:
    poses, rotations = synthetic_imu.session(2)
    acc = poses[0].acc_m_s2.copy()
    acc[5:8, 1] = np.nan
    acc[20, 2] = 490.0
    poses[0] = replace(poses[0], acc_m_s2=acc)
    acc = poses[1].acc_m_s2.copy()
    acc[: len(acc) // 2] = np.nan
    poses[1] = replace(poses[1], acc_m_s2=acc)
    gyro = rotations[0].gyro_rad_s.copy()
    gyro[200] = [7.0, 0.0, 0.0]
    rotations[0] = replace(rotations[0], gyro_rad_s=gyro)
    time_s = rotations[3].time_s.copy()
    time_s[300:] += 0.1
    rotations[3] = replace(rotations[3], time_s=time_s)
    poses.append(
        replace(
            poses[2],
            name="glimpse",
            time_s=poses[2].time_s[:9] + 1000.0,
            acc_m_s2=poses[2].acc_m_s2[:9],
            gyro_rad_s=poses[2].gyro_rad_s[:9],
        )
    )
    time_s = poses[4].time_s.copy()
    time_s[700:] += 0.5
    poses[4] = replace(poses[4], time_s=time_s)
    found = calibrate_imu(poses, rotations, gyro_range_rad_s=6.98, acc_range_m_s2=490.0)
    said = {(item.what, item.count): item.why for item in found.not_used}
    assert said["x_up (accelerometer)", 3] == "missing values (NaN)"
    assert "saturated" in said["x_up (accelerometer)", 1]
    assert "whole rest" in said["x_down (accelerometer)", 750]
    assert "1 saturated samples" in said["x_plus (gyro)", 600]
    assert "1 gaps" in said["y_minus (gyro)", 600]
    assert "too short" in said["glimpse (gyro)", 9]
    assert "gaps in time" in said["z_up (gyro)", 25]
    assert "x_plus (gyro)" not in found.gyro_residuals_rad_s
    # What is left still gives the truth: nothing spoilt was averaged in.
    assert np.abs(found.gyro.matrix - synthetic_imu.gyro_m).max() < 1e-4
    assert np.abs(found.acc.matrix - synthetic_imu.acc_m).max() < 1e-3


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_missing_excitation_is_named(synthetic_imu, axis: str) -> None:
    poses, rotations = synthetic_imu.session(3)
    with pytest.raises(CalibrationError, match=f"turn about body {axis}") as refusal:
        calibrate_imu(poses, [run for run in rotations if run.name[0] != axis])
    assert f"turn about body {axis}" in refusal.value.remedy
    with pytest.raises(CalibrationError, match=f"specific force along body {axis}"):
        calibrate_imu([pose for pose in poses if pose.name[0] != axis], rotations)


def test_one_sided_poses_cannot_tell_bias_from_scale_factor(synthetic_imu) -> None:
    poses, rotations = synthetic_imu.session(3)
    with pytest.raises(CalibrationError, match="bias and the scale factor of x, y, z cannot be told apart"):
        calibrate_imu([pose for pose in poses if pose.name.endswith("up")], rotations)


def test_nothing_usable_and_nonsense_are_refused(synthetic_imu) -> None:
    poses, rotations = synthetic_imu.session(3)
    with pytest.raises(CalibrationError, match="No run of the session can be used"):
        calibrate_imu([], rotations)
    flat = replace(poses[0], acc_m_s2=poses[0].acc_m_s2[:, 0])
    with pytest.raises(CalibrationError, match="shape"):
        calibrate_imu([flat, *poses[1:]], rotations)
    unknown = replace(poses[0], specific_force_body_m_s2=np.array([np.nan, 0, 0]))
    with pytest.raises(CalibrationError, match="finite"):
        calibrate_imu([unknown, *poses[1:]], rotations)
    short = replace(rotations[0], time_s=rotations[0].time_s[:-1])
    with pytest.raises(CalibrationError, match="600 samples and 599 times"):
        calibrate_imu(poses, [short, *rotations[1:]])
    with pytest.raises(CalibrationError, match="larger than"):
        calibrate_imu(poses * 8, rotations)


def test_the_second_look_sees_the_identity_and_a_planted_error(synthetic_imu) -> None:
    found = calibrate_imu(*synthetic_imu.session(4))
    poses, rotations = synthetic_imu.session(5)

    def compensated(gain: float):
        return (
            [
                replace(
                    pose,
                    gyro_rad_s=found.gyro.compensate(pose.gyro_rad_s),
                    acc_m_s2=found.acc.compensate(pose.acc_m_s2) * [1, 1, gain],
                )
                for pose in poses
            ],
            [
                replace(run, gyro_rad_s=found.gyro.compensate(run.gyro_rad_s) * [1, gain, 1])
                for run in rotations
            ],
        )

    clean = verify_imu(*compensated(1.0))
    assert clean.gyro_scale_factor_error_max < 2e-5
    assert clean.gyro_cross_coupling_max_rad < 6e-5
    assert clean.gyro_bias_residual_max_rad_s < 3e-5
    assert clean.acc_scale_factor_error_max < 1e-4
    assert clean.acc_bias_residual_max_m_s2 < 1e-3
    assert clean.acc_residual_max_m_s2 < 2e-3
    assert clean.gyro_angle_residual_max_rad < 1e-3
    planted = verify_imu(*compensated(1.001))
    assert planted.gyro_scale_factor_error_max == pytest.approx(1e-3, abs=2e-5)
    assert planted.acc_scale_factor_error_max == pytest.approx(1e-3, abs=1e-4)
    assert planted.gyro_angle_residual_max_rad == pytest.approx(6 * np.pi * 1e-3, rel=0.05)
    assert planted.acc_residual_max_m_s2 == pytest.approx(9.797e-3, rel=0.2)
    names = planted.as_measurements()
    assert names["gyro_scale_factor_error_max"] == (planted.gyro_scale_factor_error_max, "1")
    assert {unit for _, unit in names.values()} == {"1", "rad", "rad/s", "m/s^2"}

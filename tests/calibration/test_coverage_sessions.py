"""Stated intervals of sessions on a stand and by hand: emulated units, imperfect stands, coloured noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Attitude

from calibration.algorithms.ferraris import calibrate_ferraris
from calibration.algorithms.multi_position import fit_multi_position
from calibration.imu_session import SlowNoise, calibrate_imu
from dut_emulator.effects.effect import Stimulus
from dut_emulator.products.gnc_module.inertial_sensors import ACC_LSB_M_S2, GYRO_LSB_RAD_S, InertialSensors
from dut_emulator.products.gnc_module.population import draw_unit, unit_seed
from tests.calibration.conftest import SyntheticImu
from tests.calibration.shaped_noise import check_coverage, exponential, flicker
from tests.calibration.test_ferraris_session import ACC_B, ACC_M, GRAVITY, GYRO_B, GYRO_M, session

ARC_SECOND = np.radians(1 / 3600)
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def on_a_stand(poses, rotations, rng: np.random.Generator, sigma_rad: float, stated_rad: float):
    """What the stand says: each pose and turn is off by an angle of its own, each turn in its angle too."""

    def off(vector: np.ndarray) -> np.ndarray:
        return Attitude.from_rotvec(rng.normal(0.0, sigma_rad, 3)).apply(vector)

    said = [
        replace(
            pose,
            specific_force_body_m_s2=off(pose.specific_force_body_m_s2),
            attitude_uncertainty_rad=stated_rad,
        )
        for pose in poses
    ]
    turned = [
        replace(
            run,
            rotation_body_rad=off(run.rotation_body_rad) + rng.normal(0.0, sigma_rad, 3),
            attitude_uncertainty_rad=stated_rad,
        )
        for run in rotations
    ]
    return said, turned


def test_a_stand_whose_error_is_not_stated_is_not_covered(synthetic_imu, pulls) -> None:
    """Twenty arc seconds of a pose: stated they are held, unstated the matrix is more certain than right."""
    unit = synthetic_imu.but(pose_s=15.0, turn_s=10.0)
    rms = []
    for stated_rad in (20 * ARC_SECOND, 0.0):
        rng, found = np.random.default_rng(1), []
        for seed in range(8):
            seen = calibrate_imu(*on_a_stand(*unit.session(seed), rng, 20 * ARC_SECOND, stated_rad))
            found.append(pulls(seen.gyro, unit.gyro_m, unit.gyro_b)[:9])
        rms.append(np.sqrt(np.mean(np.square(found))))
    assert rms[0] < 1.4
    assert rms[1] > 2.5


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["white", "flicker", "exponential"])
def test_sessions_on_imperfect_stands_are_covered(colour: str, synthetic_imu, pulls) -> None:
    """200 sessions; the noise beside the white one is of FFTs, over the whole session, and stated roughly."""
    unit = synthetic_imu.but(pose_s=15.0, turn_s=10.0, rate_hz=20.0)
    period_s, total_s = 1 / unit.rate_hz, 6 * (15.0 + 10.0 + 2 * unit.pause_s)
    count = int(total_s / period_s)
    gyro, acc = [], []
    known = {}
    if colour != "white":
        known = {"gyro_slow_noise": SlowNoise(2e-5, 60.0), "acc_slow_noise": SlowNoise(4e-4, 60.0)}
    for seed in range(200):
        rng = np.random.default_rng(1000 + seed)
        poses, rotations = unit.session(seed)
        if colour == "white":
            slow = {"gyro": np.zeros((count, 3)), "acc": np.zeros((count, 3))}
        elif colour == "flicker":
            slow = {
                "gyro": flicker(rng, count, 3, 1.2e-5, period_s),
                "acc": flicker(rng, count, 3, 2.4e-4, period_s),
            }
            slow = {
                kind: drift - drift.mean(axis=0) for kind, drift in slow.items()
            }  # the bias is of this session
        else:
            slow = {
                "gyro": exponential(rng, count, 3, 2e-5, 60.0, period_s),
                "acc": exponential(rng, count, 3, 4e-4, 60.0, period_s),
            }

        def at(kind: str, time_s: np.ndarray, slow=slow) -> np.ndarray:
            return slow[kind][np.minimum((time_s / period_s).astype(int), count - 1)]

        poses = [
            replace(
                pose,
                gyro_rad_s=pose.gyro_rad_s + at("gyro", pose.time_s),
                acc_m_s2=pose.acc_m_s2 + at("acc", pose.time_s),
            )
            for pose in poses
            if pose.time_s is not None
        ]
        rotations = [replace(run, gyro_rad_s=run.gyro_rad_s + at("gyro", run.time_s)) for run in rotations]
        sigma = 4 * ARC_SECOND
        seen = calibrate_imu(*on_a_stand(poses, rotations, rng, sigma, sigma), **known)
        gyro.append(pulls(seen.gyro, unit.gyro_m, unit.gyro_b))
        acc.append(pulls(seen.acc, unit.acc_m, unit.acc_b))
    for each in (np.array(gyro), np.array(acc)):
        check_coverage(each.reshape(-1, 12)[:, :9], less=0.03, more=0.2)
        check_coverage(each.reshape(-1, 12)[:, 9:], less=0.03, more=0.33)


@pytest.mark.slow
def test_emulated_units_on_imperfect_stands_are_covered(pulls) -> None:
    """200 units of a lot through the emulator's chains; each on a stand whose poses are off."""
    stand = SyntheticImu(
        gyro_m=IDENTITY,
        acc_m=IDENTITY,
        gyro_b=(0.0,) * 3,
        acc_b=(0.0,) * 3,
        white_gyro=0.0,
        white_acc=0.0,
        rate_hz=50.0,
        pose_s=12.0,
        turn_s=10.0,
    )
    true_poses, true_rotations = stand.session(0)
    gyro, acc = [], []
    number = 0
    while len(gyro) < 200:
        number += 1
        serial = f"U-{number:04d}"
        unit = draw_unit(31, serial)
        if unit.defect is not None:
            continue
        rng = np.random.default_rng(number)
        sensors = InertialSensors(unit, unit_seed(31, serial, number), 0.0)

        def seen(time_s, rate, force, sensors=sensors, unit=unit):
            acting = Stimulus(
                time_s=time_s,
                sample_period_s=1 / stand.rate_hz,
                rate_rad_s=rate,
                specific_force_m_s2=force,
                field_t=np.zeros((len(time_s), 3)),
                temperature_c=np.full(len(time_s), 25.0 - unit.self_heating_c),
            )
            samples = sensors.sample(time_s + 600.0, 1 / stand.rate_hz, acting)
            return samples.gyro * GYRO_LSB_RAD_S, samples.acc * ACC_LSB_M_S2

        poses = []
        for pose in true_poses:
            of_gyro, of_acc = seen(pose.time_s, pose.gyro_rad_s, pose.acc_m_s2)
            poses.append(replace(pose, gyro_rad_s=of_gyro, acc_m_s2=of_acc))
        rotations = [
            replace(run, gyro_rad_s=seen(run.time_s, run.gyro_rad_s, np.zeros_like(run.gyro_rad_s))[0])
            for run in true_rotations
        ]
        said = on_a_stand(poses, rotations, rng, 4 * ARC_SECOND, 4 * ARC_SECOND)

        def slow(median: float, triad) -> tuple[SlowNoise, ...]:
            product = SlowNoise(median * np.exp(0.3**2), triad.correlation_time_s)
            return product, SlowNoise(triad.turn_on_deviation_si, np.inf)

        found = calibrate_imu(
            *said,
            gyro_slow_noise=slow(np.radians(5 / 3600), unit.gyro),
            acc_slow_noise=slow(0.1 * 9.80665e-3, unit.acc),
        )
        for triad, of_unit, into in ((found.gyro, unit.gyro, gyro), (found.acc, unit.acc, acc)):
            matrix = np.diag(1.0 + np.array(of_unit.scale_factor_error))
            matrix = matrix @ (np.eye(3) + np.array(of_unit.misalignment_rad))
            into.append(pulls(triad, matrix, of_unit.bias_si))
    for each in (np.array(gyro), np.array(acc)):
        check_coverage(each, less=0.02, more=0.2)


@pytest.mark.slow
def test_hand_made_sessions_are_covered(pulls) -> None:
    acc, gyro = [], []
    for seed in range(200):
        found = calibrate_ferraris(*session(5000 + seed), GRAVITY)
        acc.append(pulls(found.acc.coefficients, ACC_M, ACC_B))
        gyro.append(pulls(found.gyro.coefficients, GYRO_M, GYRO_B))
    for each in (np.array(acc), np.array(gyro)):
        check_coverage(each, less=0.04, more=0.31)


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["flicker", "exponential"])
def test_unknown_attitudes_are_covered_on_coloured_noise(colour: str) -> None:
    """24 rests of 5 s at 20 Hz; the noise runs on from rest to rest, and only their scatter tells of it."""
    forward = np.array([[1.02, 0.006, -0.004], [0.0, 0.97, 0.008], [0.0, 0.0, 1.035]])
    bias, each, rate_hz = np.array([0.35, -0.2, -1.1]), 100, 20.0
    pulls = []
    for seed in range(200):
        rng = np.random.default_rng(9000 + seed)
        up = rng.normal(size=(24, 3))
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        if colour == "flicker":
            noise = flicker(rng, 24 * each, 3, 2e-3, 1 / rate_hz)
            noise -= noise.mean(axis=0)  # the bias is of this session
        else:
            noise = exponential(rng, 24 * each, 3, 3e-3, 2.0, 1 / rate_hz)
        noise += rng.normal(0.0, 0.01, noise.shape)
        means = 9.79 * up @ forward.T + bias + noise.reshape(24, each, 3).mean(axis=1)
        found = fit_multi_position(means, np.full(24, 0.01**2 / each), 9.79, "test").coefficients
        upper = np.triu_indices(3)
        of_matrix = (found.matrix - forward)[upper] / found.matrix_standard_uncertainty()[upper]
        pulls.append([*of_matrix, *((found.bias - bias) / found.bias_standard_uncertainty())])
    check_coverage(np.array(pulls), less=0.04, more=0.25)

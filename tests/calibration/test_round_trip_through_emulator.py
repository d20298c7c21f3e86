"""Emulated units of a production lot, calibrated: every coefficient within what its uncertainty says.

The stimulus comes from this folder's own generator, the sensors from the emulator, the coefficients
from the calibration: three pieces that share no code.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from calibration.imu_session import SlowNoise, calibrate_imu
from dut_emulator.effects.effect import Stimulus
from dut_emulator.products.gnc_module.inertial_sensors import (
    ACC_LSB_M_S2,
    GYRO_LSB_RAD_S,
    InertialSensors,
)
from dut_emulator.products.gnc_module.population import draw_unit, unit_seed
from dut_emulator.products.gnc_module.unit_truth import TriadTruth, UnitTruth

UNITS = 12
WARM_UP_S = 600.0
REFERENCE_C = 25.0
GYRO_INSTABILITY = math.radians(5 / 3600)  # medians of the product
ACC_INSTABILITY = 0.1 * 9.80665e-3
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture
def lot() -> list[UnitTruth]:
    """Healthy units of a lot."""
    units = [draw_unit(11, f"U-{number:04d}") for number in range(4 * UNITS)]
    return [unit for unit in units if unit.defect is None][:UNITS]


def true_matrix(triad: TriadTruth) -> np.ndarray:
    return np.diag(1.0 + np.array(triad.scale_factor_error)) @ (np.eye(3) + np.array(triad.misalignment_rad))


def slow(median: float, triad: TriadTruth) -> tuple[SlowNoise, ...]:
    """Product knowledge, not the unit's own level: log-normal over units with a spread of 0.3."""
    return (
        SlowNoise(median * math.exp(0.3**2), triad.correlation_time_s),
        SlowNoise(triad.turn_on_deviation_si, math.inf),
    )


def test_every_coefficient_comes_back(synthetic_imu, pulls, lot: list[UnitTruth]) -> None:
    stand = synthetic_imu.but(
        gyro_m=IDENTITY,
        acc_m=IDENTITY,
        gyro_b=(0.0,) * 3,
        acc_b=(0.0,) * 3,
        white_gyro=0.0,
        white_acc=0.0,
        rate_hz=200.0,
    )
    true_poses, true_rotations = stand.session(0)
    found_pulls = []
    for number, unit in enumerate(lot):
        sensors = InertialSensors(unit, unit_seed(11, unit.serial, number), 0.0)

        def seen(time_s, rate, force, sensors=sensors, unit=unit):
            count = len(time_s)
            acting = Stimulus(
                time_s=time_s,
                sample_period_s=1 / stand.rate_hz,
                rate_rad_s=rate,
                specific_force_m_s2=force,
                field_t=np.zeros((count, 3)),
                temperature_c=np.full(count, REFERENCE_C - unit.self_heating_c),
            )
            samples = sensors.sample(time_s + WARM_UP_S, 1 / stand.rate_hz, acting)
            return samples.gyro * GYRO_LSB_RAD_S, samples.acc * ACC_LSB_M_S2

        poses, rotations = [], []
        for pose in true_poses:
            gyro, acc = seen(pose.time_s, pose.gyro_rad_s, pose.acc_m_s2)
            poses.append(replace(pose, gyro_rad_s=gyro, acc_m_s2=acc))
        for run in true_rotations:
            gyro, _ = seen(run.time_s, run.gyro_rad_s, np.zeros_like(run.gyro_rad_s))
            rotations.append(replace(run, gyro_rad_s=gyro))
        found = calibrate_imu(
            poses,
            rotations,
            gyro_slow_noise=slow(GYRO_INSTABILITY, unit.gyro),
            acc_slow_noise=slow(ACC_INSTABILITY, unit.acc),
        )
        assert found.not_used == ()
        found_pulls.append(pulls(found.gyro, true_matrix(unit.gyro), unit.gyro.bias_si))
        found_pulls.append(pulls(found.acc, true_matrix(unit.acc), unit.acc.bias_si))
    every = np.array(found_pulls)
    assert np.abs(every).max() < 4.0
    assert (np.abs(every) < 3.0).mean() > 0.985
    assert 0.7 < (every[:, :9] ** 2).mean() < 1.4
    assert 0.5 < (every[:, 9:] ** 2).mean() < 1.7

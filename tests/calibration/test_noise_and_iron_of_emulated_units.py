"""Emulated noise and an emulated magnetometer, evaluated: the truth within what the uncertainty says."""

import numpy as np

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.magnetometer import hard_and_soft_iron
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.slow_noise import FlickerNoise, RateRandomWalk
from dut_emulator.effects.stochastic import WhiteNoise
from dut_emulator.products.gnc_module.inertial_sensors import InertialSensors
from dut_emulator.products.gnc_module.population import draw_unit, unit_seed

RATE_HZ, SAMPLES, RECORDS = 20.0, 2**14, 67  # of three axes each
WHITE, FLICKER, WALK = 1e-3, 6e-4, 6e-5


def test_emulated_noise_gives_its_coefficients_back() -> None:
    """67 records of three axes: 68 and 95 % of N, B and K within one and 1.96 u, or more where cut at 0."""
    chain = EffectChain(
        (
            WhiteNoise(sensor="gyro", density_si_per_sqrt_hz=(WHITE,) * 3),
            FlickerNoise(sensor="gyro", coefficient_si=(FLICKER,) * 3, shortest_time_s=0.01),
            RateRandomWalk(sensor="gyro", coefficient_si_per_sqrt_s=(WALK,) * 3),
        )
    )
    times = np.arange(SAMPLES) / RATE_HZ
    stimulus = Stimulus(times, np.full(SAMPLES, 25.0), 1 / RATE_HZ)
    truth = np.array([WHITE, FLICKER, WALK]) ** 2
    pulls = []
    for record in range(RECORDS):
        memory = chain.begin(np.random.SeedSequence(record))
        output = chain.apply(np.zeros((SAMPLES, 3)), stimulus, memory)
        for axis in range(3):
            measured = overlapping_allan_deviation(np.ascontiguousarray(output[:, axis]), RATE_HZ)
            fit = fit_allan_coefficients(measured, ("random_walk", "bias_instability", "rate_random_walk"))
            pulls.append((fit.squares[1:4] - truth) / np.sqrt(np.diag(fit.covariance)[1:4]))
    for sigmas, stated in ((1.0, 0.683), (1.96, 0.95)):
        covered = (np.abs(pulls) <= sigmas).mean(axis=0)
        assert (covered >= stated - 4 * np.sqrt(stated * (1 - stated) / len(pulls))).all(), covered
    assert np.abs(np.mean(pulls, axis=0)).max() < 0.6


def test_emulated_magnetometers_give_scale_and_hard_iron_back() -> None:
    """20 units of a lot, turned all ways in 50 uT: K = 1 / (1 + scale factor error), b = their hard iron."""
    pulls = []
    field_t = 50e-6
    for number in range(20):
        serial = f"M-{number:04d}"
        truth = draw_unit(5, serial)
        sensors = InertialSensors(truth, unit_seed(5, serial), 0.0)
        directions = np.random.default_rng(number).standard_normal((3000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        found = hard_and_soft_iron(sensors.field_t(field_t * directions), field_t)
        uncertainty = found.compensation_standard_uncertainty()
        expected = 1 / (1 + np.array(truth.magnetometer.scale_factor_error))
        pulls.append((np.diag(found.compensation) - expected) / np.diag(uncertainty))
        difference = found.hard_iron - np.array(truth.magnetometer.bias_t)
        pulls.append(difference / found.hard_iron_standard_uncertainty())
    assert 0.8 < np.std(pulls) < 1.2
    assert abs(np.mean(pulls)) < 0.3
    assert (np.abs(pulls) < 5).all()

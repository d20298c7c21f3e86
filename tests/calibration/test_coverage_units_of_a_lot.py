"""200 units of a lot through the emulator's chains, by hand or on a plot: intervals hold the truth.

The motion comes from generators of the tests' own. Noise of plots also from `shaped_noise`.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Attitude

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.ferraris import HandRest, HandTurn, calibrate_ferraris
from calibration.algorithms.magnetometer import hard_and_soft_iron
from calibration.algorithms.multi_position import fit_multi_position
from calibration.algorithms.turned_gravity import fit_turned_gravity
from calibration.algorithms.wavelet_variance import fit_wavelet_coefficients, wavelet_variance
from dut_emulator.effects.effect import EffectChain, Stimulus
from dut_emulator.effects.slow_noise import FlickerNoise, RateRandomWalk
from dut_emulator.effects.stochastic import WhiteNoise
from dut_emulator.products.gnc_module.inertial_sensors import ACC_LSB_M_S2, GYRO_LSB_RAD_S, InertialSensors
from dut_emulator.products.gnc_module.population import draw_unit, unit_seed
from dut_emulator.products.gnc_module.unit_truth import TriadTruth, UnitTruth
from tests.calibration.shaped_noise import check_coverage, exponential, flicker, white
from tests.calibration.test_ferraris_session import ACC_B, ACC_M, GYRO_B, GYRO_M
from tests.calibration.test_ferraris_session import GRAVITY as OWN_GRAVITY
from tests.calibration.test_ferraris_session import session as by_own_hand
from tests.calibration.test_turned_gravity import BIAS, MATRIX, session

GRAVITY, EARTH_RAD_S = 9.8, 7.2921e-5
WARM_S = 600.0
UNITS = 200


def units(lot: int, *, steady: bool = True) -> Iterator[tuple[int, UnitTruth]]:
    """Sound units; `steady`: the bias of each is that of this power-on."""
    found, number = 0, 0
    while found < UNITS:
        number += 1
        unit = draw_unit(lot, f"U-{number:04d}")
        if unit.defect is not None:
            continue
        if steady:
            gyro, acc = (dataclasses.replace(one, turn_on_deviation_si=0.0) for one in (unit.gyro, unit.acc))
            unit = dataclasses.replace(unit, gyro=gyro, acc=acc)
        found += 1
        yield number, unit


class Seen:
    """Outputs of a unit that is moved; its own temperature is 25 degC."""

    def __init__(self, unit: UnitTruth, seed: np.random.SeedSequence) -> None:
        self._unit, self._sensors = unit, InertialSensors(unit, seed, 0.0)

    def __call__(self, time_s: np.ndarray, rate: np.ndarray, force: np.ndarray):
        period_s, count = float(time_s[1] - time_s[0]), len(time_s)
        acting = Stimulus(
            time_s=time_s,
            sample_period_s=period_s,
            rate_rad_s=rate,
            specific_force_m_s2=force,
            field_t=np.zeros((count, 3)),
            temperature_c=np.full(count, 25.0 - self._unit.self_heating_c),
        )
        samples = self._sensors.sample(time_s + WARM_S, period_s, acting)
        gyro = np.asarray(samples.gyro * GYRO_LSB_RAD_S, dtype=np.float64)
        return gyro, np.asarray(samples.acc * ACC_LSB_M_S2, dtype=np.float64)


def matrix_of(triad: TriadTruth) -> np.ndarray:
    return np.diag(1.0 + np.array(triad.scale_factor_error)) @ (np.eye(3) + np.array(triad.misalignment_rad))


def pulls_in_session(found: TriadCoefficients, true: np.ndarray, triad: TriadTruth) -> np.ndarray:
    """Of M and b; what the bias was in these two minutes is known only to the slow noise."""
    of_matrix = np.zeros((3, 3))
    told = found.matrix_standard_uncertainty() > 0.0  # a triangle's other elements are 0 by definition
    of_matrix[told] = ((found.matrix - true) / np.where(told, found.matrix_standard_uncertainty(), 1.0))[told]
    doubt = np.hypot(found.bias_standard_uncertainty(), triad.bias_instability_si)
    return np.concatenate([of_matrix.ravel(), (found.bias - np.array(triad.bias_si)) / doubt])


def by_hand(unit: UnitTruth, seed: np.random.SeedSequence, rng: np.random.Generator):
    """Six rests and three turns, each a degree off its nominal direction, one after the other."""
    seen, period_s, clock_s = Seen(unit, seed), 0.02, 0.0
    rests: dict[str, HandRest] = {}
    turns: dict[str, HandTurn] = {}

    def tilt(vector: np.ndarray, axis: int) -> np.ndarray:
        angles = rng.normal(0.0, np.radians(1.0), 3) * (np.arange(3) != axis)
        return Attitude.from_rotvec(angles).apply(vector)

    for axis in range(3):
        for sign, name in ((1.0, "p"), (-1.0, "a")):
            force = np.tile(tilt(sign * GRAVITY * np.eye(3)[axis], axis), (250, 1))
            way = rng.normal(size=3)
            rate = np.tile(EARTH_RAD_S * way / np.linalg.norm(way), (250, 1))
            time_s = clock_s + period_s * np.arange(250, dtype=np.float64)
            gyro, acc = seen(time_s, rate, force)
            rests[f"{'xyz'[axis]}_{name}"] = HandRest(period_s * np.arange(250, dtype=np.float64), acc, gyro)
            clock_s = float(time_s[-1]) + 1.0
        shape = np.clip(np.sin(np.linspace(-0.2, np.pi + 0.2, 300)), 0, None)
        spin = tilt((2 * np.pi + rng.normal(0.0, np.radians(1.0))) * np.eye(3)[axis], axis)
        rate = shape[:, None] / (shape.sum() * period_s) * spin
        time_s = clock_s + period_s * np.arange(300, dtype=np.float64)
        gyro, _ = seen(time_s, rate, np.zeros((300, 3)))
        turns[f"{'xyz'[axis]}_rot"] = HandTurn(period_s * np.arange(300, dtype=np.float64), gyro)
        clock_s = float(time_s[-1]) + 1.0
    return rests, turns


@pytest.mark.slow
def test_ferraris_sessions_are_covered() -> None:
    gyro, acc = [], []
    for number, unit in units(41):
        rng = np.random.default_rng(number)
        found = calibrate_ferraris(*by_hand(unit, unit_seed(41, unit.serial, number), rng), GRAVITY)
        gyro.append(pulls_in_session(found.gyro.coefficients, matrix_of(unit.gyro), unit.gyro))
        acc.append(pulls_in_session(found.acc.coefficients, matrix_of(unit.acc), unit.acc))
    # three turns tell little of how well the hand aligned them
    for each in (np.array(gyro), np.array(acc)):
        check_coverage(each, less=0.04, more=0.31)


@pytest.mark.slow
@pytest.mark.parametrize("colour", ["exponential", "flicker"])
def test_ferraris_sessions_are_covered_on_coloured_noise(colour: str, pulls) -> None:
    """Noise that runs on from rest to rest; in a rest's mean it is more than the white one."""
    gyro, acc = [], []
    for seed in range(200):
        rests, turns = by_own_hand(8000 + seed)
        rng, period_s, count = np.random.default_rng(seed), 0.01, 6 * 500 + 3 * 400
        shape = exponential if colour == "exponential" else None
        for kind, level in (("gyro_rad_s", 1e-4), ("acc_m_s2", 2e-3)):
            slow = (
                shape(rng, count, 3, level, 5.0, period_s)
                if shape
                else flicker(rng, count, 3, 0.6 * level, period_s)
            )
            slow, begin = slow - slow.mean(axis=0), 0  # the bias is of this session
            runs: tuple[dict[str, Any], ...] = (rests, turns)
            for held in runs:
                for name, one in list(held.items()):
                    if not hasattr(one, kind):
                        continue
                    samples = getattr(one, kind)
                    added = samples + slow[begin : begin + len(samples)]
                    held[name] = dataclasses.replace(one, **{kind: added})
                    begin += len(samples)
        found = calibrate_ferraris(rests, turns, OWN_GRAVITY)
        gyro.append(pulls(found.gyro.coefficients, GYRO_M, GYRO_B))
        acc.append(pulls(found.acc.coefficients, ACC_M, ACC_B))
    for each in (np.array(gyro), np.array(acc)):
        check_coverage(each, less=0.04, more=0.31)


@pytest.mark.slow
def test_unknown_attitudes_are_covered() -> None:
    """24 rests of 4 s; the truth's M in body axes in which it is a triangle."""
    pulls = []
    for number, unit in units(43):
        rng = np.random.default_rng(number)
        seen = Seen(unit, unit_seed(43, unit.serial, number))
        up = rng.normal(size=(24, 3))
        up *= GRAVITY / np.linalg.norm(up, axis=1, keepdims=True)
        time_s = 0.04 * np.arange(24 * 100, dtype=np.float64)
        _, acc = seen(time_s, np.zeros((2400, 3)), np.repeat(up, 100, axis=0))
        blocks = acc.reshape(24, 100, 3)
        variance = np.full(24, blocks.var(axis=1, ddof=1).mean() / 100)
        found = fit_multi_position(blocks.mean(axis=1), variance, GRAVITY, "test").coefficients
        # K of the fit is upper triangular: the truth's body axes turned until its K is, too
        _, upper = np.linalg.qr(np.linalg.inv(matrix_of(unit.acc)))
        true = np.linalg.inv(np.sign(np.diag(upper))[:, None] * upper)
        of_all = pulls_in_session(found, true, unit.acc)
        pulls.append(of_all[[0, 1, 2, 4, 5, 8, 9, 10, 11]])
    check_coverage(np.array(pulls), less=0.04, more=0.25)


@pytest.mark.slow
def test_gyros_from_gravity_are_covered() -> None:
    """15 turns between rests whose directions scatter by 0.6 mrad."""
    pulls = []
    for number, unit in units(47):
        still = session(number, 6e-4, white=0.0)
        rate = (still.gyro_rad_s - BIAS) @ np.linalg.inv(MATRIX).T
        seen = Seen(unit, unit_seed(47, unit.serial, number))
        gyro, _ = seen(still.time_s, rate, np.zeros_like(rate))
        at_rest = np.array([gyro[first:last].mean(axis=0) for first, last in still.rests])
        scatter = np.mean([gyro[first:last].var(axis=0, ddof=1) for first, last in still.rests])
        found = fit_turned_gravity(
            dataclasses.replace(
                still,
                gyro_rad_s=gyro,
                bias_rad_s=at_rest.mean(axis=0),
                bias_deviation_rad_s=at_rest.std(axis=0, ddof=1),
                white_density=float(scatter) * float(still.time_s[1] - still.time_s[0]),
            ),
            "test",
        ).coefficients
        off = (found.matrix - matrix_of(unit.gyro)) / found.matrix_standard_uncertainty()
        pulls.append(off.ravel())
    check_coverage(np.array(pulls), less=0.03, more=0.12)


@pytest.mark.slow
def test_magnetometers_turned_all_ways_are_covered() -> None:
    """Scale along each axis and hard iron of units in 50 uT, 600 directions each."""
    pulls, field_t = [], 50e-6
    for number, unit in units(53):
        sensors = InertialSensors(unit, unit_seed(53, unit.serial), 0.0)
        directions = np.random.default_rng(number).standard_normal((600, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        found = hard_and_soft_iron(sensors.field_t(field_t * directions), field_t)
        forward = np.diag(1.0 + np.array(unit.magnetometer.scale_factor_error))
        forward = forward @ (np.eye(3) + np.array(unit.magnetometer.soft_iron))
        # the fit's K is symmetric: that of the truth up to a rotation
        inverse = np.linalg.inv(forward)
        values, axes = np.linalg.eigh(inverse.T @ inverse)
        true = axes @ np.diag(np.sqrt(values)) @ axes.T
        at = np.triu_indices(3)
        of_matrix = (found.compensation - true)[at] / found.compensation_standard_uncertainty()[at]
        off = found.hard_iron - np.array(unit.magnetometer.bias_t)
        pulls.append([*of_matrix, *(off / found.hard_iron_standard_uncertainty())])
    check_coverage(np.array(pulls))


RATE_HZ, SAMPLES = 20.0, 2**13
WHITE, FLICKER, WALK = 1e-3, 6e-4, 6e-5


def emulated_noise() -> np.ndarray:
    """(samples, 201): three axes of 67 records."""
    chain = EffectChain(
        (
            WhiteNoise(sensor="gyro", density_si_per_sqrt_hz=(WHITE, WHITE, WHITE)),
            FlickerNoise(sensor="gyro", coefficient_si=(FLICKER, FLICKER, FLICKER), shortest_time_s=0.01),
            RateRandomWalk(sensor="gyro", coefficient_si_per_sqrt_s=(WALK, WALK, WALK)),
        )
    )
    times = np.arange(SAMPLES) / RATE_HZ
    stimulus = Stimulus(times, np.full(SAMPLES, 25.0), 1 / RATE_HZ)
    records = [
        chain.apply(np.zeros((SAMPLES, 3)), stimulus, chain.begin(np.random.SeedSequence(record)))
        for record in range(67)
    ]
    return np.concatenate(records, axis=1)


def noise_of_spectra() -> np.ndarray:
    """The same three terms from spectra and from sums of draws."""
    rng, period_s = np.random.default_rng(3), 1 / RATE_HZ
    walk = WALK * np.sqrt(period_s) * np.cumsum(rng.standard_normal((SAMPLES, 201)), axis=0)
    return white(rng, SAMPLES, 201, WHITE**2, period_s) + flicker(rng, SAMPLES, 201, FLICKER, period_s) + walk


@pytest.mark.slow
@pytest.mark.parametrize("noise", [emulated_noise, noise_of_spectra])
def test_coefficients_of_plots_are_covered(noise) -> None:
    """N, B and K by Allan's plot and by wavelets; where a term is cut at zero it is held more often."""
    by_allan, by_wavelet = [], []
    truth = np.array([WHITE, FLICKER, WALK]) ** 2
    for record in noise().T:
        samples = np.ascontiguousarray(record)
        fit = fit_allan_coefficients(
            overlapping_allan_deviation(samples, RATE_HZ),
            ("random_walk", "bias_instability", "rate_random_walk"),
        )
        by_allan.append((fit.squares[1:4] - truth) / np.sqrt(np.diag(fit.covariance)[1:4]))
        fit = fit_wavelet_coefficients(wavelet_variance(samples, RATE_HZ))
        by_wavelet.append((fit.squares[1:4] - truth) / np.sqrt(np.diag(fit.covariance)[1:4]))
    for each in (by_allan, by_wavelet):
        check_coverage(np.array(each), more=0.33)

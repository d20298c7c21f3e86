"""Gyros from gravity turned between rests: a body turned by a rotation of our own, not by the fit's."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.turned_gravity import (
    GravitySession,
    TurnedGravityFit,
    cumulative_attitude,
    fit_turned_gravity,
    turns_between,
)
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import exponential

GRAVITY = 9.8
PERIOD_S = 0.04
MATRIX = np.array([[1.02, 0.006, -0.004], [-0.003, 0.97, 0.008], [0.005, -0.002, 1.01]])
BIAS = np.array([0.01, -0.02, 0.015])
REST, TURN = 25, 38  # samples
UNKNOWN_ACC = TriadCoefficients("acceleration", np.eye(3), np.zeros(3), np.zeros((12, 12)), 0.0, 1)


def session(
    seed: int,
    direction_rad: float,
    white: float = 2e-5,
    axes: tuple[int, ...] = (0, 1, 2),
    turns: int = 15,
    slow: float = 0.0,
) -> GravitySession:
    """Rests with turns of 60 to 150 deg between them, each about one body axis or near it."""
    rng = np.random.default_rng(seed)
    rates = [np.zeros((REST, 3))]
    for k in range(turns):
        axis = np.eye(3)[axes[k % len(axes)]] + 0.2 * rng.standard_normal(3) * np.isin(range(3), axes)
        angle = np.radians(rng.uniform(60, 150)) * rng.choice([-1, 1])
        shape = np.sin(np.pi * (np.arange(TURN) + 0.5) / TURN) ** 2
        rates += [np.outer(shape / shape.sum(), axis / np.linalg.norm(axis)) * angle / PERIOD_S]
        rates += [np.zeros((REST, 3))]
    rate = np.concatenate(rates)
    steps = (rate[1:] + rate[:-1]) / 2 * PERIOD_S
    attitude = [Rotation.from_rotvec([0.3, -0.4, 0.0]).as_matrix()]
    for step in Rotation.from_rotvec(steps).as_matrix():
        attitude.append(attitude[-1] @ step)
    down = GRAVITY * np.array(attitude)[:, 2]
    rests = tuple((k * (REST + TURN), k * (REST + TURN) + REST) for k in range(turns + 1))
    force = down.copy()
    for first, last in rests:
        tilt = Rotation.from_rotvec(direction_rad * rng.standard_normal(3))
        force[first:last] = tilt.apply(down[first:last])
    gyro = rate @ MATRIX.T + BIAS + np.sqrt(white**2 / PERIOD_S) * rng.standard_normal(rate.shape)
    wander = exponential(rng, len(rate), 3, slow, 20.0, PERIOD_S) if slow else 0.0
    at_rest = np.array([(gyro + wander)[first:last].mean(axis=0) for first, last in rests])
    return GravitySession(
        time_s=PERIOD_S * np.arange(len(rate)),
        gyro_rad_s=gyro + wander,
        specific_force_m_s2=force,
        rests=rests,
        turns=turns_between(turns + 1, [True] * turns),
        bias_rad_s=at_rest.mean(axis=0),
        bias_deviation_rad_s=at_rest.std(axis=0, ddof=1) + 1e-7,
        white_density=white**2,
        gravity_m_s2=GRAVITY,
        acc=UNKNOWN_ACC,
    )


def pulls(fit: TurnedGravityFit) -> np.ndarray:
    found = fit.coefficients
    of_matrix = (found.matrix - MATRIX) / found.matrix_standard_uncertainty()
    return np.concatenate([of_matrix.ravel(), (found.bias - BIAS) / found.bias_standard_uncertainty()])


def test_the_products_of_small_rotations_are_scipys() -> None:
    angles = 0.3 * np.random.default_rng(0).standard_normal((300, 3))
    found, expected = cumulative_attitude(angles), Rotation.identity()
    for k, angle in enumerate(angles):
        np.testing.assert_allclose(found[k], expected.as_matrix(), atol=1e-12)
        expected = expected * Rotation.from_rotvec(angle)


def test_turns_without_noise_give_matrix_and_bias() -> None:
    fit = fit_turned_gravity(session(1, 0.0, white=0.0), "test")
    np.testing.assert_allclose(fit.coefficients.matrix, MATRIX, atol=1e-5)  # Earth rate is not modelled
    np.testing.assert_allclose(fit.coefficients.bias, BIAS, atol=1e-6)
    assert fit.outliers == ()


@pytest.mark.parametrize("seeds", [6, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("slow", [0.0, 3e-5])
def test_intervals_cover_the_truth(seeds: int, slow: float) -> None:
    """Directions that scatter by 0.6 mrad from rest to rest; white noise, and a slow one beside it."""
    every = np.array([pulls(fit_turned_gravity(session(s, 6e-4, slow=slow), "test")) for s in range(seeds)])
    for width, stated in ((1.0, 0.6827), (1.96, 0.95)):
        of_matrix, of_bias = (np.abs(part) <= width for part in (every[:, :9], every[:, 9:]))
        # Nine elements of one fit are correlated: a third of them counts as independent.
        margin = 3.5 * np.sqrt(stated * (1 - stated) / (3 * seeds))
        assert abs(of_matrix.mean() - stated) <= margin, (width, of_matrix.mean())
        assert of_bias.mean() >= stated - margin, (width, of_bias.mean())


def test_a_turn_that_was_hit_is_left_out_and_said() -> None:
    clean = session(3, 3e-4)
    force = clean.specific_force_m_s2.copy()
    first, last = clean.rests[-1]
    force[first:last] = Rotation.from_rotvec([0.1, 0.1, 0.0]).apply(force[first:last])
    fit = fit_turned_gravity(dataclasses.replace(clean, specific_force_m_s2=force), "test")
    assert [turn.after for turn in fit.outliers] == [len(clean.rests) - 1]
    assert np.abs(pulls(fit)).max() < 4


def test_turns_about_two_axes_and_too_few_are_refused() -> None:
    with pytest.raises(CalibrationError, match="open") as refusal:
        fit_turned_gravity(session(4, 1e-4, axes=(0, 1)), "test")
    assert "turn about z" in refusal.value.remedy
    with pytest.raises(CalibrationError, match="need 9 turns"):
        fit_turned_gravity(session(5, 1e-4, turns=8), "test")

"""A session by hand: tilted poses and imperfect turns from a generator of its own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Attitude

from calibration.algorithms.ferraris import HandRest, HandTurn, calibrate_ferraris
from protocol.errors import CalibrationError

GRAVITY = 9.81
ACC_M = np.array([[1.02, 0.004, -0.006], [-0.003, 0.985, 0.008], [0.005, -0.007, 1.01]])
ACC_B = np.array([0.2, -0.1, 0.3])
GYRO_M = np.array([[0.99, 0.01, -0.004], [0.006, 1.015, 0.003], [-0.008, 0.002, 1.005]])
GYRO_B = np.array([0.01, -0.02, 0.005])
ALIGNMENT_RAD = np.radians(1.0)
TURN_RAD = np.radians(1.0)
EARTH_RAD_S = 7.2921e-5
DT = 0.01


def session(seed: int, direction: float = 1.0) -> tuple[dict[str, HandRest], dict[str, HandTurn]]:
    """Rests tilted at random about both level axes, turns of 360 deg give or take a degree."""
    rng = np.random.default_rng(seed)
    rests: dict[str, HandRest] = {}
    turns: dict[str, HandTurn] = {}

    def tilt(vector: np.ndarray, axis: int) -> np.ndarray:
        angles = rng.normal(size=3) * ALIGNMENT_RAD
        angles[axis] = 0.0
        return Attitude.from_rotvec(angles).apply(vector)

    def earth() -> np.ndarray:
        way = rng.normal(size=3)
        return EARTH_RAD_S * way / np.linalg.norm(way)

    for axis in range(3):
        for sign, name in ((1, "p"), (-1, "a")):
            up = np.zeros(3)
            up[axis] = sign * GRAVITY
            force = tilt(up, axis)
            acc = ACC_M @ force + ACC_B + rng.normal(size=(500, 3)) * 0.01
            gyro = GYRO_M @ earth() + GYRO_B + rng.normal(size=(500, 3)) * 1e-3
            rests[f"{'xyz'[axis]}_{name}"] = HandRest(np.arange(500) * DT, acc, gyro)
        shape = np.clip(np.sin(np.linspace(-0.2, np.pi + 0.2, 400)), 0, None)
        spin = np.zeros(3)
        spin[axis] = direction * (2 * np.pi + rng.normal() * TURN_RAD)
        rate = shape[:, None] / (shape.sum() * DT) * tilt(spin, axis)
        gyro = rate @ GYRO_M.T + GYRO_B + rng.normal(size=(400, 3)) * 1e-3
        turns[f"{'xyz'[axis]}_rot"] = HandTurn(np.arange(400) * DT, gyro)
    return rests, turns


def test_hand_made_poses_are_covered_by_the_stated_uncertainties(pulls) -> None:
    acc, gyro, alignments = [], [], []
    for seed in range(80):
        found = calibrate_ferraris(*session(seed), GRAVITY)
        acc.append(pulls(found.acc.coefficients, ACC_M, ACC_B))
        gyro.append(pulls(found.gyro.coefficients, GYRO_M, GYRO_B))
        alignments.append(found.alignment_rad)
    across = np.array([1, 2, 3, 5, 6, 7])
    assert 0.7 < (np.array(acc)[:, across] ** 2).mean() < 1.3
    assert (np.array(acc)[:, [0, 4, 8]] ** 2).mean() < 1.5
    assert (np.array(acc)[:, 9:] ** 2).mean() < 1.5
    assert 0.6 < (np.array(gyro)[:, :9] ** 2).mean() < 1.3
    assert (np.array(gyro)[:, 9:] ** 2).mean() < 1.5
    assert np.median(alignments) == pytest.approx(ALIGNMENT_RAD, rel=0.4)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_direction_of_a_turn_is_recognised(direction: float) -> None:
    found = calibrate_ferraris(*session(7, direction), GRAVITY)
    assert set(found.turns.values()) == {int(direction)}
    np.testing.assert_allclose(np.diag(found.gyro.coefficients.matrix), np.diag(GYRO_M), atol=0.015)


def test_missing_parts_and_turns_that_are_none_are_named() -> None:
    rests, turns = session(1)
    with pytest.raises(CalibrationError, match="lacks y_a, z_rot"):
        calibrate_ferraris(
            {name: rest for name, rest in rests.items() if name != "y_a"},
            {name: turn for name, turn in turns.items() if name != "z_rot"},
            GRAVITY,
        )
    short = replace(
        turns["x_rot"], time_s=turns["x_rot"].time_s[:200], gyro_rad_s=turns["x_rot"].gyro_rad_s[:200]
    )
    with pytest.raises(CalibrationError, match=r"'x_rot' is no whole turn about x: the gyro saw \+0\.49"):
        calibrate_ferraris(rests, turns | {"x_rot": short}, GRAVITY)
    lost = turns["x_rot"].gyro_rad_s.copy()
    lost[10, 0] = np.nan
    with pytest.raises(CalibrationError, match="no whole turn"):
        calibrate_ferraris(rests, turns | {"x_rot": replace(turns["x_rot"], gyro_rad_s=lost)}, GRAVITY)

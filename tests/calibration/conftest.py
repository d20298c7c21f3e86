"""A synthetic IMU of its own: it shares no code with calibration or emulator."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.imu_session import Rotation, StaticPose

EARTH_RAD_S = 7.2921e-5
COARSE_S = 0.5  # the slow noise is drawn at 2 Hz and held: slow against everything else


@dataclass(frozen=True)
class SyntheticImu:
    """A unit and a stand: y = M u + b + white + Gauss-Markov, sampled at 50 Hz.

    `white_*`: standard deviation of a sample; `slow_*`: of the Gauss-Markov bias with
    `correlation_s`, drawn step by step as a recursion.
    """

    gyro_m: tuple[tuple[float, ...], ...] = (
        (1.012, 0.004, -0.006),
        (-0.003, 0.985, 0.008),
        (0.005, -0.007, 1.021),
    )
    gyro_b: tuple[float, ...] = (0.012, -0.007, 0.004)
    acc_m: tuple[tuple[float, ...], ...] = (
        (1.002, -0.003, 0.002),
        (0.004, 0.998, -0.005),
        (-0.001, 0.006, 1.004),
    )
    acc_b: tuple[float, ...] = (0.2, -0.15, 0.3)
    white_gyro: float = 5e-4
    white_acc: float = 0.01
    slow_gyro: float = 0.0
    slow_acc: float = 0.0
    correlation_s: float = 300.0
    gravity: float = 9.797
    latitude_rad: float = 0.6
    rate_hz: float = 50.0
    pose_s: float = 30.0
    turn_s: float = 12.0
    pause_s: float = 5.0
    turns: float = 3.0

    def but(self, **changes: object) -> "SyntheticImu":
        return replace(self, **changes)  # pyright: ignore[reportArgumentType]

    def session(self, seed: int) -> tuple[list[StaticPose], list[Rotation]]:
        """Six positions and three turns about each axis each way, on a stand with a vertical spin axis."""
        rng = np.random.default_rng(seed)
        dt = 1 / self.rate_hz
        earth_ned = EARTH_RAD_S * np.array([np.cos(self.latitude_rad), 0.0, -np.sin(self.latitude_rad)])
        total_s = 6 * (self.pose_s + self.pause_s) + 6 * (self.turn_s + self.pause_s)
        slow = {
            kind: gauss_markov(rng, int(total_s / COARSE_S) + 2, level, self.correlation_s)
            for kind, level in (("gyro", self.slow_gyro), ("acc", self.slow_acc))
        }
        gyro_m, acc_m = np.array(self.gyro_m), np.array(self.acc_m)

        def noisy(clean: NDArray[np.float64], time_s: NDArray[np.float64], kind: str) -> NDArray[np.float64]:
            held = slow[kind][(time_s / COARSE_S).astype(int)]
            white = self.white_gyro if kind == "gyro" else self.white_acc
            return clean + held + rng.normal(size=clean.shape) * white

        poses: list[StaticPose] = []
        rotations: list[Rotation] = []
        clock_s = 0.0
        for axis in range(3):
            for sign in (1.0, -1.0):
                up = np.zeros(3)
                up[axis] = sign
                north = np.roll(up, 1)
                earth = np.stack([north, np.cross(-up, north), -up], axis=1) @ earth_ned
                count = int(self.pose_s * self.rate_hz)
                time_s = np.float64(clock_s) + np.arange(count, dtype=np.float64) * dt
                gyro = np.tile(gyro_m @ earth + self.gyro_b, (count, 1))
                acc = np.tile(acc_m @ (self.gravity * up) + self.acc_b, (count, 1))
                poses.append(
                    StaticPose(
                        f"{'xyz'[axis]}_{'up' if sign > 0 else 'down'}",
                        noisy(gyro, time_s, "gyro"),
                        noisy(acc, time_s, "acc"),
                        self.gravity * up,
                        earth,
                        time_s,
                    )
                )
                clock_s += self.pose_s + self.pause_s
        for axis in range(3):
            for sign in (1.0, -1.0):
                count = int(self.turn_s * self.rate_hz)
                local = (np.arange(count, dtype=np.float64) + 0.5) * dt
                window = np.clip(1 - np.abs(local - 4.0) / 3.0, 0, None)  # a triangle from 1 s to 7 s
                rate = sign * 2 * np.pi * self.turns * window / (window.sum() * dt)
                spin = np.zeros(3)
                spin[axis] = 1.0
                north = np.roll(spin, 1)
                east = np.cross(-spin, north)
                angle = np.cumsum(rate) * dt
                # With the spin axis up, the horizontal part of the Earth's rate turns backwards in the body.
                level = np.cos(angle)[:, None] * north + np.sin(angle)[:, None] * east
                earth = earth_ned[0] * level - earth_ned[2] * spin
                true = rate[:, None] * spin
                time_s = np.float64(clock_s) + np.arange(count, dtype=np.float64) * dt
                rotations.append(
                    Rotation(
                        f"{'xyz'[axis]}_{'plus' if sign > 0 else 'minus'}",
                        time_s,
                        noisy((true + earth) @ gyro_m.T + self.gyro_b, time_s, "gyro"),
                        true.sum(axis=0) * dt,
                        earth.sum(axis=0) * dt,
                    )
                )
                clock_s += self.turn_s + self.pause_s
        return poses, rotations


def gauss_markov(
    rng: np.random.Generator, count: int, level: float, correlation_s: float
) -> NDArray[np.float64]:
    """(count, 3) samples, COARSE_S apart, of a stationary first-order process, step by step."""
    if level == 0.0:
        return np.zeros((count, 3))
    phi = np.exp(-COARSE_S / correlation_s)
    state = rng.normal(size=3) * level
    samples = np.empty((count, 3))
    for row in range(count):
        samples[row] = state
        state = phi * state + rng.normal(size=3) * level * np.sqrt(1 - phi**2)
    return samples


@pytest.fixture
def synthetic_imu() -> SyntheticImu:
    """The synthetic unit with its default coefficients and white noise."""
    return SyntheticImu()


@pytest.fixture
def pulls():
    """(estimate - truth) / standard uncertainty: nine of the matrix, three of the bias."""

    def pulls_of(found: TriadCoefficients, matrix: object, bias: object) -> NDArray[np.float64]:
        of_matrix = (found.matrix - np.array(matrix)) / found.matrix_standard_uncertainty()
        of_bias = (found.bias - np.array(bias)) / found.bias_standard_uncertainty()
        return np.concatenate([of_matrix.ravel(), of_bias])

    return pulls_of

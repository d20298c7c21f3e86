"""A synthetic session of its own: shares no code with calibration or emulator.

Noise is built in the time domain: white samples, and a Gauss-Markov bias as an explicit recursion.
"""

import numpy as np

from calibration.imu_session import Rotation, StaticPose

GRAVITY = 9.797
EARTH = 7.2921e-5
RATE_HZ = 50.0
POSE_S = 30.0
GYRO_M = np.array([[1.012, 0.004, -0.006], [-0.003, 0.985, 0.008], [0.005, -0.007, 1.021]])
GYRO_B = np.array([0.012, -0.007, 0.004])
ACC_M = np.array([[1.002, -0.003, 0.002], [0.004, 0.998, -0.005], [-0.001, 0.006, 1.004]])
ACC_B = np.array([0.2, -0.15, 0.3])


def gauss_markov(rng, n, dt, sigma, tau):
    """(n, 3) samples of a stationary Gauss-Markov process, step by step."""
    phi = np.exp(-dt / tau)
    drive = rng.normal(size=(n, 3)) * sigma * np.sqrt(1 - phi**2)
    out = np.empty((n, 3))
    state = rng.normal(size=3) * sigma
    for k in range(n):
        out[k] = state
        state = phi * state + drive[k]
    return out


def session(
    seed,
    white_gyro=5e-4,
    white_acc=0.01,
    slow_gyro=0.0,
    slow_acc=0.0,
    tau=300.0,
    turns=3.0,
    gyro_m=GYRO_M,
    gyro_b=GYRO_B,
    acc_m=ACC_M,
    acc_b=ACC_B,
    pause_s=5.0,
):
    """Six poses and six turns; white: standard deviation per sample; slow: Gauss-Markov."""
    rng = np.random.default_rng(seed)
    dt = 1 / RATE_HZ
    earth_ned = EARTH * np.array([np.cos(0.6), 0.0, -np.sin(0.6)])
    poses, rotations = [], []
    total = 6 * (POSE_S + pause_s) + 6 * (12.0 + pause_s)
    coarse = 0.5  # the slow noise is drawn at 2 Hz and held: slow against everything else
    slow = {
        "gyro": gauss_markov(rng, int(total / coarse) + 2, coarse, slow_gyro, tau),
        "acc": gauss_markov(rng, int(total / coarse) + 2, coarse, slow_acc, tau),
    }

    def noisy(clean, time_s, kind, white):
        held = slow[kind][(time_s / coarse).astype(int)]
        return clean + held + rng.normal(size=clean.shape) * white

    clock = 0.0
    for axis in range(3):
        for sign in (1.0, -1.0):
            up = np.zeros(3)
            up[axis] = sign
            north = np.roll(up, 1)
            body_from_ned = np.stack([north, np.cross(-up, north), -up], axis=1)
            time_s = clock + np.arange(int(POSE_S * RATE_HZ)) * dt
            force, earth = GRAVITY * up, body_from_ned @ earth_ned
            ones = np.ones((len(time_s), 1))
            poses.append(
                StaticPose(
                    f"{'xyz'[axis]}_{'up' if sign > 0 else 'down'}",
                    noisy(ones * (gyro_m @ earth + gyro_b), time_s, "gyro", white_gyro),
                    noisy(ones * (acc_m @ force + acc_b), time_s, "acc", white_acc),
                    force,
                    earth,
                    time_s,
                )
            )
            clock += POSE_S + pause_s
    for axis in range(3):
        for sign in (1.0, -1.0):
            n = int(12.0 * RATE_HZ)
            local = (np.arange(n) + 0.5) * dt
            window = np.clip(1 - np.abs(local - 4.0) / 3.0, 0, None)  # triangle from 1 s to 7 s
            rate = sign * 2 * np.pi * turns * window / (window.sum() * dt)
            spin = np.zeros(3)
            spin[axis] = 1.0
            north = np.roll(spin, 1)
            east = np.cross(-spin, north)
            angle = np.cumsum(rate) * dt
            # spin axis up: earth's horizontal part turns backwards in the body
            earth = (
                earth_ned[0] * (np.cos(angle)[:, None] * north + np.sin(angle)[:, None] * east)
                - earth_ned[2] * spin
            )
            true = rate[:, None] * spin
            time_s = clock + np.arange(n) * dt
            rotations.append(
                Rotation(
                    f"{'xyz'[axis]}_{'plus' if sign > 0 else 'minus'}",
                    time_s,
                    noisy((true + earth) @ gyro_m.T + gyro_b, time_s, "gyro", white_gyro),
                    true.sum(axis=0) * dt,
                    earth.sum(axis=0) * dt,
                )
            )
            clock += 12.0 + pause_s
    return poses, rotations


def pulls(coefficients, matrix, bias):
    """(estimate - truth) / standard uncertainty of all twelve coefficients."""
    return np.concatenate(
        [
            ((coefficients.matrix - matrix) / coefficients.matrix_standard_uncertainty()).ravel(),
            (coefficients.bias - bias) / coefficients.bias_standard_uncertainty(),
        ]
    )

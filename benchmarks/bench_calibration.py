"""Calibration beside its peers on the same samples: accuracy over some seeds, CPU time of the fastest round.

Six positions and turns, 30 s at 1 kHz each, 1 mg of noise: imucal's Ferraris calibration, and a plain
least squares of the six means with a column of ones. An ellipsoid through 1e5 points with 500 uG of noise:
a plain algebraic fit. The peers state no uncertainty; what is timed of ours is screening, fit and covariance.
"""

import gc
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import imucal
import numpy as np

from calibration.algorithms.magnetometer import hard_and_soft_iron
from calibration.imu_session import ImuCalibration, Rotation, StaticPose, calibrate_imu

SEEDS = 6
ROUNDS = 7
AT_OR_BELOW = 1.0
SAME = 1.02
"""Equally good: two estimators that differ by less than this over the seeds."""
GRAVITY = 9.81
SAMPLES = 30_000
RATE_HZ = 1000.0
ACC_NOISE = 9.80665e-3  # 1 mg a sample
GYRO_NOISE = 1e-3
MATRIX = np.array([[1.01, 0.004, -0.003], [0.002, 0.99, 0.005], [-0.004, 0.003, 1.02]])
ACC_BIAS = np.array([0.1, -0.2, 0.15])
GYRO_BIAS = np.array([0.01, -0.02, 0.015])
MICRO_G = 9.80665e-6

POINTS = 100_000
FIELD_GAUSS = 0.35
POINT_NOISE_GAUSS = 500e-6
SOFT_IRON = np.array([[1.1, 0.05, -0.02], [0.05, 0.9, 0.03], [-0.02, 0.03, 1.2]])
HARD_IRON_GAUSS = np.array([0.08, -0.05, 0.12])

Captures = dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class _Estimate:
    matrix: np.ndarray
    bias: np.ndarray


def run() -> list[dict[str, Any]]:
    """The figures."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _six_positions() + _ellipsoid()


def _six_positions() -> list[dict[str, Any]]:
    ours, peer, plain = [], [], []
    captures: Captures = {}
    for seed in range(SEEDS):
        captures = _captures(np.random.Generator(np.random.SFC64(seed)))
        regions, session = _regions(captures), _session(captures)
        ours.append(_errors(_by_testloom(*session)))
        peer.append(_errors(_by_imucal(regions)))
        plain.append(_errors(_by_least_squares(captures)))
    ours_rms, peer_rms, plain_rms = (
        np.sqrt(np.mean(np.square(each), axis=0)) for each in (ours, peer, plain)
    )
    regions, session = _regions(captures), _session(captures)
    ours_s = _fastest(lambda: _by_testloom(*session))
    peer_s, plain_s = _fastest(lambda: _by_imucal(regions)), _fastest(lambda: _by_least_squares(captures))
    what = "six positions and turns"
    return [
        _row(
            f"{what}, CPU over imucal's",
            ours_s / peer_s,
            AT_OR_BELOW,
            f"imucal {1e3 * peer_s:.1f} ms, Testloom {1e3 * ours_s:.1f} ms with covariance "
            f"(least squares of six means alone {1e3 * plain_s:.1f} ms)",
        ),
        _row(
            f"{what}, error of the matrix over imucal's",
            ours_rms[0] / peer_rms[0],
            SAME,
            f"rms: imucal {peer_rms[0]:.2g}, least squares {plain_rms[0]:.2g}, Testloom {ours_rms[0]:.2g}",
        ),
        _row(
            f"{what}, error of the bias over imucal's",
            ours_rms[1] / peer_rms[1],
            AT_OR_BELOW,
            f"rms: imucal {peer_rms[1] / MICRO_G:.2g} ug, Testloom {ours_rms[1] / MICRO_G:.2g} ug",
        ),
        _row(
            f"{what}, error of the bias over a plain least squares'",
            ours_rms[1] / plain_rms[1],
            SAME,
            f"rms: least squares {plain_rms[1] / MICRO_G:.2g} ug",
        ),
    ]


def _captures(rng: np.random.Generator) -> Captures:
    """Name → accelerometer and gyro (n, 3), true specific force and rate (3,)."""
    captures: Captures = {}
    for axis in range(3):
        for way, sign in (("p", 1.0), ("a", -1.0)):
            captures[f"{'xyz'[axis]}_{way}"] = _capture(rng, sign * GRAVITY * np.eye(3)[axis], np.zeros(3))
        rate = -2.0 * np.pi / (SAMPLES / RATE_HZ) * np.eye(3)[axis]
        captures[f"{'xyz'[axis]}_rot"] = _capture(rng, GRAVITY * np.eye(3)[axis], rate)
    return captures


def _capture(rng: np.random.Generator, force: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, ...]:
    acc = MATRIX @ force + ACC_BIAS + ACC_NOISE * rng.standard_normal((SAMPLES, 3))
    gyro = MATRIX @ rate + GYRO_BIAS + GYRO_NOISE * rng.standard_normal((SAMPLES, 3))
    return acc, gyro, force, rate


def _session(captures: Captures) -> tuple[list[StaticPose], list[Rotation]]:
    time_s, zero = np.arange(SAMPLES) / RATE_HZ, np.zeros(3)
    poses = [
        StaticPose(name, gyro, acc, force, zero, time_s)
        for name, (acc, gyro, force, rate) in captures.items()
        if not rate.any()
    ]
    turns = [
        Rotation(name, time_s, gyro, rate * SAMPLES / RATE_HZ, zero)
        for name, (_, gyro, _, rate) in captures.items()
        if rate.any()
    ]
    return poses, turns


def _regions(captures: Captures) -> imucal.FerrarisSignalRegions:
    acc = {f"acc_{name}": capture[0] for name, capture in captures.items()}
    gyro = {f"gyr_{name}": np.degrees(capture[1]) for name, capture in captures.items()}
    return imucal.FerrarisSignalRegions(**acc, **gyro)


def _by_testloom(poses: list[StaticPose], turns: list[Rotation]) -> _Estimate:
    found: ImuCalibration = calibrate_imu(poses, turns)
    return _Estimate(found.acc.matrix, found.acc.bias)


def _by_imucal(regions: imucal.FerrarisSignalRegions) -> _Estimate:
    calibration = imucal.FerrarisCalibration(grav=GRAVITY)
    found = calibration.compute(regions, RATE_HZ, from_acc_unit="m/s^2", from_gyr_unit="deg/s")
    return _Estimate(found.K_a @ found.R_a, found.b_a)


def _by_least_squares(captures: Captures) -> _Estimate:
    rests = [capture for name, capture in captures.items() if not name.endswith("rot")]
    design = np.array([np.append(force, 1.0) for _, _, force, _ in rests])
    means = np.array([acc.mean(axis=0) for acc, *_ in rests])
    solution, *_ = np.linalg.lstsq(design, means, rcond=None)
    return _Estimate(solution[:3].T, solution[3])


def _errors(found: _Estimate) -> tuple[float, float]:
    """Rms of the matrix's nine elements (1) and of the three biases (m/s^2)."""
    return (
        float(np.sqrt(np.mean((found.matrix - MATRIX) ** 2))),
        float(np.sqrt(np.mean((found.bias - ACC_BIAS) ** 2))),
    )


def _ellipsoid() -> list[dict[str, Any]]:
    ours, peer = [], []
    points = np.zeros((0, 3))
    for seed in range(SEEDS):
        points = _points(np.random.Generator(np.random.SFC64(100 + seed)))
        ours.append(hard_and_soft_iron(points).hard_iron - HARD_IRON_GAUSS)
        peer.append(_plain_centre(points) - HARD_IRON_GAUSS)
    ours_rms, peer_rms = (1e6 * float(np.sqrt(np.mean(np.square(each)))) for each in (ours, peer))
    ours_s = _fastest(lambda: hard_and_soft_iron(points))
    peer_s = _fastest(lambda: _plain_centre(points))
    return [
        _row(
            "ellipsoid of 1e5 points, CPU over a plain fit's",
            ours_s / peer_s,
            AT_OR_BELOW,
            f"plain {1e3 * peer_s:.1f} ms, Testloom {1e3 * ours_s:.1f} ms, robust and with covariance",
        ),
        _row(
            "ellipsoid of 1e5 points, error of the centre over a plain fit's",
            ours_rms / peer_rms,
            AT_OR_BELOW,
            f"rms: plain {peer_rms:.2g} uG, Testloom {ours_rms:.2g} uG",
        ),
    ]


def _points(rng: np.random.Generator) -> np.ndarray:
    directions = rng.standard_normal((POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    clean = FIELD_GAUSS * directions @ SOFT_IRON + HARD_IRON_GAUSS
    return clean + POINT_NOISE_GAUSS * rng.standard_normal((POINTS, 3))


def _plain_centre(points: np.ndarray) -> np.ndarray:
    """v^T A v + 2 b^T v = 1 by numpy's least squares; the centre."""
    x, y, z = points.T
    design = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z])
    v, *_ = np.linalg.lstsq(design, np.ones(len(points)), rcond=None)
    matrix = np.array([[v[0], v[3], v[4]], [v[3], v[1], v[5]], [v[4], v[5], v[2]]])
    return -np.linalg.solve(matrix, v[6:])


def _fastest(task: Callable[[], object]) -> float:
    """Least CPU time of some rounds, s."""
    durations = []
    gc.collect()
    for _ in range(ROUNDS):
        began = time.process_time()
        task()
        durations.append(time.process_time() - began)
    return min(durations)


def _row(figure: str, ratio: float, goal: float, beside: str) -> dict[str, Any]:
    return {
        "figure": figure,
        "value": float(ratio),
        "unit": "1",
        "goal": f"at most {goal:g}",
        "met": bool(ratio <= goal),
        "compared_with": beside,
    }

# pyright: strict
"""The unit's attitude algorithm: strapdown by quaternions, corrected by gravity while its gates are open.

Body axes are x forward, y left, z up; the level frame is z up with the heading of power-on. Roll is right
side down, pitch nose up, yaw clockwise: C_body_from_level = Rx(roll) Ry(−pitch) Rz(−yaw). On a turntable they
are the inner angle, less the middle one, less the outer one.

Gyros are integrated at every sample (trapezoid). Every `BLOCK` samples, if the gates were open throughout,
the mean specific force f is held against the up direction u that the attitude gives: e = f/|f| × u turns the
attitude by k_p e and the bias estimate by −k_i e per second (Mahony, Hamel, Pflimlin, *Nonlinear
Complementary Filters on the Special Orthogonal Group*, IEEE TAC 53, 2008). The first open second levels the
attitude and takes the mean rate for the bias. A block's corrections take effect over the next one, half of
them before the block's own rotation and half after it; so blocks can be integrated side by side.

The gates (paper 2, 3.1 and 3.2, corrected) are held against f and ω smoothed over 0.1 s, and ω̇ of the
smoothed ω:

    | |f| − g | < √(g² + ξ_a²) − g + 3 s_f + what the accelerometers may err
    |ω| < ξ_ω / V + 3 s_ω + what the gyros may err
    |ω̇| < √3 · ξ_ω̇ / √(3 (d_x² + d_z²)) + 3 s_ω̇

The errors' part is far larger than ξ_a's: at MEMS accuracy the norm alone cannot keep a horizontal
acceleration of ξ_a out. Out of scope: coning and sculling terms, Earth rate, vehicle's own lever arm.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from dut_emulator.effects.first_order import first_order

BLOCK = 10
SMOOTHING_S = 0.1
ALIGNMENT_S = 1.0
TILT_GAIN_PER_S = 0.08
BIAS_GAIN_PER_S2 = TILT_GAIN_PER_S**2 / 4.0
"""Critically damped."""

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Gates:
    """Bounds in SI on | |f| − g |, |ω| and |ω̇|."""

    norm_m_s2: float
    rate_rad_s: float
    acceleration_rad_s2: float
    gravity_m_s2: float = 9.80665


def gates(*, compensated: bool) -> Gates:
    """The firmware's. Accelerometers err by 5 mg when compensated and 30 mg else (paper 2, 2.2.2).

    ξ_a = 0.01 g, ξ_ω = 0.1 m/s² at V = 50 m/s, ξ_ω̇ = 0.05 m/s² with d = (0.3, 0.02, 0.02) m. After the
    smoothing 0.06 m/s/√h leave s_f = 2 mm/s², 0.3 °/√h leave s_ω = 0.02 °/s and s_ω̇ = 0.3 °/s². Gyros err by
    0.8 °/s before and 0.2 °/s after compensation, turn-on and warm-up included.
    """
    gravity, horizontal = 9.80665, 0.01 * 9.80665
    norm = horizontal**2 / (math.hypot(gravity, horizontal) + gravity)  # √(g² + ξ²) − g without loss
    acceleration = math.sqrt(3.0) * 0.05 / math.sqrt(3.0 * (0.3**2 + 0.02**2))
    acc_error, gyro_error = (5e-3, 0.2) if compensated else (30e-3, 0.8)
    return Gates(
        norm_m_s2=norm + 3.0 * 2e-3 + acc_error * gravity,
        rate_rad_s=0.1 / 50.0 + 3.0 * math.radians(0.02) + math.radians(gyro_error),
        acceleration_rad_s2=acceleration + 3.0 * math.radians(0.3),
    )


@dataclass
class _Estimate:
    """At the end of the last whole block. `correction`: rotation over the next block, rad."""

    attitude: Quaternion
    bias: Vector = (0.0, 0.0, 0.0)
    correction: Vector = (0.0, 0.0, 0.0)
    blocks_levelled: int = 0


@dataclass
class _Memory:
    """Between calls: smoothed inputs, and the samples of the block that is not whole yet."""

    smoothed: FloatArray
    rate_before: FloatArray
    rate: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    force: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    open: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))


@dataclass(frozen=True)
class AttitudeSamples:
    """n samples: attitude (n, 4) level from body, scalar first; whether the gates were open; aligned."""

    attitude: FloatArray
    steady: NDArray[np.bool_]
    aligned: NDArray[np.bool_]


class AttitudeFilter:
    """From the start of sampling on. However the samples are cut into calls, the attitude is the same."""

    def __init__(self, period_s: float, limits: Gates) -> None:
        self._period_s = period_s
        self._limits = limits
        self._estimate: _Estimate | None = None
        self._memory: _Memory | None = None

    def process(self, rate_rad_s: FloatArray, force_m_s2: FloatArray) -> AttitudeSamples:
        """Corrected rates and specific forces (n, 3) → attitude."""
        if len(rate_rad_s) == 0:
            none = np.zeros(0, dtype=np.bool_)
            return AttitudeSamples(np.zeros((0, 4)), none, none)
        if self._memory is None or self._estimate is None:
            smoothed = np.concatenate([rate_rad_s[0], rate_rad_s[0], force_m_s2[0]])
            self._memory = _Memory(smoothed, -rate_rad_s[0])  # no turn before the first sample
            self._estimate = _Estimate(_levelled(*force_m_s2[0].tolist()))
        steady = self._open(rate_rad_s, force_m_s2, self._memory)
        attitude, aligned = self._integrate(rate_rad_s, force_m_s2, steady, self._memory, self._estimate)
        return AttitudeSamples(attitude, steady, aligned)

    def _open(self, rate: FloatArray, force: FloatArray, memory: _Memory) -> NDArray[np.bool_]:
        """(n,) whether all gates are open."""
        keep = math.exp(-self._period_s / SMOOTHING_S)
        share = 1.0 - keep
        once, twice, before = np.split(memory.smoothed, 3)
        once = first_order(share * rate, keep, keep * once)
        twice = first_order(share * once, keep, keep * twice)
        smooth = first_order(share * force, keep, keep * before)
        memory.smoothed = np.concatenate([once[-1], twice[-1], smooth[-1]])
        limits = self._limits
        norm = np.abs(_length(smooth) - limits.gravity_m_s2)
        acceleration = _length(once - twice) / SMOOTHING_S
        steady: NDArray[np.bool_] = np.less(norm, limits.norm_m_s2)
        steady &= np.less(_length(once), limits.rate_rad_s)
        steady &= np.less(acceleration, limits.acceleration_rad_s2)
        return steady

    def _integrate(
        self,
        rate: FloatArray,
        force: FloatArray,
        steady: NDArray[np.bool_],
        memory: _Memory,
        estimate: _Estimate,
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        given = len(memory.rate)  # samples of the open block that were put out before
        before = np.concatenate([memory.rate_before[np.newaxis, :], memory.rate, rate])
        force = np.concatenate([memory.force, force])
        steady = np.concatenate([memory.open, steady])
        turns = _rotation((before[1:] + before[:-1]) * (0.5 * self._period_s))
        count = len(turns)
        whole, rows = count // BLOCK, -(-count // BLOCK)
        turns = np.concatenate([turns, np.zeros((rows * BLOCK - count, 4))]).reshape(rows, BLOCK, 4)
        for place in range(1, BLOCK):
            turns[:, place] = _product(turns[:, place - 1], turns[:, place])
        cut = whole * BLOCK
        rates, forces = _block_means(before[1 : cut + 1]), _block_means(force[:cut])
        open_blocks: NDArray[np.bool_] = np.logical_and.reduce(steady[:cut].reshape(-1, BLOCK), axis=1)
        open_blocks &= np.less(_length(rates), self._limits.rate_rad_s)  # what is smoothed comes late
        starts, corrections, aligned = self._correct(
            turns[:whole, -1], rates, forces, open_blocks, estimate, rows
        )
        parts = np.arange(1, BLOCK + 1) / (2.0 * BLOCK)
        halves = _rotation((corrections[:, np.newaxis, :] * parts[:, np.newaxis]).reshape(-1, 3))
        attitude = _product(np.repeat(starts, BLOCK, axis=0), halves)
        attitude = _product(_product(attitude, turns.reshape(-1, 4)), halves)[given:count]
        memory.rate_before, memory.rate = before[cut], before[cut + 1 :]
        memory.force, memory.open = force[cut:], steady[cut:]
        return attitude, np.repeat(aligned, BLOCK)[given:count]

    def _correct(
        self,
        block_turns: FloatArray,
        rates: FloatArray,
        forces: FloatArray,
        steady: NDArray[np.bool_],
        estimate: _Estimate,
        rows: int,
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Goes through whole blocks: attitude at the start, correction and alignment of each of `rows`."""
        span_s = BLOCK * self._period_s
        levelling = max(1, round(ALIGNMENT_S / span_s))
        starts: list[Quaternion] = []
        corrections: list[Vector] = []
        aligned: list[bool] = []
        inputs = zip(block_turns.tolist(), rates.tolist(), forces.tolist(), steady.tolist(), strict=True)
        for turn, rate, force, is_steady in inputs:
            starts.append(estimate.attitude)
            corrections.append(estimate.correction)
            aligned.append(estimate.blocks_levelled >= levelling)
            half = _turn(estimate.correction, 0.5)
            attitude = _unit(_times(_times(_times(estimate.attitude, half), turn), half))
            error = _tilt(attitude, force) if is_steady else (0.0, 0.0, 0.0)
            bias, gain = estimate.bias, TILT_GAIN_PER_S * span_s
            if is_steady and estimate.blocks_levelled < levelling:
                estimate.blocks_levelled += 1
                gain = 1.0 / estimate.blocks_levelled
                bias = _plus(bias, gain, _plus(rate, -1.0, bias))
            elif is_steady:
                bias = _plus(bias, -BIAS_GAIN_PER_S2 * span_s, error)
            estimate.attitude, estimate.bias = attitude, bias
            estimate.correction = _plus((gain * error[0], gain * error[1], gain * error[2]), -span_s, bias)
        if rows > len(starts):
            starts.append(estimate.attitude)
            corrections.append(estimate.correction)
            aligned.append(estimate.blocks_levelled >= levelling)
        return np.array(starts), np.array(corrections), np.array(aligned, dtype=np.bool_)


def roll_pitch_yaw_rad(attitude: FloatArray) -> FloatArray:
    """(n, 4) → (n, 3), roll and yaw in [−π, π], pitch in [−π/2, π/2]."""
    w, x, y, z = attitude.T
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (x * z - w * y), -1.0, 1.0))
    yaw = np.arctan2(-2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=1)


def _block_means(values: FloatArray) -> FloatArray:
    return np.asarray(values.reshape(-1, BLOCK, 3).mean(axis=1), dtype=np.float64)


def _length(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def _rotation(vectors: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3), rad → quaternions (n, 4)."""
    half = 0.5 * _length(vectors)
    scale = 0.5 * np.sinc(half / np.pi)
    return np.column_stack([np.cos(half), vectors * scale[:, np.newaxis]])


def _product(one: FloatArray, other: FloatArray) -> FloatArray:
    a, b, c, d = one.T
    w, x, y, z = other.T
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=1,
    )


# The same on floats: a block's step is too small for arrays.


def _times(one: Quaternion, other: Quaternion) -> Quaternion:
    a, b, c, d = one
    w, x, y, z = other
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def _turn(vector: Vector, share: float) -> Quaternion:
    x, y, z = vector
    angle = share * math.sqrt(x * x + y * y + z * z)
    scale = share * (math.sin(angle / 2) / angle if angle else 0.5)
    return math.cos(angle / 2), x * scale, y * scale, z * scale


def _unit(quaternion: Quaternion) -> Quaternion:
    w, x, y, z = quaternion
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale


def _plus(one: Vector, share: float, other: Vector) -> Vector:
    return one[0] + share * other[0], one[1] + share * other[1], one[2] + share * other[2]


def _tilt(attitude: Quaternion, force: Vector) -> Vector:
    """f/|f| × u, u being the up direction in body axes."""
    w, x, y, z = attitude
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    scale = 1.0 / math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    fx, fy, fz = force[0] * scale, force[1] * scale, force[2] * scale
    return fy * up[2] - fz * up[1], fz * up[0] - fx * up[2], fx * up[1] - fy * up[0]


def _levelled(fx: float, fy: float, fz: float) -> Quaternion:
    """From one specific force, heading 0."""
    roll, pitch = math.atan2(fy, fz), math.atan2(fx, math.hypot(fy, fz))
    about_y = (math.cos(pitch / 2), 0.0, -math.sin(pitch / 2), 0.0)
    return _times(about_y, (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0))

"""Attitude from gyros, corrected by accelerometers while the gates are open (paper 2, 3).

The gyros' attitude is integrated over the whole record at once, in a level frame that drifts with them. What
corrects it is a slow rotation P of that frame, stepped once a block:

    C = P C_gyro,   e = (P <C_gyro f> / |f|) x z     (block means, so a turn inside a block does no harm)
    P turns by e T / tau_tilt,   bias by - C^T e T / (tau_tilt tau_bias)     while the gates are open

a proportional-integral observer (Mahony, Hamel & Pflimlin, IEEE TAC 53 (2008) 1203) with s^2 + s / tau_tilt +
1 / (tau_tilt tau_bias): critically damped with tau_bias = 4 tau_tilt. A block's correction acts from its end.

Increments are coning-consistent: rates are samples at instants, their integral is that of the cubic through
four of them, and a linear rate's commutator is added (Bortz's equation to second order):

    phi = T/24 (-w_-1 + 13 w_0 + 13 w_1 - w_2) + T^2/12 (w_0 x w_1)

Arrays have time first, then any number of units side by side, then x y z. Out of scope: Earth rate (at the
alignment it is in the bias; a turn leaves up to 15 deg/h of it), transport rate, sculling.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.attitude_angles import (
    accumulated,
    levelled,
    matrix_of,
    normalised,
    of_rotation_vector,
    product,
    quaternion_of,
    roll_pitch_yaw_rad,
)
from calibration.algorithms.coefficients import FloatArray
from protocol.errors import CalibrationError, Fault

MIN_ALIGNMENT_BLOCKS = 4
_SKEW = np.zeros((3, 9))
"""vector @ _SKEW is its cross product matrix, rows one after the other."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _SKEW[_i, 3 * _k + _j], _SKEW[_i, 3 * _j + _k] = 1.0, -1.0


@dataclass(frozen=True)
class CorrectionSettings:
    """Time constants of the correction.

    Attributes:
        tilt_time_constant_s: of a tilt error while the gates are open.
        bias_time_constant_s: of the bias estimate behind it; None: the alignment's bias stays.
        block_s: the correction is stepped, and the gates are looked at, so often.
    """

    tilt_time_constant_s: float = 20.0
    bias_time_constant_s: float | None = 80.0
    block_s: float = 0.5


@dataclass(frozen=True)
class OpenGates:
    """Bounds on block means, SI: of | |f| - g |, |w| less the bias, |dw/dt| between blocks."""

    norm_m_s2: float
    rate_rad_s: float
    angular_acceleration_rad_s2: float


@dataclass(frozen=True)
class Alignment:
    """What a rest tells before the unit moves.

    Attributes:
        attitude: (..., 4), level from body, heading 0.
        bias_rad_s: (..., 3) mean rate, the Earth's included.
        norm_m_s2: (...,) magnitude of the specific force: what the gates compare with.
        norm_noise_m_s2, rate_noise_rad_s, angular_acceleration_noise_rad_s2: (...,) standard deviations of
            the gated quantities, block by block.
        duration_s: of the rest.
    """

    attitude: FloatArray
    bias_rad_s: FloatArray
    norm_m_s2: FloatArray
    norm_noise_m_s2: FloatArray
    rate_noise_rad_s: FloatArray
    angular_acceleration_noise_rad_s2: FloatArray
    duration_s: float


@dataclass(frozen=True)
class StrapdownAttitude:
    """n samples, k blocks.

    Attributes:
        quaternion: (n, ..., 4) level from body.
        gates_open: (k, ...) whether the accelerometers corrected after this block.
        bias_rad_s: (k, ..., 3) the estimate that acted in the block.
        turned: (k, ..., 3, 3) mean of C_level_from_body over the block.
        mean_rate_rad_s: (k, ..., 3) of the block, less the bias of the alignment.
        block_samples: of a whole block; the last one may be shorter.
        period_s: between samples.
    """

    quaternion: FloatArray
    gates_open: NDArray[np.bool_]
    bias_rad_s: FloatArray
    turned: FloatArray
    mean_rate_rad_s: FloatArray
    block_samples: int
    period_s: float

    @property
    def roll_pitch_yaw_rad(self) -> FloatArray:
        """(n, ..., 3)."""
        return roll_pitch_yaw_rad(self.quaternion)


def rotation_increments(rate_rad_s: FloatArray, period_s: float) -> FloatArray:
    """Rotation vectors from each sample to the next, shape (n - 1, ..., 3); see the module.

    Ends have no fourth rate: the trapezoid, with the commutator.
    """
    before, after = rate_rad_s[:-1], rate_rad_s[1:]
    increments = 0.5 * period_s * (before + after)
    if len(rate_rad_s) > 3:
        bend = before[1:-1] + after[1:-1] - rate_rad_s[:-3] - rate_rad_s[3:]
        increments[1:-1] += period_s / 24.0 * bend
    return increments + period_s**2 / 12.0 * np.cross(before, after)


def gyro_attitude(start: FloatArray, rate_rad_s: FloatArray, period_s: float) -> FloatArray:
    """Attitude (n, ..., 4) from rates (n, ..., 3) alone, beginning with `start` (..., 4)."""
    turns = of_rotation_vector(rotation_increments(rate_rad_s, period_s))
    return accumulated(np.concatenate([np.broadcast_to(start, (1, *turns.shape[1:])), turns]))


def align_at_rest(
    rate_rad_s: FloatArray, force_m_s2: FloatArray, period_s: float, block_s: float = 0.5
) -> Alignment:
    """Level, bias and noise from samples (n, ..., 3) at rest; see `flight_phases.initial_rest_samples`.

    Raises:
        CalibrationError: too short, or samples are missing.
    """
    size = _block_samples(period_s, block_s)
    blocks = len(rate_rad_s) // size
    if blocks < MIN_ALIGNMENT_BLOCKS:
        raise _refused(
            f"A rest of {len(rate_rad_s) * period_s:.2g} s is too short to align in.",
            f"leave the unit at rest for at least {MIN_ALIGNMENT_BLOCKS * block_s:g} s before it moves.",
        )
    rates = _means(rate_rad_s[: blocks * size], size)
    forces = _means(force_m_s2[: blocks * size], size)
    if not (np.isfinite(rates).all() and np.isfinite(forces).all()):
        raise _refused("Samples of the rest are missing.", "align in a rest without missing samples.")
    bias, force = rates.mean(axis=0), forces.mean(axis=0)
    norm = np.linalg.norm(forces, axis=-1)
    changes = np.diff(rates, axis=0) / (size * period_s)
    return Alignment(
        attitude=levelled(force),
        bias_rad_s=bias,
        norm_m_s2=norm.mean(axis=0),
        norm_noise_m_s2=norm.std(axis=0, ddof=1),
        rate_noise_rad_s=_rms(rates - bias),
        angular_acceleration_noise_rad_s2=_rms(changes),
        duration_s=blocks * size * period_s,
    )


def strapdown_attitude(
    rate_rad_s: FloatArray,
    force_m_s2: FloatArray,
    period_s: float,
    alignment: Alignment,
    gates: OpenGates,
    settings: CorrectionSettings | None = None,
) -> StrapdownAttitude:
    """Corrected attitude of one unit or of many side by side.

    Args:
        rate_rad_s, force_m_s2: (n, ..., 3) at even instants, from the alignment on, without missing samples.
        period_s: between them.
        alignment: of the same units.
        gates: bounds of the block means.
        settings: time constants; None: the defaults.

    Raises:
        CalibrationError: missing samples, shapes that do not fit, time constants that are not positive.
    """
    settings = settings or CorrectionSettings()
    _check(rate_rad_s, force_m_s2, settings)
    size = _block_samples(period_s, settings.block_s)
    drifting = gyro_attitude(alignment.attitude, rate_rad_s - alignment.bias_rad_s, period_s)
    frames, forces = _block_frames(drifting, force_m_s2, size)
    rates = _means(rate_rad_s, size) - alignment.bias_rad_s
    is_open = _open(rates, forces, alignment, gates, size * period_s)
    counts = np.full(len(rates), size)
    counts[-1] = len(rate_rad_s) - size * (len(rates) - 1)
    correction, bias = _observe(frames, forces, is_open, counts * period_s, settings)
    drift = -np.einsum("k...ij,k...j->k...i", frames, bias) * period_s
    block = np.arange(len(rate_rad_s)) // size
    share = (np.arange(len(rate_rad_s)) % size).reshape(-1, *([1] * (rate_rad_s.ndim - 1)))
    within = of_rotation_vector(drift[block] * share)
    quaternion = product(product(quaternion_of(correction)[block], within), drifting)
    return StrapdownAttitude(
        quaternion=normalised(quaternion),
        gates_open=is_open,
        bias_rad_s=alignment.bias_rad_s + bias,
        turned=correction @ frames,
        mean_rate_rad_s=rates,
        block_samples=size,
        period_s=period_s,
    )


def _observe(
    frames: FloatArray,
    forces: FloatArray,
    is_open: NDArray[np.bool_],
    duration_s: FloatArray,
    settings: CorrectionSettings,
) -> tuple[FloatArray, FloatArray]:
    """P at the start of each block (k, ..., 3, 3), and the bias beyond the alignment's (k, ..., 3)."""
    slow = settings.bias_time_constant_s
    correction = np.broadcast_to(np.eye(3), frames.shape[1:]).copy()
    bias = np.zeros(frames.shape[1:-1])
    corrections, biases = np.empty_like(frames), np.empty(frames.shape[:-1])
    up = forces / np.linalg.norm(forces, axis=-1, keepdims=True)
    gain = (is_open * (duration_s / settings.tilt_time_constant_s).reshape(-1, *[1] * (is_open.ndim - 1)))[
        ..., None
    ]
    error = np.zeros_like(bias)
    for k in range(len(frames)):
        corrections[k], biases[k] = correction, bias
        drift = -(frames[k] @ bias[..., None])[..., 0] * duration_s[k]
        correction = correction @ _small_turn(drift)
        seen = (correction @ up[k][..., None])[..., 0]
        error[..., 0], error[..., 1] = seen[..., 1], -seen[..., 0]
        step = gain[k] * error
        correction = _small_turn(step) @ correction
        if slow is not None:
            body = np.swapaxes(correction @ frames[k], -1, -2)
            bias = bias - (body @ step[..., None])[..., 0] / slow
        square = np.swapaxes(correction, -1, -2) @ correction
        correction = 1.5 * correction - 0.5 * (correction @ square)  # stays a rotation
    return corrections, biases


def _small_turn(vector: FloatArray) -> FloatArray:
    """To second order, shape (..., 3, 3)."""
    cross = (vector @ _SKEW).reshape(*vector.shape, 3)
    return np.eye(3) + cross + 0.5 * (cross @ cross)


def _block_frames(drifting: FloatArray, force: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Means over blocks of C (k, ..., 3, 3) and of C f (k, ..., 3)."""
    frames: list[FloatArray] = []
    forces: list[FloatArray] = []
    for first in range(0, len(drifting), size * 512):  # a few megabytes at a time
        piece = slice(first, first + size * 512)
        turned = matrix_of(drifting[piece])
        frames.append(_means(turned, size))
        forces.append(_means((turned @ force[piece][..., None])[..., 0], size))
    return np.concatenate(frames), np.concatenate(forces)


def _open(
    rates: FloatArray, forces: FloatArray, alignment: Alignment, gates: OpenGates, block_s: float
) -> NDArray[np.bool_]:
    norm = np.abs(np.linalg.norm(forces, axis=-1) - alignment.norm_m_s2)
    change = np.linalg.norm(np.diff(rates, axis=0, prepend=rates[:1]), axis=-1) / block_s
    steady = (norm < gates.norm_m_s2) & (np.linalg.norm(rates, axis=-1) < gates.rate_rad_s)
    return np.asarray(steady & (change < gates.angular_acceleration_rad_s2), dtype=np.bool_)


def _means(values: FloatArray, size: int) -> FloatArray:
    """Over blocks along axis 0, the last one of what is left."""
    whole = len(values) // size
    blocks = values[: whole * size].reshape(whole, size, *values.shape[1:]).mean(axis=1)
    if whole * size == len(values):
        return blocks
    return np.concatenate([blocks, values[whole * size :].mean(axis=0, keepdims=True)])


def _block_samples(period_s: float, block_s: float) -> int:
    return max(1, round(block_s / period_s))


def _rms(vectors: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(np.sum(vectors**2, axis=-1), axis=0))


def _check(rate: FloatArray, force: FloatArray, settings: CorrectionSettings) -> None:
    times = (settings.tilt_time_constant_s, settings.bias_time_constant_s or 1.0, settings.block_s)
    if not all(math.isfinite(time) and time > 0.0 for time in times):
        raise _refused("A time constant is not a positive number.", "state positive ones.", Fault.PLAN)
    if rate.shape != force.shape or rate.shape[-1] != 3 or len(rate) < 2:
        raise _refused(
            f"Rates {rate.shape} and forces {force.shape} do not go together.", "hand over one row for each."
        )
    if not (np.isfinite(rate).all() and np.isfinite(force).all()):
        raise _refused(
            "Samples are missing: an attitude cannot be integrated across them.",
            "cut the record at its holes, and align again.",
        )


def _refused(what: str, remedy: str, fault: Fault = Fault.DATA) -> CalibrationError:
    return CalibrationError(what, where="strapdown attitude", fault=fault, remedy=remedy)

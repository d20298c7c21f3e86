"""Quaternions and angles of an attitude.

Body axes x forward, y left, z up; the level frame has z up and the heading of the start. Roll is right side
down, pitch nose up, yaw clockwise: C_body_from_level = Rx(roll) Ry(-pitch) Rz(-yaw). A quaternion is level
from body, scalar first, in the last axis; all other axes go along.
"""

# pyright: strict
import numpy as np

from calibration.algorithms.coefficients import FloatArray


def product(one: FloatArray, other: FloatArray) -> FloatArray:
    """The rotation `other`, then `one`, shape (..., 4)."""
    a, b, c, d = np.moveaxis(one, -1, 0)
    w, x, y, z = np.moveaxis(other, -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def conjugate(quaternion: FloatArray) -> FloatArray:
    """The rotation back, shape (..., 4)."""
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def of_rotation_vector(vector_rad: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3), rad, as quaternions (..., 4)."""
    half = 0.5 * np.sqrt(np.sum(vector_rad**2, axis=-1, keepdims=True))
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vector_rad], axis=-1)


def normalised(quaternion: FloatArray) -> FloatArray:
    """Of length 1, shape (..., 4)."""
    length: FloatArray = np.sqrt(np.sum(quaternion**2, axis=-1, keepdims=True))
    return quaternion / length


def accumulated(turns: FloatArray) -> FloatArray:
    """Products of the first k + 1 quaternions along axis 0, shape (n, ..., 4), each one after the other.

    By doubling: ceil(log2 n) passes over the whole array in place of n steps.
    """
    found = turns.copy()
    step = 1
    while step < len(found):
        found[step:] = product(found[:-step], found[step:])
        step *= 2
    return normalised(found)


def matrix_of(quaternion: FloatArray) -> FloatArray:
    """C_level_from_body, shape (..., 3, 3)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_of(matrix: FloatArray) -> FloatArray:
    """Of rotation matrices (..., 3, 3); by the largest of the four components, so never by a small one."""
    r = matrix
    trace = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    squares = [trace, *(2.0 * r[..., k, k] - trace for k in range(3))]
    largest = np.argmax(np.stack(squares, axis=-1), axis=-1)
    a, b, c = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    d, e, f = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    one = [1.0 + square for square in squares]
    candidates = np.stack(
        [
            np.stack([one[0], a, b, c], axis=-1),
            np.stack([a, one[1], d, e], axis=-1),
            np.stack([b, d, one[2], f], axis=-1),
            np.stack([c, e, f, one[3]], axis=-1),
        ],
        axis=-2,
    )
    return normalised(np.take_along_axis(candidates, largest[..., None, None], axis=-2)[..., 0, :])


def roll_pitch_yaw_rad(quaternion: FloatArray) -> FloatArray:
    """(..., 4) as roll, pitch, yaw (..., 3): roll and yaw in [-pi, pi], pitch in [-pi/2, pi/2]."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    roll = np.arctan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (x * z - w * y), -1.0, 1.0))
    yaw = np.arctan2(-2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def quaternion_of_angles(roll_pitch_yaw: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (..., 3), rad, as quaternions (..., 4)."""
    nothing = np.zeros_like(roll_pitch_yaw[..., 0])
    roll, pitch, yaw = np.moveaxis(roll_pitch_yaw, -1, 0)
    about_z = of_rotation_vector(np.stack([nothing, nothing, -yaw], axis=-1))
    about_y = of_rotation_vector(np.stack([nothing, -pitch, nothing], axis=-1))
    about_x = of_rotation_vector(np.stack([roll, nothing, nothing], axis=-1))
    return product(product(about_z, about_y), about_x)


def levelled(specific_force: FloatArray) -> FloatArray:
    """Attitude of heading 0 in which specific forces (..., 3) point up, shape (..., 4)."""
    x, y, z = np.moveaxis(specific_force, -1, 0)
    angles = np.stack([np.arctan2(y, z), np.arctan2(x, np.hypot(y, z)), np.zeros_like(x)], axis=-1)
    return quaternion_of_angles(angles)


def angle_about_rad(quaternion: FloatArray, start: FloatArray, axis: int) -> FloatArray:
    """Angle (n,) turned about a body axis since `start` (4,), continuous; small turns across it cancel."""
    relative = product(conjugate(start), quaternion)
    return np.unwrap(2.0 * np.arctan2(relative[..., 1 + axis], relative[..., 0]))

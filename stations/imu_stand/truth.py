# pyright: strict
"""What a unit on the turntable truly sees, from the stand's encoders and the site.

Laboratory frame of the stand: x east, y north, z up, turned about z by the site's heading (azimuth of
y, east of north). `C_body_from_lab = Rx(inner) · Ry(middle) · Rz(outer)`, passive rotations; at zero
angles body axes are the laboratory's (docs/stands.md). The outer axis is vertical: a body axis that
points up is turned about by the outer axis alone, whatever the mounting.

Earth rate goes through the encoders' angles, sample by sample: with a vertical spin axis and the rests
of a capture left in, up to 8.3 deg/h of its horizontal part would leak into the cross axes (paper 1).
"""

import math

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.earth import EARTH_RATE_RAD_S
from protocol.bench_description import Site

FloatArray = NDArray[np.float64]

POSES_DEG: dict[str, tuple[float, float, float]] = {
    "x_up": (0.0, -90.0, 0.0),
    "x_down": (0.0, 90.0, 0.0),
    "y_up": (0.0, 0.0, 90.0),
    "y_down": (0.0, 0.0, -90.0),
    "z_up": (0.0, 0.0, 0.0),
    "z_down": (0.0, 0.0, 180.0),
}
"""Six positions: name → (outer, middle, inner), deg."""


def dcm_body_from_lab(angles_rad: FloatArray) -> FloatArray:
    """Attitude at gimbal angles (outer, middle, inner): (n, 3) → (n, 3, 3)."""
    outer, middle, inner = (angles_rad[:, axis] for axis in range(3))
    turn_z = _passive(outer, 0, 1)
    turn_y = _passive(middle, 2, 0)
    turn_x = _passive(inner, 1, 2)
    return turn_x @ turn_y @ turn_z


def earth_rate_lab(site: Site) -> FloatArray:
    """Earth rate in the stand's laboratory frame, shape (3,), rad/s."""
    latitude, heading = math.radians(site.latitude_deg), math.radians(site.heading_deg)
    north = np.array([-math.sin(heading), math.cos(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return EARTH_RATE_RAD_S * (math.cos(latitude) * north + math.sin(latitude) * up)


def static_truth(angles_rad: FloatArray, site: Site) -> tuple[FloatArray, FloatArray]:
    """At rest at angles (n, 3): specific force (m/s²), Earth rate (rad/s) in body axes, shape (3,) each."""
    attitude = dcm_body_from_lab(angles_rad).mean(axis=0)
    return attitude @ np.array([0.0, 0.0, site.gravity_m_s2]), attitude @ earth_rate_lab(site)


def turn_truth(time_s: FloatArray, angles_rad: FloatArray, site: Site) -> tuple[FloatArray, FloatArray]:
    """Integrals over a capture, shape (3,) each, rad: the body's turn in the laboratory, the Earth's.

    The turn is the sum of the encoders' increments about the gimbal axes as they lie in the body: exact
    for a fixed axis, where it telescopes, and free of the noise of a rate.

    Args:
        time_s: (n,).
        angles_rad: outer, middle, inner, (n, 3); jumps of a whole turn are taken out.
    """
    unwrapped = np.unwrap(angles_rad, axis=0)
    steps = np.diff(unwrapped, axis=0)
    midway = unwrapped[:-1] + steps / 2
    attitude = dcm_body_from_lab(midway)
    inner_turn = _passive(midway[:, 2], 1, 2)
    axes = np.stack(
        [attitude[:, :, 2], inner_turn[:, :, 1], np.tile([1.0, 0.0, 0.0], (len(steps), 1))], axis=2
    )
    turn = np.einsum("nij,nj->i", axes, steps)
    earth_rate = dcm_body_from_lab(unwrapped) @ earth_rate_lab(site)
    intervals = np.diff(time_s)[:, None]
    return turn, ((earth_rate[1:] + earth_rate[:-1]) / 2 * intervals).sum(axis=0)


def _passive(angle_rad: FloatArray, first: int, second: int) -> FloatArray:
    """Coordinates turned from axis `first` towards `second`: (n,) → (n, 3, 3)."""
    matrix = np.tile(np.eye(3), (len(angle_rad), 1, 1))
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    matrix[:, first, first] = matrix[:, second, second] = cosine
    matrix[:, first, second] = sine
    matrix[:, second, first] = -sine
    return matrix

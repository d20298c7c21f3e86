"""Earth rate where a gyro is calibrated: never silently left in or out.

Frames: `ned` is north, east, down at the site.
"""

# pyright: strict
import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

EARTH_RATE_RAD_S = 7.292115e-5
"""Rotation rate of the Earth (WGS 84)."""


def earth_rate_ned(latitude_rad: float) -> FloatArray:
    """Earth rate in north, east, down, shape (3,), rad/s."""
    return EARTH_RATE_RAD_S * np.array([math.cos(latitude_rad), 0.0, -math.sin(latitude_rad)])


def earth_rotation_body(dcm_body_from_ned: FloatArray, time_s: FloatArray, latitude_rad: float) -> FloatArray:
    """Integral of the Earth rate in body axes over a capture, shape (3,), rad.

    Whole turns leave only the part along the spin axis; the rest before and after a turn leaks
    the horizontal part into the cross axes (8.3 deg/h for 10 s of 15 s at 34.2 deg latitude), so
    the capture is taken as it was, attitude by attitude.

    Args:
        dcm_body_from_ned: attitude at each time, shape (n, 3, 3).
        time_s: shape (n,).
        latitude_rad: of the site.
    """
    rate_body = dcm_body_from_ned @ earth_rate_ned(latitude_rad)
    return np.asarray(np.trapezoid(rate_body, time_s, axis=0), dtype=np.float64)


def unknown_pose_covariance() -> FloatArray:
    """Covariance (3, 3), (rad/s)^2, of the Earth rate in body axes when site or pose is unknown.

    Every direction is as likely as another: Omega^2 / 3 along each axis.
    """
    return np.eye(3) * EARTH_RATE_RAD_S**2 / 3.0

"""Spin of the magnetometer about Z in a steady field: zeros, sensitivity ratio, orthogonality, roll.

x_out = dX + B cos(theta - alpha),  y_out = dY + (B / K_y) sin(theta)

Paper 1, eq (5)-(8), takes zeros and ratio from minima and maxima and alpha from the one sample where y
peaks: `spin_min_max`, to be shown beside. On noise of 500 uG and 3 min at 1 kHz it scatters by 120 uG
and 1.2 deg; the ellipse through all samples by 1.6 uG and 0.0006 deg: `spin_ellipse`. Printed eq (9) lacks
a division; x = (x' - y' sin(alpha)) / cos(alpha) puts the points on a circle.

Out of scope: Z off the field's axis beyond what an ellipse shows, eddy currents of a fast spin.
"""

from dataclasses import dataclass

import numpy as np

from calibration.algorithms.allan_variance import FloatArray
from calibration.algorithms.ellipsoid_fit import EllipsoidFit, fit_ellipsoid, propagate
from protocol.errors import CalibrationError, Fault

MAX_PHASE_GAP_RAD = np.pi / 3
"""A spin with a larger hole in its phases is sampled in step with its rate (15 rev/s at 15 or 30 Hz)."""
MIN_SAMPLES = 24


@dataclass(frozen=True)
class SpinCoefficients:
    """Corrections of the two channels across the spin axis.

    Attributes:
        zero_x, zero_y: dX, dY, unit of the outputs (paper 1, eq (5), (6)).
        ratio_y: K_y, sensitivity of x over that of y.
        nonorthogonality_rad: alpha.
        radius: B, field across the axis in the unit of x.
        covariance: of (dX, dY, K_y, alpha, B), shape (5, 5); None: not known (min/max).
        residual_rms: of the samples from the ellipse, unit of the outputs; None: not known.
        outliers: samples left out.
    """

    zero_x: float
    zero_y: float
    ratio_y: float
    nonorthogonality_rad: float
    radius: float
    covariance: FloatArray | None
    residual_rms: float | None
    outliers: int

    @property
    def standard_uncertainty(self) -> FloatArray | None:
        """u of (dX, dY, K_y, alpha, B), shape (5,); None: not known."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))

    def correct(self, x_out: FloatArray, y_out: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x, y on a circle, unit of x: paper 1, eq (7)-(9), with the division that eq (9) lacks."""
        y = (y_out - self.zero_y) * self.ratio_y
        sine, cosine = np.sin(self.nonorthogonality_rad), np.cos(self.nonorthogonality_rad)
        return (x_out - self.zero_x - y * sine) / cosine, y

    def correct_as_printed(self, x_out: FloatArray, y_out: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x, y by eq (7)-(9) as printed: the circle stays an ellipse, 0.0175 deg of roll at 2 deg."""
        y = (y_out - self.zero_y) * self.ratio_y
        return x_out - self.zero_x - y * np.sin(self.nonorthogonality_rad), y

    def roll_rad(self, x_out: FloatArray, y_out: FloatArray) -> FloatArray:
        """theta = atan2(y, x) in -pi … pi, from the horizontal field."""
        x, y = self.correct(x_out, y_out)
        return np.arctan2(y, x)

    def roll_standard_uncertainty_rad(self, roll_rad: FloatArray) -> FloatArray | None:
        """u(theta) at true rolls from these coefficients alone, shape of `roll_rad`; None: not known.

        A sample's own noise comes on top: residual_rms / radius for nearly equal channels.
        """
        if self.covariance is None:
            return None
        theta, alpha, radius = np.asarray(roll_rad), self.nonorthogonality_rad, self.radius
        # d(theta) = (x dy - y dx) / B^2 with the corrected x = B cos, y = B sin.
        sine, cosine = np.sin(theta), np.cos(theta)
        by_x, by_y = -sine / radius, cosine / radius  # of theta by corrected x and y
        with_y = by_y - by_x * np.tan(alpha)
        along_alpha = by_x * radius * (cosine * np.tan(alpha) - sine)
        gradient = np.stack(
            [
                -by_x / np.cos(alpha),
                -self.ratio_y * with_y,
                radius * sine / self.ratio_y * with_y,
                along_alpha,
                np.zeros_like(theta),
            ],
            axis=-1,
        )
        return np.sqrt(np.einsum("...p,pq,...q->...", gradient, self.covariance, gradient))


def spin_min_max(x_out: FloatArray, y_out: FloatArray) -> SpinCoefficients:
    """Paper 1, eq (5)-(9), as printed: extremes of single samples, no uncertainty.

    Args:
        x_out, y_out: outputs at whole turns, shape (n,), any common unit.
    """
    _check_channels(x_out, y_out)
    high_x, low_x, high_y, low_y = x_out.max(), x_out.min(), y_out.max(), y_out.min()
    if not (high_x > low_x and high_y > low_y):
        raise _refused("A channel does not change while the unit spins.", "look for a stuck output")
    zero_x, zero_y = float(high_x + low_x) / 2.0, float(high_y + low_y) / 2.0
    ratio = float((high_x - low_x) / (high_y - low_y))
    sine = float(x_out[int(y_out.argmax())] - zero_x) / (ratio * (float(high_y) - zero_y))
    alpha = float(np.arcsin(np.clip(sine, -1.0, 1.0)))
    return SpinCoefficients(zero_x, zero_y, ratio, alpha, float(high_x - low_x) / 2.0, None, None, 0)


def spin_ellipse(x_out: FloatArray, y_out: FloatArray) -> SpinCoefficients:
    """The least-squares ellipse through all samples, with covariance; outliers are left out and counted.

    Args:
        x_out, y_out: outputs, shape (n,), any common unit.

    Raises:
        CalibrationError: missing samples, phases with a hole (sampling in step with the spin), no ellipse.
    """
    _check_channels(x_out, y_out)
    fit = fit_ellipsoid(np.column_stack([x_out, y_out]), "magnetometer spin")
    values, covariance = propagate(fit, _of_ellipse)
    zero_x, zero_y, ratio_y, alpha, radius = (float(value) for value in values)
    found = SpinCoefficients(
        zero_x, zero_y, ratio_y, alpha, radius, covariance, fit.distance_rms, fit.outliers
    )
    _check_phases(found, fit, x_out, y_out)
    return found


def _of_ellipse(centre: FloatArray, shape: FloatArray) -> FloatArray:
    """dX, dY, K_y, alpha, B: inv(Q) = [[B^2, B^2 sin(alpha) / K_y], [., B^2 / K_y^2]]."""
    spread = np.linalg.inv(shape)
    radius_x, radius_y = np.sqrt(spread[0, 0]), np.sqrt(spread[1, 1])
    alpha = np.arcsin(spread[0, 1] / (radius_x * radius_y))
    return np.array([centre[0], centre[1], radius_x / radius_y, alpha, radius_x])


def _check_phases(found: SpinCoefficients, fit: EllipsoidFit, x_out: FloatArray, y_out: FloatArray) -> None:
    phases = np.sort(found.roll_rad(x_out[fit.used], y_out[fit.used]))
    gap = float(np.diff(phases, append=phases[0] + 2.0 * np.pi).max())
    if gap > MAX_PHASE_GAP_RAD:
        raise _refused(
            f"The samples leave {np.degrees(gap):.0f} deg of the turn out.",
            "turn all the way round, and sample out of step with the spin (15 rev/s: not at 15 or 30 Hz)",
        )


def _check_channels(x_out: FloatArray, y_out: FloatArray) -> None:
    if x_out.shape != y_out.shape or x_out.ndim != 1 or len(x_out) < MIN_SAMPLES:
        raise _refused(
            f"A spin needs two channels of {MIN_SAMPLES} samples, not {x_out.shape} and {y_out.shape}.",
            "record longer",
        )
    missing = int((~np.isfinite(x_out) | ~np.isfinite(y_out)).sum())
    if missing:
        raise _refused(f"{missing} of {len(x_out)} samples are missing (NaN).", "leave them out")


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="magnetometer spin", fault=Fault.DATA, remedy=remedy + ".")

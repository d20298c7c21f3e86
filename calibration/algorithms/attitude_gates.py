"""When an accelerometer may correct a strapdown attitude: the gates of paper 2, corrected.

Each gate comes as it should be, with the printed one beside it. A gate has a theoretical part, from
the largest error xi that the correction may suffer, and `noise_sigmas` standard deviations of the gated
quantity at rest, so that a unit at rest passes: one sigma lets 68 % of the rest through, three 99.7 %.

- Norm of the specific force. Printed: sigma_a from horizontal accelerations, compared with a deviation
  of the norm. A horizontal acceleration h changes the norm by sqrt(g^2 + h^2) - g only, so to hold h
  below xi the gate is sqrt(g^2 + xi^2) - g: 0.5 mm/s^2 for 0.01 g. That is below the noise of a MEMS
  accelerometer: the norm alone cannot meet the intent, and `NormGate.meets_intent` says so.
- Angular acceleration. Printed: sqrt(3 dw'), a wrong dimension. Here: sqrt(3) dw'.
- Lever arm. Printed 'vectors' are magnitudes along the wrong axes. Here: w x (w x d) and w' x d.

SI: m/s^2, rad/s, rad/s^2, m, rad. Vectors in body axes.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from protocol.errors import CalibrationError, Fault


@dataclass(frozen=True)
class Gate:
    """A bound that a quantity must stay below: theoretical part plus noise, and the printed value.

    `printed` is the number that the paper's formula gives, without noise; its dimension may be wrong.
    """

    theoretical: float
    noise: float
    printed: float

    @property
    def bound(self) -> float:
        """What to compare with."""
        return self.theoretical + self.noise


@dataclass(frozen=True)
class NormGate(Gate):
    """The gate on | |f| - g |, m/s^2, and what it lets through.

    Attributes:
        wanted_m_s2: xi, the horizontal acceleration that it is to keep out.
        gravity_m_s2: g.
    """

    wanted_m_s2: float
    gravity_m_s2: float

    @property
    def admitted_m_s2(self) -> float:
        """Horizontal acceleration that passes, m/s^2."""
        return admitted_horizontal_acceleration(self.bound, self.gravity_m_s2)

    @property
    def attitude_error_rad(self) -> float:
        """Tilt that the correction then takes for true, rad."""
        return math.atan(self.admitted_m_s2 / self.gravity_m_s2)

    @property
    def meets_intent(self) -> bool:
        """Does the gate, noise included, keep out what it is to keep out (to a tenth more)?"""
        return self.admitted_m_s2 <= 1.1 * self.wanted_m_s2


def admitted_horizontal_acceleration(bound_m_s2: float, gravity_m_s2: float) -> float:
    """h with sqrt(g^2 + h^2) - g = bound, m/s^2: what a gate on the norm lets through."""
    return math.sqrt(bound_m_s2 * (bound_m_s2 + 2.0 * gravity_m_s2))


def norm_gate(
    wanted_m_s2: float, gravity_m_s2: float, norm_noise_m_s2: float, noise_sigmas: float = 3.0
) -> NormGate:
    """Gate on | |f| - g | that keeps horizontal accelerations above `wanted_m_s2` out.

    Args:
        wanted_m_s2: xi_a of paper 2, 3.2 (1).
        norm_noise_m_s2: standard deviation of |f| - g at rest.

    Raises:
        CalibrationError: values that are not positive.
    """
    _positive(wanted_m_s2=wanted_m_s2, gravity_m_s2=gravity_m_s2)
    _not_negative(norm_noise_m_s2=norm_noise_m_s2, noise_sigmas=noise_sigmas)
    # xi^2 / (sqrt(g^2 + xi^2) + g): the difference itself would lose half of its digits.
    theoretical = wanted_m_s2**2 / (math.hypot(gravity_m_s2, wanted_m_s2) + gravity_m_s2)
    horizontal, vertical = printed_axis_accelerations(wanted_m_s2, gravity_m_s2)
    printed = math.sqrt(2.0 * horizontal**2 + vertical**2)
    return NormGate(theoretical, noise_sigmas * norm_noise_m_s2, printed, wanted_m_s2, gravity_m_s2)


def printed_axis_accelerations(wanted_m_s2: float, gravity_m_s2: float) -> tuple[float, float]:
    """dF_bx = dF_by and dF_bz of paper 2, 3.2 (1), as printed, m/s^2."""
    horizontal = math.sqrt(((wanted_m_s2 + gravity_m_s2) ** 2 - gravity_m_s2**2) / 3.0)
    return horizontal, wanted_m_s2 / 3.0


def turn_rate_gate(
    wanted_m_s2: float,
    speed_m_s: float,
    rate_noise_rad_s: float,
    printed_radius_m: float,
    noise_sigmas: float = 3.0,
) -> Gate:
    """Gate on |w| that keeps the centripetal acceleration V w of a turn below `wanted_m_s2`: xi / V.

    Paper 2 gates with sqrt(xi / L) for a turn of radius L, which the unit cannot know: a true radius
    of four times L lets four times xi through. A speed is bounded by the vehicle; the gate needs one.

    Args:
        wanted_m_s2: xi_w.
        speed_m_s: largest of the vehicle.
        rate_noise_rad_s: standard deviation of |w| at rest.
        printed_radius_m: L that the printed form assumes; only `printed` rests on it.

    Raises:
        CalibrationError: values that are not positive.
    """
    _positive(wanted_m_s2=wanted_m_s2, speed_m_s=speed_m_s)
    _not_negative(rate_noise_rad_s=rate_noise_rad_s, noise_sigmas=noise_sigmas)
    printed = printed_turn_rate_gate(wanted_m_s2, printed_radius_m)
    return Gate(wanted_m_s2 / speed_m_s, noise_sigmas * rate_noise_rad_s, printed)


def printed_turn_rate_gate(wanted_m_s2: float, radius_m: float) -> float:
    """sigma_w = sqrt(xi / L) of paper 2, 3.2 (2), rad/s; its own text derives `strict_turn_rate`."""
    _positive(wanted_m_s2=wanted_m_s2, radius_m=radius_m)
    return math.sqrt(wanted_m_s2 / radius_m)


def strict_turn_rate(wanted_m_s2: float, radius_m: float) -> float:
    """dw_L = sqrt(xi / (sqrt(3) L)) of paper 2, 3.2 (2), rad/s."""
    return printed_turn_rate_gate(wanted_m_s2, math.sqrt(3.0) * radius_m)


def angular_acceleration_gate(
    wanted_m_s2: float,
    lever_arm_m: FloatArray,
    angular_acceleration_noise_rad_s2: float,
    noise_sigmas: float = 3.0,
) -> Gate:
    """Gate on |w'|: sqrt(3) dw'_y with dw'_y = xi / sqrt(3 (d_x^2 + d_z^2)) (paper 2, 3.2 (3)).

    Args:
        wanted_m_s2: largest tangential acceleration.
        lever_arm_m: d, shape (3,), from the centre of mass to the unit.
        angular_acceleration_noise_rad_s2: standard deviation of |w'| at rest.

    Raises:
        CalibrationError: a unit at the centre of mass, where no gate is needed.
    """
    _positive(wanted_m_s2=wanted_m_s2, lever_arm_x_z_m=math.hypot(lever_arm_m[0], lever_arm_m[2]))
    _not_negative(
        angular_acceleration_noise_rad_s2=angular_acceleration_noise_rad_s2, noise_sigmas=noise_sigmas
    )
    per_axis = wanted_m_s2 / (math.sqrt(3.0) * math.hypot(lever_arm_m[0], lever_arm_m[2]))
    noise = noise_sigmas * angular_acceleration_noise_rad_s2
    return Gate(math.sqrt(3.0) * per_axis, noise, math.sqrt(3.0 * per_axis))


def centripetal_acceleration(rate_rad_s: FloatArray, lever_arm_m: FloatArray) -> FloatArray:
    """w x (w x d), shape (..., 3), m/s^2, body axes."""
    return np.asarray(np.cross(rate_rad_s, np.cross(rate_rad_s, lever_arm_m)), dtype=np.float64)


def tangential_acceleration(angular_acceleration_rad_s2: FloatArray, lever_arm_m: FloatArray) -> FloatArray:
    """w' x d, shape (..., 3), m/s^2, body axes."""
    return np.asarray(np.cross(angular_acceleration_rad_s2, lever_arm_m), dtype=np.float64)


def printed_lever_arm_magnitudes(first: FloatArray, lever_arm_m: FloatArray) -> FloatArray:
    """first_i times the distance of d from axis i, shape (3,): paper 2, 3.1, as printed.

    With w^2 it is the printed centripetal 'vector', with w' (printed: w) the tangential one.
    """
    x, y, z = lever_arm_m
    return first * np.array([math.hypot(y, z), math.hypot(x, z), math.hypot(x, y)])


def accepted_at_rest(noise_sigmas: float) -> float:
    """Part of a normal noise's samples within this many sigmas, 0 … 1: what a gate of noise alone passes."""
    return math.erf(noise_sigmas / math.sqrt(2.0))


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise _refused(f"{name} is {value:g}, not a positive number.")


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0):
            raise _refused(f"{name} is {value:g}: negative, or not a number.")


def _refused(what: str) -> CalibrationError:
    return CalibrationError(
        what, where="gates of the attitude", fault=Fault.PLAN, remedy="state what the correction may suffer."
    )

"""How well a strapdown attitude is known: gates for one unit, and the propagation of its errors.

States, as standard deviations of what the run does not tell (error of the attitude in the level frame first):

    psi' = C (beta + M w) + N noise         psi: 3, beta: gyro bias left over, M: scale factors, misalignment
    after a block with open gates           e = -psi + (C c + a) x z,   z up, horizontal parts only
        psi += e T / tau_tilt,  beta += C^T e T / (tau_tilt tau_bias)

c: accelerometer bias over g, constant in the body; a: horizontal acceleration over g that passes the gates,
first-order Gauss-Markov; beta walks as the bias instability of white increments over its correlation time.
Alignment levels on c and takes the mean rate for the bias, which ties psi to c from the start.
Linear: right while errors stay below some degrees. C, w and gates are those of the run.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.attitude_angles import matrix_of
from calibration.algorithms.attitude_gates import Gate, NormGate, angular_acceleration_gate, norm_gate
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.strapdown_attitude import (
    Alignment,
    CorrectionSettings,
    OpenGates,
    StrapdownAttitude,
)

_PSI, _BETA, _C, _M, _A = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 18), slice(18, 20)
_STATES = 20
_LEVEL = np.diag([1.0, 1.0, 0.0])
_CROSS_UP = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""v x z."""


@dataclass(frozen=True)
class GateIntent:
    """What the correction may suffer, and what is known of the vehicle (paper 2, 3.2).

    Attributes:
        horizontal_m_s2: xi, largest horizontal acceleration that may pass.
        speed_m_s: largest of the vehicle: a turn of rate w pushes by speed w.
        lever_arm_m: from the centre of turning to the unit.
        accelerometer_error_m_s2: by which the norm may differ from that at the alignment.
        gyro_error_rad_s: likewise of the rate.
        noise_sigmas: standard deviations of the gated quantities at rest that are let pass.
    """

    horizontal_m_s2: float = 0.0980665
    speed_m_s: float = 60.0
    lever_arm_m: tuple[float, float, float] = (0.3, 0.02, 0.02)
    accelerometer_error_m_s2: float = 0.02
    gyro_error_rad_s: float = math.radians(0.1)
    noise_sigmas: float = 3.0


@dataclass(frozen=True)
class GatesOfRun:
    """`norm`, `angular_acceleration`: with what they admit and the printed values; `bounds`: to apply."""

    norm: NormGate
    angular_acceleration: Gate
    bounds: OpenGates


def gates_of_run(
    alignment: Alignment, gravity_m_s2: float, intent: GateIntent | None = None, unit: int | None = None
) -> GatesOfRun:
    """Corrected gates from the noise that the alignment saw; of units side by side that of one, or the mean.

    Raises:
        CalibrationError: values that are not positive.
    """
    intent = intent or GateIntent()

    def noise(of_units: FloatArray) -> float:
        every = np.atleast_1d(of_units)
        return float(every.mean() if unit is None else every[unit])

    norm = norm_gate(
        intent.horizontal_m_s2, gravity_m_s2, noise(alignment.norm_noise_m_s2), intent.noise_sigmas
    )
    change = angular_acceleration_gate(
        intent.horizontal_m_s2,
        np.array(intent.lever_arm_m),
        noise(alignment.angular_acceleration_noise_rad_s2),
        intent.noise_sigmas,
    )
    turning = intent.horizontal_m_s2 / intent.speed_m_s
    bounds = OpenGates(
        norm_m_s2=norm.bound + intent.accelerometer_error_m_s2,
        rate_rad_s=turning
        + intent.noise_sigmas * noise(alignment.rate_noise_rad_s)
        + intent.gyro_error_rad_s,
        angular_acceleration_rad_s2=change.bound,
    )
    return GatesOfRun(norm, change, bounds)


@dataclass(frozen=True)
class AttitudeErrorSources:
    """Standard uncertainties, SI, the same for the three axes.

    Attributes:
        angle_random_walk_rad_per_sqrt_s: N of the gyros.
        gyro_bias_instability_rad_s, correlation_time_s: slow part of the bias.
        gyro_scale_factor: relative, of each gyro.
        gyro_misalignment_rad: of each off-diagonal element.
        accelerometer_bias_m_s2: constant.
        velocity_random_walk_m_s_per_sqrt_s: of the accelerometers.
        passed_acceleration_m_s2: horizontal acceleration while the gates are open.
        passed_correlation_s: how long it lasts.
    """

    angle_random_walk_rad_per_sqrt_s: float
    gyro_bias_instability_rad_s: float = 0.0
    correlation_time_s: float = 300.0
    gyro_scale_factor: float = 0.0
    gyro_misalignment_rad: float = 0.0
    accelerometer_bias_m_s2: float = 0.0
    velocity_random_walk_m_s_per_sqrt_s: float = 0.0
    passed_acceleration_m_s2: float = 0.0
    passed_correlation_s: float = 5.0


def roll_pitch_uncertainty_rad(
    run: StrapdownAttitude,
    alignment: Alignment,
    sources: AttitudeErrorSources,
    settings: CorrectionSettings,
    gravity_m_s2: float,
) -> FloatArray:
    """Standard uncertainty of roll and pitch at the beginning of each block, shape (k, 2); of a single unit.

    Near a pitch of 90 deg the roll's grows without bound, as roll itself loses its meaning.
    """
    block_s = run.block_samples * run.period_s
    covariance = _initial(alignment, sources, gravity_m_s2)
    walk = np.zeros((_STATES, _STATES))
    walk[_PSI, _PSI] = sources.angle_random_walk_rad_per_sqrt_s**2 * block_s * np.eye(3)
    slow = 2.0 * sources.gyro_bias_instability_rad_s**2 * block_s / sources.correlation_time_s
    walk[_BETA, _BETA] = slow * np.eye(3)
    keep = math.exp(-block_s / sources.passed_correlation_s)
    passed = (sources.passed_acceleration_m_s2 / gravity_m_s2) ** 2
    walk[_A, _A] = (1.0 - keep**2) * passed * np.eye(2)
    seen_noise = sources.velocity_random_walk_m_s_per_sqrt_s**2 / block_s / gravity_m_s2**2
    found = np.empty((len(run.turned), 2))
    for k, frame in enumerate(run.turned):
        found[k] = _roll_pitch(frame, covariance)
        step = np.eye(_STATES)
        step[_PSI, _BETA] = frame * block_s
        step[_PSI, _M] = np.einsum("ij,k->ijk", frame, run.mean_rate_rad_s[k] * block_s).reshape(3, 9)
        step[_A, _A] = keep * np.eye(2)
        covariance = step @ covariance @ step.T + walk
        if run.gates_open[k]:
            covariance = _corrected(covariance, frame, block_s, settings, seen_noise)
    return found


def _initial(alignment: Alignment, sources: AttitudeErrorSources, gravity_m_s2: float) -> FloatArray:
    duration_s = alignment.duration_s
    frame = matrix_of(alignment.attitude)
    covariance = np.zeros((_STATES, _STATES))
    tilt = (sources.accelerometer_bias_m_s2 / gravity_m_s2) ** 2
    noise = sources.velocity_random_walk_m_s_per_sqrt_s**2 / duration_s / gravity_m_s2**2
    to_level = _CROSS_UP @ frame
    covariance[_C, _C] = tilt * np.eye(3)
    covariance[_PSI, _C] = tilt * to_level
    covariance[_C, _PSI] = tilt * to_level.T
    covariance[_PSI, _PSI] = tilt * to_level @ to_level.T + noise * _LEVEL
    rest = sources.angle_random_walk_rad_per_sqrt_s**2 / duration_s
    slow = sources.gyro_bias_instability_rad_s**2 * min(1.0, duration_s / sources.correlation_time_s)
    covariance[_BETA, _BETA] = (rest + slow) * np.eye(3)
    of_matrix = np.full((3, 3), sources.gyro_misalignment_rad**2)
    np.fill_diagonal(of_matrix, sources.gyro_scale_factor**2)
    covariance[_M, _M] = np.diag(of_matrix.ravel())
    covariance[_A, _A] = (sources.passed_acceleration_m_s2 / gravity_m_s2) ** 2 * np.eye(2)
    return covariance


def _corrected(
    covariance: FloatArray, frame: FloatArray, block_s: float, settings: CorrectionSettings, noise: float
) -> FloatArray:
    gain = block_s / settings.tilt_time_constant_s
    error = np.zeros((3, _STATES))
    error[:, _PSI] = -_LEVEL
    error[:, _C] = _CROSS_UP @ frame
    error[:, _A] = _CROSS_UP[:, :2]
    drives = np.zeros((_STATES, 3))
    drives[_PSI] = gain * np.eye(3)
    if settings.bias_time_constant_s is not None:
        drives[_BETA] = gain / settings.bias_time_constant_s * frame.T
    step = np.eye(_STATES) + drives @ error
    return step @ covariance @ step.T + noise * drives @ _LEVEL @ drives.T


def _roll_pitch(frame: FloatArray, covariance: FloatArray) -> FloatArray:
    """(2,) from the error of the level frame: up moves by -psi x z, seen in the body."""
    up = frame[2]
    to_up = frame.T @ _CROSS_UP  # of psi; the sign does not matter here
    cross = up[1] ** 2 + up[2] ** 2
    of_roll = np.array([0.0, up[2], -up[1]]) @ to_up / cross
    of_pitch = np.array([1.0, 0.0, 0.0]) @ to_up / math.sqrt(cross)
    variance = covariance[_PSI, _PSI]
    return np.sqrt(np.array([of_roll @ variance @ of_roll, of_pitch @ variance @ of_pitch]))

"""One IMU on a stand: six static positions and turns about each axis, evaluated together.

The evaluation behind the plan `imu_calibration` (paper 1, section 3.2, in the corrected form).
Outputs are in the unit's nominal SI scaling; truth comes from the stand: specific force and Earth
rate in body axes for each pose, the integrated turn from the encoders for each rotation.

Entry points:
    calibrate_imu(poses, rotations)  -> ImuCalibration   coefficients, covariance, what was not used
    calibrate_acc(poses), calibrate_gyro(poses, rotations) -> SensorCalibration    one triad alone
    gyro_bias_at_rest(poses)         -> GyroBias         where nothing turned
    verify_imu(poses, rotations)     -> ImuResiduals     second look, on compensated output
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.algorithms.captures import (
    Rotation,
    Run,
    StaticPose,
    acc_run_name,
    gyro_run_name,
    observe,
    period_s,
    place_in_time,
)
from calibration.algorithms.coefficients import FloatArray, Quantity, TriadCoefficients
from calibration.algorithms.correlated_fit import Blocks, fit_correlated
from calibration.algorithms.linear_triad import LinearFit, fit_linear_triad, fit_with_unknown_slow_noise
from calibration.algorithms.noise_covariance import Observations, noise_hypotheses
from calibration.algorithms.screening import NotUsed
from calibration.evaluation import GyroBias
from protocol.errors import CalibrationError, Fault

__all__ = [
    "ImuCalibration",
    "ImuResiduals",
    "NotUsed",
    "Rotation",
    "SensorCalibration",
    "SlowNoise",
    "StaticPose",
    "calibrate_acc",
    "calibrate_gyro",
    "calibrate_imu",
    "gyro_bias_at_rest",
    "verify_imu",
]

UNKNOWN_MATRIX = 5e-3
"""Standard uncertainty of each element of M that no turn told."""


@dataclass(frozen=True)
class SlowNoise:
    """What is known of a sensor's bias instability beforehand (IEEE 952 Gauss-Markov term).

    Attributes:
        standard_deviation: SI of the sensor (rad/s or m/s^2).
        correlation_time_s: of the exponential correlation; infinite: constant over a power-on.
    """

    standard_deviation: float
    correlation_time_s: float


@dataclass(frozen=True)
class SensorCalibration:
    """One triad of a session. `residuals`, `noise`: as in `ImuCalibration`."""

    coefficients: TriadCoefficients
    residuals: dict[str, FloatArray]
    noise: str
    not_used: tuple[NotUsed, ...]


@dataclass(frozen=True)
class ImuCalibration:
    """Coefficients of both triads, with what they rest on.

    `*_residuals`: per pose or rotation, output mean less model, SI, shape (3,). `*_noise`: what
    the covariance assumes of the noise, in words with figures.
    """

    gyro: TriadCoefficients
    acc: TriadCoefficients
    gyro_residuals_rad_s: dict[str, FloatArray]
    acc_residuals_m_s2: dict[str, FloatArray]
    gyro_noise: str
    acc_noise: str
    not_used: tuple[NotUsed, ...] = field(default=())


@dataclass(frozen=True)
class ImuResiduals:
    """What is left after compensation, against the stand. Each is the largest magnitude over its entries.

    `as_measurements()` gives the names and units that a plan can put limits on.
    """

    gyro_scale_factor_error_max: float
    gyro_cross_coupling_max_rad: float
    gyro_bias_residual_max_rad_s: float
    acc_scale_factor_error_max: float
    acc_cross_coupling_max_rad: float
    acc_bias_residual_max_m_s2: float
    acc_residual_max_m_s2: float
    gyro_angle_residual_max_rad: float
    not_used: tuple[NotUsed, ...] = field(default=())

    def as_measurements(self) -> dict[str, tuple[float, str]]:
        """Measurement name → (value, unit of measure)."""
        return {
            "gyro_scale_factor_error_max": (self.gyro_scale_factor_error_max, "1"),
            "gyro_cross_coupling_max": (self.gyro_cross_coupling_max_rad, "rad"),
            "gyro_bias_residual_max": (self.gyro_bias_residual_max_rad_s, "rad/s"),
            "gyro_angle_residual_max": (self.gyro_angle_residual_max_rad, "rad"),
            "acc_scale_factor_error_max": (self.acc_scale_factor_error_max, "1"),
            "acc_cross_coupling_max": (self.acc_cross_coupling_max_rad, "rad"),
            "acc_bias_residual_max": (self.acc_bias_residual_max_m_s2, "m/s^2"),
            "acc_residual_max": (self.acc_residual_max_m_s2, "m/s^2"),
        }


def calibrate_imu(
    poses: Sequence[StaticPose],
    rotations: Sequence[Rotation],
    *,
    gyro_range_rad_s: float | None = None,
    acc_range_m_s2: float | None = None,
    gyro_slow_noise: SlowNoise | tuple[SlowNoise, ...] | None = None,
    acc_slow_noise: SlowNoise | tuple[SlowNoise, ...] | None = None,
) -> ImuCalibration:
    """Coefficients of both triads from a session on a stand.

    Args:
        poses: at least four whose specific forces span space and whose span leaves a bias (six
            positions, +-g on each axis, do).
        rotations: turns about at least three independent axes; both directions let the gyro bias
            and the scale factor be told apart without a static pose.
        gyro_range_rad_s, acc_range_m_s2: the sensor's range; samples there are saturated. None:
            saturation cannot be seen and is not looked for.
        gyro_slow_noise, acc_slow_noise: bias instability known beforehand, one term or a few; None:
            from the data, which tell a wander over the session but not one that is slower. A term
            with infinite correlation time is the turn-on repeatability: with it the bias stands for
            the unit, without it for this power-on.

    Raises:
        CalibrationError: the geometry cannot carry the coefficients (the missing excitation is
            named), or too little usable data is left.
    """
    placed = place_in_time(poses, rotations)
    acc = _of_sensor("acceleration", placed.acc_runs(), acc_range_m_s2, acc_slow_noise)
    gyro = _of_sensor("angular_rate", placed.gyro_runs(), gyro_range_rad_s, gyro_slow_noise)
    return ImuCalibration(
        gyro=gyro.coefficients,
        acc=acc.coefficients,
        gyro_residuals_rad_s=gyro.residuals,
        acc_residuals_m_s2=acc.residuals,
        gyro_noise=gyro.noise,
        acc_noise=acc.noise,
        not_used=(*acc.not_used, *gyro.not_used),
    )


def calibrate_acc(
    poses: Sequence[StaticPose],
    *,
    range_m_s2: float | None = None,
    slow_noise: SlowNoise | tuple[SlowNoise, ...] | None = None,
) -> SensorCalibration:
    """The accelerometers alone; arguments and errors as `calibrate_imu`."""
    return _of_sensor("acceleration", place_in_time(poses, ()).acc_runs(), range_m_s2, slow_noise)


def calibrate_gyro(
    poses: Sequence[StaticPose],
    rotations: Sequence[Rotation],
    *,
    range_rad_s: float | None = None,
    slow_noise: SlowNoise | tuple[SlowNoise, ...] | None = None,
) -> SensorCalibration:
    """The gyros alone; arguments and errors as `calibrate_imu`."""
    return _of_sensor("angular_rate", place_in_time(poses, rotations).gyro_runs(), range_rad_s, slow_noise)


def gyro_bias_at_rest(
    poses: Sequence[StaticPose],
    *,
    range_rad_s: float | None = None,
    slow_noise: SlowNoise | tuple[SlowNoise, ...] | None = None,
) -> tuple[GyroBias, tuple[NotUsed, ...]]:
    """Mean output at rest less the Earth rate, M the identity to `UNKNOWN_MATRIX`; what was not used.

    Raises:
        CalibrationError: too little usable data is left.
    """
    not_used: list[NotUsed] = []
    seen = observe(place_in_time(poses, ()).gyro_runs(), range_rad_s, not_used)
    blocks = Blocks(seen.middle_s, seen.duration_s, seen.output - seen.true_input)
    influences = np.repeat(seen.true_input[:, :, None], 3, axis=2) * UNKNOWN_MATRIX
    ones = np.ones((len(seen.middle_s), 1))
    known = _terms(slow_noise) or None
    fit = fit_correlated(ones, blocks, ("bias",), "gyro bias at rest", known, systematic=influences)
    found = GyroBias(fit.values[:, 0], fit.standard_uncertainty[:, 0], fit.degrees_of_freedom)
    return found, tuple(not_used)


def verify_imu(
    poses: Sequence[StaticPose],
    rotations: Sequence[Rotation],
    *,
    gyro_range_rad_s: float | None = None,
    acc_range_m_s2: float | None = None,
) -> ImuResiduals:
    """The second look: the same evaluation on *compensated* output, against the identity.

    Args:
        poses, rotations: as in `calibrate_imu`, with compensated outputs.
        gyro_range_rad_s, acc_range_m_s2: as in `calibrate_imu`.

    Raises:
        CalibrationError: as in `calibrate_imu`.
    """
    seen = calibrate_imu(poses, rotations, gyro_range_rad_s=gyro_range_rad_s, acc_range_m_s2=acc_range_m_s2)
    # Mean output less truth: what the fit left over, and what the fit differs from the identity.
    acc_residuals = [
        seen.acc_residuals_m_s2[name]
        + seen.acc.predict(pose.specific_force_body_m_s2)
        - pose.specific_force_body_m_s2
        for pose in poses
        if (name := acc_run_name(pose.name)) in seen.acc_residuals_m_s2
    ]
    angle_residuals: list[FloatArray] = []
    for run in rotations:
        name = gyro_run_name(run.name)
        if name in seen.gyro_residuals_rad_s:
            duration_s = period_s(run.time_s) * len(run.time_s)
            rate = (run.rotation_body_rad + run.earth_rotation_body_rad) / duration_s
            angle_residuals.append(
                (seen.gyro_residuals_rad_s[name] + seen.gyro.predict(rate) - rate) * duration_s
            )
    return ImuResiduals(
        gyro_scale_factor_error_max=float(np.abs(seen.gyro.scale_factor_error()).max()),
        gyro_cross_coupling_max_rad=float(np.abs(seen.gyro.cross_coupling()).max()),
        gyro_bias_residual_max_rad_s=float(np.abs(seen.gyro.bias).max()),
        acc_scale_factor_error_max=float(np.abs(seen.acc.scale_factor_error()).max()),
        acc_cross_coupling_max_rad=float(np.abs(seen.acc.cross_coupling()).max()),
        acc_bias_residual_max_m_s2=float(np.abs(seen.acc.bias).max()),
        acc_residual_max_m_s2=float(np.abs(acc_residuals).max()),
        gyro_angle_residual_max_rad=float(np.abs(angle_residuals).max()),
        not_used=seen.not_used,
    )


def _of_sensor(
    quantity: Quantity,
    runs: Sequence[Run],
    limit: float | None,
    known: SlowNoise | tuple[SlowNoise, ...] | None,
) -> SensorCalibration:
    not_used: list[NotUsed] = []
    seen = observe(runs, limit, not_used)
    fit = _fit(quantity, seen, known)
    noise = fit.likeliest if known is not None else f"{fit.likeliest} (posterior {fit.posterior:.2f})"
    return SensorCalibration(fit.coefficients, _residuals_by_run(seen, fit), noise, tuple(not_used))


def _terms(known: SlowNoise | tuple[SlowNoise, ...] | None) -> tuple[tuple[float, float], ...]:
    terms = (known,) if isinstance(known, SlowNoise) else known or ()
    return tuple((term.standard_deviation, term.correlation_time_s) for term in terms)


def _fit(
    quantity: Quantity, observations: Observations, known: SlowNoise | tuple[SlowNoise, ...] | None
) -> LinearFit:
    where = {"angular_rate": "gyro of the session", "acceleration": "accelerometer of the session"}[quantity]
    if not observations.run_names:
        raise CalibrationError(
            "No run of the session can be used.",
            where=where,
            fault=Fault.DATA,
            remedy="look at what was not used and why, and record the session again.",
        )
    slow = _terms(known)
    if not slow:
        return fit_with_unknown_slow_noise(quantity, observations, where)
    return fit_linear_triad(quantity, observations, noise_hypotheses(observations, slow, True), where)


def _residuals_by_run(observations: Observations, fit: LinearFit) -> dict[str, FloatArray]:
    return {
        name: fit.residuals[observations.run == index].mean(axis=0)
        for index, name in enumerate(observations.run_names)
    }

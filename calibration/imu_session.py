"""One IMU on a stand: six static positions and turns about each axis, evaluated together.

The evaluation behind the plan `imu_calibration` (paper 1, section 3.2, in the corrected form).
Outputs are in the unit's nominal SI scaling; truth comes from the stand: specific force and Earth
rate in body axes for each pose, the integrated turn from the encoders for each rotation.

Entry points:
    calibrate_imu(poses, rotations)  -> ImuCalibration   coefficients, covariance, what was not used
    verify_imu(poses, rotations)     -> ImuResiduals     second look, on compensated output
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients


@dataclass(frozen=True)
class NotUsed:
    """Something in the data that no coefficient rests on: what, how many samples, why."""

    what: str
    count: int
    why: str


@dataclass(frozen=True)
class SlowNoise:
    """What is known of a sensor's bias instability beforehand (IEEE 952 Gauss-Markov term).

    Attributes:
        standard_deviation: SI of the sensor (rad/s or m/s^2).
        correlation_time_s: of the exponential correlation.
    """

    standard_deviation: float
    correlation_time_s: float


@dataclass(frozen=True)
class StaticPose:
    """The unit at rest in a known attitude.

    Attributes:
        name: of the pose, e.g. 'x_up'.
        gyro_rad_s, acc_m_s2: outputs in nominal SI scaling, shape (n, 3), uniformly sampled.
        specific_force_body_m_s2: true specific force in body axes, shape (3,) (z up: [0, 0, +g]).
        earth_rate_body_rad_s: true Earth rate in body axes, shape (3,).
        time_s: sample times (n,) on the clock of the rotations; None: the poses are taken to
            follow each other, in their order, at the rotations' sample period.
    """

    name: str
    gyro_rad_s: FloatArray
    acc_m_s2: FloatArray
    specific_force_body_m_s2: FloatArray
    earth_rate_body_rad_s: FloatArray
    time_s: FloatArray | None = None


@dataclass(frozen=True)
class Rotation:
    """A capture that begins and ends at rest with a known turn in between.

    Attributes:
        name: of the run, e.g. 'x_plus'.
        time_s: sample times, shape (n,), uniform.
        gyro_rad_s: outputs in nominal SI scaling, shape (n, 3).
        rotation_body_rad: true integral of the body rate relative to the laboratory over the
            capture, in body axes, shape (3,). Nothing of the Earth is in it.
        earth_rotation_body_rad: true integral of the Earth rate in body axes over the capture, (3,).
    """

    name: str
    time_s: FloatArray
    gyro_rad_s: FloatArray
    rotation_body_rad: FloatArray
    earth_rotation_body_rad: FloatArray


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
    gyro_slow_noise: SlowNoise | None = None,
    acc_slow_noise: SlowNoise | None = None,
) -> ImuCalibration:
    """Coefficients of both triads from a session on a stand.

    Args:
        poses: at least four whose specific forces span space and whose span leaves a bias (six
            positions, +-g on each axis, do).
        rotations: turns about at least three independent axes; both directions let the gyro bias
            and the scale factor be told apart without a static pose.
        gyro_range_rad_s, acc_range_m_s2: the sensor's range; samples there are saturated. None:
            saturation cannot be seen and is not looked for.
        gyro_slow_noise, acc_slow_noise: bias instability known beforehand; None: from the data.

    Raises:
        CalibrationError: the geometry cannot carry the coefficients (the missing excitation is
            named), or too little usable data is left.
    """
    raise NotImplementedError


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
    raise NotImplementedError

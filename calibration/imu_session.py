"""One IMU on a stand: six static positions and turns about each axis, evaluated together.

The evaluation behind the plan `imu_calibration` (paper 1, section 3.2, in the corrected form).
Outputs are in the unit's nominal SI scaling; truth comes from the stand: specific force and Earth
rate in body axes for each pose, the integrated turn from the encoders for each rotation.

Entry points:
    calibrate_imu(poses, rotations)  -> ImuCalibration   coefficients, covariance, what was not used
    verify_imu(poses, rotations)     -> ImuResiduals     second look, on compensated output
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.algorithms.coefficients import FloatArray, Quantity, TriadCoefficients
from calibration.algorithms.linear_triad import LinearFit, fit_linear_triad
from calibration.algorithms.noise_covariance import BLOCKS_PER_REST, Observations, noise_hypotheses
from calibration.algorithms.screening import NotUsed, screen_rotation, screen_static
from protocol.errors import CalibrationError, Fault

MAX_RUNS = 200
"""Poses and rotations of one session; the noise covariance grows with their square."""


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
    not_used: list[NotUsed] = []
    placed = _place_in_time(poses, rotations)
    acc = _observe(placed.acc_runs(), acc_range_m_s2, not_used)
    acc_fit = _fit("acceleration", acc, acc_slow_noise)
    gyro = _observe(placed.gyro_runs(), gyro_range_rad_s, not_used)
    gyro_fit = _fit("angular_rate", gyro, gyro_slow_noise)
    return ImuCalibration(
        gyro=gyro_fit.coefficients,
        acc=acc_fit.coefficients,
        gyro_residuals_rad_s=_residuals_by_run(gyro, gyro_fit),
        acc_residuals_m_s2=_residuals_by_run(acc, acc_fit),
        gyro_noise=f"{gyro_fit.likeliest} (posterior {gyro_fit.posterior:.2f})",
        acc_noise=f"{acc_fit.likeliest} (posterior {acc_fit.posterior:.2f})",
        not_used=tuple(not_used),
    )


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
    seen = calibrate_imu(
        poses, rotations, gyro_range_rad_s=gyro_range_rad_s, acc_range_m_s2=acc_range_m_s2
    )
    left_out = {item.what for item in seen.not_used}
    acc_residuals = [
        np.nanmean(pose.acc_m_s2, axis=0) - pose.specific_force_body_m_s2
        for pose in poses
        if f"{pose.name} (accelerometer)" not in left_out
    ]
    angle_residuals = [
        (run.gyro_rad_s.sum(axis=0) * _period_s(run.time_s)) - run.rotation_body_rad - run.earth_rotation_body_rad
        for run in rotations
        if f"{run.name} (gyro)" not in left_out
    ]
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


@dataclass(frozen=True)
class _Run:
    """One capture of one sensor: `parts` means of it become observations."""

    name: str
    start_s: float
    period_s: float
    samples: FloatArray
    true_input: FloatArray
    parts: int
    screen: Callable[[float | None], tuple["np.ndarray", tuple[NotUsed, ...]]]


@dataclass(frozen=True)
class _PlacedSession:
    """Poses and rotations with the start of each on one clock."""

    poses: tuple[tuple[StaticPose, float, float], ...]  # pose, start, period
    rotations: tuple[tuple[Rotation, float, float], ...]

    def acc_runs(self) -> list[_Run]:
        return [
            _static_run(f"{pose.name} (accelerometer)", start, period, pose.acc_m_s2, pose.specific_force_body_m_s2)
            for pose, start, period in self.poses
        ]

    def gyro_runs(self) -> list[_Run]:
        runs = [
            _static_run(f"{pose.name} (gyro)", start, period, pose.gyro_rad_s, pose.earth_rate_body_rad_s)
            for pose, start, period in self.poses
        ]
        return runs + [_rotation_run(run, start, period) for run, start, period in self.rotations]


def _static_run(name: str, start: float, period: float, samples: FloatArray, truth: FloatArray) -> _Run:
    values = _checked(name, samples, 2)
    return _Run(
        name, start, period, values, _checked(name, truth, 1), BLOCKS_PER_REST,
        lambda limit: screen_static(name, values, limit),
    )  # fmt: skip


def _rotation_run(run: Rotation, start: float, period: float) -> _Run:
    name = f"{run.name} (gyro)"
    values = _checked(name, run.gyro_rad_s, 2)
    turn = _checked(name, run.rotation_body_rad, 1) + _checked(name, run.earth_rotation_body_rad, 1)

    def screen(limit: float | None) -> tuple[np.ndarray, tuple[NotUsed, ...]]:
        reasons = screen_rotation(name, run.time_s, values, limit)
        return np.arange(0 if reasons else len(values)), reasons

    duration = period * max(len(values), 1)
    return _Run(name, start, period, values, turn / duration, 1, screen)


def _place_in_time(poses: Sequence[StaticPose], rotations: Sequence[Rotation]) -> _PlacedSession:
    """Start and sample period of every run; in order, one after another, where the times are not known."""
    if len(poses) + len(rotations) > MAX_RUNS:
        raise CalibrationError(
            f"A session of {len(poses) + len(rotations)} runs is larger than {MAX_RUNS}.",
            where="calibrate_imu",
            fault=Fault.DATA,
            remedy="evaluate it in parts.",
        )
    periods = [_period_s(run.time_s) for run in rotations if len(run.time_s) > 1]
    typical = float(np.median(periods)) if periods else 1.0
    timed = all(pose.time_s is not None and len(pose.time_s) > 1 for pose in poses)
    cursor = 0.0
    placed_poses: list[tuple[StaticPose, float, float]] = []
    for pose in poses:
        period = _period_s(pose.time_s) if timed and pose.time_s is not None else typical
        start = float(pose.time_s[0]) if timed and pose.time_s is not None else cursor
        placed_poses.append((pose, start, period))
        cursor += period * len(pose.acc_m_s2)
    placed_rotations: list[tuple[Rotation, float, float]] = []
    for run in rotations:
        period = _period_s(run.time_s) if len(run.time_s) > 1 else typical
        placed_rotations.append((run, float(run.time_s[0]) if timed and len(run.time_s) else cursor, period))
        cursor += period * len(run.time_s)
    return _PlacedSession(tuple(placed_poses), tuple(placed_rotations))


def _observe(runs: Sequence[_Run], range_limit: float | None, not_used: list[NotUsed]) -> Observations:
    """Means over parts of each usable run; what is not usable goes to `not_used`."""
    inputs: list[FloatArray] = []
    outputs: list[FloatArray] = []
    middles: list[float] = []
    durations: list[float] = []
    run_index: list[int] = []
    names: list[str] = []
    for run in runs:
        usable, left_out = run.screen(range_limit)
        not_used.extend(left_out)
        if len(usable) == 0:
            continue
        for part in np.array_split(usable, run.parts):
            inputs.append(run.true_input)
            outputs.append(run.samples[part].mean(axis=0))
            middles.append(run.start_s + run.period_s * (float(part.mean()) + 0.5))
            durations.append(run.period_s * len(part))
            run_index.append(len(names))
        names.append(run.name)
    return Observations(
        np.array(inputs).reshape(-1, 3),
        np.array(outputs).reshape(-1, 3),
        np.array(middles),
        np.array(durations),
        np.array(run_index, dtype=np.intp),
        tuple(names),
        np.zeros((len(names), 3, 3)),
    )


def _fit(quantity: Quantity, observations: Observations, known: SlowNoise | None) -> LinearFit:
    where = {"angular_rate": "gyro of the session", "acceleration": "accelerometer of the session"}[quantity]
    if not observations.run_names:
        raise CalibrationError(
            "No run of the session can be used.",
            where=where,
            fault=Fault.DATA,
            remedy="look at what was not used and why, and record the session again.",
        )
    slow = None if known is None else (known.standard_deviation, known.correlation_time_s)
    return fit_linear_triad(quantity, observations, noise_hypotheses(observations, slow, True), where)


def _residuals_by_run(observations: Observations, fit: LinearFit) -> dict[str, FloatArray]:
    return {
        name: fit.residuals[observations.run == index].mean(axis=0)
        for index, name in enumerate(observations.run_names)
    }


def _period_s(time_s: FloatArray) -> float:
    """Sample period: the span over its steps (uniform sampling)."""
    return float((time_s[-1] - time_s[0]) / (len(time_s) - 1))


def _checked(name: str, values: FloatArray, dimensions: int) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    finite_enough = dimensions == 2 or bool(np.isfinite(array).all())
    if array.ndim != dimensions or array.shape[-1] != 3 or not finite_enough:
        raise CalibrationError(
            f"'{name}' has an array of shape {array.shape} where (n, 3) samples or a finite (3,) truth belong.",
            where=name,
            fault=Fault.DATA,
            remedy="hand over samples as (n, 3) and truth as three finite numbers.",
        )
    return array

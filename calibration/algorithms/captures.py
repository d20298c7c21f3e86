"""Captures of a session (rests and turns) and their reduction to observations.

A rest gives the means of a few blocks, so that its own noise can be seen; a turn gives one
observation, its mean rate. What cannot be used goes into the record, not into a mean.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.noise_covariance import BLOCKS_PER_REST, Observations
from calibration.algorithms.screening import NotUsed, screen_rotation, screen_static
from protocol.errors import CalibrationError, Fault

MAX_RUNS = 48
"""Poses and rotations of one session; the noise covariance grows with their square."""
MIN_OWN_PART = 0.99
"""Part of a run that must lie before the next one's start for their clocks to be one."""


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
        attitude_uncertainty_rad: standard uncertainty of the pose's own attitude about each axis. An
            error that all poses share turns the body axes and is in none of them.
    """

    name: str
    gyro_rad_s: FloatArray
    acc_m_s2: FloatArray
    specific_force_body_m_s2: FloatArray
    earth_rate_body_rad_s: FloatArray
    time_s: FloatArray | None = None
    attitude_uncertainty_rad: float = 0.0


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
        attitude_uncertainty_rad: standard uncertainty of the turn's own axis, and of its angle.
    """

    name: str
    time_s: FloatArray
    gyro_rad_s: FloatArray
    rotation_body_rad: FloatArray
    earth_rotation_body_rad: FloatArray
    attitude_uncertainty_rad: float = 0.0


@dataclass(frozen=True)
class Run:
    """One capture of one sensor: `parts` means of it become observations."""

    name: str
    start_s: float
    period_s: float
    samples: FloatArray
    true_input: FloatArray
    parts: int
    input_covariance: FloatArray
    screen: Callable[[float | None], tuple[NDArray[np.intp], tuple[NotUsed, ...]]]


@dataclass(frozen=True)
class PlacedSession:
    """Poses and rotations with the start of each on one clock."""

    poses: tuple[tuple[StaticPose, float, float], ...]  # pose, start, period
    rotations: tuple[tuple[Rotation, float, float], ...]

    def acc_runs(self) -> list[Run]:
        """The accelerometer's captures."""
        return [
            _static_run(
                acc_run_name(pose.name),
                start,
                period,
                pose.acc_m_s2,
                pose.specific_force_body_m_s2,
                pose.time_s,
                pose.attitude_uncertainty_rad,
            )
            for pose, start, period in self.poses
        ]

    def gyro_runs(self) -> list[Run]:
        """The gyro's captures: poses and turns."""
        runs = [
            _static_run(
                gyro_run_name(pose.name),
                start,
                period,
                pose.gyro_rad_s,
                pose.earth_rate_body_rad_s,
                pose.time_s,
                pose.attitude_uncertainty_rad,
            )
            for pose, start, period in self.poses
        ]
        return runs + [_rotation_run(run, start, period) for run, start, period in self.rotations]


def acc_run_name(name: str) -> str:
    """What the accelerometer's part of a pose is called in residuals and records."""
    return f"{name} (accelerometer)"


def gyro_run_name(name: str) -> str:
    """What the gyro's part of a pose or turn is called in residuals and records."""
    return f"{name} (gyro)"


def _static_run(
    name: str,
    start_s: float,
    period_s: float,
    samples: FloatArray,
    truth: FloatArray,
    time_s: FloatArray | None,
    attitude_uncertainty_rad: float,
) -> Run:
    values, true_input = _checked(name, samples, 2), _checked(name, truth, 1)
    if time_s is not None:
        _check_lengths(name, time_s, values)

    def screen(limit: float | None) -> tuple[NDArray[np.intp], tuple[NotUsed, ...]]:
        return screen_static(name, values, limit, time_s=time_s)

    doubt = tilted_covariance(true_input, attitude_uncertainty_rad)
    return Run(name, start_s, period_s, values, true_input, BLOCKS_PER_REST, doubt, screen)


def tilted_covariance(vector: FloatArray, angle_rad: float) -> FloatArray:
    """Covariance of a vector (3,) that is turned by independent small angles about each axis, (3, 3)."""
    return angle_rad**2 * (float(vector @ vector) * np.eye(3) - np.outer(vector, vector))


def _rotation_run(run: Rotation, start: float, period: float) -> Run:
    name = gyro_run_name(run.name)
    values = _checked(name, run.gyro_rad_s, 2)
    _check_lengths(name, run.time_s, values)
    turn = _checked(name, run.rotation_body_rad, 1) + _checked(name, run.earth_rotation_body_rad, 1)

    def screen(limit: float | None) -> tuple[NDArray[np.intp], tuple[NotUsed, ...]]:
        reasons = screen_rotation(name, run.time_s, values, limit)
        return np.arange(0 if reasons else len(values)), reasons

    duration = period * max(len(values), 1)
    # axis and angle err alike in angle: the axis as the turn is long, the angle once
    doubt = tilted_covariance(turn, run.attitude_uncertainty_rad) + run.attitude_uncertainty_rad**2 * np.eye(
        3
    )
    return Run(name, start, period, values, turn / duration, 1, doubt / duration**2, screen)


def place_in_time(poses: Sequence[StaticPose], rotations: Sequence[Rotation]) -> PlacedSession:
    """Start and sample period of every run on one clock.

    Where a pose has no times, or the runs' times overlap (each began a clock of its own), the runs
    are placed one after another in their order: only the slow noise's correlation hangs on it.
    """
    if len(poses) + len(rotations) > MAX_RUNS:
        raise CalibrationError(
            f"A session of {len(poses) + len(rotations)} runs is larger than {MAX_RUNS}.",
            where="calibrate_imu",
            fault=Fault.DATA,
            remedy="evaluate it in parts.",
        )
    times = [*(pose.time_s for pose in poses), *(run.time_s for run in rotations)]
    counts = [*(len(pose.acc_m_s2) for pose in poses), *(len(run.gyro_rad_s) for run in rotations)]
    known = [period_s(time_s) for time_s in times if time_s is not None and len(time_s) > 1]
    typical = float(np.median(known)) if known else 1.0
    periods = [period_s(time_s) if time_s is not None and len(time_s) > 1 else typical for time_s in times]
    lengths = [period * count for period, count in zip(periods, counts, strict=True)]
    starts = _one_clock(times, lengths)
    if starts is None:
        starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]).tolist() if lengths else []
    placed = list(zip(starts, periods, strict=True))
    return PlacedSession(
        tuple((pose, *place) for pose, place in zip(poses, placed[: len(poses)], strict=True)),
        tuple((run, *place) for run, place in zip(rotations, placed[len(poses) :], strict=True)),
    )


def _one_clock(times: Sequence[FloatArray | None], lengths: Sequence[float]) -> list[float] | None:
    """Starts of the runs where all have times and none overlaps another; None otherwise."""
    starts: list[float] = []
    for time_s in times:
        if time_s is None or len(time_s) < 2:
            return None
        starts.append(float(time_s[0]))
    order = sorted(zip(starts, lengths, strict=True))
    apart = all(
        start + MIN_OWN_PART * length <= following
        for (start, length), (following, _) in itertools.pairwise(order)
    )
    return starts if apart else None


def observe(runs: Sequence[Run], range_limit: float | None, not_used: list[NotUsed]) -> Observations:
    """Means over parts of each usable run; what is not usable goes to `not_used`."""
    inputs: list[FloatArray] = []
    outputs: list[FloatArray] = []
    middles: list[float] = []
    durations: list[float] = []
    run_index: list[int] = []
    names: list[str] = []
    doubts: list[FloatArray] = []
    for run in runs:
        usable, left_out = run.screen(range_limit)
        not_used.extend(left_out)
        if len(usable) == 0:
            continue
        whole = len(usable) == len(run.samples)
        for part in np.array_split(usable, run.parts):
            inputs.append(run.true_input)
            # A view where nothing was left out; a product with ones sums far faster than down three columns.
            taken = run.samples[part[0] : part[-1] + 1] if whole else run.samples[part]
            outputs.append(np.full(len(taken), 1.0 / len(taken)) @ taken)
            middles.append(run.start_s + run.period_s * (float(part.mean()) + 0.5))
            durations.append(run.period_s * len(part))
            run_index.append(len(names))
        names.append(run.name)
        doubts.append(run.input_covariance)
    return Observations(
        np.array(inputs).reshape(-1, 3),
        np.array(outputs).reshape(-1, 3),
        np.array(middles),
        np.array(durations),
        np.array(run_index, dtype=np.intp),
        tuple(names),
        np.array(doubts).reshape(-1, 3, 3),
    )


def period_s(time_s: FloatArray) -> float:
    """Sample period: the span over its steps (uniform sampling)."""
    return float((time_s[-1] - time_s[0]) / (len(time_s) - 1))


def _checked(name: str, values: FloatArray, dimensions: int) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    finite_enough = dimensions == 2 or bool(np.isfinite(array).all())
    if array.ndim != dimensions or array.shape[-1] != 3 or not finite_enough:
        raise CalibrationError(
            f"'{name}' has an array of shape {array.shape} where (n, 3) samples or a finite (3,) belong.",
            where=name,
            fault=Fault.DATA,
            remedy="hand over samples as (n, 3) and truth as three finite numbers.",
        )
    return array


def _check_lengths(name: str, time_s: FloatArray, samples: FloatArray) -> None:
    if len(time_s) != len(samples):
        raise CalibrationError(
            f"'{name}' has {len(samples)} samples and {len(time_s)} times.",
            where=name,
            fault=Fault.DATA,
            remedy="hand over one time for each sample.",
        )

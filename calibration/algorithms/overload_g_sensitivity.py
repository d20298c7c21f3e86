"""g-sensitivity of three gyros from a sinusoidal overload rig: D_1, D_2, D_3 as a 3 x 3 matrix (paper 5).

    dW/dt = E_1 (w + D . A)          eq (12): w the constant rate (bias, Earth rate, what gravity adds)

    W+ = E_1 (w T+ + d V+),   W- = E_1 (w T- - d V-)      d: response to motion along the run's direction

The printed d = (W+ - W-) / (2 E_1 V), eq (16)-(18), lets w cancel, which needs T+ = T-. A
slider-crank's halves differ; the two equations are solved for w and d instead.

D is in (rad/s)/(m/s^2), row: gyro, column: body axis of the specific force.
"""

# pyright: strict
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.sinusoidal_overload import MIN_CYCLES, HalfCycles, refused
from calibration.algorithms.uncertainty_budget import t_inflation
from protocol.errors import Fault

MAX_CONDITION = 10.0
"""Directions of motion closer to one plane than this do not tell three columns apart."""


@dataclass(frozen=True)
class GyroRun:
    """Cycles along one direction.

    Attributes:
        direction_body: unit vector of the rig's positive motion in body axes, shape (3,).
        motion: m cycles.
        pulses: W+ and W- of the three gyros, shape (m, 2, 3).
    """

    direction_body: FloatArray
    motion: HalfCycles
    pulses: FloatArray


@dataclass(frozen=True)
class GSensitivity:
    """D with its uncertainty.

    Attributes:
        matrix: D, shape (3, 3), (rad/s)/(m/s^2); row i: gyro i.
        covariance: of each gyro's row, shape (3, 3, 3).
        rate_rad_s: w of each run and gyro, shape (runs, 3).
        printed: D by eq (16)-(18), shape (3, 3).
    """

    matrix: FloatArray
    covariance: FloatArray
    rate_rad_s: FloatArray
    printed: FloatArray

    @property
    def standard_uncertainty(self) -> FloatArray:
        """u(D), shape (3, 3)."""
        return np.sqrt(np.einsum("ijj->ij", self.covariance))


def response_along(
    motion: HalfCycles, pulses: FloatArray, scale_factor_pulse_rad: float
) -> tuple[FloatArray, FloatArray]:
    """d in (rad/s)/(m/s^2) and w in rad/s of each cycle, shapes (m, ...), from pulses (m, 2, ...)."""
    shape = (len(pulses), 2) + (1,) * (pulses.ndim - 2)
    duration, speed = motion.duration_s.reshape(shape), motion.speed_change_m_s.reshape(shape)
    mean_rate = pulses / duration / scale_factor_pulse_rad
    mean_force = speed / duration
    response = (mean_rate[:, 0] - mean_rate[:, 1]) / mean_force.sum(axis=1)
    return response, mean_rate[:, 0] - response * mean_force[:, 0]


@dataclass(frozen=True)
class RunResponse:
    """What one run tells: the three gyros' response d to motion along its direction, shapes (3,).

    Attributes:
        response: d, (rad/s)/(m/s^2).
        variance: of it; by `response_of_run` from the scatter of the cycles or the counting, whichever is
            larger.
        rate_rad_s: w.
        printed: d by eq (16)-(18).
    """

    response: FloatArray
    variance: FloatArray
    rate_rad_s: FloatArray
    printed: FloatArray


def response_of_run(run: GyroRun, scale_factor_pulse_rad: FloatArray) -> RunResponse:
    """One direction alone: with the motion along a body axis, a column of D.

    Args:
        run: at least `MIN_CYCLES` cycles.
        scale_factor_pulse_rad: E_1 of the gyros, pulses per rad, shape (3,).

    Raises:
        CalibrationError: too few cycles, or pulses that are missing.
    """
    cycles = len(run.motion.duration_s)
    if run.pulses.shape != (cycles, 2, 3) or not np.isfinite(run.pulses).all():
        raise refused("The gyros' pulses are missing, or not (cycles, 2, 3).", Fault.DATA)
    if cycles < MIN_CYCLES:
        raise refused(f"{cycles} cycles carry no standard uncertainty; {MIN_CYCLES} do.", Fault.PLAN)
    each, _ = response_along(run.motion, run.pulses, 1.0)
    total, counted = run.motion.total(), run.pulses.sum(axis=0, keepdims=True)
    slope, rate = response_along(total, counted, 1.0)
    seen = each.var(axis=0, ddof=1)
    variance = seen / cycles * t_inflation(cycles - 1) ** 2
    speed = float(total.speed_change_m_s.sum())
    return RunResponse(
        slope[0] / scale_factor_pulse_rad,
        np.maximum(variance, _counting_variance(total, cycles, seen)) / scale_factor_pulse_rad**2,
        rate[0] / scale_factor_pulse_rad,
        (counted[0, 0] - counted[0, 1]) / (speed * scale_factor_pulse_rad),
    )


def calibrate_g_sensitivity(
    runs: Sequence[GyroRun],
    scale_factor_pulse_rad: FloatArray,
    u_scale_factor: float,
    u_grating: float,
) -> GSensitivity:
    """D from runs along three or more directions.

    Args:
        runs: each with at least `MIN_CYCLES` cycles.
        scale_factor_pulse_rad: E_1 of the gyros, pulses per rad, shape (3,).
        u_scale_factor, u_grating: relative standard uncertainties, common to all runs.

    Raises:
        CalibrationError: too few cycles, pulses that are missing, or directions that leave a body axis
            without excitation (it is named).
    """
    directions = np.array([run.direction_body for run in runs], dtype=np.float64).reshape(-1, 3)
    _check_directions(directions)
    found = [response_of_run(run, scale_factor_pulse_rad) for run in runs]
    return combine_runs(directions, found, u_scale_factor, u_grating)


def combine_runs(
    directions: FloatArray, found: Sequence[RunResponse], u_scale_factor: float, u_grating: float
) -> GSensitivity:
    """D from what each run tells.

    Args:
        directions: unit vectors of the motion in body axes, shape (runs, 3).
        found: one a run.
        u_scale_factor, u_grating: relative standard uncertainties, common to all runs.

    Raises:
        CalibrationError: directions that leave a body axis without excitation (it is named).
    """
    _check_directions(directions)
    # slopes (runs, 3 gyros) = directions D^T
    to_columns = np.asarray(np.linalg.pinv(directions), dtype=np.float64)
    matrix = (to_columns @ np.array([one.response for one in found])).T
    covariance = np.einsum("ar,rg,br->gab", to_columns, np.array([one.variance for one in found]), to_columns)
    printed = to_columns @ np.array([one.printed for one in found])
    common = u_scale_factor**2 + u_grating**2
    covariance = covariance + common * np.einsum("ga,gb->gab", matrix, matrix)
    return GSensitivity(matrix, covariance, np.array([one.rate_rad_s for one in found]), printed.T)


def _counting_variance(total: HalfCycles, cycles: int, seen: FloatArray) -> FloatArray:
    """Of the mean of d times E_1, from pulses cut at the halves' boundaries, shape (3,).

    Two counters, each cut evenly over one pulse, make 1/6 a cut, shared by its halves with opposite signs.
    Pulses that step with the cycles are cut alike in each of them: the mean then errs as one cycle does, and
    the scatter does not tell. Only noise of s pulses, seen as what the cycles scatter beyond counting, moves
    the cuts through the pulse: their errors correlate by exp(-2 pi^2 s^2) from a cycle to the next.
    """
    duration, speed = total.duration_s[0] / cycles, total.speed_change_m_s[0] / cycles
    effect = np.array([1.0, -1.0]) / duration / float((speed / duration).sum())
    counting = np.array([[2.0, -2.0], [-2.0, 2.0]]) / 6.0
    one_cycle = float(effect @ counting @ effect)
    noise = np.maximum(seen - one_cycle, 0.0) / float(effect @ effect)
    kept = np.exp(-2.0 * math.pi**2 * noise)
    return one_cycle * np.minimum((1.0 + kept) / np.maximum((1.0 - kept) * cycles, 1e-300), 1.0)


def _check_directions(directions: FloatArray) -> None:
    if len(directions) == 0 or not np.isfinite(directions).all():
        raise refused("There is no run, or a direction is not a number.", Fault.PLAN)
    if (np.abs(np.linalg.norm(directions, axis=1) - 1.0) > 1e-3).any():
        raise refused("A direction of motion is no unit vector.", Fault.DATA)
    _, strengths, axes = np.linalg.svd(directions)
    if len(strengths) < 3 or strengths[0] > MAX_CONDITION * strengths[2]:
        missing = axes[2]
        named = "xyz"[int(np.argmax(np.abs(missing)))]
        raise refused(f"No run moves along body {named}: its column of D is not told.", Fault.PLAN)

"""A session by hand after Ferraris, Grimaldi & Parvis (Sensors and Materials 7 (1995) 311).

Six rests with each axis up and down on a flat surface, one or more whole turns about each axis. The
poses are only as good as the hand: their alignment is estimated from the rests themselves (the
cross-axis parts of opposite rests must mirror each other) and carried into every uncertainty. The
angle of a turn has no such witness: its standard uncertainty is stated, not measured.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration.algorithms.captures import Rotation, StaticPose, observe, period_s, place_in_time
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.earth import unknown_pose_covariance
from calibration.algorithms.linear_triad import LinearFit, fit_linear_triad
from calibration.algorithms.noise_covariance import NoiseHypothesis, Observations, noise_hypotheses
from calibration.algorithms.screening import NotUsed
from protocol.errors import CalibrationError, Fault

POSES = ("x_p", "x_a", "y_p", "y_a", "z_p", "z_a")
"""axis_p: the axis points up (specific force +g along it); axis_a: down."""
TURNS = ("x_rot", "y_rot", "z_rot")
ALIGNMENTS_RAD = tuple(float(a) for a in np.radians(np.geomspace(0.02, 6.0, 14)))
"""Alignment errors of a hand-made pose that are weighed, evenly on a log scale (standard deviations)."""
TURN_STANDARD_UNCERTAINTY_RAD = math.radians(1.0)
"""Angle of a turn by hand from stop to stop, stated: no datum in the session tells it."""
MAX_TURN_DEPARTURE = 0.2
"""Part of a turn by which the gyro may differ from whole turns before the turn is refused."""


@dataclass(frozen=True)
class HandRest:
    """Outputs at rest in nominal SI scaling: time (n,), acc and gyro (n, 3)."""

    time_s: FloatArray
    acc_m_s2: FloatArray
    gyro_rad_s: FloatArray


@dataclass(frozen=True)
class HandTurn:
    """Outputs during a turn that begins and ends at rest: time (n,), gyro (n, 3)."""

    time_s: FloatArray
    gyro_rad_s: FloatArray


@dataclass(frozen=True)
class FerrarisCalibration:
    """Both triads, and what the session says of itself.

    `alignment_rad`: standard deviation of the poses' tilt, estimated. `turns`: signed whole turns
    about each axis; the sign is the gyro's own, so a gyro wired the wrong way round is not seen.
    """

    acc: LinearFit
    gyro: LinearFit
    acc_observations: Observations
    gyro_observations: Observations
    alignment_rad: float
    turns: dict[str, int]
    not_used: tuple[NotUsed, ...]


def calibrate_ferraris(
    rests: Mapping[str, HandRest],
    turns: Mapping[str, HandTurn],
    gravity_m_s2: float,
    *,
    gyro_range_rad_s: float | None = None,
    acc_range_m_s2: float | None = None,
) -> FerrarisCalibration:
    """Both triads' matrices and biases from six rests and three turns by hand.

    The body axes are those of the housing's faces as it stood on the surface. Earth rate is not
    known in a session without site and azimuth: it is in the uncertainty of the gyro bias.

    Args:
        rests: by the names in `POSES`.
        turns: by the names in `TURNS`.
        gravity_m_s2: magnitude of gravity at the site.
        gyro_range_rad_s, acc_range_m_s2: ends of range; None: not known.

    Raises:
        CalibrationError: a part is missing (named) or cannot be used.
    """
    missing = [name for name in POSES if name not in rests] + [name for name in TURNS if name not in turns]
    if missing:
        raise _refused(f"The Ferraris session lacks {', '.join(missing)}.", "record the missing parts")
    not_used: list[NotUsed] = []
    poses = [_nominal_pose(name, rests[name], gravity_m_s2) for name in POSES]
    acc_observations = observe(place_in_time(poses, []).acc_runs(), acc_range_m_s2, not_used)
    acc, alignment_rad = _fit_acc(acc_observations, gravity_m_s2)

    static_bias = np.mean([np.nanmean(rests[name].gyro_rad_s, axis=0) for name in POSES], axis=0)
    signed = {name: _whole_turns(name, turns[name], static_bias) for name in TURNS}
    rotations = [_nominal_turn(name, turns[name], signed[name]) for name in TURNS]
    gyro_observations = observe(place_in_time(poses, rotations).gyro_runs(), gyro_range_rad_s, not_used)
    gyro_observations = replace(
        gyro_observations,
        reference_covariance=_turn_covariance(gyro_observations, turns, signed, alignment_rad),
    )
    gyro = fit_linear_triad(
        "angular_rate",
        gyro_observations,
        noise_hypotheses(gyro_observations, (), True),
        "gyro of the Ferraris session",
    )
    return FerrarisCalibration(
        acc, gyro, acc_observations, gyro_observations, alignment_rad, signed, tuple(not_used)
    )


def _nominal_pose(name: str, rest: HandRest, gravity_m_s2: float) -> StaticPose:
    up = np.zeros(3)
    up["xyz".index(name[0])] = gravity_m_s2 if name.endswith("p") else -gravity_m_s2
    return StaticPose(name, rest.gyro_rad_s, rest.acc_m_s2, up, np.zeros(3), rest.time_s)


def _nominal_turn(name: str, turn: HandTurn, whole_turns: int) -> Rotation:
    angle = np.zeros(3)
    angle["xyz".index(name[0])] = 2.0 * math.pi * whole_turns
    return Rotation(name, turn.time_s, turn.gyro_rad_s, angle, np.zeros(3))


def _fit_acc(observations: Observations, gravity_m_s2: float) -> tuple[LinearFit, float]:
    """The accelerometer's fit, averaged over the unknown alignment, and that alignment (rms)."""
    directions = np.array(
        [observations.true_input[observations.run == run][0] for run in range(len(observations.run_names))]
    ) / gravity_m_s2  # fmt: skip
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    hypotheses: list[NoiseHypothesis] = []
    for alignment in ALIGNMENTS_RAD:
        tilted = replace(observations, reference_covariance=(gravity_m_s2 * alignment) ** 2 * across)
        (white,) = noise_hypotheses(tilted, (), False)
        words = f"poses aligned to {math.degrees(alignment):.2g} deg"
        hypotheses.append(NoiseHypothesis(white.covariance, 1.0 / len(ALIGNMENTS_RAD), words))
    fit = fit_linear_triad(
        "acceleration", observations, tuple(hypotheses), "accelerometer of the Ferraris session"
    )
    mean_square = float(np.dot(fit.weights, np.square(ALIGNMENTS_RAD)))
    # A tilt shortens the projection by 1 - cos, of mean and standard deviation alignment^2: a second-order
    # error that is not corrected but stated. Of two poses, half the difference (scale) has both, half the
    # sum (bias) only what differs.
    covariance = fit.coefficients.covariance.copy()
    for axis in range(3):
        covariance[4 * axis, 4 * axis] += 1.5 * mean_square**2
        covariance[9 + axis, 9 + axis] += 0.5 * (gravity_m_s2 * mean_square) ** 2
    return replace(fit, coefficients=replace(fit.coefficients, covariance=covariance)), math.sqrt(mean_square)


def _whole_turns(name: str, turn: HandTurn, static_bias: FloatArray) -> int:
    """Signed number of whole turns by the gyro itself."""
    axis = "xyz".index(name[0])
    if len(turn.time_s) < 2:
        raise _refused(f"'{name}' has no samples.", "record the turn")
    angles = (turn.gyro_rad_s - static_bias).sum(axis=0) * period_s(turn.time_s) / (2.0 * math.pi)
    turns = round(float(angles[axis])) if np.isfinite(angles).all() else 0
    if turns == 0 or abs(float(angles[axis]) - turns) > MAX_TURN_DEPARTURE:
        raise _refused(
            f"'{name}' is no whole turn about {name[0]}: the gyro saw "
            f"{', '.join(f'{a:+.2f}' for a in angles)} turns about x, y, z.",
            "record whole turns from stop to stop, without missing samples",
        )
    return turns


def _turn_covariance(
    observations: Observations, turns: Mapping[str, HandTurn], signed: Mapping[str, int], alignment_rad: float
) -> FloatArray:
    """Covariance of each run's true mean rate: Earth rate of unknown direction, and the hand in the turns."""
    covariance = np.tile(unknown_pose_covariance(), (len(observations.run_names), 1, 1))
    for index, run_name in enumerate(observations.run_names):
        name = run_name.split(" ")[0]
        if name not in turns:
            continue
        axis = "xyz".index(name[0])
        duration = period_s(turns[name].time_s) * len(turns[name].time_s)
        angles = np.full(3, 2.0 * math.pi * abs(signed[name]) * alignment_rad)
        angles[axis] = TURN_STANDARD_UNCERTAINTY_RAD
        covariance[index] += np.diag((angles / duration) ** 2)
    return covariance


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="Ferraris session", fault=Fault.DATA, remedy=remedy + ".")

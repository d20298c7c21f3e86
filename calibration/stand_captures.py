"""Rests and turns out of a recording with a stand's stream, each with the stand's truth and Earth rate.

A turn is captured from rest to rest, as paper 1 does, with the Earth rate attitude by attitude: whole turns
cancel what lies across the spin axis, the rest before and after does not.
"""

# pyright: strict
import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.captures import Rotation, StaticPose
from calibration.algorithms.coefficients import FloatArray
from calibration.clock_of_turns import ClockRate, clock_rate_of_turns
from calibration.evaluations.channels import channels_in_si
from calibration.evaluations.method_evaluation import refused, stream_with
from calibration.evaluations.stand_motion import ANGLES, RATES, StandMotion, stand_motion
from protocol.recordings import Recording

STAND_PROFILES = ("multi_position", "rotation")
STILL_RAD_S = 1e-6
SETTLE_S = 0.2
"""Left out after a motion: filters and delays."""
TAKEN_S = 1.0
"""Of the rest on both sides that a turn's capture takes, or half of it where it is shorter."""
ATTITUDE_UNCERTAINTY_RAD = math.radians(4.0 / 3600.0)
"""Of one pose or turn beside what all of them share: encoders, wobble and orthogonality of a table's axes."""
CLOCK_STEPS = 2
"""A clock far off shifts a turn by more than its delay is linear in: told again with the first taken out."""
LEAST_REST_S = 1.0
LEAST_TURN_RAD = 1.0


@dataclass(frozen=True)
class StandCaptures:
    """Of one recording, on its own clock, set right where the turns tell its rate.

    Attributes:
        poses, rotations: with names that begin with the recording's.
        outside: samples in none of them.
        clock: rate of the unit's clock, taken out; None: not told.
    """

    poses: tuple[StaticPose, ...]
    rotations: tuple[Rotation, ...]
    outside: int
    clock: ClockRate | None = None

    def later(self, seconds: float) -> "StandCaptures":
        """On a clock that is ahead by so much."""
        poses = tuple(
            replace(one, time_s=None if one.time_s is None else one.time_s + seconds) for one in self.poses
        )
        return replace(
            self,
            poses=poses,
            rotations=tuple(replace(one, time_s=one.time_s + seconds) for one in self.rotations),
        )


def has_stand_truth(recording: Recording) -> bool:
    """Whether its profile and its stand's stream tell poses or turns."""
    stand = recording.streams.get("stand")
    known = stand is not None and stand.has(*RATES) and stand.has(*ANGLES)
    return known and recording.test.get("profile") in STAND_PROFILES


def stand_captures(recording: Recording) -> StandCaptures:
    """All rests of a second and more; of a profile 'rotation' the turns too.

    Raises:
        CalibrationError: clocks that no trigger joins, no site, no triad, a stand that is never at rest.
    """
    dut = stream_with(recording, "dut")
    time_s = dut.time_s()
    triads: dict[str, FloatArray] = {}
    for kind in ("gyro", "acc"):
        letters, samples = channels_in_si(recording, kind)
        if letters != "xyz":
            raise refused(recording, f"The recording has no triad of {kind} channels.", f"record {kind}_x …")
        triads[kind] = samples
    motion, rests, turns = _moved(recording, time_s, triads["gyro"])
    clock, fast = None, 0.0
    for _ in range(CLOCK_STEPS if turns else 0):
        rows = [row for row, _ in turns]
        clock = clock_rate_of_turns(motion.time_s, motion.rate_rad_s, triads["gyro"], rows)
        if clock is None:
            break
        fast += clock.rate
        time_s = dut.time_s() * (1.0 - fast)
        motion, rests, turns = _moved(recording, time_s, triads["gyro"])
    clock = clock and replace(clock, rate=fast)
    inside = np.zeros(len(time_s), dtype=np.bool_)
    for rows, _ in turns:
        inside[rows] = True
    poses: list[StaticPose] = []
    for number, (first, last) in enumerate(rests, start=1):
        free = np.flatnonzero(~inside[first:last]) + first
        settled = free[time_s[free] >= time_s[first] + SETTLE_S] if first else free
        if len(settled) < 2 or time_s[settled[-1]] - time_s[settled[0]] < LEAST_REST_S:
            continue
        rows = slice(int(settled[0]), int(settled[-1]) + 1)
        poses.append(_pose(recording, motion, rows, triads, number))
        inside[rows] = True
    return StandCaptures(tuple(poses), tuple(turn for _, turn in turns), int((~inside).sum()), clock)


def _moved(
    recording: Recording, time_s: FloatArray, gyro: FloatArray
) -> tuple[StandMotion, list[tuple[int, int]], list[tuple[slice, Rotation]]]:
    """What the stand did at these times: its motion, its rests, its turns with what the gyros say."""
    motion = stand_motion(recording, time_s)
    rests = _rests(motion)
    if not rests:
        raise refused(recording, "The stand is never at rest.", "record rests between the motions")
    return motion, rests, _turns(recording, motion, rests, gyro)


def _rests(motion: StandMotion) -> list[tuple[int, int]]:
    """(first, past the last) sample of each stretch in which the stand does not move."""
    still = (np.abs(motion.rate_rad_s) < STILL_RAD_S).all(axis=1)
    edges = np.diff(np.concatenate([[0], still.astype(np.int8), [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [
        (first, last)
        for first, last in zip(begins.tolist(), ends.tolist(), strict=True)
        if motion.time_s[last - 1] - motion.time_s[first] >= LEAST_REST_S / 2.0
    ]


def _pose(
    recording: Recording, motion: StandMotion, rows: slice, triads: dict[str, FloatArray], number: int
) -> StaticPose:
    part = replace(motion, time_s=motion.time_s[rows], dcm_body_from_ned=motion.dcm_body_from_ned[rows])
    force = part.specific_force_m_s2.mean(axis=0)
    return StaticPose(
        f"{recording.recording_id} rest {number}, {_direction(force)}",
        triads["gyro"][rows],
        triads["acc"][rows],
        np.asarray(force, dtype=np.float64),
        np.asarray(part.earth_rate_rad_s.mean(axis=0), dtype=np.float64),
        motion.time_s[rows],
        ATTITUDE_UNCERTAINTY_RAD,
    )


def _direction(force: FloatArray) -> str:
    axis = int(np.abs(force).argmax())
    return f"{'xyz'[axis]} {'up' if force[axis] > 0 else 'down'}"


def _turns(
    recording: Recording, motion: StandMotion, rests: list[tuple[int, int]], gyro: FloatArray
) -> list[tuple[slice, Rotation]]:
    """Rows and capture of each turn between two rests."""
    if recording.test.get("profile") != "rotation":
        return []
    time_s = motion.time_s
    period_s = float(np.median(np.diff(time_s)))
    found: list[tuple[slice, Rotation]] = []
    for (first, end_of_rest), (start_of_rest, last) in pairwise(rests):
        before = time_s[end_of_rest - 1] - min(TAKEN_S, (time_s[end_of_rest - 1] - time_s[first]) / 2.0)
        after = time_s[start_of_rest] + min(TAKEN_S, (time_s[last - 1] - time_s[start_of_rest]) / 2.0)
        rows = slice(*_within(time_s, before, after))
        turn = np.asarray(np.trapezoid(motion.rate_rad_s[rows], time_s[rows], axis=0), dtype=np.float64)
        if float(np.linalg.norm(turn)) < LEAST_TURN_RAD:
            continue
        part = replace(motion, dcm_body_from_ned=motion.dcm_body_from_ned[rows])
        duration_s = period_s * (rows.stop - rows.start)
        earth = part.earth_rate_rad_s.mean(axis=0) * duration_s
        axis = int(np.abs(turn).argmax())
        angle = f"{'xyz'[axis]} {math.degrees(float(turn[axis])):+.0f} deg"
        name = f"{recording.recording_id} turn {len(found) + 1}, {angle}"
        whole_earth = np.asarray(earth, dtype=np.float64)
        doubt = ATTITUDE_UNCERTAINTY_RAD
        found.append((rows, Rotation(name, time_s[rows], gyro[rows], turn, whole_earth, doubt)))
    return found


def _within(time_s: FloatArray, begin_s: float, end_s: float) -> NDArray[np.intp]:
    return np.searchsorted(time_s, [begin_s, end_s])

"""M and D of both triads at room temperature, from a turntable's `multi_position` and `rotation` recordings.

Poses and turns are known: the stand's own rates and specific forces say where the unit was.
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.earth import unknown_pose_covariance
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import refuse_unjoined, refused, stream_with
from calibration.imu_session import Rotation, SlowNoise, StaticPose, calibrate_imu
from calibration.rest_segments import rests
from calibration.sensor_knowledge import axes, sensor_range, slow_noise
from protocol.recordings import Recording

ROOM_PROFILES = ("multi_position", "rotation")
MARGIN_S = 0.2
"""Left out at both ends of a rest: filters settle."""
BETWEEN_S = 600.0
"""Taken to lie between two recordings: their noise has little in common."""
MIN_REST_S = 2.0
RATES = ("rate_x", "rate_y", "rate_z")
FORCES = ("acc_x", "acc_y", "acc_z")


@dataclass(frozen=True)
class RoomMatrix:
    """What is frozen.

    Attributes:
        acc, gyro: the triads.
        temperature_c: of the sensors by name, while they were measured.
        recordings: that they rest on.
        not_used: in them.
    """

    acc: TriadCoefficients
    gyro: TriadCoefficients
    temperature_c: dict[str, float]
    recordings: tuple[Recording, ...]
    not_used: tuple[NotUsed, ...]


def room_matrix(recordings: Sequence[Recording]) -> RoomMatrix:
    """Both triads from recordings at room temperature.

    Raises:
        CalibrationError: a profile is missing, the stand's truth is, or the poses do not carry the matrix.
    """
    first = recordings[0]
    for profile in ROOM_PROFILES:
        if not any(one.test.get("profile") == profile for one in recordings):
            raise refused(
                first,
                f"The matrix at room temperature needs a recording '{profile}' too.",
                f"record {' and '.join(ROOM_PROFILES)} of this unit on a turntable at room temperature, and "
                "name them together",
            )
    poses: list[StaticPose] = []
    turns: list[Rotation] = []
    begins_s = 0.0
    for recording in recordings:
        refuse_unjoined(recording)
        dut = stream_with(recording, "dut", *axes("gyro"), *axes("acc"))
        if recording.test.get("profile") == "multi_position":
            poses += _poses(recording, begins_s)
        else:
            turns += _turns(recording, begins_s)
        begins_s += float(dut.time_s()[-1]) + BETWEEN_S
    found = calibrate_imu(
        poses,
        turns,
        gyro_range_rad_s=sensor_range(first, "gyro"),
        acc_range_m_s2=sensor_range(first, "acc"),
        gyro_slow_noise=_within_a_power_on(first, "gyro"),
        acc_slow_noise=_within_a_power_on(first, "acc"),
    )
    covariance = found.gyro.covariance.copy()
    covariance[9:, 9:] += unknown_pose_covariance()
    return RoomMatrix(
        acc=found.acc,
        gyro=replace(found.gyro, covariance=covariance),
        temperature_c={kind: _mean_temperature(recordings, kind) for kind in ("acc", "gyro")},
        recordings=tuple(recordings),
        not_used=found.not_used,
    )


def temperature_column(recording: Recording, kind: str) -> str:
    """The column that tells the sensor's own temperature, else the unit's.

    Raises:
        CalibrationError: there is none.
    """
    columns = recording.stream("dut").columns
    for name in (f"temp_{kind}", "temp"):
        if name in columns:
            return name
    raise refused(
        recording,
        "The recording has no temperature of the unit.",
        f"record the column temp_{kind} or temp in the stream 'dut'",
    )


def _mean_temperature(recordings: Sequence[Recording], kind: str) -> float:
    parts = [
        np.asarray(one.stream("dut").columns[temperature_column(one, kind)], dtype=np.float64)
        for one in recordings
    ]
    return float(np.nanmean(np.concatenate(parts)))


def _within_a_power_on(recording: Recording, kind: str) -> tuple[SlowNoise, ...] | None:
    return slow_noise(recording, kind) or None


def _poses(recording: Recording, begins_s: float) -> list[StaticPose]:
    dut, stand = recording.stream("dut"), stream_with(recording, "stand", *RATES, *FORCES)
    time_s, gyro, acc = dut.time_s(), dut.si(*axes("gyro")), dut.si(*axes("acc"))
    stand_s, force = stand.time_s(), stand.si(*FORCES)
    poses: list[StaticPose] = []
    for segment in rests(recording, None).segments:
        start, end = time_s[segment.first] + MARGIN_S, time_s[segment.last - 1] - MARGIN_S
        if end - start < MIN_REST_S:
            continue
        rows = slice(*np.searchsorted(time_s, [start, end]).tolist())
        there = (stand_s >= start) & (stand_s <= end)
        truth = np.asarray(force[there].mean(axis=0), dtype=np.float64)
        name = f"{segment.name} of {recording.recording_id}"
        poses.append(StaticPose(name, gyro[rows], acc[rows], truth, np.zeros(3), time_s[rows] + begins_s))
    return poses


def _turns(recording: Recording, begins_s: float) -> list[Rotation]:
    """Turns between two rests of the stand; the way to another axis is one too, and tells no less."""
    dut, stand = recording.stream("dut"), stream_with(recording, "stand", *RATES)
    time_s, gyro = dut.time_s(), dut.si(*axes("gyro"))
    stand_s, rate = stand.time_s(), stand.si(*RATES)
    still = [segment for segment in rests(recording, None).segments if segment.last - segment.first > 2]
    turns: list[Rotation] = []
    for before, after in pairwise(still):
        rows = slice((before.first + before.last) // 2, (after.first + after.last) // 2)
        span = time_s[rows]
        there = (stand_s >= span[0]) & (stand_s <= span[-1])
        moving = np.abs(rate[there]).max(axis=1) > 1e-4
        alone = np.abs(rate[there]).max(axis=0)
        if not moving.any() or np.sort(alone)[1] > 1e-3 * alone.max():
            continue  # turned about several axes at once: the integral of the rates is no rotation
        turn = _integral(stand_s[there], rate[there])
        name = f"turn {len(turns) + 1} of {recording.recording_id}"
        turns.append(Rotation(name, span + begins_s, gyro[rows], turn, np.zeros(3)))
    return turns


def _integral(time_s: FloatArray, rate: FloatArray) -> FloatArray:
    return np.asarray(np.trapezoid(rate, time_s, axis=0), dtype=np.float64)

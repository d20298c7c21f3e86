"""A station's own recording: `test.segments` name each pose and turn, with the stand's truth.

{"name", "kind": "static", "start_s", "end_s", "specific_force_body_m_s2", "earth_rate_body_rad_s"}
{"name", "kind": "rotation", "start_s", "end_s", "rotation_body_rad", "earth_rotation_body_rad"}
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.evaluation import Evaluation, Residual
from calibration.imu_session import ImuCalibration, NotUsed, Rotation, StaticPose, calibrate_imu
from calibration.sensor_knowledge import axes, sensor_range, slow_noise
from protocol.errors import CalibrationError, Fault
from protocol.language import say
from protocol.recordings import Recording


def evaluate_stand_session(recording: Recording) -> Evaluation:
    """Both triads from a recording with named segments.

    Raises:
        CalibrationError: a segment is damaged (named), or the session cannot carry the coefficients.
    """
    poses, rotations, inside = _captures(recording)
    found = calibrate_imu(
        poses,
        rotations,
        gyro_range_rad_s=sensor_range(recording, "gyro"),
        acc_range_m_s2=sensor_range(recording, "acc"),
        gyro_slow_noise=slow_noise(recording, "gyro"),
        acc_slow_noise=slow_noise(recording, "acc"),
    )
    not_used = list(found.not_used)
    outside = len(recording.stream("dut")) - inside
    if outside > 0:
        moving = say("the stand was moving to the next pose")
        not_used.append(NotUsed(say("between the segments"), outside, moving))
    return Evaluation(
        recording_ids=(recording.recording_id,),
        serial=str(recording.unit.get("serial", "")),
        product=str(recording.unit.get("product", "")),
        method="imu_calibration",
        acc=found.acc,
        gyro=found.gyro,
        gyro_bias=None,
        residuals=_residuals(found),
        assumptions=(
            say("poses, turns and Earth rate in body axes as the stand's encoders give them"),
            say("gyro noise: {words}", words=found.gyro_noise),
            say("accelerometer noise: {words}", words=found.acc_noise),
        ),
        not_used=tuple(not_used),
    )


def _captures(recording: Recording) -> tuple[list[StaticPose], list[Rotation], int]:
    """Poses, rotations, and how many samples lie in them."""
    stream = recording.stream("dut")
    time_s, gyro, acc = stream.time_s(), stream.si(*axes("gyro")), stream.si(*axes("acc"))
    poses: list[StaticPose] = []
    rotations: list[Rotation] = []
    inside = np.zeros(len(stream), dtype=np.bool_)
    for number, segment in enumerate(recording.test["segments"], start=1):
        try:
            name, kind = str(segment["name"]), segment["kind"]
            bounds = [float(segment["start_s"]), float(segment["end_s"])]
            rows = slice(*np.searchsorted(time_s, bounds, side="left").tolist())
            if kind == "static":
                force = _vector(segment, "specific_force_body_m_s2")
                earth = _vector(segment, "earth_rate_body_rad_s")
                poses.append(StaticPose(name, gyro[rows], acc[rows], force, earth, time_s[rows]))
            elif kind == "rotation":
                turn = _vector(segment, "rotation_body_rad")
                earth = _vector(segment, "earth_rotation_body_rad")
                rotations.append(Rotation(name, time_s[rows], gyro[rows], turn, earth))
            else:
                raise ValueError(f"kind '{kind}' is neither 'static' nor 'rotation'")
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(
                f"A segment of the recording cannot be used: {error}.",
                where=f"{recording.recording_id}, test.segments[{number}]",
                fault=Fault.DATA,
                remedy="give name, kind, start_s, end_s and the stand's truth for each segment.",
            ) from None
        inside[rows] = True
    return poses, rotations, int(inside.sum())


def _residuals(found: ImuCalibration) -> tuple[Residual, ...]:
    by_unit = (("m/s^2", found.acc_residuals_m_s2), ("rad/s", found.gyro_residuals_rad_s))
    return tuple(
        Residual(name, tuple(float(value) for value in values), unit)
        for unit, residuals in by_unit
        for name, values in residuals.items()
    )


def _vector(segment: Mapping[str, Any], key: str) -> FloatArray:
    vector = np.array(segment[key], dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{key} is not three finite numbers")
    return vector

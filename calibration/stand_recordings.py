"""Sessions on a stand: a station's own recording, or recordings of profiles whose stand stream tells poses.

A station's recording names each pose and turn in `test.segments`, with the stand's truth:

{"name", "kind": "static", "start_s", "end_s", "specific_force_body_m_s2", "earth_rate_body_rad_s"}
{"name", "kind": "rotation", "start_s", "end_s", "rotation_body_rad", "earth_rotation_body_rad"}
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.evaluation import Evaluation, Residual
from calibration.evaluations.method_evaluation import refused
from calibration.evaluations.repeated_runs import between_runs, started_s
from calibration.evaluations.stand_motion import rate_uncertainty
from calibration.evaluations.sweep import CRYSTAL_DOUBT
from calibration.imu_session import (
    ImuCalibration,
    NotUsed,
    Rotation,
    SensorCalibration,
    SlowNoise,
    StaticPose,
    calibrate_acc,
    calibrate_gyro,
    calibrate_imu,
    gyro_bias_at_rest,
)
from calibration.sensor_knowledge import axes, sensor_range, slow_noise
from calibration.stand_captures import LEAST_TURN_RAD, StandCaptures, stand_captures
from protocol.errors import CalibrationError, Fault
from protocol.language import say
from protocol.recordings import Recording

BETWEEN_S = 600.0
"""Taken to lie between recordings whose slow noise is not stated and found from the data."""
INDEPENDENT_S, POWER_ON_S = 1e8, 1e6
"""So far apart no noise of one recording reaches another; what a power-on brings lasts so long."""


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
    # The encoders tell a turn's angle, the unit's own clock how long it took.
    found = replace(found, gyro=found.gyro.with_input_uncertainty(CRYSTAL_DOUBT))
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
            _crystal_sentence(),
            say("gyro noise: {words}", words=found.gyro_noise),
            say("accelerometer noise: {words}", words=found.acc_noise),
        ),
        not_used=tuple(not_used),
    )


def evaluate_stand_profiles(recordings: Sequence[Recording]) -> Evaluation:
    """What recordings `multi_position` and `rotation` of one unit carry together: see `stand_captures`.

    Both: matrix and bias of both triads. Positions alone: the accelerometers, and the gyros' bias. Turns
    alone: the gyros, and the accelerometers where the rests have attitudes enough.

    Raises:
        CalibrationError: neither triad can be told; the missing excitation is named.
    """
    first = recordings[0]
    captures, far_apart = _on_one_clock(recordings)
    poses = [pose for one in captures for pose in one.poses]
    turns = [turn for one in captures for turn in one.rotations]
    not_used: list[NotUsed] = []
    known = {kind: _known_slow(first, kind, far_apart) for kind in ("gyro", "acc")}
    rate_doubt = max(rate_uncertainty(recording) for recording in recordings)
    acc: SensorCalibration | None = None
    gyro: SensorCalibration | None = None
    try:
        acc = calibrate_acc(poses, range_m_s2=sensor_range(first, "acc"), slow_noise=known["acc"])
    except CalibrationError as error:
        not_used.append(NotUsed(say("accelerometers"), sum(len(one.acc_m_s2) for one in poses), error.what))
    gyro_bias, limit = None, sensor_range(first, "gyro")
    try:
        _refuse_unturned(first, turns)
        gyro = calibrate_gyro(poses, turns, range_rad_s=limit, slow_noise=known["gyro"])
        shared = math.hypot(_clock_doubt(captures), rate_doubt)  # by all turns
        gyro = replace(gyro, coefficients=gyro.coefficients.with_input_uncertainty(shared))
    except CalibrationError as error:
        if acc is None:
            raise
        not_used.append(NotUsed(say("gyro matrix"), sum(len(one.time_s) for one in turns), error.what))
        gyro_bias, left_out = gyro_bias_at_rest(poses, range_rad_s=limit, slow_noise=known["gyro"])
        not_used += left_out
    outside = sum(one.outside for one in captures)
    if outside:
        moving = say("the stand was moving to the next pose")
        not_used.append(NotUsed(say("between the segments"), outside, moving))
    found = [one for one in (acc, gyro) if one is not None]
    return Evaluation(
        recording_ids=tuple(recording.recording_id for recording in recordings),
        serial=str(first.unit.get("serial", "")),
        product=str(first.unit.get("product", "")),
        method="imu_calibration",
        acc=None if acc is None else acc.coefficients,
        gyro=None if gyro is None else gyro.coefficients,
        gyro_bias=gyro_bias,
        residuals=tuple(
            Residual(name, tuple(float(value) for value in values), one.coefficients.unit)
            for one in found
            for name, values in one.residuals.items()
        ),
        assumptions=_sentences(acc, gyro, captures, rate_doubt, far_apart),
        not_used=(*(note for one in found for note in one.not_used), *not_used),
    )


def _refuse_unturned(recording: Recording, turns: Sequence[Rotation]) -> None:
    """Where nothing else turns a body axis the Earth does, and that carries no column of a matrix."""
    most = np.abs([turn.rotation_body_rad for turn in turns]).max(axis=0) if turns else np.zeros(3)
    still = [axis for axis, angle in zip("xyz", most, strict=True) if angle < LEAST_TURN_RAD]
    if still:
        raise refused(
            recording,
            f"Nothing turns about body {', '.join(still)}: the Earth's rate alone carries no column of the "
            "gyros' matrix.",
            "record 'rotation' about all three axes, and name it together with 'multi_position'",
        )


def _sentences(
    acc: SensorCalibration | None,
    gyro: SensorCalibration | None,
    captures: Sequence[StandCaptures],
    rate_doubt: float,
    far_apart: bool,
) -> tuple[str, ...]:
    poses = sum(len(one.poses) for one in captures)
    turns = sum(len(one.rotations) for one in captures)
    sentences = [
        say("poses, turns and Earth rate in body axes as the stand's encoders give them"),
        say("{poses} rests and {turns} turns found in the stand's rates", poses=poses, turns=turns),
        say("how the unit sits on the stand is part of the misalignment, not of its uncertainty"),
    ]
    if gyro is not None:
        sentences += [
            say(
                "rate of the stand good to {part} (standard uncertainty, taken as stated)",
                part=f"{rate_doubt:g}",
            ),
            say("scale factors are those at the rate of the turns: turns of one size tell no linearity"),
            *_clock_sentences(captures),
            say("gyro noise: {words}", words=gyro.noise),
        ]
    if acc is not None:
        sentences.append(say("accelerometer noise: {words}", words=acc.noise))
    if far_apart:
        sentences.append(
            say("the unit may have been switched off between the recordings: their slow noise is independent")
        )
    return tuple(sentences)


def _clock_doubt(captures: Sequence[StandCaptures]) -> float:
    """Of the unit's clock while it turned, relative."""
    turned = [one.clock for one in captures if one.rotations]
    return max(CRYSTAL_DOUBT if one is None else one.standard_uncertainty for one in turned)


def _clock_sentences(captures: Sequence[StandCaptures]) -> list[str]:
    turned = [one.clock for one in captures if one.rotations]
    told = [
        say(
            "clocks joined by the trigger; the unit's runs {ppm} ± {doubt} ppm fast by the turns, taken out",
            ppm=f"{clock.rate * 1e6:.1f}",
            doubt=f"{clock.standard_uncertainty * 1e6:.2g}",
        )
        for clock in turned
        if clock is not None
    ]
    return told + [_crystal_sentence()] * (len(told) < len(turned))


def _crystal_sentence() -> str:
    return say(
        "the unit's crystal is taken as good to {ppm} ppm: as much of every scale factor of the gyros",
        ppm=f"{CRYSTAL_DOUBT * 1e6:g}",
    )


def _on_one_clock(recordings: Sequence[Recording]) -> tuple[list[StandCaptures], bool]:
    """Captures of all recordings on one clock; whether their slow noise is taken as independent."""
    captures = [stand_captures(recording) for recording in recordings]
    if len(recordings) == 1:
        return captures, False
    if between_runs(recordings).condition == "same_power_on":
        begins = [float(started_s(recording) or 0.0) for recording in recordings]
        return [one.later(begin - begins[0]) for one, begin in zip(captures, begins, strict=True)], False
    apart_s = INDEPENDENT_S if slow_noise(recordings[0], "gyro") else BETWEEN_S
    return [one.later(apart_s * number) for number, one in enumerate(captures)], True


def _known_slow(recording: Recording, kind: str, far_apart: bool) -> tuple[SlowNoise, ...]:
    """As stated; what differs from one power-on to the next lasts through a recording and ends with it."""
    return tuple(
        replace(term, correlation_time_s=POWER_ON_S)
        if far_apart and math.isinf(term.correlation_time_s)
        else term
        for term in slow_noise(recording, kind)
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

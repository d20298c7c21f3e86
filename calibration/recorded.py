"""From recordings to coefficients: which method their profiles and streams allow, and its result.

test.segments in the recording                → session on a stand (`imu_session`)
profiles multi_position and rotation, with a stand stream → the same, from the stand's rates and angles
profiles ferraris_x_p … ferraris_z_rot        → Ferraris session in parts
profile ferraris_session with sections.csv    → Ferraris session in one recording
accelerometer with rests in many attitudes    → multi-position, poses unknown
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.ferraris import (
    POSES,
    TURN_STANDARD_UNCERTAINTY_RAD,
    TURNS,
    HandRest,
    HandTurn,
    calibrate_ferraris,
)
from calibration.evaluation import Evaluation, Residual
from calibration.evaluations.by_profile import COMPANIONS, TOGETHER, has_method
from calibration.imu_session import NotUsed
from calibration.many_positions import evaluate_positions
from calibration.rest_segments import named_sections
from calibration.sensor_knowledge import axes, sensor_range
from calibration.site_gravity import gravity
from calibration.stand_captures import has_stand_truth
from calibration.stand_recordings import evaluate_stand_profiles, evaluate_stand_session
from protocol.errors import CalibrationError, Fault
from protocol.language import say
from protocol.recordings import Recording, Stream

__all__ = ["Source", "evaluate", "sensor_range", "together"]

FERRARIS_PREFIX = "ferraris_"
FERRARIS_PARTS = (*POSES, *TURNS)


@dataclass(frozen=True)
class Source:
    """A recording and the folder it came from (None: not from a folder)."""

    recording: Recording
    folder: Path | None = None

    @property
    def profile(self) -> str:
        """The recording's test profile."""
        return str(self.recording.test.get("profile", ""))


AnySource = TypeVar("AnySource", bound=Source)


def together(sources: Sequence[AnySource]) -> tuple[tuple[AnySource, ...], ...]:
    """Recordings that are evaluated together; others alone.

    These are the parts of one unit's Ferraris run, and one unit's runs of a profile in `TOGETHER` with
    their companions after them.
    """
    groups: dict[tuple[str, ...], list[AnySource]] = {}
    companions = {
        (companion, *_unit_key(source)): ("profile", source.profile, *_unit_key(source))
        for source in sources
        for companion in COMPANIONS.get(source.profile, ())
        if has_method(source.recording)
    }
    taken_along = [source for source in sources if (source.profile, *_unit_key(source)) in companions]
    others = [source for source in sources if (source.profile, *_unit_key(source)) not in companions]
    for index, source in enumerate(others):
        unit = source.recording.unit
        if source.profile in TOGETHER and has_method(source.recording):
            key = ("profile", source.profile, str(unit.get("product")), str(unit.get("serial")))
            groups.setdefault(key, []).append(source)
            continue
        if has_stand_truth(source.recording) and not source.recording.test.get("segments"):
            mount = str(source.recording.test.get("mount"))
            key = ("stand", mount, str(unit.get("product")), str(unit.get("serial")))
            groups.setdefault(key, []).append(source)
            continue
        if _ferraris_part(source) is None:
            groups[("alone", str(index))] = [source]
            continue
        test = source.recording.test
        key = (
            "parts",
            str(source.recording.unit.get("serial")),
            str(test.get("run")),
            str(test.get("mount")),
        )
        groups.setdefault(key, []).append(source)
    for source in taken_along:
        groups[companions[source.profile, *_unit_key(source)]].append(source)
    return tuple(tuple(group) for group in groups.values())


def _unit_key(source: Source) -> tuple[str, str]:
    unit = source.recording.unit
    return str(unit.get("product")), str(unit.get("serial"))


def evaluate(group: Sequence[Source]) -> Evaluation:
    """Coefficients from recordings that belong together.

    Raises:
        CalibrationError: no method applies, or the data cannot carry it: what is missing is named.
    """
    first = group[0]
    if _ferraris_part(first) is not None:
        return _ferraris_in_parts(group)
    if has_stand_truth(first.recording) and not first.recording.test.get("segments"):
        return evaluate_stand_profiles([source.recording for source in group])
    if len(group) != 1:
        raise _refused("These recordings do not belong to one evaluation.", group, "evaluate them one by one")
    if first.recording.test.get("segments"):
        return evaluate_stand_session(first.recording)
    if first.profile == "ferraris_session":
        return _ferraris_in_one(first)
    if not first.recording.stream("dut").has(*axes("acc")):
        raise _refused(
            "No calibration method applies: the recording has no accelerometer, no named segments and "
            "no parts of a Ferraris session.",
            group,
            "record acc_x, acc_y, acc_z in at least nine attitudes, or a session on a stand",
        )
    return evaluate_positions(
        first.recording,
        first.folder,
        gravity(first.recording),
        acc_range_m_s2=sensor_range(first.recording, "acc"),
    )


def _ferraris_part(source: Source) -> str | None:
    part = source.profile.removeprefix(FERRARIS_PREFIX)
    return part if source.profile.startswith(FERRARIS_PREFIX) and part in FERRARIS_PARTS else None


def _ferraris_in_parts(group: Sequence[Source]) -> Evaluation:
    rests: dict[str, HandRest] = {}
    turns: dict[str, HandTurn] = {}
    for source in group:
        part = str(_ferraris_part(source))
        if part in rests or part in turns:
            raise _refused(f"The part '{part}' is there twice.", group, "name the parts of one session only")
        stream = source.recording.stream("dut")
        _take_part(part, stream, 0, len(stream), rests, turns)
    return _ferraris(group, rests, turns, ())


def _ferraris_in_one(source: Source) -> Evaluation:
    sections = named_sections(source.recording, source.folder)
    if sections is None:
        raise _refused(
            "Nothing says which part of this Ferraris session is which.",
            [source],
            "put sections.csv (section,start_s,end_s with x_p … z_rot) beside the recording",
        )
    rests: dict[str, HandRest] = {}
    turns: dict[str, HandTurn] = {}
    stream = source.recording.stream("dut")
    outside = len(stream)
    for segment in sections.segments:
        if segment.name in FERRARIS_PARTS:
            _take_part(segment.name, stream, segment.first, segment.last, rests, turns)
            outside -= segment.last - segment.first
    not_used = (NotUsed(say("between the sections"), outside, say("handling, in no named section")),)
    return _ferraris([source], rests, turns, not_used)


def _take_part(
    part: str, stream: Stream, first: int, last: int, rests: dict[str, HandRest], turns: dict[str, HandTurn]
) -> None:
    rows = slice(first, last)
    time_s, gyro = stream.time_s()[rows], stream.si(*axes("gyro"))[rows]
    if part in POSES:
        rests[part] = HandRest(time_s, stream.si(*axes("acc"))[rows], gyro)
    else:
        turns[part] = HandTurn(time_s, gyro)


def _ferraris(
    group: Sequence[Source],
    rests: Mapping[str, HandRest],
    turns: Mapping[str, HandTurn],
    not_used: tuple[NotUsed, ...],
) -> Evaluation:
    recording = group[0].recording
    local = gravity(recording)
    found = calibrate_ferraris(
        rests,
        turns,
        local.magnitude_m_s2,
        gyro_range_rad_s=sensor_range(recording, "gyro"),
        acc_range_m_s2=sensor_range(recording, "acc"),
    )
    directions = ", ".join(f"{name[0]} {count * 360:+d}°" for name, count in found.turns.items())
    assumptions = (
        local.sentence,
        say("body axes: faces of the housing as it stood on the surface"),
        say(
            "poses by hand, aligned to {angle}° (standard deviation, estimated from the poses)",
            angle=f"{math.degrees(found.alignment_rad):.2f}",
        ),
        say(
            "turns {turns} by the gyro's own sign; angle of a turn by hand taken as good to {angle}° "
            "(standard uncertainty, stated)",
            turns=directions,
            angle=f"{math.degrees(TURN_STANDARD_UNCERTAINTY_RAD):.1f}",
        ),
        say("Earth rate is not known in body axes: it is part of the gyro bias's uncertainty"),
    )
    residuals = [
        *_residuals(
            found.acc_observations.run_names, found.acc_observations.run, found.acc.residuals, "m/s^2"
        ),
        *_residuals(
            found.gyro_observations.run_names, found.gyro_observations.run, found.gyro.residuals, "rad/s"
        ),
    ]
    return Evaluation(
        recording_ids=tuple(source.recording.recording_id for source in group),
        serial=str(recording.unit.get("serial", "")),
        product=str(recording.unit.get("product", "")),
        method="ferraris",
        acc=found.acc.coefficients.with_input_uncertainty(local.relative_uncertainty),
        gyro=found.gyro.coefficients,
        gyro_bias=None,
        residuals=tuple(residuals),
        assumptions=assumptions,
        not_used=(*found.not_used, *not_used),
    )


def _residuals(names: Sequence[str], run: Any, values: FloatArray, unit: str) -> list[Residual]:
    means = [values[run == index].mean(axis=0) for index in range(len(names))]
    return [
        Residual(name, tuple(float(v) for v in mean), unit) for name, mean in zip(names, means, strict=True)
    ]


def _refused(what: str, group: Sequence[Source], remedy: str) -> CalibrationError:
    names = ", ".join(source.recording.recording_id for source in group)
    return CalibrationError(what, where=f"recording {names}", fault=Fault.DATA, remedy=remedy + ".")

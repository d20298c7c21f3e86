"""Recordings of an overload rig, cut into half-cycles: pulses of accelerometer and gyros in each of them."""

# pyright: strict
from dataclasses import dataclass
from typing import cast

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.overload_motion import OverloadMotion, half_cycles_from_grating
from calibration.algorithms.pulse_timing import PulseCounters, SlideMotion
from calibration.evaluations.method_evaluation import (
    believed_number,
    believed_sensor,
    refuse_unjoined,
    refused,
    stream_with,
)
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

COUNT_MARGIN = 2
"""Readings that must lie on either side of a cut."""


@dataclass(frozen=True)
class CutRun:
    """One recording, cut into half-cycles.

    Attributes:
        recording: along one body axis.
        axis: 0, 1, 2.
        motion: of the slide.
        acc_pulses: of the accelerometer along the stroke, net, shape (m, 2).
        gyro_pulses: of the gyros, net, shape (m, 2, 3); None: none were recorded.
    """

    recording: Recording
    axis: int
    motion: OverloadMotion
    acc_pulses: FloatArray
    gyro_pulses: FloatArray | None


def cut_into_halves(recording: Recording) -> CutRun:
    refuse_unjoined(recording)
    axis = _axis(recording)
    stand = stream_with(recording, "stand", "position")
    acc = _net_counts(recording, "acc", ("xyz"[axis],))
    time_s = recording.stream("dut").time_s()
    _refuse_saturated(recording, axis, acc[:, 0], time_s)
    stand_s, position_m = stand.time_s(), stand.si("position")
    # cuts shall lie where counters were read on either side
    period_s = float(np.median(np.diff(time_s))) * COUNT_MARGIN
    seen = (stand_s >= time_s[0] + period_s) & (stand_s <= time_s[-1] - period_s)
    motion = half_cycles_from_grating(stand_s[seen], position_m[seen])
    has_gyros = recording.stream("dut").has(*(f"pulse_gyro_{a}_{s}" for a in "xyz" for s in ("pos", "neg")))
    gyro = _net_counts(recording, "gyro", ("x", "y", "z")) if has_gyros else None

    def halves(counts: FloatArray) -> FloatArray:
        at_cuts = _cubic(motion.cut_s, time_s, counts)
        return np.diff(at_cuts, axis=0).reshape(-1, 2, counts.shape[1])

    gyro_pulses = None if gyro is None else halves(gyro)
    return CutRun(recording, axis, motion, halves(acc)[:, :, 0], gyro_pulses)


def _axis(recording: Recording) -> int:
    """Index of the body axis along the stroke: as the profile says."""
    values = recording.test.get("values")
    stated = cast(dict[str, object], values).get("axis") if isinstance(values, dict) else None
    if isinstance(stated, int | float) and stated in (1, 2, 3):
        return int(stated) - 1
    raise refused(
        recording,
        "The recording does not say which body axis lies along the stroke.",
        "write test.values.axis (1 x, 2 y, 3 z) into recording.json",
    )


def _net_counts(recording: Recording, kind: str, letters: tuple[str, ...]) -> FloatArray:
    """Positive less negative pulses from the start on, shape (n, axes)."""
    return np.stack([np.subtract(*_running_counts(recording, kind, letter)) for letter in letters], axis=1)


def _running_counts(recording: Recording, kind: str, letter: str) -> tuple[FloatArray, FloatArray]:
    """Positive and negative pulses of a sensor from the start on, shapes (n,)."""
    columns = (f"pulse_{kind}_{letter}_pos", f"pulse_{kind}_{letter}_neg")
    dut = stream_with(recording, "dut", *columns)
    pulses = np.stack([dut.si(column) for column in columns])
    missing = int((~np.isfinite(pulses)).any(axis=0).sum())
    steps = np.diff(dut.time_s())
    holes = int((steps > 1.5 * float(np.median(steps))).sum()) if len(steps) else 0
    if missing or holes or pulses.shape[1] < 4:
        raise refused(
            recording,
            f"{missing} samples of pulses are missing and {holes} holes are in their times: what was counted "
            "there is lost.",
            "record again without a break",
            "stream dut",
        )
    if (pulses < 0).any():
        raise refused(
            recording,
            f"{int((pulses < 0).any(axis=0).sum())} samples of {kind} {letter} hold fewer than no pulses.",
            "record what each counter gained since the sample before, positive and negative apart",
            "stream dut",
        )
    positive, negative = np.cumsum(pulses, axis=1)
    return positive, negative


def gyro_counters(run: CutRun, letter: str) -> tuple[PulseCounters, SlideMotion]:
    """One gyro's counters inside the half-cycles, and the slide's motion at their readings."""
    dut = run.recording.stream("dut")
    time_s, cuts_s = dut.time_s(), run.motion.cut_s
    inside = (time_s >= cuts_s[0]) & (time_s <= cuts_s[-1])
    positive, negative = (counts[inside] for counts in _running_counts(run.recording, "gyro", letter))
    read_s = time_s[inside]
    period_s = float((read_s[-1] - read_s[0]) / (len(read_s) - 1))
    cycle = np.searchsorted(cuts_s[::2], read_s, side="right")
    position, speed, acceleration = run.motion.slide(
        read_s[0] + 0.5 * period_s * np.arange(2 * len(read_s) - 1)
    )
    half_m = run.motion.amplitude_m
    return (
        PulseCounters(period_s, positive, negative, cycle),
        SlideMotion(acceleration, speed, position / half_m, half_m),
    )


def _refuse_saturated(recording: Recording, axis: int, counts: FloatArray, time_s: FloatArray) -> None:
    limit, scale = (believed_number(recording, "acc", key) for key in ("range", "pulses_per_unit_s"))
    if limit is None or scale is None:
        return
    most = float(np.abs(np.diff(counts)).max()) - 1.0  # one pulse more or less is counting
    reached = most / float(np.median(np.diff(time_s))) / scale
    if reached >= limit * 0.998:
        raise refused(
            recording,
            f"The accelerometer {'xyz'[axis]} is at the end of its range ({limit:g}).",
            "record with less overload",
        )


def _cubic(at_s: FloatArray, time_s: FloatArray, counts: FloatArray) -> FloatArray:
    """Counts between readings by the cubic through the four around, shape (k, axes).

    A straight line cuts the corner where the count turns, by j dt^2 / 12 a cut and always the same way.
    """
    step = np.searchsorted(time_s, at_s, side="right") - 1
    first = np.clip(step - 1, 0, len(time_s) - 4)[:, None] + np.arange(4)
    nodes = time_s[first]
    weights = np.ones((len(at_s), 4))
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= (at_s - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return np.einsum("ki,kia->ka", weights, counts[first])


def pulses_per_si(recording: Recording, kind: str) -> float:
    """Nominal pulses per (m/s) or rad."""
    scale = believed_number(recording, kind, "pulses_per_unit_s")
    unit = believed_sensor(recording, kind).get("unit")
    if scale is None or scale <= 0.0 or not isinstance(unit, str):
        raise refused(
            recording,
            f"The recording does not say what a pulse of the {kind} stands for.",
            f"write believed.{kind}.unit and .pulses_per_unit_s into recording.json",
        )
    return scale / factor_to_si(unit)

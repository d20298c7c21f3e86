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
    refuse_backward_time,
    refuse_unjoined,
    refused,
    stream_with,
)
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

COUNT_MARGIN = 2
"""Readings that must lie on either side of a cut."""
MAX_LATE_PERIODS = 3.0
"""Periods of reading that grating and counters may be apart: more are clocks that are not joined."""
JUMP_SIGMAS, JUMP_PULSES = 12.0, 8.0
"""A half-cycle's pulses are off beyond so many robust standard deviations, and pulses."""


@dataclass(frozen=True)
class CutRun:
    """One recording, cut into half-cycles.

    Attributes:
        recording: along one body axis.
        axis: 0, 1, 2.
        motion: of the slide.
        acc_pulses: of the accelerometer along the stroke, net, shape (m, 2).
        gyro_pulses: of the gyros, net, shape (m, 2, 3); None: none were recorded.
        counted_late_s: how much later than the grating the counters were read, by the accelerometer.
    """

    recording: Recording
    axis: int
    motion: OverloadMotion
    acc_pulses: FloatArray
    gyro_pulses: FloatArray | None
    counted_late_s: float


def cut_into_halves(recording: Recording) -> CutRun:
    refuse_unjoined(recording)
    axis = _axis(recording)
    refuse_backward_time(recording, stream_with(recording, "dut"))
    stand = stream_with(recording, "stand", "position")
    acc = _net_counts(recording, "acc", ("xyz"[axis],))
    time_s = recording.stream("dut").time_s()
    _refuse_saturated(recording, axis, acc[:, 0], time_s)
    stand_s, position_m = stand.time_s(), stand.si("position")
    # cuts shall lie where counters were read on either side
    period_s = float(np.median(np.diff(time_s))) * COUNT_MARGIN
    seen = (stand_s >= time_s[0] + period_s) & (stand_s <= time_s[-1] - period_s)
    motion = half_cycles_from_grating(stand_s[seen], position_m[seen])
    late_s = _counted_late_s(recording, motion, acc[:, 0], time_s)
    time_s = time_s - late_s
    has_gyros = recording.stream("dut").has(*(f"pulse_gyro_{a}_{s}" for a in "xyz" for s in ("pos", "neg")))
    gyro = _net_counts(recording, "gyro", ("x", "y", "z")) if has_gyros else None

    def halves(counts: FloatArray) -> FloatArray:
        at_cuts = _cubic(motion.cut_s, time_s, counts)
        return np.diff(at_cuts, axis=0).reshape(-1, 2, counts.shape[1])

    gyro_pulses = None if gyro is None else halves(gyro)
    acc_pulses = halves(acc)[:, :, 0]
    _refuse_jumps(recording, f"accelerometer {'xyz'[axis]}", acc_pulses)
    if gyro_pulses is not None:
        for i, letter in enumerate("xyz"):
            _refuse_jumps(recording, f"gyro {letter}", gyro_pulses[:, :, i])
    return CutRun(recording, axis, motion, acc_pulses, gyro_pulses, late_s)


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
    odd = (pulses < 0) | (pulses != np.rint(pulses))
    level = bool(((np.diff(pulses, axis=1) >= 0).all(axis=1) & (np.ptp(pulses, axis=1) > 1)).any())
    if odd.any() or level:
        raise refused(
            recording,
            f"{int(odd.any(axis=0).sum())} samples of {kind} {letter} are no whole numbers of pulses."
            if not level
            else f"The pulses of {kind} {letter} only ever grow: they are a counter's level.",
            "record what each counter gained since the sample before, positive and negative apart",
            "stream dut",
        )
    positive, negative = np.cumsum(pulses, axis=1)
    return positive, negative


def gyro_counters(run: CutRun, letter: str) -> tuple[PulseCounters, SlideMotion]:
    """One gyro's counters inside the half-cycles, and the slide's motion at their readings."""
    dut = run.recording.stream("dut")
    time_s, cuts_s = dut.time_s() - run.counted_late_s, run.motion.cut_s
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


def _counted_late_s(
    recording: Recording, motion: OverloadMotion, counts: FloatArray, time_s: FloatArray
) -> float:
    """How much later than the grating the accelerometer's counter was read, s.

    The counted speed is K (c + w t + v(t - late)), so its part along the acceleration tells -K late.

    Raises:
        CalibrationError: so late that the clocks are not joined.
    """
    _, speed, acceleration = motion.slide(time_s)
    basis = np.column_stack([np.ones_like(time_s), time_s - time_s[0], speed, acceleration])
    size = np.abs(basis).max(axis=0)
    solved = np.asarray(np.linalg.lstsq(basis / size, counts, rcond=None)[0], dtype=np.float64)
    terms = solved / size
    late_s = -float(terms[3] / terms[2]) if terms[2] != 0.0 else 0.0
    bound_s = MAX_LATE_PERIODS * float(np.median(np.diff(time_s)))
    if not abs(late_s) <= bound_s:
        raise refused(
            recording,
            f"The accelerometer follows the grating by {late_s * 1e3:.3g} ms, more than {bound_s * 1e3:.3g}: "
            "their clocks are not joined, or the pulses are of another axis.",
            "see that one trigger starts both clocks, and which axis lies along the stroke",
        )
    return late_s


def _refuse_jumps(recording: Recording, sensor: str, pulses: FloatArray) -> None:
    """A half-cycle whose pulses are far from those of the other cycles was not counted right."""
    away = np.abs(pulses - np.median(pulses, axis=0))
    usual = np.maximum(JUMP_SIGMAS * 1.4826 * np.median(away, axis=0), JUMP_PULSES)
    jumps = np.argwhere(away > usual)
    if len(jumps):
        cycle, half = (int(index) for index in jumps[0])
        raise refused(
            recording,
            f"{len(jumps)} half-cycles of {sensor} hold pulses unlike those of other cycles, the first in "
            f"cycle {cycle + 1}: {pulses[cycle, half]:.0f} instead of {np.median(pulses[:, half]):.0f}.",
            "look for disturbances on the pulse lines and for lost readings",
            "stream dut",
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

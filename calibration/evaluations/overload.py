"""Profile 'overload': K_a, K_2 of an accelerometer and the gyros' D from a sinusoidal overload rig (paper 5).

One recording moves along one body axis: it tells that axis' K_a and K_2, and one column of D. Recordings
along all three, evaluated together, tell the whole of D with its common uncertainties.
"""

# pyright: strict
import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.overload_g_sensitivity import GyroRun, calibrate_g_sensitivity, response_of_run
from calibration.algorithms.overload_motion import OverloadMotion, half_cycles_from_grating
from calibration.algorithms.screening import NotUsed
from calibration.algorithms.sinusoidal_overload import KnownAccelerometer, OverloadResult, calibrate_overload
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_linear,
    believed_number,
    believed_sensor,
    method_evaluation,
    refuse_unjoined,
    refused,
    stream_with,
)
from calibration.records.making import RecordContent
from calibration.records.method_contents import G_SENSITIVITY_UNIT, g_sensitivity_content, overload_content
from calibration.records.record_parts import CalibratedQuantity, Model
from protocol.language import say
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si

U_SCALE_FACTOR = 5e-5
"""Relative, of the scale factors known beforehand: 3 degC at 15 ppm/degC."""
U_LEVEL_RAD = 2e-4
"""Of the stroke against the level and of the unit on the slide: what gravity adds along the axis."""
U_BIAS_G = 2e-5
U_EVEN_QUADRATIC_S2_M = 3e-7
"""3 ug/g^2: the even quadratic term is not known beforehand and taken as zero."""
U_GRATING = 1e-5
COUNT_MARGIN = 2
"""Readings that must lie on either side of a cut."""


@dataclass(frozen=True)
class _Run:
    """One recording, cut into half-cycles."""

    recording: Recording
    axis: int
    motion: OverloadMotion
    acc_pulses: FloatArray
    gyro_pulses: FloatArray | None


def evaluate_overload(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """K_a and K_2 of each axis that was moved along; D of the gyros, or its columns.

    Raises:
        CalibrationError: no grating or pulses, clocks that no trigger joins, nothing known of scale factor
            and bias, a motion that is not steady, too few cycles, a saturated accelerometer.
    """
    runs = [_cut(recording) for recording in recordings]
    results: list[SensorResult] = []
    for run in runs:
        known = _known(run)
        amplitude = run.motion.amplitude_m
        found = calibrate_overload(run.motion.half_cycles, run.acc_pulses, known, amplitude)
        sensor = f"acc_{'xyz'[run.axis]}"
        results.append(SensorResult(sensor, overload_content(found), (run.recording,), _beside(found)))
    of_gyros, not_used = _g_sensitivity([run for run in runs if run.gyro_pulses is not None])
    results += of_gyros
    uncertainties = say(
        "scale factors and bias as the recording states them (standard uncertainties taken as {scale} and "
        "{bias} µg), even quadratic term 0 ± {even} µg/g², stroke level to {level} mrad",
        scale=f"{U_SCALE_FACTOR:g}",
        bias=f"{U_BIAS_G * 1e6:g}",
        even=f"{U_EVEN_QUADRATIC_S2_M * factor_to_si('g') * 1e6:.1f}",
        level=f"{U_LEVEL_RAD * 1e3:g}",
    )
    motion = say("half-cycles from the grating, cut where the acceleration changes its sign")
    counting = say(
        "counting errors taken as independent from cycle to cycle: pulses in step with the cycles err more"
    )
    return method_evaluation(recordings, results, [motion, uncertainties, counting], not_used)


def _cut(recording: Recording) -> _Run:
    refuse_unjoined(recording)
    axis = _axis(recording)
    stand = stream_with(recording, "stand", "position")
    acc = _running_counts(recording, "acc", ("xyz"[axis],))
    time_s = recording.stream("dut").time_s()
    _refuse_saturated(recording, axis, acc[:, 0], time_s)
    stand_s, position_m = stand.time_s(), stand.si("position")
    # cuts shall lie where counters were read on either side
    period_s = float(np.median(np.diff(time_s))) * COUNT_MARGIN
    seen = (stand_s >= time_s[0] + period_s) & (stand_s <= time_s[-1] - period_s)
    motion = half_cycles_from_grating(stand_s[seen], position_m[seen])
    has_gyros = recording.stream("dut").has(*(f"pulse_gyro_{a}_{s}" for a in "xyz" for s in ("pos", "neg")))
    gyro = _running_counts(recording, "gyro", ("x", "y", "z")) if has_gyros else None

    def halves(counts: FloatArray) -> FloatArray:
        at_cuts = _cubic(motion.cut_s, time_s, counts)
        return np.diff(at_cuts, axis=0).reshape(-1, 2, counts.shape[1])

    gyro_pulses = None if gyro is None else halves(gyro)
    return _Run(recording, axis, motion, halves(acc)[:, :, 0], gyro_pulses)


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


def _running_counts(recording: Recording, kind: str, letters: tuple[str, ...]) -> FloatArray:
    """Positive less negative pulses from the start on, shape (n, axes)."""
    columns = [(f"pulse_{kind}_{letter}_pos", f"pulse_{kind}_{letter}_neg") for letter in letters]
    dut = stream_with(recording, "dut", *(name for pair in columns for name in pair))
    net = np.stack([dut.si(positive) - dut.si(negative) for positive, negative in columns], axis=1)
    missing = int((~np.isfinite(net)).any(axis=1).sum())
    steps = np.diff(dut.time_s())
    holes = int((steps > 1.5 * float(np.median(steps))).sum()) if len(steps) else 0
    if missing or holes or len(net) < 4:
        raise refused(
            recording,
            f"{missing} samples of pulses are missing and {holes} holes are in their times: what was counted "
            "there is lost.",
            "record again without a break",
            "stream dut",
        )
    return np.cumsum(net, axis=0)


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


def _known(run: _Run) -> KnownAccelerometer:
    """K_1 and K_0 of the axis: as believed, with what gravity adds across and along it."""
    recording, axis = run.recording, run.axis
    matrix, bias = believed_linear(recording, "acc")
    unit_si = factor_to_si(str(believed_sensor(recording, "acc").get("unit", "")))
    scale = _pulses_per_si(recording, "acc")
    gravity = _mean_force_m_s2(run)
    own = float(matrix[axis, axis])
    if own <= 0.0:
        raise refused(
            recording,
            f"The recording states no scale factor above zero for the accelerometer {'xyz'[axis]}.",
            "see whether the accelerometer answers at all, and calibrate its scale factor first",
        )
    k_0 = (float(bias[axis]) * unit_si + float(matrix[axis] @ gravity)) / own
    u_k_0 = math.hypot(U_BIAS_G * factor_to_si("g"), U_LEVEL_RAD * float(np.linalg.norm(gravity)))
    return KnownAccelerometer(
        scale_factor_pulse_s_m=scale * own,
        bias_m_s2=k_0,
        u_scale_factor=U_SCALE_FACTOR,
        u_bias_m_s2=u_k_0,
        u_grating=math.hypot(U_GRATING, run.motion.relative_uncertainty),
        u_even_quadratic_s2_m=U_EVEN_QUADRATIC_S2_M,
    )


def _pulses_per_si(recording: Recording, kind: str) -> float:
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


def _mean_force_m_s2(run: _Run) -> FloatArray:
    """Gravity in body axes: the mean of the stand's force over whole cycles, in which motion adds nothing."""
    names = ("acc_x", "acc_y", "acc_z")
    stand = stream_with(run.recording, "stand", *names)
    time_s = stand.time_s()
    inside = (time_s >= run.motion.cut_s[0]) & (time_s <= run.motion.cut_s[-1])
    mean = stand.si(*names)[inside].mean(axis=0)
    mean[run.axis] = 0.0 if abs(mean[run.axis]) < 0.1 else mean[run.axis]
    return mean


def _beside(found: OverloadResult) -> tuple[Beside, ...]:
    return (
        Beside(say("K_a as paper 5 prints it, eq (9)"), found.printed[0], "1"),
        Beside(say("K_2 as paper 5 prints it, eq (11)"), found.printed[1], "1/(m/s^2)"),
        Beside(say("ratio of the halves' squares: 1 for a sinusoid"), found.half_ratio, "1"),
        Beside(say("cycles"), float(found.cycles), "1"),
    )


def _g_sensitivity(runs: list[_Run]) -> tuple[list[SensorResult], list[NotUsed]]:
    """All of D from three directions, else a column from each run; gyros that do not answer left out."""
    if not runs:
        return [], []
    scales = [_gyro_scales(run.recording) for run in runs]
    dead = [letter for letter, scale in zip("xyz", scales[0], strict=True) if math.isnan(scale)]
    why = say("the recording states no scale factor above zero for it")
    not_used = [
        NotUsed(say("pulses of gyro {axis}", axis=letter), len(runs[0].recording.stream("dut")), why)
        for letter in dead
    ]
    of_gyros = [
        GyroRun(np.eye(3)[run.axis], run.motion.half_cycles, run.gyro_pulses)
        for run in runs
        if run.gyro_pulses is not None
    ]
    if {run.axis for run in runs} == {0, 1, 2} and not dead:
        found = calibrate_g_sensitivity(of_gyros, scales[0], U_SCALE_FACTOR, U_GRATING)
        return [SensorResult("gyro", g_sensitivity_content(found), tuple(run.recording for run in runs))], []
    if len(dead) == len(scales[0]):
        return [], not_used
    columns = [
        SensorResult("gyro", _column(run.axis, gyros, scale), (run.recording,))
        for run, gyros, scale in zip(runs, of_gyros, scales, strict=True)
    ]
    return columns, not_used


def _gyro_scales(recording: Recording) -> FloatArray:
    """E_1 of the gyros, pulses per rad, shape (3,); NaN for one that does not answer."""
    matrix, _ = believed_linear(recording, "gyro")
    scales = _pulses_per_si(recording, "gyro") * np.diag(matrix)
    return np.where(scales > 0.0, scales, np.nan)


def _column(axis: int, run: GyroRun, scale: FloatArray) -> RecordContent:
    """The three gyros' response to one axis."""
    found = response_of_run(run, scale)
    common = math.hypot(U_SCALE_FACTOR, U_GRATING)
    letter = "xyz"[axis]
    return RecordContent(
        method="sinusoidal_overload",
        model=Model(name="g_sensitivity", equation="bias = bias_0 + D f"),
        quantities=tuple(
            CalibratedQuantity(
                name=f"g_sensitivity_{'xyz'[i]}{letter}",
                symbol=f"D_{i + 1}{letter}",
                value=float(found.response[i]),
                unit=G_SENSITIVITY_UNIT,
                standard_uncertainty=math.hypot(
                    math.sqrt(float(found.variance[i])), common * float(found.response[i])
                ),
            )
            for i in np.flatnonzero(np.isfinite(scale)).tolist()
        ),
    )

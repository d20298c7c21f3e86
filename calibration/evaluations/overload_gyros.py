"""The gyros' part of an overload recording: their response to acceleration, D, by columns or whole.

Pulses of a slow gyro are few in a half-cycle, so D comes from when they came (`pulse_timing`). Where too few
came for that it comes from their sums, whose error is as that of a single cycle unless noise moves it.
"""

# pyright: strict
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.overload_g_sensitivity import GyroRun, RunResponse, combine_runs, response_of_run
from calibration.algorithms.pulse_timing import response_by_pulse_times
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import SensorResult, believed_linear
from calibration.evaluations.overload_halves import CutRun, gyro_counters, pulses_per_si
from calibration.records.making import RecordContent
from calibration.records.method_contents import G_SENSITIVITY_UNIT, g_sensitivity_content
from calibration.records.record_parts import CalibratedQuantity, Model
from protocol.language import say
from protocol.recordings import Recording

U_SCALE_FACTOR = 5e-5
"""Relative, of the scale factors known beforehand: 3 degC at 15 ppm/degC."""
U_GRATING = 1e-5
READ_TOGETHER = 0.5
"""Of a counter's reading period: grating and counters are read within this of each other (a bound)."""


def g_sensitivity(runs: Sequence[CutRun]) -> tuple[list[SensorResult], list[NotUsed]]:
    """All of D from three directions, else a column from each run; gyros that do not answer left out."""
    runs = [run for run in runs if run.gyro_pulses is not None]
    if not runs:
        return [], []
    scales = [_scales(run.recording) for run in runs]
    silent = [
        letter
        for i, letter in enumerate("xyz")
        if any(run.gyro_pulses is not None and not run.gyro_pulses[..., i].any() for run in runs)
    ]
    unstated = [letter for i, letter in enumerate("xyz") if any(math.isnan(scale[i]) for scale in scales)]
    count = len(runs[0].recording.stream("dut"))
    not_used = [
        NotUsed(say("pulses of gyro {axis}", axis=letter), count, why)
        for letters, why in (
            (unstated, say("the recording states no scale factor above zero for it")),
            ([one for one in silent if one not in unstated], say("not one pulse came: it does not answer")),
        )
        for letter in letters
    ]
    answering = np.array([letter not in silent and letter not in unstated for letter in "xyz"])
    if not answering.any():
        return [], not_used
    by_sums: set[str] = set()
    found = [_response(run, scale, answering, by_sums) for run, scale in zip(runs, scales, strict=True)]
    if by_sums:
        why = say(
            "too few or too scattered to tell by: taken as sums over half-cycles, with their larger error"
        )
        instants = say("instants of the pulses of gyros {axes}", axes=", ".join(sorted(by_sums)))
        not_used.append(NotUsed(instants, count, why))
    if {run.axis for run in runs} == {0, 1, 2} and answering.all():
        directions = np.eye(3)[[run.axis for run in runs]]
        whole = combine_runs(directions, found, U_SCALE_FACTOR, U_GRATING)
        recordings = tuple(run.recording for run in runs)
        return [SensorResult("gyro", g_sensitivity_content(whole), recordings)], not_used
    columns = [
        SensorResult("gyro", _column(run.axis, one, answering), (run.recording,))
        for run, one in zip(runs, found, strict=True)
    ]
    return columns, not_used


def _scales(recording: Recording) -> FloatArray:
    """E_1 of the gyros, pulses per rad, shape (3,); NaN for one that does not answer."""
    matrix, _ = believed_linear(recording, "gyro")
    scales = pulses_per_si(recording, "gyro") * np.diag(matrix)
    return np.where(scales > 0.0, scales, np.nan)


def _response(run: CutRun, scale: FloatArray, answering: NDArray[np.bool_], by_sums: set[str]) -> RunResponse:
    """Of the gyros that answer, by their pulses' instants; by sums of those that are put into `by_sums`."""
    assert run.gyro_pulses is not None
    sums = response_of_run(
        GyroRun(np.eye(3)[run.axis], run.motion.half_cycles, run.gyro_pulses), np.where(answering, scale, 1.0)
    )
    response, variance, rate = sums.response.copy(), sums.variance.copy(), sums.rate_rad_s.copy()
    for i in np.flatnonzero(answering).tolist():
        counters, motion = gyro_counters(run, "xyz"[i])
        timed = response_by_pulse_times(counters, motion)
        if timed is None:
            by_sums.add("xyz"[i])
            continue
        apart_s = READ_TOGETHER * counters.period_s / math.sqrt(3.0)
        response[i] = timed.response_pulse_s_m / scale[i]
        variance[i] = (timed.response_variance + (timed.response_per_delay * apart_s) ** 2) / scale[i] ** 2
        rate[i] = timed.rate_pulse_s / scale[i]
    return RunResponse(response, variance, rate, sums.printed)


def _column(axis: int, found: RunResponse, answering: NDArray[np.bool_]) -> RecordContent:
    """The three gyros' response to one axis."""
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
            for i in np.flatnonzero(answering).tolist()
        ),
    )

"""Profile 'overload': K_a, K_2 of an accelerometer and the gyros' D from a sinusoidal overload rig (paper 5).

One recording moves along one body axis: it tells that axis' K_a and K_2, and one column of D. Recordings
along all three, evaluated together, tell the whole of D with its common uncertainties.
"""

# pyright: strict
import math

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.sinusoidal_overload import KnownAccelerometer, OverloadResult, calibrate_overload
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_linear,
    believed_sensor,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.evaluations.overload_gyros import READ_TOGETHER, U_GRATING, U_SCALE_FACTOR, g_sensitivity
from calibration.evaluations.overload_halves import CutRun, cut_into_halves, pulses_per_si
from calibration.records.method_contents import overload_content
from protocol.language import say
from protocol.recordings import Recording
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2, factor_to_si

U_LEVEL_RAD = 1e-4
"""Of the stroke against the level and of the unit on the slide: what gravity adds along the axis."""
U_BIAS_G = 4e-5
U_EVEN_QUADRATIC_S2_M = 3e-7
"""3 ug/g^2: the even quadratic term is not known beforehand and taken as zero."""
MIN_FORCES = 10
GRAVITY_TOLERANCE = 0.01


def evaluate_overload(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """K_a and K_2 of each axis that was moved along; D of the gyros, or its columns.

    Raises:
        CalibrationError: no grating or pulses, clocks that no trigger joins, nothing known of scale factor
            and bias, a motion that is not steady, too few cycles, a saturated accelerometer.
    """
    runs = [cut_into_halves(recording) for recording in recordings]
    results: list[SensorResult] = []
    for run in runs:
        known = _known(run)
        amplitude = run.motion.amplitude_m
        found = calibrate_overload(run.motion.half_cycles, run.acc_pulses, known, amplitude)
        sensor = f"acc_{'xyz'[run.axis]}"
        results.append(SensorResult(sensor, overload_content(found), (run.recording,), _beside(found)))
    of_gyros, not_used = g_sensitivity(runs)
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
    assumptions = [motion, uncertainties]
    if of_gyros:
        assumptions.append(
            say(
                "D from the instants of the gyros' pulses; grating and counters read within {part} of a "
                "reading's period of each other",
                part=f"{READ_TOGETHER:g}",
            )
        )
    return method_evaluation(recordings, results, assumptions, not_used)


def _known(run: CutRun) -> KnownAccelerometer:
    """K_1 and K_0 of the axis: as believed, with what gravity adds across and along it."""
    recording, axis = run.recording, run.axis
    matrix, bias = believed_linear(recording, "acc")
    unit_si = factor_to_si(str(believed_sensor(recording, "acc").get("unit", "")))
    scale = pulses_per_si(recording, "acc")
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


def _mean_force_m_s2(run: CutRun) -> FloatArray:
    """Gravity in body axes: what the stand's force has beside the slide's acceleration, by medians."""
    names = ("acc_x", "acc_y", "acc_z")
    stand = stream_with(run.recording, "stand", *names)
    time_s = stand.time_s()
    force = stand.si(*names)
    known = np.isfinite(force).all(axis=1) & np.isfinite(time_s)
    if known.sum() < MIN_FORCES:
        raise refused(
            run.recording, "The stand's force is missing.", "record acc_x, acc_y, acc_z", "stream stand"
        )
    beside = force[known]
    beside[:, run.axis] -= run.motion.slide(time_s[known])[2]
    gravity = np.median(beside, axis=0)
    if abs(float(np.linalg.norm(gravity)) / STANDARD_GRAVITY_M_S2 - 1.0) > GRAVITY_TOLERANCE:
        raise refused(
            run.recording,
            f"The stand's force less the slide's acceleration is {float(np.linalg.norm(gravity)):.4g} m/s^2: "
            "no gravity.",
            "see that the stand's force is specific force in body axes, and its unit",
            "stream stand",
        )
    return gravity


def _beside(found: OverloadResult) -> tuple[Beside, ...]:
    return (
        Beside(say("K_a as paper 5 prints it, eq (9)"), found.printed[0], "1"),
        Beside(say("K_2 as paper 5 prints it, eq (11)"), found.printed[1], "1/(m/s^2)"),
        Beside(say("ratio of the halves' squares: 1 for a sinusoid"), found.half_ratio, "1"),
        Beside(say("cycles"), float(found.cycles), "1"),
    )

"""Profile 'swing': a unit's lag behind the stand, and the error of its attitude without it (paper 2, 4.1).

The unit's own attitude is evaluated where it sends one; what its gyros make of the swing is evaluated beside
it, or alone. Without a common trigger only the sum of the lag and the clocks' offset is told.
"""

# pyright: strict
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.attitude_angles import angle_about_rad
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.flight_phases import initial_rest_samples
from calibration.algorithms.screening import NotUsed
from calibration.algorithms.strapdown_attitude import gyro_attitude
from calibration.algorithms.swing import (
    PAPER_ERROR_DEG,
    PAPER_OFFSET_S,
    PAPER_RATE_DEG_S,
    SwingResult,
    SwingSamples,
    fit_swing,
)
from calibration.evaluations.attitude_sources import (
    OWN,
    InertialSamples,
    has_inertial,
    has_own_attitude,
    inertial_samples,
    own_attitude,
)
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.records.attitude_contents import LagContribution, curves_table, swing_content
from calibration.records.record_parts import RecordTable
from calibration.sensor_knowledge import axes, sensor_range
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

U_TRIGGER_S = 2e-6
"""Standard uncertainty of the common edge."""
U_G_SENSITIVITY_RAD_S_PER_G = math.radians(0.005)
"""Standard uncertainty of each element of a MEMS gyro's, where the recording does not compensate it."""
LEAST_LAG_S = 1e-7
"""Of a contribution that is worth a row."""
ANGLES = ("angle_outer", "angle_middle", "angle_inner")
CYCLES_SHOWN = 2.0


@dataclass(frozen=True)
class _Stand:
    """The angle that swings and its rate (m,), turned so that they go with the body axis; SI."""

    axis: int
    time_s: FloatArray
    angle_rad: FloatArray
    rate_rad_s: FloatArray
    force_m_s2: FloatArray


def evaluate_swing(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Lag, scale factor error and attitude error.

    Raises:
        CalibrationError: no swing, a stand without angles, a unit without attitude and gyros, a swing faster
            than the gyros' range, too few whole cycles, a unit that does not follow.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut")
    stand = _stand(recording)
    limit = sensor_range(recording, "gyro")
    peak = float(np.abs(stand.rate_rad_s).max())
    if limit is not None and peak >= limit:
        raise refused(
            recording,
            f"The swing's {math.degrees(peak):.4g} °/s are beyond the gyros' range of "
            f"{math.degrees(limit):.4g} °/s.",
            "swing slower, or with a smaller amplitude",
        )
    triggered = recording.test.get("triggered") is not False
    assumptions = _assumptions(stand.axis, triggered)
    results: list[SensorResult] = []
    not_used: list[NotUsed] = []
    if has_own_attitude(dut):
        missing = np.asarray(~np.isfinite(dut.si("roll", "pitch", "yaw")).all(axis=1), dtype=np.bool_)
        angle = _own_angle(dut, stand.axis, ~missing)
        samples = _samples(dut.time_s(), angle, stand)
        results.append(_result(OWN, recordings, samples, stand, triggered))
        if missing.any():
            not_used.append(NotUsed(say("samples of the attitude"), int(missing.sum()), say("missing (NaN)")))
    if has_inertial(dut):
        try:
            inertial = inertial_samples(recording, dut)
            samples = _of_gyros(recording, dut, inertial, stand)
            results.append(_result(axes("gyro")[stand.axis], recordings, samples, stand, triggered))
            assumptions.append(inertial.sentence)
        except CalibrationError as error:
            if not results:
                raise
            not_used.append(NotUsed(say("gyros"), len(dut), error.what))
    if not results:
        raise refused(
            recording,
            "The unit sends neither roll, pitch and yaw nor its gyros and accelerometers.",
            "record one of them",
            "stream dut",
        )
    return method_evaluation(recordings, results, assumptions, not_used)


def _assumptions(axis: int, triggered: bool) -> list[str]:
    said = [
        say(
            "swing about body {axis}; the lag is that of the angle, its filters' and its link's",
            axis="xyz"[axis],
        ),
        say(
            "g-sensitivity of a gyro {value} °/s/g (standard uncertainty, stated): it looks like a lag",
            value=f"{math.degrees(U_G_SENSITIVITY_RAD_S_PER_G):g}",
        ),
        say("scale factor error: at this rate and temperature, over the whole swing"),
        say("lag at time 0 of the unit's clock, which may run fast or slow (clock drift)"),
    ]
    if triggered:
        said.append(say("a common trigger joins the clocks to {time} µs", time=f"{U_TRIGGER_S * 1e6:g}"))
    else:
        said.append(
            say(
                "no trigger joins the clocks: only the sum of the unit's lag and of what its clock is ahead "
                "of the stand's is told; one swing cannot separate them"
            )
        )
    return said


def _stand(recording: Recording) -> _Stand:
    """Which body axis swings, and the gimbal angle that does it."""
    stream = stream_with(recording, "stand", "rate_x", "rate_y", "rate_z")
    there = [name for name in ANGLES if name in stream.columns]
    if not there:
        raise refused(
            recording,
            "The stand's angles are not recorded.",
            f"record {', '.join(ANGLES)}",
            "stream stand",
        )
    rates, angles = stream.si("rate_x", "rate_y", "rate_z"), stream.si(*there).reshape(len(stream), -1)
    kept = np.isfinite(rates).all(axis=1) & np.isfinite(angles).all(axis=1)
    if kept.sum() < 2:
        raise refused(recording, "The stand's rates and angles are missing.", "look at the stand's stream")
    rates, angles = rates[kept], angles[kept]
    axis = int(np.sum(rates**2, axis=0).argmax())
    turned = np.unwrap(angles, axis=0)
    angle = turned[:, int(np.ptp(turned, axis=0).argmax())]
    sign = np.sign(float(np.sum(np.gradient(angle) * rates[:, axis]))) or 1.0
    force = stream.si(*axes("acc"))[kept] if stream.has(*axes("acc")) else np.zeros_like(rates)
    return _Stand(axis, stream.time_s()[kept], sign * angle, rates[:, axis], force)


def _samples(
    time_s: FloatArray, angle: FloatArray, stand: _Stand, breaks_s: tuple[float, ...] = ()
) -> SwingSamples:
    return SwingSamples(time_s, angle, stand.time_s, stand.angle_rad, stand.rate_rad_s, breaks_s)


def _own_angle(dut: Stream, axis: int, there: np.ndarray) -> FloatArray:
    """Angle about the axis since the start by the unit's own attitude; not a number where it sent none."""
    angle = np.full(len(dut), np.nan)
    attitude = own_attitude(dut)[there]
    if len(attitude):
        angle[there] = angle_about_rad(attitude, attitude[0], axis)
    return angle


def _of_gyros(recording: Recording, dut: Stream, inertial: InertialSamples, stand: _Stand) -> SwingSamples:
    """The gyros' own angle, begun anew after every hole; the accelerometers play no part in a swing."""
    period_s = sample_period_s(recording, dut)
    rest = initial_rest_samples(inertial.rate_rad_s, inertial.force_m_s2, period_s)
    if not rest:
        raise refused(
            recording,
            "The unit was not at rest before the swing: its gyros' bias is not known.",
            "leave it at rest for at least two seconds first",
            "stream dut",
        )
    rates = inertial.rate_rad_s - inertial.rate_rad_s[:rest].mean(axis=0)
    begins = np.flatnonzero(inertial.broken)
    angle = np.full(len(rates), np.nan)
    start = np.array([1.0, 0.0, 0.0, 0.0])
    for first, last in zip([0, *begins.tolist()], [*begins.tolist(), len(rates)], strict=True):
        if last - first > 1:
            angle[first:last] = angle_about_rad(
                gyro_attitude(start, rates[first:last], period_s), start, stand.axis
            )
    breaks = tuple(float(inertial.time_s[index]) for index in begins)
    return _samples(inertial.time_s, angle, stand, breaks)


def _result(
    sensor: str, recordings: tuple[Recording, ...], samples: SwingSamples, stand: _Stand, triggered: bool
) -> SensorResult:
    added = {
        axis: np.interp(samples.unit_time_s, stand.time_s, _integral(stand.time_s, stand.force_m_s2[:, k]))
        for k, axis in enumerate("xyz")
    }
    found = fit_swing(samples, added)
    of_trigger = [LagContribution("common edge of the clocks", "s", U_TRIGGER_S, 1.0)] if triggered else []
    of_gyro = [
        LagContribution(
            f"g-sensitivity of the gyro along {axis}", "rad/s", U_G_SENSITIVITY_RAD_S_PER_G, lag_per_unit
        )
        for axis, lag_per_unit in found.lag_per_error.items()
        if abs(lag_per_unit) * U_G_SENSITIVITY_RAD_S_PER_G > LEAST_LAG_S
    ]
    content = swing_content(found, [*of_trigger, *of_gyro], triggered, (_curves(samples, found),))
    return SensorResult(sensor, content, recordings, _beside(found, triggered))


def _integral(time_s: FloatArray, force_m_s2: FloatArray) -> FloatArray:
    """Angle (m,) that a rate of 1 rad/s per g of this specific force makes, the mean left off."""
    share = (force_m_s2 - force_m_s2.mean()) / STANDARD_GRAVITY_M_S2
    steps = 0.5 * (share[1:] + share[:-1]) * np.diff(time_s)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _curves(samples: SwingSamples, found: SwingResult) -> RecordTable:
    """Two cycles from the first that was used on: both angles, and what is left without the lag."""
    begin_s = float(found.error_time_s[0])
    shown = (found.error_time_s - begin_s) <= CYCLES_SHOWN * found.period_s
    time_s = found.error_time_s[shown]
    unit = np.interp(time_s, samples.unit_time_s, np.nan_to_num(samples.unit_angle_rad))
    stand = np.interp(time_s, samples.stand_time_s, samples.stand_angle_rad)
    return curves_table(
        "swing",
        {
            "time": ("s", time_s - begin_s),
            "stand_angle": ("rad", stand),
            "unit_angle": ("rad", unit - float(np.mean(unit - stand))),
            "residual": ("rad", found.error_rad[shown]),
        },
    )


def _beside(found: SwingResult, triggered: bool) -> tuple[Beside, ...]:
    degrees: Callable[[float], float] = math.degrees
    of_lag = abs(found.lag_s) * found.peak_rate_rad_s
    words = (
        say("of it by the lag: lag times the peak rate")
        if triggered
        else say("of it by lag and clock offset together: their sum times the peak rate")
    )
    return (
        Beside(say("largest difference from the stand, as recorded"), degrees(found.largest_rad), "deg"),
        Beside(words, degrees(of_lag), "deg"),
        Beside(say("largest error without the lag"), degrees(found.error.largest), "deg"),
        Beside(say("peak rate of the swing"), degrees(found.peak_rate_rad_s), "deg/s"),
        Beside(say("paper 2's largest error, which it lays to the clocks"), PAPER_ERROR_DEG, "deg"),
        Beside(
            say("13 ms between clocks at 200 °/s, which is the same"),
            PAPER_OFFSET_S * PAPER_RATE_DEG_S,
            "deg",
        ),
    )

"""Profile 'temperature_ramp': bias over temperature both ways, hysteresis, what follows dT/dt.

The unit rests: its output is a bias plus what gravity and the Earth give it in that pose, which stays. Only
changes over temperature are told, and those of the scale factor times a steady input are among them.
"""

# pyright: strict
from dataclasses import replace

import numpy as np

from calibration.algorithms.block_means import block_means
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.correlated_fit import MAX_BLOCKS
from calibration.algorithms.screening import NotUsed
from calibration.algorithms.thermal_ramp import RampFit, fit_ramp
from calibration.evaluations.channels import SI, Kind, channels_in_si
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.evaluations.room_matrix import temperature_column
from calibration.records.temperature_contents import ramp_content
from calibration.sensor_knowledge import sensor_range, slow_noise
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.mems_ahrs import CALIBRATED_RANGE_C
from protocol.recordings import Recording

SETTLING_S = 600.0
"""After power-on: the unit warms itself, its biases settle, and hysteresis takes a side."""
BLOCK_S = 10.0
MOST_BLOCKS = 900
RANGES_C = {"mems_ahrs": CALIBRATED_RANGE_C}
"""Calibrated range of a product's temperature, where it has one."""
KINDS: tuple[Kind, ...] = ("gyro", "acc")


def evaluate_temperature_ramp(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Every sensor that is there.

    Raises:
        CalibrationError: no sensor or temperature, a temperature that does not go both ways, too little data.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut")
    power_on_s = recording.test.get("power_on_s", 0.0)
    on_s = float(power_on_s) if isinstance(power_on_s, int | float) else 0.0
    used = dut.time_s() >= on_s + SETTLING_S
    why = say("the first {seconds} s after power-on: the unit settles", seconds=f"{SETTLING_S:g}")
    not_used: list[NotUsed] = []
    if (~used).any():
        not_used.append(NotUsed(say("samples"), int((~used).sum()), why))
    results: list[SensorResult] = []
    own: list[str] = []
    sentences = [
        say("the unit at rest: changes of its output over temperature; gravity and the Earth stay the same"),
        say("one cycle: how well the curve repeats is not told"),
    ]
    for kind in KINDS:
        letters, output = channels_in_si(recording, kind)
        if not letters:
            continue
        result, said = _sensor(recording, kind, letters, output[used], used, not_used)
        results.append(result)
        own += said
    if not results:
        raise refused(recording, "The recording has no gyro and no accelerometer.", "record their outputs")
    sentences += _beyond(recording, used)
    found = method_evaluation(recordings, results, sentences, not_used)
    return replace(found, assumptions=(*own, *found.assumptions))  # each sensor's own are in its record


def _sensor(
    recording: Recording,
    kind: Kind,
    letters: str,
    output: FloatArray,
    used: np.ndarray,
    not_used: list[NotUsed],
) -> tuple[SensorResult, list[str]]:
    dut = recording.stream("dut")
    time_s = dut.time_s()[used]
    warmth = np.asarray(dut.columns[temperature_column(recording, kind)], dtype=np.float64)[used]
    if len(time_s) < 2:
        raise refused(
            recording, "The recording ends while the unit settles.", "record the whole cycle of temperature"
        )
    block_s = max(BLOCK_S, float(time_s[-1] - time_s[0]) / MOST_BLOCKS, 4.0 * sample_period_s(recording, dut))
    found = block_means(
        f"{kind} in {recording.recording_id}",
        time_s,
        output,
        block_s,
        inputs=warmth[:, None],
        range_limit=sensor_range(recording, kind),
    )
    assert len(found.blocks.middle_s) <= MAX_BLOCKS
    not_used += found.not_used
    stated = tuple((term.standard_deviation, term.correlation_time_s) for term in slow_noise(recording, kind))
    try:
        fit = fit_ramp(found.blocks, found.inputs[:, 0], stated or None)
    except CalibrationError as error:
        raise refused(recording, error.what, error.remedy.removesuffix("."), f"stream dut, {kind}") from None
    said = [
        say(
            "{sensor} at {low} … {high} °C; noise: {words}",
            sensor=kind,
            low=f"{fit.span_c[0]:.1f}",
            high=f"{fit.span_c[1]:.1f}",
            words=fit.fit.noise[0],
        )
    ]
    content = replace(ramp_content(fit, letters, SI[kind]), assumptions=tuple(said))
    return SensorResult(kind, content, (recording,), _beside(fit, letters, SI[kind])), said


def _beside(fit: RampFit, letters: str, unit: str) -> tuple[Beside, ...]:
    figures: list[Beside] = []
    for channel, letter in enumerate(letters):
        row = int(np.abs(fit.loop_si[:, channel]).argmax())
        words = say(
            "{axis}: largest hysteresis, at {degrees} °C (± {u}); the largest of many is seldom small",
            axis=letter,
            degrees=f"{fit.temperature_c[row]:.0f}",
            u=f"{fit.loop_u_si[row, channel]:.1g}",
        )
        figures.append(Beside(words, float(fit.loop_si[row, channel]), unit))
        span = float(np.ptp(fit.curve_si[:, channel]))
        figures.append(Beside(say("{axis}: span of the mean curve", axis=letter), span, unit))
    return tuple(figures)


def _beyond(recording: Recording, used: np.ndarray) -> list[str]:
    """Samples outside the range that the product is calibrated in."""
    span = RANGES_C.get(str(recording.unit.get("product", "")))
    if span is None:
        return []
    warmth = np.asarray(
        recording.stream("dut").columns[temperature_column(recording, "gyro")], dtype=np.float64
    )[used]
    beyond = int(((warmth < span[0]) | (warmth > span[1])).sum())
    if beyond == 0:
        return []
    return [
        say(
            "{count} samples were taken beyond the product's calibrated range of {low} … {high} °C",
            count=beyond,
            low=f"{span[0]:g}",
            high=f"{span[1]:g}",
        )
    ]

"""Profile 'impact': pure lag of a fibre-optic gyro from the stamps of its frames (paper 3).

The rig's stamp of a frame counts from the latest trigger: a count that falls begins a shot. The trigger's
own stream is not needed for that, so clocks need not be joined.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.impact_detection import (
    MIN_REST_FRAMES,
    THRESHOLD_SIGMAS,
    detect_impact,
    latest_detection_s,
)
from calibration.algorithms.pure_lag import PureLag, TimeStamps, paper_bounds, pure_lag
from calibration.algorithms.pure_lag_shots import confidence, paper_confidence
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_number,
    method_evaluation,
    refuse_backward_time,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.records.method_contents import pure_lag_content
from protocol.errors import CalibrationError
from protocol.impact_rig import STAMP_FLAG, STAMP_FULL_SCALE_S, STAMP_MAX_COUNT, STAMP_RESOLUTION_S
from protocol.language import say
from protocol.recordings import Recording, Stream

REST_FRAMES = 180
"""Frames before the impact that tell the noise."""
SEARCHED_FRAMES = 40
"""Frames from the trigger on that the impact is looked for in."""
PRECISION_PART = 0.05
"""Of a frame: the precision that a probability is told for (paper 3: 25 us of 500 us)."""
PERIOD_TOLERANCE = 0.01
"""Of the frames' period, between times and stamps."""
STAMPS = TimeStamps(STAMP_RESOLUTION_S, STAMP_FULL_SCALE_S, "down")


@dataclass(frozen=True)
class _Shots:
    """Stamps of the first frames that show the impacts, s; their numbers from 1; how clear they are."""

    delays_s: FloatArray
    frame_numbers: NDArray[np.int64]
    weakest_sigmas: float
    not_used: tuple[NotUsed, ...]


def evaluate_impact(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Pure lag of the gyro that was struck.

    Raises:
        CalibrationError: no stamps, no triggers in them, too few shots, stamps that are saturated or do not
            fit one lag, or a gyro that does not answer.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut", "stamp")
    refuse_backward_time(recording, dut)
    channel = _struck_channel(recording, dut)
    frame_s = sample_period_s(recording, dut)
    shots = _shots(recording, dut, channel)
    bandwidth_hz = believed_number(recording, "gyro", "bandwidth_hz")
    detection_s = 0.0
    if bandwidth_hz is not None and bandwidth_hz > 0.0:
        detection_s = latest_detection_s(shots.weakest_sigmas, 0.5 / (math.pi * bandwidth_hz))
        rise = say(
            "until then at most {detection} µs pass, by the gyro's bandwidth of {hz} Hz: the lower bound "
            "allows it",
            detection=f"{detection_s * 1e6:.2f}",
            hz=f"{bandwidth_hz:.0f}",
        )
    else:
        rise = say("the gyro's bandwidth is not known: what passes until then is part of the lag")
    found = pure_lag(shots.delays_s, frame_s, STAMPS, detection_s)
    assumptions = [
        say(
            "frames every {period} µs, stamps rounded down to {resolution} ns",
            period=f"{frame_s * 1e6:.2f}",
            resolution=f"{STAMP_RESOLUTION_S * 1e9:.2f}",
        ),
        say(
            "the lag ends where the response leaves the rest by {sigmas} standard deviations; the weakest "
            "impact peaked at {peak} of them",
            sigmas=f"{THRESHOLD_SIGMAS:g}",
            peak=f"{shots.weakest_sigmas:.0f}",
        ),
        rise,
    ]
    content = pure_lag_content(found, shots.delays_s)
    result = SensorResult(channel, content, recordings, _beside(recording, found, shots, frame_s))
    return method_evaluation(recordings, [result], assumptions, shots.not_used)


def _struck_channel(recording: Recording, dut: Stream) -> str:
    """The gyro whose output moves most."""
    there = [name for name in ("gyro_x", "gyro_y", "gyro_z") if name in dut.columns]
    if not there:
        raise refused(
            recording, "The recording has no gyro.", "record gyro_x, gyro_y or gyro_z", "stream dut"
        )
    outputs = {name: dut.si(name)[np.isfinite(dut.si(name))] for name in there}
    spans = [float(np.ptp(values)) if len(values) else 0.0 for values in outputs.values()]
    return there[int(np.argmax(spans))]


def _shots(recording: Recording, dut: Stream, channel: str) -> _Shots:
    sent = np.asarray(dut.columns["stamp"], dtype=np.float64)
    unread = ~np.isfinite(sent)
    stamps = np.where(unread, 0.0, sent).astype(np.int64)
    output = np.where(unread, np.nan, dut.si(channel))  # no shot may lean on a frame without a stamp
    told = (stamps & STAMP_FLAG) != 0
    counts = np.where(told, stamps & STAMP_MAX_COUNT, STAMP_MAX_COUNT + 1)  # before a trigger: beyond all
    begins = np.flatnonzero(np.diff(counts) < 0) + 1
    if not len(begins):
        raise refused(
            recording,
            "No frame is stamped: no trigger came to the acquisition module.",
            "connect the rig's trigger, and strike",
            "stream dut, stamp",
        )
    _refuse_other_period(recording, dut, stamps, told)
    lost = _lost_before(dut)
    delays: list[float] = []
    numbers: list[int] = []
    peaks: list[float] = []
    left_out: dict[str, int] = {}
    ends = [*begins[1:].tolist(), len(counts)]
    previous = 0
    for begin, end in zip(begins.tolist(), ends, strict=True):
        first = max(begin - REST_FRAMES, previous)
        last = min(begin + SEARCHED_FRAMES, end)
        previous = begin
        try:
            seen = detect_impact(output[first:last], begin - first)
        except CalibrationError as error:
            left_out[error.what] = left_out.get(error.what, 0) + 1
            continue
        shown = first + seen.frame
        if lost[begin : shown + 1].any():
            why = say("a frame was lost between the impact and the first frame that shows it")
            left_out[why] = left_out.get(why, 0) + 1
            continue
        delays.append(float(counts[shown]) * STAMP_RESOLUTION_S)
        numbers.append(shown - begin + 1)
        peaks.append(seen.peak / seen.rest_deviation)
    if not delays:
        why = max(left_out, key=lambda word: left_out[word])
        raise refused(
            recording,
            f"None of {len(begins)} impacts can be used: {why}",
            f"strike a gyro at rest for at least {MIN_REST_FRAMES} frames, harder, and look at the link",
        )
    not_used = tuple(NotUsed(say("impacts"), count, why) for why, count in left_out.items())
    return _Shots(np.array(delays), np.array(numbers), min(peaks), not_used)


def _refuse_other_period(
    recording: Recording, dut: Stream, stamps: NDArray[np.int64], told: NDArray[np.bool_]
) -> None:
    """Two clocks tell the frames' period: the recording's times and the rig's stamps."""
    counts = stamps & STAMP_MAX_COUNT
    running = told[1:] & told[:-1] & (counts[1:] < STAMP_MAX_COUNT) & (counts[1:] > counts[:-1])
    if not running.any():
        return
    by_stamps = float(np.median(np.diff(counts)[running])) * STAMP_RESOLUTION_S
    by_times = sample_period_s(recording, dut)
    if abs(by_stamps - by_times) > PERIOD_TOLERANCE * by_times + STAMP_RESOLUTION_S:
        raise refused(
            recording,
            f"Frames come every {by_times * 1e6:.2f} us by their times, every {by_stamps * 1e6:.2f} us by "
            "their stamps.",
            "look at the unit of the recording's times, and at the stamps",
            "stream dut",
        )


def _lost_before(dut: Stream) -> NDArray[np.bool_]:
    """Whether frames are missing before each one, by the 8-bit counter, else by the times, shape (n,)."""
    lost = np.zeros(len(dut), dtype=np.bool_)
    if "counter" in dut.columns:
        counter = np.asarray(dut.columns["counter"], dtype=np.float64)
        step = np.mod(np.diff(np.where(np.isfinite(counter), counter, 0.5)), 256.0)
        lost[1:] = step != 1.0  # a missing number is none of a row either
    else:
        steps = np.diff(dut.time_s())
        lost[1:] = steps > 1.5 * float(np.median(steps))
    return lost


def _beside(recording: Recording, found: PureLag, shots: _Shots, frame_s: float) -> tuple[Beside, ...]:
    """Probabilities for random phases, and paper 3's own evaluation."""
    paper = paper_bounds(shots.delays_s, frame_s, shots.frame_numbers)
    figures = [
        Beside(say("half width of the bounds"), found.half_width_s, "s"),
        Beside(say("paper 3's lag, by first and second frames"), paper.lag_s, "s"),
        Beside(say("paper 3's half width"), paper.half_width_s, "s"),
    ]
    values = recording.test.get("values")
    programmed = isinstance(values, dict) and float(values.get("next_frame_us", -1.0)) >= 0.0  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
    if not programmed:
        precision_s = PRECISION_PART * frame_s
        figures += [
            Beside(
                say(
                    "probability that {shots} random shots reach a half width of {precision} µs",
                    shots=found.shots,
                    precision=f"{precision_s * 1e6:g}",
                ),
                confidence(found.shots, precision_s, frame_s),
                "1",
            ),
            Beside(
                say("the same by paper 3, eq (22), as printed: too high"),
                paper_confidence(found.shots, precision_s, frame_s),
                "1",
            ),
        ]
    return tuple(figures)

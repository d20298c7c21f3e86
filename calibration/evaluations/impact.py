"""Profile 'impact': pure lag of a fibre-optic gyro from the stamps of its frames (paper 3).

The rig's stamp of a frame counts from the latest trigger: a count that falls begins a shot. The trigger's
own stream is not needed for that, so clocks need not be joined.
"""

# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.impact_detection import MIN_REST_FRAMES, THRESHOLD_SIGMAS, detect_impact
from calibration.algorithms.pure_lag import PureLag, TimeStamps, paper_bounds, pure_lag
from calibration.algorithms.pure_lag_shots import confidence, paper_confidence
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
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
    channel = _struck_channel(recording, dut)
    frame_s = sample_period_s(recording, dut)
    shots = _shots(recording, dut, channel)
    found = pure_lag(shots.delays_s, frame_s, STAMPS)
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
    ]
    result = SensorResult(
        channel, pure_lag_content(found), recordings, _beside(recording, found, shots, frame_s)
    )
    return method_evaluation(recordings, [result], assumptions, shots.not_used)


def _struck_channel(recording: Recording, dut: Stream) -> str:
    """The gyro whose output moves most."""
    there = [name for name in ("gyro_x", "gyro_y", "gyro_z") if name in dut.columns]
    if not there:
        raise refused(
            recording, "The recording has no gyro.", "record gyro_x, gyro_y or gyro_z", "stream dut"
        )
    spans = [float(np.nanmax(dut.si(name)) - np.nanmin(dut.si(name))) for name in there]
    return there[int(np.argmax(spans))]


def _shots(recording: Recording, dut: Stream, channel: str) -> _Shots:
    stamps = np.asarray(dut.columns["stamp"], dtype=np.int64)
    output = dut.si(channel)
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


def _lost_before(dut: Stream) -> NDArray[np.bool_]:
    """Whether frames are missing before each one, by the 8-bit counter where there is one, shape (n,)."""
    lost = np.zeros(len(dut), dtype=np.bool_)
    if "counter" in dut.columns:
        lost[1:] = np.diff(np.asarray(dut.columns["counter"], dtype=np.int64)) % 256 != 1
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

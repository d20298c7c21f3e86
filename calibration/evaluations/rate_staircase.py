"""Profile 'rate_staircase': M and b of the gyros, linearity, asymmetry, geometry; repeatability over runs."""

# pyright: strict
import numpy as np

from calibration.algorithms.repeatability import repeatability
from calibration.algorithms.scale_factor_figures import (
    Dwell,
    StaircaseFigures,
    find_dwells,
    staircase_figures,
)
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.channels import channels_in_si, stated_slow_terms, this_power_on
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.evaluations.repeated_runs import between_runs, each_that_can, merged, mounts_words
from calibration.evaluations.stand_motion import rate_uncertainty, stand_motion
from calibration.records.inertial_contents import repeatability_content, staircase_content
from calibration.sensor_knowledge import sensor_range
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

SETTLE_S, LEAST_DWELL_S = 0.2, 0.5
STEADY_RAD_S = 1e-5


def evaluate_rate_staircase(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """One staircase or several of one unit.

    Raises:
        CalibrationError: clocks that no trigger joins, no site, an axis or a direction that is missing.
    """
    found: dict[str, tuple[str, StaircaseFigures]] = {}

    def one(recording: Recording) -> MethodEvaluation:
        letters, figures, evaluation = _staircase(recording)
        found[recording.recording_id] = letters, figures
        return evaluation

    done, failed = each_that_can(recordings, one)
    parts = [part for _, part in done]
    if len(recordings) > 1:
        repeated, missed = _repeatability([recording for recording, _ in done], found)
        parts += repeated
        failed += missed
    return merged(parts, failed)


def _staircase(recording: Recording) -> tuple[str, StaircaseFigures, MethodEvaluation]:
    time_s = stream_with(recording, "dut").time_s()
    letters, output = channels_in_si(recording, "gyro")
    if not letters:
        raise refused(recording, "The recording has no gyro.", "record gyro_x …")
    motion, rate_doubt = stand_motion(recording, time_s), rate_uncertainty(recording)
    rate, earth = motion.rate_rad_s, motion.earth_rate_rad_s
    stretches = find_dwells(
        rate, time_s, tolerance_rad_s=STEADY_RAD_S, least_s=LEAST_DWELL_S, settle_s=SETTLE_S
    )
    if not stretches:
        raise refused(recording, "The stand held no rate.", "record a staircase of rates about each axis")
    dwells = [
        Dwell(f"dwell from {time_s[a]:.1f} s", time_s[a:b], output[a:b], rate[a:b], earth[a:b])
        for a, b in stretches
    ]
    found = staircase_figures(
        dwells,
        sensors=tuple("xyz".index(letter) for letter in letters),
        range_rad_s=sensor_range(recording, "gyro"),
        rate_standard_uncertainty=rate_doubt,
        known_slow=stated_slow_terms(recording, "gyro"),
        where=f"recording {recording.recording_id}",
    )
    not_used = list(found.not_used)
    outside = len(time_s) - sum(b - a for a, b in stretches)
    if outside > 0:
        why = say("the stand changed its rate, or had just done so")
        not_used.append(NotUsed(say("between the dwells"), outside, why))
    sentences = [
        say(
            "rate of the stand good to {part} (standard uncertainty, taken as stated)", part=f"{rate_doubt:g}"
        ),
        say("Earth rate from the site's latitude and the stand's angles"),
        say("how the unit sits on the stand is part of the misalignment, not of its uncertainty"),
        this_power_on(),
        *(
            say("noise of {channel}: {words}", channel=f"gyro_{letter}", words=words)
            for letter, words in zip(letters, found.noise, strict=True)
        ),
    ]
    content = staircase_content(letters, found)
    result = SensorResult("gyro", content, (recording,), _beside(letters, found))
    return letters, found, method_evaluation((recording,), [result], sentences, not_used)


def _beside(letters: str, found: StaircaseFigures) -> tuple[Beside, ...]:
    figures: list[Beside] = []
    for letter, axis in zip(letters, found.axes, strict=True):
        noise = say("non-linearity {axis} that noise alone would show", axis=letter)
        minimax = say("non-linearity {axis} from the minimax line, the least possible", axis=letter)
        figures.append(Beside(noise, axis.nonlinearity_of_noise, "1"))
        figures.append(Beside(minimax, axis.nonlinearity_minimax, "1"))
    figures.append(Beside(say("condition of the design"), found.condition, "1"))
    return tuple(figures)


def _repeatability(
    recordings: list[Recording], found: dict[str, tuple[str, StaircaseFigures]]
) -> tuple[list[MethodEvaluation], list[NotUsed]]:
    """Of the scale factors over runs; or why there is none."""
    between = between_runs(recordings)
    samples = sum(len(recording.stream("dut")) for recording in recordings)
    what = say("repeatability over {count} recordings", count=len(recordings))
    if between.condition is None:
        return [], [NotUsed(what, samples, between.words)]
    names = [recording.recording_id for recording in recordings]
    letters = found[names[0]][0]
    values, doubt = (
        np.array([[axis.scale_factor_error[k] for axis in found[name][1].axes] for name in names])
        for k in range(2)
    )
    try:
        over_runs = repeatability(values, doubt, between.condition)
    except CalibrationError as error:
        return [], [NotUsed(what, samples, error.what)]
    content = repeatability_content("scale_factor", letters, over_runs, names, (values + 1.0, doubt), "1")
    beside = tuple(
        Beside(
            say("what the runs of {channel} differ by beyond their noise", channel=f"gyro_{letter}"),
            float(over_runs.beyond_noise[k]) if over_runs.beyond_noise_resolved[k] else None,
            "1",
        )
        for k, letter in enumerate(letters)
    )
    mounts = mounts_words(recordings)
    sentences = [between.words] if mounts is None else [between.words, mounts]
    result = SensorResult("gyro", content, tuple(recordings), beside)
    return [method_evaluation(recordings, [result], sentences)], []

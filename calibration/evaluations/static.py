"""Profile 'static': noise coefficients (IEEE 952), bias of gyros, bias stability, repeatability over runs.

One recording gives noise and bias, from an hour on bias stability (GJB 2426A). Several recordings of one unit
give the bias of each, the noise of the longest, and from six of ten minutes on the repeatability: see
`repeated_runs` for what tells a run from a power-on. The bias of accelerometers needs several attitudes.
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.algorithms.bias_figures import (
    STABILITY_DURATION_S,
    TrueInput,
    bias,
    bias_stability,
    unknown_earth_rate,
)
from calibration.algorithms.block_means import span_s
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.earth import EARTH_RATE_RAD_S
from calibration.algorithms.repeatability import Condition, bias_repeatability
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.channels import SI, Kind, channels_in_si, stated_slow_terms
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_sensor,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.evaluations.noise import evaluate_noise
from calibration.evaluations.quanta import of_quanta, quantum_words
from calibration.evaluations.repeated_runs import between_runs, each_that_can, merged, mounts_words
from calibration.evaluations.stand_motion import U_ATTITUDE_RAD, stand_motion
from calibration.records.inertial_contents import bias_content, repeatability_content
from calibration.sensor_knowledge import sensor_range
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

STILL_RAD_S = 1e-5
U_MATRIX = 5e-3
"""Standard uncertainty of each element of M that the recording does not state."""


def evaluate_static(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Noise, bias and repeatability at rest.

    Raises:
        CalibrationError: no recording is long enough, or a stand that was to be at rest moved.
    """
    first = recordings[0]
    done, failed = each_that_can(recordings, _bias_and_stability)
    longest = max(recordings, key=lambda one: span_s(one.stream("dut").time_s()))
    parts: list[MethodEvaluation] = []
    try:
        parts.append(evaluate_noise((longest,)))
    except CalibrationError as error:
        failed.append(NotUsed(say("noise coefficients"), len(longest.stream("dut")), error.what))
    parts += [part for _, part in done if part.results]
    if len(recordings) > 1:
        repeated, missed = _repeatability([recording for recording, _ in done])
        parts += repeated
        failed += missed
    if not parts:
        why = "; ".join(dict.fromkeys(note.why for note in failed))
        raise refused(first, why, "record gyro_x … or acc_x …, longer than 180 s at rest")
    return merged(parts, failed)


def _bias_and_stability(recording: Recording) -> MethodEvaluation:
    """Of gyros the bias, of both triads the stability where an hour is there."""
    time_s = stream_with(recording, "dut").time_s()
    long_enough = span_s(time_s) >= STABILITY_DURATION_S * (1.0 - 1e-3)
    results: list[SensorResult] = []
    sentences: list[str] = []
    not_used: list[NotUsed] = []
    for kind in SI:
        letters, output = _alive(recording, kind, not_used)
        if not letters:
            continue
        limit, slow = sensor_range(recording, kind), stated_slow_terms(recording, kind)
        quanta, (by_quanta,) = of_quanta(recording, kind, [output])
        found, stable = None, None
        if kind == "gyro":
            acted, words = _earth_rate(recording, letters)
            found = bias(
                time_s,
                output,
                acted,
                range_limit=limit,
                known_slow=slow,
                of_quantum=by_quanta,
                where=recording.recording_id,
            )
            sentences += [words, *_noise_words(kind, letters, found.noise)]
            sentences += quantum_words(kind, letters, quanta, by_quanta, found.standard_uncertainty)
            if slow is None:
                sentences.append(
                    say(
                        "slow noise not stated: the bias's uncertainty bounds it by these data, also a "
                        "wander slower than the record: about five times that of white noise alone"
                    )
                )
            not_used += found.not_used
        else:
            why = say("one attitude does not tell it from scale factor and tilt: see multi_position")
            not_used.append(NotUsed(say("bias of the accelerometers"), len(time_s), why))
        if long_enough:
            where = f"{recording.recording_id}, {kind}"
            stable = bias_stability(
                time_s, output, range_limit=limit, known_slow=slow, of_quantum=by_quanta, where=where
            )
            sentences += quantum_words(kind, letters, quanta, by_quanta, stable.standard_uncertainty)
        if found is not None or stable is not None:
            content = bias_content(letters, found, stable, SI[kind])
            results.append(SensorResult(kind, content, (recording,)))
    if not results:
        return method_evaluation((recording,), [], [], not_used)
    if not long_enough:
        why = say("an hour is asked for (GJB 2426A)")
        not_used.append(NotUsed(say("bias stability"), len(time_s), why))
    sentences.append(say("bias of this power-on, at the temperature and in the gravity that the unit had"))
    return method_evaluation((recording,), results, sentences, not_used)


def _alive(recording: Recording, kind: Kind, not_used: list[NotUsed]) -> tuple[str, FloatArray]:
    """Channels that change at all, and their samples."""
    letters, output = channels_in_si(recording, kind)
    kept = _that_change(kind, letters, output, not_used)
    return "".join(letters[k] for k in kept), output[:, kept]


def _that_change(kind: Kind, letters: str, output: FloatArray, not_used: list[NotUsed]) -> list[int]:
    """Columns that change at all: one that stays at a number tells nothing of its sensor."""
    changing = np.ptp(output, axis=0) != 0.0 if len(output) else np.zeros(len(letters), dtype=np.bool_)
    for letter, moves in zip(letters, changing, strict=True):
        if not moves:
            why = say("constant: the channel is stuck, or its quantum is coarser than its noise")
            not_used.append(NotUsed(f"{kind}_{letter}", len(output), why))
    return [int(k) for k in np.flatnonzero(changing)]


def _noise_words(kind: Kind, letters: str, noise: Sequence[str]) -> list[str]:
    words = dict.fromkeys(noise)
    if len(words) == 1:
        return [say("gyro noise: {words}", words=noise[0])]
    return [
        say("noise of {channel}: {words}", channel=f"{kind}_{letter}", words=one)
        for letter, one in zip(letters, noise, strict=True)
    ]


def _earth_rate(recording: Recording, letters: str) -> tuple[TrueInput, str]:
    """What the Earth gave each gyro at rest, and the sentence that says where it is from.

    Raises:
        CalibrationError: the stand moved.
    """
    index = ["xyz".index(letter) for letter in letters]
    try:
        stand = stream_with(recording, "stand", "rate_x", "rate_y", "rate_z")
        motion = stand_motion(recording, stand.time_s())
    except CalibrationError as error:
        words = say("Earth rate not known in body axes, so part of the uncertainty: {why}", why=error.what)
        return unknown_earth_rate(len(letters)), words
    if float(np.nanmax(np.abs(motion.rate_rad_s))) > STILL_RAD_S:
        raise refused(recording, "The stand moved while the unit was to be at rest.", "record it at rest")
    earth = np.nanmean(motion.earth_rate_rad_s, axis=0)
    across = np.sqrt(np.maximum(EARTH_RATE_RAD_S**2 - earth**2, 0.0))[index] * U_ATTITUDE_RAD
    matrix, of_matrix, source = _matrix(recording)
    doubt = np.hypot(across, of_matrix * EARTH_RATE_RAD_S)
    words = say(
        "Earth rate from the site's latitude and the stand's angles, taken out with {source}", source=source
    )
    return TrueInput((matrix @ earth)[index], doubt, words), words


def _matrix(recording: Recording) -> tuple[FloatArray, float, str]:
    """M of the gyros as the recording states it, else the identity; its doubt; where it is from."""
    matrix = np.array(believed_sensor(recording, "gyro").get("matrix", ()), dtype=np.float64)
    if matrix.shape == (3, 3) and bool(np.isfinite(matrix).all()):
        return matrix, 0.0, say("the gyros' matrix that the recording states")
    return (
        np.eye(3),
        U_MATRIX,
        say("scale factors taken as 1 and axes as nominal, to {doubt}", doubt=U_MATRIX),
    )


def _repeatability(recordings: list[Recording]) -> tuple[list[MethodEvaluation], list[NotUsed]]:
    """Over runs, of both triads; or why there is none."""
    between = between_runs(recordings)
    samples = sum(len(recording.stream("dut")) for recording in recordings)
    what = say("repeatability over {count} recordings", count=len(recordings))
    if between.condition is None:
        return [], [NotUsed(what, samples, between.words)]
    results: list[SensorResult] = []
    not_used: list[NotUsed] = []
    own: list[str] = []
    for kind in SI:
        try:
            result, words = _repeatability_of(kind, recordings, between.condition, not_used)
        except CalibrationError as error:
            not_used.append(NotUsed(what, samples, error.what))
            break
        results += result
        own += words
    if not results:
        return [], not_used
    mounts = mounts_words(recordings)
    seconds = f"{min(span_s(one.stream('dut').time_s()) for one in recordings):.0f}"
    sentences = [
        between.words,
        say("{count} runs, the shortest of {seconds} s", count=len(recordings), seconds=seconds),
        *([] if mounts is None else [mounts]),
    ]
    found = method_evaluation(recordings, results, sentences)
    found = replace(found, assumptions=(*own, *found.assumptions))  # each sensor's own are in its record
    return [found], not_used


def _repeatability_of(
    kind: Kind, recordings: list[Recording], condition: Condition, not_used: list[NotUsed]
) -> tuple[list[SensorResult], list[str]]:
    """Of one triad, with what its quanta do; nothing where it is not there or stuck throughout."""
    letters, unit = channels_in_si(recordings[0], kind)[0], SI[kind]
    outputs = [channels_in_si(recording, kind)[1] for recording in recordings]
    kept = _that_change(kind, letters, np.concatenate(outputs), not_used)
    if not kept:
        return [], []
    letters, outputs = "".join(letters[k] for k in kept), [output[:, kept] for output in outputs]
    quanta, by_quanta = of_quanta(recordings[0], kind, outputs)
    found, figures = bias_repeatability(
        [(one.stream("dut").time_s(), output) for one, output in zip(recordings, outputs, strict=True)],
        [_acted(recording, kind, letters) for recording in recordings],
        condition,
        of_quantum=by_quanta,
    )
    values = np.array([figure.bias for figure in figures])
    doubt = np.array([figure.of_mean for figure in figures])
    names = [recording.recording_id for recording in recordings]
    content = repeatability_content("bias", letters, found, names, (values, doubt), unit)
    beside = tuple(
        Beside(
            say("what the runs of {channel} differ by beyond their noise", channel=f"{kind}_{letter}"),
            float(found.beyond_noise[k]) if found.beyond_noise_resolved[k] else None,
            unit,
        )
        for k, letter in enumerate(letters)
    )
    words = quantum_words(kind, letters, quanta, found.of_quantum, found.standard_uncertainty)
    if kind == "acc":
        words.append(
            say(
                "runs: the mean less gravity in the stand's attitude; how the unit sits and its scale "
                "factors are in it, the same in all runs"
            )
        )
    content = replace(content, assumptions=tuple(words))
    return [SensorResult(kind, content, tuple(recordings), beside)], words


def _acted(recording: Recording, kind: Kind, letters: str) -> TrueInput:
    """Earth rate or gravity in the run's own attitude; zeros where it is not known, the same for all runs."""
    if kind == "gyro":
        return _earth_rate(recording, letters)[0]
    zero = np.zeros(len(letters))
    try:
        stand = stream_with(recording, "stand", "rate_x", "rate_y", "rate_z")
        motion = stand_motion(recording, stand.time_s())
    except CalibrationError:
        return TrueInput(zero, zero, "")
    force = np.nanmean(motion.specific_force_m_s2, axis=0)
    return TrueInput(force[["xyz".index(letter) for letter in letters]], zero, "")

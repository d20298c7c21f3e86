"""Profile 'tumble': g-sensitivity of the gyros, M, bias and quadratic term of the accelerometers."""

# pyright: strict
from collections.abc import Callable

from calibration.algorithms.screening import NotUsed
from calibration.algorithms.tumble_g_sensitivity import (
    Site,
    TumbleFigures,
    TumbleRun,
    accelerometer_quadratic,
    gyro_g_sensitivity,
)
from calibration.evaluations.channels import Kind, channels_in_si, stated_slow_terms, this_power_on
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.evaluations.stand_motion import U_ATTITUDE_RAD, stand_motion
from calibration.records.inertial_contents import tumble_acc_content, tumble_gyro_content
from calibration.records.making import RecordContent
from calibration.sensor_knowledge import sensor_range
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording


def evaluate_tumble(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Both triads, as far as the recording has them.

    Raises:
        CalibrationError: clocks that no trigger joins, no site, no triad, an axis that gravity never acts
            along.
    """
    (recording,) = recordings
    motion = stand_motion(recording, stream_with(recording, "dut").time_s())
    site = Site(motion.latitude_rad, motion.gravity_m_s2, U_ATTITUDE_RAD)
    results: list[SensorResult] = []
    not_used: list[NotUsed] = []
    sentences: list[str] = []
    errors: list[CalibrationError] = []
    for kind, evaluate, content_of in _TRIADS:
        letters, output = channels_in_si(recording, kind)
        if letters != "xyz":
            not_used.append(NotUsed(kind, len(output), say("no triad of this kind in the recording")))
            continue
        run = TumbleRun("tumble", motion.time_s, output, motion.rate_rad_s, motion.dcm_body_from_ned)
        try:
            found = evaluate(recording, run, site)
        except CalibrationError as error:
            errors.append(error)
            not_used.append(NotUsed(kind, len(output), error.what))
            continue
        condition = max(fit.condition for fit in found.fits)
        beside = (Beside(say("condition of the design"), condition, "1"),)
        results.append(SensorResult(kind, content_of(found), recordings, beside))
        sentences.append(found.words)
        sentences += [
            say("noise of {channel}: {words}", channel=f"{kind}_{letter}", words=fit.noise[0])
            for letter, fit in zip("xyz", found.fits, strict=True)
        ]
        if stated_slow_terms(recording, kind) is None:
            sentences.append(
                say(
                    "{kind}: slow noise not stated: bounded by these data, uncertainties widened where they "
                    "hardly see it",
                    kind=kind,
                )
            )
        not_used += found.not_used
    if not results:
        raise (
            errors[0]
            if errors
            else refused(recording, "There is no triad.", "record gyros or accelerometers")
        )
    sentences.append(this_power_on())
    return method_evaluation(recordings, results, sentences, not_used)


def _of_gyros(recording: Recording, run: TumbleRun, site: Site) -> TumbleFigures:
    return gyro_g_sensitivity(
        [run],
        site,
        range_rad_s=sensor_range(recording, "gyro"),
        known_slow=stated_slow_terms(recording, "gyro"),
        where=f"recording {recording.recording_id}, g-sensitivity",
    )


def _of_accelerometers(recording: Recording, run: TumbleRun, site: Site) -> TumbleFigures:
    return accelerometer_quadratic(
        [run],
        site,
        range_m_s2=sensor_range(recording, "acc"),
        known_slow=stated_slow_terms(recording, "acc"),
        where=f"recording {recording.recording_id}, accelerometer tumble",
    )


_Evaluate = Callable[[Recording, TumbleRun, Site], TumbleFigures]
_TRIADS: tuple[tuple[Kind, _Evaluate, Callable[[TumbleFigures], RecordContent]], ...] = (
    ("gyro", _of_gyros, tumble_gyro_content),
    ("acc", _of_accelerometers, tumble_acc_content),
)

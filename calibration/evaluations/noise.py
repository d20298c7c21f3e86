"""Profile 'static': the noise coefficients of IEEE 952 for each gyro and accelerometer, by Allan variance."""

# pyright: strict
import numpy as np

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.channels import SI, channel_in_si
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.records.method_contents import allan_content
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

MIN_DURATION_S = 180.0
"""Taus up to an eighth of the record: less than 20 s would tell white noise and nothing of what is slower."""
HOLE_PERIODS = 1.5


def evaluate_noise(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Noise of each channel at rest.

    Raises:
        CalibrationError: too short, no channel, or none that can be evaluated.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut")
    period_s = sample_period_s(recording, dut)
    longest = _longest_whole(dut.time_s(), period_s)
    duration_s = (longest.stop - longest.start) * period_s
    if duration_s < MIN_DURATION_S:
        raise refused(
            recording,
            f"{duration_s:.0f} s at rest without a hole are too short for noise coefficients.",
            f"record at least {MIN_DURATION_S:.0f} s; an hour where the bias instability counts",
            "stream dut",
        )
    results: list[SensorResult] = []
    not_used: list[NotUsed] = []
    errors: list[CalibrationError] = []
    outside = len(dut) - (longest.stop - longest.start)
    if outside:
        why = say("a hole parts them from the longest part: a filled hole is not the unit's noise")
        not_used.append(NotUsed(say("samples of the recording"), outside, why))
    for kind in SI:
        for letter in "xyz":
            samples = channel_in_si(recording, dut, kind, letter, period_s)
            if samples is None:
                continue
            channel = f"{kind}_{letter}"
            try:
                results.append(_noise_of(channel, samples[longest], 1.0 / period_s, recordings))
            except CalibrationError as error:
                errors.append(error)
                not_used.append(NotUsed(channel, longest.stop - longest.start, error.what))
    if not results:
        raise (
            errors[0]
            if errors
            else refused(
                recording, "The recording has no gyro and no accelerometer.", "record gyro_x … or acc_x …"
            )
        )
    assumptions = [
        say(
            "overlapping Allan deviation of {duration} s, averaging times up to an eighth of it",
            duration=f"{duration_s:.0f}",
        ),
        say("at rest throughout: warming up and drift stand in the slow terms"),
    ]
    return method_evaluation(recordings, results, assumptions, not_used)


def _longest_whole(time_s: FloatArray, period_s: float) -> slice:
    """The longest part without a hole in its times."""
    edges = np.r_[0, np.flatnonzero(np.diff(time_s) > HOLE_PERIODS * period_s) + 1, len(time_s)]
    longest = int(np.diff(edges).argmax())
    return slice(int(edges[longest]), int(edges[longest + 1]))


def _noise_of(
    channel: str, samples: FloatArray, rate_hz: float, recordings: tuple[Recording, ...]
) -> SensorResult:
    measured = overlapping_allan_deviation(np.ascontiguousarray(samples), rate_hz)
    fit = fit_allan_coefficients(measured)
    unit = SI["acc" if channel.startswith("acc") else "gyro"]
    lowest = int(measured.deviation.argmin())
    beside = (
        Beside(say("least Allan deviation"), float(measured.deviation[lowest]), unit),
        Beside(say("its averaging time"), float(measured.tau_s[lowest]), "s"),
        Beside(say("chi-square of the fit per degree of freedom"), fit.chi_square_ratio, "1"),
    )
    return SensorResult(channel, allan_content(fit, unit), recordings, beside)

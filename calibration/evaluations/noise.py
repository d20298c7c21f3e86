"""Profile 'static': the noise coefficients of IEEE 952 for each gyro and accelerometer, by Allan variance."""

# pyright: strict
import numpy as np

from calibration.algorithms.allan_coefficients import fit_allan_coefficients
from calibration.algorithms.allan_variance import overlapping_allan_deviation
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_number,
    believed_sensor,
    method_evaluation,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.records.method_contents import allan_content
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import factor_to_si

MIN_DURATION_S = 180.0
"""Taus up to an eighth of the record: less than 20 s would tell white noise and nothing of what is slower."""
HOLE_PERIODS = 1.5
_SI = {"gyro": "rad/s", "acc": "m/s^2"}


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
    for kind in ("gyro", "acc"):
        for letter in "xyz":
            samples = _in_si(recording, dut, kind, letter, period_s)
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
    unit = _SI[channel.split("_", maxsplit=1)[0]]
    lowest = int(measured.deviation.argmin())
    beside = (
        Beside(say("least Allan deviation"), float(measured.deviation[lowest]), unit),
        Beside(say("its averaging time"), float(measured.tau_s[lowest]), "s"),
        Beside(say("chi-square of the fit per degree of freedom"), fit.chi_square_ratio, "1"),
    )
    return SensorResult(channel, allan_content(fit, unit), recordings, beside)


def _in_si(recording: Recording, dut: Stream, kind: str, letter: str, period_s: float) -> FloatArray | None:
    """A channel in rad/s or m/s^2 from whichever form the unit sends, shape (n,); None: not there.

    Raises:
        CalibrationError: counts, volts or pulses of which the recording does not say what they stand for.
    """
    name = f"{kind}_{letter}"
    if name in dut.columns and dut.units[name] != "1":
        return dut.si(name)
    positive, negative = f"pulse_{name}_pos", f"pulse_{name}_neg"
    if name in dut.columns:
        raw, per_unit = dut.si(name), _counts_per_unit(recording, kind)
    elif dut.has(positive, negative):
        raw = (dut.si(positive) - dut.si(negative)) / period_s
        per_unit = believed_number(recording, kind, "pulses_per_unit_s")
    elif kind == "gyro" and f"volt_{letter}" in dut.columns:
        raw, per_unit = dut.si(f"volt_{letter}"), believed_number(recording, kind, "volts_per_unit")
    else:
        return None
    unit = believed_sensor(recording, kind).get("unit")
    if per_unit is None or per_unit <= 0.0 or not isinstance(unit, str):
        raise refused(
            recording,
            f"The recording does not say what a count, volt or pulse of the {kind} stands for.",
            f"write believed.{kind}.unit and its counts, volts_per_unit or pulses_per_unit_s",
        )
    return raw / per_unit * factor_to_si(unit)


def _counts_per_unit(recording: Recording, kind: str) -> float | None:
    counts = believed_sensor(recording, kind).get("counts")
    stated = counts.get("per_unit") if isinstance(counts, dict) else None  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return float(stated) if isinstance(stated, int | float) else None

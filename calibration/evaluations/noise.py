"""Profile 'static': the noise coefficients of IEEE 952 for each gyro and accelerometer, by Allan variance.

Beside it, in record and on the page: the modified deviations, 95 % limits of both plots, and the coefficients
by wavelet variance, which is blind to a ramp and so tells a warm-up from rate random walk.
"""

# pyright: strict
from dataclasses import replace

import numpy as np

from calibration.algorithms.allan_coefficients import AllanFit, fit_allan_coefficients
from calibration.algorithms.allan_noise import TERMS, NoiseModel, confidence_intervals
from calibration.algorithms.allan_variance import (
    AllanDeviation,
    modified_allan_deviation,
    overlapping_allan_deviation,
)
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.screening import NotUsed
from calibration.algorithms.wavelet_variance import fit_wavelet_coefficients, wavelet_variance
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
from calibration.records.method_contents import ALLAN_TERMS, allan_content
from calibration.records.record_parts import RecordTable, TableColumn
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

MIN_DURATION_S = 180.0
"""Taus up to an eighth of the record: less than 20 s would tell white noise and nothing of what is slower."""
HOLE_PERIODS = 1.5
WHITE = NoiseModel(random_walk=1.0)


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
    values = np.ascontiguousarray(samples)
    measured = overlapping_allan_deviation(values, rate_hz)
    fit = fit_allan_coefficients(measured)
    unit = SI["acc" if channel.startswith("acc") else "gyro"]
    lowest = int(measured.deviation.argmin())
    content = allan_content(fit, unit)
    tables, by_wavelet = _tables(values, rate_hz, measured, fit, unit)
    beside = (
        Beside(say("least Allan deviation"), float(measured.deviation[lowest]), unit),
        Beside(say("its averaging time"), float(measured.tau_s[lowest]), "s"),
        Beside(say("chi-square of the fit per degree of freedom"), fit.chi_square_ratio, "1"),
        *_by_wavelet(by_wavelet, unit),
    )
    content = replace(content, tables=(*content.tables, *tables))
    return SensorResult(channel, content, recordings, beside)


def _tables(
    samples: FloatArray, rate_hz: float, measured: AllanDeviation, fit: AllanFit, unit: str
) -> tuple[tuple[RecordTable, ...], AllanFit | None]:
    """The three plots with what their points are good for, and the coefficients by wavelet variance."""
    tables = [_deviations("allan_deviation", measured, fit, unit)]
    modified = modified_allan_deviation(
        samples, rate_hz, measured.tau_s[measured.factors * 4 <= len(samples)]
    )
    tables.append(_deviations("modified_allan_deviation", modified, fit, unit))
    try:
        variances = wavelet_variance(samples, rate_hz)
        by_wavelet = fit_wavelet_coefficients(variances)
    except CalibrationError:
        return tuple(tables), None  # too short for its scales: the Allan plot stands alone
    columns = (("scale", "s", variances.tau_s), ("wavelet_deviation", unit, np.sqrt(variances.variance)))
    tables.append(_table("wavelet_deviation", columns))
    return tuple(tables), by_wavelet


def _deviations(name: str, measured: AllanDeviation, fit: AllanFit, unit: str) -> RecordTable:
    """With 95 % limits for the mixture of noises that was fitted."""
    limits = confidence_intervals(measured, fit.model if fit.model.squares[:4].any() else WHITE)
    columns = (
        ("averaging_time", "s", measured.tau_s),
        ("deviation", unit, measured.deviation),
        ("lower_limit_95", unit, limits.lower),
        ("upper_limit_95", unit, limits.upper),
        ("degrees_of_freedom", "1", limits.degrees_of_freedom),
    )
    return _table(name, columns)


def _table(name: str, columns: tuple[tuple[str, str, FloatArray], ...]) -> RecordTable:
    return RecordTable(
        name=name,
        columns=tuple(
            TableColumn(name=column, unit=unit, values=tuple(float(value) for value in values))
            for column, unit, values in columns
        ),
    )


def _by_wavelet(fit: AllanFit | None, unit: str) -> tuple[Beside, ...]:
    """Q, N, B, K by wavelet variance: a ramp or a warm-up along a line is not in them."""
    if fit is None:
        return (Beside(say("by wavelet variance"), None, unit),)
    words = (
        say("quantization by wavelet variance (D4)"),
        say("random walk by wavelet variance"),
        say("bias instability by wavelet variance"),
        say("rate random walk by wavelet variance"),
    )
    units = [of_term for _, of_term in ALLAN_TERMS[unit]]
    return tuple(
        Beside(word, getattr(fit.model, term) if fit.determined(term) else None, of_term)
        for word, term, of_term in zip(words, TERMS, units, strict=False)
    )

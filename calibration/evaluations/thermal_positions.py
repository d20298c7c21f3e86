"""Profile 'thermal_positions': sigma(N, T) of both triads over a matrix of room temperature (paper 2).

Two turntables: M and D come from one at room temperature (recordings `multi_position` and `rotation`), sigma
from the other inside a chamber, in as many mounts as there are recordings. Only differences between
temperatures within one mounting count there.
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.block_means import OUTLIER_SIGMAS
from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.screening import NotUsed, screen_static
from calibration.algorithms.thermal_soaks import SoakFit, SoakReadings, fit_soaks
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refuse_unjoined,
    refused,
    stream_with,
)
from calibration.evaluations.room_matrix import (
    FORCES,
    RATES,
    ROOM_PROFILES,
    RoomMatrix,
    room_matrix,
    temperature_column,
)
from calibration.records.temperature_contents import temperature_content
from calibration.sensor_knowledge import axes, sensor_range, slow_noise
from protocol.language import say
from protocol.recordings import Recording

PROFILE = "thermal_positions"
DWELL_S = 10.0
"""Length of a reading where the recording does not say how long the stand dwelt."""
MARGIN_S = 0.5
PARTS = 2
"""Of a dwell: their difference tells the white noise."""
STEADY_C_PER_S = 0.005
"""A reading while the sensor's temperature changes faster is of no soak (0.3 deg C per minute)."""
TURNING_RAD_S = 0.02
STEADY_RATE_PART = 0.005
DIRECTION_DIGITS = 1
POWER_ON_APART_S = 1e7
"""Between recordings on the common clock: each is a power-on of its own."""


@dataclass(frozen=True)
class _Dwell:
    """Rows of the unit's stream in one position or at one rate; `pose` names it."""

    rows: slice
    pose: tuple[float, ...]


def evaluate_thermal_positions(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Both triads.

    Raises:
        CalibrationError: no matrix of room temperature, no temperature, no truth of the stand, too few soaks,
            or soaks that never became steady.
    """
    thermal = tuple(one for one in recordings if one.test.get("profile") == PROFILE)
    at_room = tuple(one for one in recordings if one.test.get("profile") in ROOM_PROFILES)
    if not at_room:
        raise refused(
            thermal[0],
            "The thermal stand does not tell the matrix: it is frozen from room temperature.",
            "name the unit's recordings multi_position and rotation from a turntable at room temperature "
            "together with these",
        )
    room = room_matrix(at_room)
    not_used: list[NotUsed] = [*room.not_used]
    results: list[SensorResult] = []
    sentences: list[str] = []
    own: list[str] = []
    for kind in ("acc", "gyro"):
        result, said = _sensor(kind, thermal, room, not_used)
        results.append(result)
        own += said
    sentences.append(
        say(
            "matrix and bias frozen from {count} recordings at room temperature, the stand's truth taken as "
            "exact; how a mounting differs from another does not enter",
            count=len(at_room),
        )
    )
    sentences.append(
        say("soaks approached as recorded: hysteresis of the temperature is not in the uncertainties")
    )
    found = method_evaluation(thermal, results, sentences, not_used)
    return replace(found, assumptions=(*own, *found.assumptions))  # each sensor's own are in its record


def _sensor(
    kind: str, thermal: Sequence[Recording], room: RoomMatrix, not_used: list[NotUsed]
) -> tuple[SensorResult, list[str]]:
    frozen: TriadCoefficients = getattr(room, kind)
    room_c = room.temperature_c[kind]
    readings = soak_readings(thermal, kind, not_used)
    slow = slow_noise(thermal[0], kind)
    stated = tuple((term.standard_deviation, term.correlation_time_s) for term in slow)
    fit = fit_soaks(readings, frozen, room_c, stated or None)
    straight = fit_soaks(readings, frozen, room_c, stated or None, highest="linear")
    low_c, high_c = fit.model.calibrated_range_c
    said = [
        say(
            "{sensor}: {soaks} soaks, sensor at {low} … {high} °C; nodes every 5 °C from {room} °C; beyond "
            "{first} … {last} °C nothing is stated",
            sensor=kind,
            soaks=len(fit.soak_c),
            low=f"{fit.soak_c[0]:.1f}",
            high=f"{fit.soak_c[-1]:.1f}",
            room=f"{room_c:.1f}",
            first=f"{low_c:.1f}",
            last=f"{high_c:.1f}",
        ),
        say("{sensor} noise: {words}", sensor=kind, words=fit.noise[0]),
        *_untold(kind, fit),
    ]
    content = temperature_content(fit.model, soak_residuals(fit, readings))
    content = replace(content, assumptions=tuple(said))
    recordings = (*thermal, *room.recordings)
    return SensorResult(kind, content, recordings, _beside(fit, straight, readings, frozen.unit)), said


def _untold(kind: str, fit: SoakFit) -> list[str]:
    """What the positions and rates left open, and which mount tells it."""
    sentences: list[str] = []
    for axis, powers in zip("xyz", fit.powers, strict=True):
        if powers == (2, 1, 0):
            continue
        missing = say("square and slope") if powers == (0,) else say("square")
        sentences.append(
            say(
                "{sensor}_{axis}: {missing} over temperature not told: no mount gave it enough different "
                "inputs; taken as 0",
                sensor=kind,
                axis=axis,
                missing=missing,
            )
        )
    return sentences


def _beside(fit: SoakFit, straight: SoakFit, readings: SoakReadings, unit: str) -> tuple[Beside, ...]:
    uncorrected = readings.output - _at_room(fit, readings)
    return (
        Beside(say("largest change from room temperature"), float(np.abs(uncorrected).max()), unit),
        Beside(say("largest residual, a N² + b N + c"), float(np.abs(fit.residual_si).max()), unit),
        Beside(
            say("largest residual, b N + c (piecewise linear)"),
            float(np.abs(straight.residual_si).max()),
            unit,
        ),
        Beside(
            say("largest change by the splines between the soaks"), float(fit.spline_change_si.max()), unit
        ),
    )


def _at_room(fit: SoakFit, readings: SoakReadings) -> FloatArray:
    """What each pose would have given at room temperature, shape (m, 3)."""
    return readings.output - fit.model.sigma(readings.output, readings.temperature_c)


def soak_residuals(fit: SoakFit, readings: SoakReadings) -> dict[str, FloatArray]:
    """Largest residual of each soak, with its sign, by temperature: what a certificate draws."""
    nearest = np.abs(readings.temperature_c[:, None] - fit.soak_c).argmin(axis=1)
    columns = {"temperature": fit.soak_c}
    for axis, letter in enumerate("xyz"):
        found = [fit.residual_si[nearest == soak, axis] for soak in range(len(fit.soak_c))]
        columns[f"residual_{letter}"] = np.array([one[np.abs(one).argmax()] for one in found])
    return columns


def soak_readings(recordings: Sequence[Recording], kind: str, not_used: list[NotUsed]) -> SoakReadings:
    """Means of both halves of each dwell, for 'acc' at rest, for 'gyro' at rates too.

    Raises:
        CalibrationError: no temperature or truth, clocks that are not joined, no steady reading.
    """
    numbers: dict[tuple[object, ...], int] = {}
    outputs: list[FloatArray] = []
    figures: list[tuple[float, float, float]] = []
    poses: list[int] = []
    unsteady = 0
    for count, recording in enumerate(recordings):
        refuse_unjoined(recording)
        dut = stream_with(recording, "dut", *axes(kind))
        time_s, output = dut.time_s(), dut.si(*axes(kind))
        warmth = np.asarray(dut.columns[temperature_column(recording, kind)], dtype=np.float64)
        limit = sensor_range(recording, kind)
        for dwell in _dwells(recording, turning=kind == "gyro"):
            time, temperature = time_s[dwell.rows], warmth[dwell.rows]
            if not _is_steady(time, temperature):
                unsteady += len(time)
                continue
            name = f"{kind} in {recording.recording_id} at {time[0]:.0f} s"
            usable, left_out = screen_static(name, output[dwell.rows], limit, PARTS * 8, time)
            not_used += left_out
            usable = _without_outliers(name, output[dwell.rows], usable, not_used)
            number = numbers.setdefault((count, *dwell.pose), len(numbers))
            for part in np.array_split(usable, PARTS) if len(usable) else ():
                period_s = float(np.median(np.diff(time)))
                outputs.append(output[dwell.rows][part].mean(axis=0))
                figures.append(
                    (
                        float(np.nanmean(temperature)),
                        count * POWER_ON_APART_S + float(time[part].mean()),
                        period_s * len(part),
                    )
                )
                poses.append(number)
    if unsteady:
        not_used.append(
            NotUsed(say("dwells of {sensor}", sensor=kind), unsteady, say("the temperature was not steady"))
        )
    if not outputs:
        raise refused(
            recordings[0],
            "No dwell has a steady temperature.",
            "soak longer at each temperature, until the sensor changes by less than 0.3 °C a minute",
            "stream dut",
        )
    temperature_c, middle_s, duration_s = np.array(figures).T
    pose = np.array(poses, dtype=np.intp)
    return SoakReadings(np.array(outputs), temperature_c, pose, middle_s, duration_s)


def _is_steady(time_s: FloatArray, temperature_c: FloatArray) -> bool:
    there = np.isfinite(temperature_c)
    if there.sum() < PARTS * 8:
        return False
    time, value = time_s[there], temperature_c[there]
    centred = time - time.mean()
    slope = float(centred @ value / (centred @ centred))
    noise = float((value - value.mean() - slope * centred).std() / np.sqrt(centred @ centred))
    return abs(slope) < STEADY_C_PER_S + 3.0 * noise


def _without_outliers(
    name: str, samples: FloatArray, usable: NDArray[np.intp], not_used: list[NotUsed]
) -> NDArray[np.intp]:
    if len(usable) == 0:
        return usable
    centred = np.abs(samples[usable] - np.median(samples[usable], axis=0))
    # A coarse quantum can make the median deviation zero: then the spread is the measure.
    median = 1.4826 * np.median(centred, axis=0)
    sigma = np.where(median > 0, median, np.sqrt((centred**2).mean(axis=0)))
    wild = (centred > OUTLIER_SIGMAS * np.maximum(sigma, 1e-300)).any(axis=1)
    if wild.any():
        why = f"outliers beyond {OUTLIER_SIGMAS:g} standard deviations"
        not_used.append(NotUsed(name, int(wild.sum()), why))
    return usable[~wild]


def _dwells(recording: Recording, *, turning: bool) -> list[_Dwell]:
    """First and last stretch of each rest, as long as the stand dwelt; steady turns where wanted."""
    dut_s = recording.stream("dut").time_s()
    stand = stream_with(recording, "stand", *RATES, *FORCES)
    stand_s, rate, force = stand.time_s(), stand.si(*RATES), stand.si(*FORCES)
    values = recording.test.get("values")
    told = values.get("dwell_s", DWELL_S) if isinstance(values, dict) else DWELL_S  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    dwell_s = float(told) if isinstance(told, int | float) else DWELL_S
    found: list[_Dwell] = []
    largest = int(np.abs(rate).max(axis=0).argmax())
    along = rate[:, largest]
    still = np.abs(rate).max(axis=1) <= 1e-4
    for first, last in _stretches(still):
        begins, ends = float(stand_s[first]), float(stand_s[last - 1])
        if ends - begins < 0.5 * dwell_s:
            continue
        direction = force[first:last].mean(axis=0)
        length = float(np.linalg.norm(direction))
        pose = tuple(round(part / length, DIRECTION_DIGITS) + 0.0 for part in direction.tolist())
        windows = [(begins, begins + dwell_s), (ends - dwell_s, ends)]
        if ends - begins < 2.0 * dwell_s:
            windows = [(begins, ends)]
        found += [_Dwell(_rows(dut_s, window), (*pose, 0.0)) for window in windows]
    if turning and np.abs(along).max() > TURNING_RAD_S:
        level = np.abs(along).max()
        for sign in (1.0, -1.0):
            steady = np.abs(sign * along - level) < STEADY_RATE_PART * level
            for first, last in _stretches(steady):
                if stand_s[last - 1] - stand_s[first] >= 0.5 * dwell_s:
                    window = (float(stand_s[first]), float(stand_s[last - 1]))
                    found.append(_Dwell(_rows(dut_s, window), (float(largest), 0.0, 0.0, sign)))
    return sorted((one for one in found if one.rows.stop > one.rows.start), key=lambda one: one.rows.start)


def _rows(time_s: FloatArray, window: tuple[float, float]) -> slice:
    start, end = np.searchsorted(time_s, [window[0] + MARGIN_S, window[1] - MARGIN_S]).tolist()
    return slice(start, end)


def _stretches(there: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.diff(np.concatenate([[0], there.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist()
    return list(zip(starts, ends, strict=True))

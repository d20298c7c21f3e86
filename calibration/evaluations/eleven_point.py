"""Profile 'eleven_point': line, linearity, hysteresis and repeatability of analogue rate gyros (paper 4)."""

# pyright: strict
import math

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.earth import EARTH_RATE_RAD_S
from calibration.algorithms.rate_gyro import LINE_METHODS, RateGyroResult, evaluate_rate_gyro
from calibration.algorithms.rate_gyro_uncertainty import Multimeter
from calibration.algorithms.rate_table_readings import RateTable, StrokeReadings, choose_points
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_number,
    method_evaluation,
    refuse_unjoined,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.records.method_contents import rate_gyro_content
from protocol.language import say
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

MINIMUM_RATE_RAD_S, MAXIMUM_RATE_RAD_S = math.radians(5.0), math.radians(1450.0)
TABLE_ACCURACY = 1e-4
METER = Multimeter(reading_part=3.5e-5, range_part=5e-6, range_v=10.0)
"""Bounds of paper 4's table and voltmeter: a recording does not tell its instruments' certificates."""
UP_STROKE, DOWN_STROKE = 1, -1
RANGE_MARGIN = 0.002


def evaluate_eleven_point(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """A line for each axis that was turned.

    Raises:
        CalibrationError: no readings of points, clocks that no trigger joins, a stroke that is missing,
            saturated or not repeated, an output that does not follow the rate.
    """
    (recording,) = recordings
    refuse_unjoined(recording)
    columns = ("duration", "rate", "axis", "cycle", "stroke")
    points = stream_with(recording, "points", *columns)
    dut = stream_with(recording, "dut")
    turned = sorted({int(axis) for axis in points.si("axis")})
    if not set(turned) <= {1, 2, 3}:
        raise refused(
            recording, f"The points name the axes {turned}, not 1, 2, 3.", "correct them", "stream points"
        )
    results: list[SensorResult] = []
    suspects: list[NotUsed] = []
    assumptions: list[str] = []
    for axis in turned:
        letter = "xyz"[axis - 1]
        table, sentence = _table(recording, letter)
        if sentence not in assumptions:
            assumptions.append(sentence)
        readings = _readings(recording, points, dut, axis, table)
        found = evaluate_rate_gyro(readings)
        content = rate_gyro_content(readings, found, table, METER)
        results.append(SensorResult(f"gyro_{letter}", content, recordings, _other_lines(found)))
        count = len(readings.suspects())
        if count:
            why = say("far from the others of their point and stroke: used all the same, look at them")
            suspects.append(NotUsed(say("suspect readings of gyro {axis}", axis=letter), count, why))
    bounds = say(
        "table good to {table} of the rate, voltmeter to {meter} of the reading (bounds, as in paper 4: the "
        "recording does not tell)",
        table=f"{TABLE_ACCURACY:g}",
        meter=f"{METER.reading_part:g}",
    )
    temperature = say("figures are of the temperature that the unit had; line by least squares")
    return method_evaluation(recordings, results, [*assumptions, bounds, temperature], suspects)


def _table(recording: Recording, letter: str) -> tuple[RateTable, str]:
    """The table, with the Earth's rotation along the axis under test, and where that is from."""
    latitude = recording.site.get("latitude_deg")
    if isinstance(latitude, int | float) and math.isfinite(latitude):
        earth = EARTH_RATE_RAD_S * math.sin(math.radians(float(latitude))) * _upward(recording, letter)
        sentence = say("Earth rate along the table's axis from the site's latitude, taken off the bias")
    else:
        earth = 0.0
        sentence = say("the site is not known: what the Earth's rotation adds is in the bias")
    return RateTable(MINIMUM_RATE_RAD_S, MAXIMUM_RATE_RAD_S, TABLE_ACCURACY, earth), sentence


def _upward(recording: Recording, letter: str) -> float:
    """1 with the axis up, -1 with it down, by the force that the stand tells while it turns about it."""
    if "stand" not in recording.streams:
        return 1.0
    stand = recording.streams["stand"]
    if not stand.has(f"acc_{letter}", f"rate_{letter}"):
        return 1.0
    rate = np.abs(stand.si(f"rate_{letter}"))
    turning = rate > 0.5 * float(rate.max())
    along = float(stand.si(f"acc_{letter}")[turning].mean()) if turning.any() else STANDARD_GRAVITY_M_S2
    return float(np.clip(along / STANDARD_GRAVITY_M_S2, -1.0, 1.0))


def _readings(
    recording: Recording, points: Stream, dut: Stream, axis: int, table: RateTable
) -> StrokeReadings:
    """Means of the output over each dwell, sorted by cycle and rate; one that is not there is missing."""
    channel = f"volt_{'xyz'[axis - 1]}"
    volts = stream_with(recording, "dut", channel).si(channel)
    mine = points.si("axis") == axis
    begin_s, duration_s, rate = points.time_s()[mine], points.si("duration")[mine], points.si("rate")[mine]
    cycle = points.si("cycle")[mine].astype(np.int64)
    stroke = points.si("stroke")[mine].astype(np.int64)
    means = _dwell_means(recording, dut, volts, begin_s, duration_s)
    chosen = choose_points(_distinct(rate), table, locked_at_zero=True)
    column = np.abs(rate[:, None] - chosen.rate_rad_s).argmin(axis=1)
    cycles = sorted(set(cycle.tolist()))
    tables: dict[int, FloatArray] = {}
    for direction in (UP_STROKE, DOWN_STROKE):
        readings = np.full((len(cycles), len(chosen.rate_rad_s)), np.nan)
        rows = np.flatnonzero(stroke == direction)
        readings[np.searchsorted(cycles, cycle[rows]), column[rows]] = means[rows]
        tables[direction] = readings
    full_range = believed_number(recording, "gyro", "range")
    volts_per_unit = believed_number(recording, "gyro", "volts_per_unit")
    limit = None
    if full_range is not None and volts_per_unit is not None:
        limit = full_range * volts_per_unit * (1.0 - RANGE_MARGIN)
    return StrokeReadings(chosen, tables[UP_STROKE], tables[DOWN_STROKE], limit)


def _distinct(rate: FloatArray) -> FloatArray:
    """The commanded rates, each once; a table's commands are alike to far below a part in a million."""
    ordered = np.sort(rate)
    apart = np.diff(ordered) > 1e-6 * float(np.abs(ordered).max())
    return ordered[np.r_[True, apart]]


def _dwell_means(
    recording: Recording, dut: Stream, volts: FloatArray, begin_s: FloatArray, duration_s: FloatArray
) -> NDArray[np.float64]:
    """Mean output of each dwell, NaN where half of its samples are not there, shape (k,)."""
    time_s, period_s = dut.time_s(), sample_period_s(recording, dut)
    first = np.searchsorted(time_s, begin_s - 1e-6)
    last = np.searchsorted(time_s, begin_s + duration_s - 1e-6)
    means = np.full(len(begin_s), np.nan)
    for row, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        samples = volts[a:b]
        samples = samples[np.isfinite(samples)]
        if len(samples) >= max(1.0, 0.5 * duration_s[row] / period_s):
            means[row] = samples.mean()
    return means


def _other_lines(found: RateGyroResult) -> tuple[Beside, ...]:
    """Linearity by the lines that paper 4 compares."""
    words = {
        "end_point": say("linearity from the end-point line"),
        "two_halves": say("linearity from the line of two halves"),
        "minimax": say("linearity from the minimax line, the least possible"),
    }
    return tuple(Beside(words[name], found.linearity[name], "1") for name in LINE_METHODS if name in words)

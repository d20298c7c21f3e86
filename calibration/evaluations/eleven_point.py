"""Profile 'eleven_point': line, linearity, hysteresis and repeatability of analogue rate gyros (paper 4)."""

# pyright: strict
import math

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.dwell_means import dwell_means
from calibration.algorithms.earth import EARTH_RATE_RAD_S
from calibration.algorithms.rate_gyro import LINE_METHODS, RateGyroResult, evaluate_rate_gyro
from calibration.algorithms.rate_gyro_uncertainty import (
    Multimeter,
    gum_holds,
    linearity_budget,
    monte_carlo_linearity,
)
from calibration.algorithms.rate_table_readings import RateTable, StrokeReadings, choose_points
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_number,
    method_evaluation,
    refuse_backward_time,
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
LINEARITY_LIMIT = 2e-3
"""Of the class of gyro that paper 4 calibrates."""
TRIALS, SEED = 5_000, 4
"""Of the Monte Carlo run; seeded, so that a recording gives the same figures each time."""
RATE_TOLERANCE = 0.01
"""Of the greatest rate, between what the points name and the table says."""
OTHER_AXIS = 10.0
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
    _refuse_unread_points(recording, points, columns)
    dut = stream_with(recording, "dut")
    refuse_backward_time(recording, dut)
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
        readings, left_out = _readings(recording, points, dut, axis, table)
        suspects += left_out
        found = evaluate_rate_gyro(readings)
        _refuse_other_axis(recording, dut, letter, found)
        if found.lines["least_squares"].sensitivity_v_per_rad_s < 0.0:
            falls = say(
                "output of gyro {axis} falls as the rate rises: see which way it is mounted", axis=letter
            )
            assumptions.append(falls)
        content = rate_gyro_content(readings, found, table, METER)
        beside = (*_other_lines(found), *_linearity_beside(readings, found, table))
        results.append(SensorResult(f"gyro_{letter}", content, recordings, beside))
        count = len(readings.suspects())
        if count:
            why = say("far from the others of their point and stroke: used all the same, look at them")
            suspects.append(NotUsed(say("suspect readings of gyro {axis}", axis=letter), count, why))
    bounds = say(
        "table good to {table} of the rate, voltmeter to {meter} of the reading (bounds, as in Zhong, Zeng & "
        "Li: the recording does not tell)",
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
) -> tuple[StrokeReadings, list[NotUsed]]:
    """Means of the output over each dwell, sorted by cycle and rate; one that is not there is missing."""
    channel = f"volt_{'xyz'[axis - 1]}"
    volts = stream_with(recording, "dut", channel).si(channel)
    mine = points.si("axis") == axis
    begin_s, duration_s, rate = points.time_s()[mine], points.si("duration")[mine], points.si("rate")[mine]
    cycle = points.si("cycle")[mine].astype(np.int64)
    stroke = points.si("stroke")[mine].astype(np.int64)
    _refuse_other_rates(recording, f"rate_{'xyz'[axis - 1]}", begin_s, duration_s, rate)
    dwells = dwell_means(dut.time_s(), volts, begin_s, duration_s, sample_period_s(recording, dut))
    if dwells.unsteady.any():
        named = ", ".join(f"{value:.6g}" for value in rate[dwells.unsteady][:4])
        raise refused(
            recording,
            f"In {int(dwells.unsteady.sum())} of {len(rate)} dwells the output has not settled: at {named} "
            "rad/s.",
            "see that the points' times are those of the recording, and dwell longer after each step",
            "stream points",
        )
    means = dwells.mean
    chosen = choose_points(_distinct(rate), table, locked_at_zero=True)
    column = np.abs(rate[:, None] - chosen.rate_rad_s).argmin(axis=1)
    _, times = np.unique(np.column_stack([cycle, stroke, column]), axis=0, return_counts=True)
    if (times > 1).any():
        raise refused(
            recording,
            f"{int((times > 1).sum())} points of a cycle and stroke are there more than once.",
            "evaluate each run of one unit as a recording of its own",
            "stream points",
        )
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
    left_out = [
        NotUsed(say("samples of {channel} in dwells", channel=channel), count, why)
        for count, why in (
            (dwells.missing, say("missing values (NaN), or never came")),
            (dwells.outliers, say("far from the others of their dwell")),
        )
        if count
    ]
    return StrokeReadings(chosen, tables[UP_STROKE], tables[DOWN_STROKE], limit), left_out


def _distinct(rate: FloatArray) -> FloatArray:
    """The commanded rates, each once; a table's commands are alike to far below a part in a million."""
    ordered = np.sort(rate)
    apart = np.diff(ordered) > 1e-6 * float(np.abs(ordered).max())
    return ordered[np.r_[True, apart]]


def _refuse_unread_points(recording: Recording, points: Stream, columns: tuple[str, ...]) -> None:
    refuse_backward_time(recording, points)
    unread = ~np.isfinite(np.stack([points.si(column) for column in columns])).all(axis=0)
    durations = points.si("duration")
    overlong = points.time_s()[:-1] + durations[:-1] > points.time_s()[1:] + 1e-6
    if unread.any() or overlong.any():
        raise refused(
            recording,
            f"{int(unread.sum())} points hold missing numbers and {int(overlong.sum())} last into the next.",
            "correct them, or take the strokes again",
            "stream points",
        )


def _refuse_other_rates(
    recording: Recording, column: str, begin_s: FloatArray, duration_s: FloatArray, rate: FloatArray
) -> None:
    """The rates that the points name are those that the table says it turned with, where it says so."""
    stand = recording.streams.get("stand")
    if stand is None or not len(stand) or not stand.has(column):
        return
    time_s, turned = stand.time_s(), stand.si(column)
    known = np.isfinite(time_s) & np.isfinite(turned)
    middle = np.interp(begin_s + 0.5 * duration_s, time_s[known], turned[known]) if known.any() else rate
    off = np.abs(middle - rate) > RATE_TOLERANCE * float(np.abs(rate).max())
    if off.any():
        raise refused(
            recording,
            f"At {int(off.sum())} of {len(rate)} points the table's own rate is another, the first time "
            f"{middle[off][0]:.6g} instead of {rate[off][0]:.6g} rad/s.",
            "look at the unit of the points' rate, the axis that turned, and the clocks of stand and points",
            "stream points",
        )


def _refuse_other_axis(recording: Recording, dut: Stream, letter: str, found: RateGyroResult) -> None:
    """Another gyro that follows the table ten times as much is the one that was turned."""
    spans = {
        axis: float(np.ptp(values))
        for axis in "xyz"
        if dut.has(f"volt_{axis}") and len(values := _finite(dut.si(f"volt_{axis}")))
    }
    largest = max(spans, key=lambda axis: spans[axis])
    if largest != letter and spans[largest] > OTHER_AXIS * found.full_scale_v and _alone(recording):
        raise refused(
            recording,
            f"The points say that axis {letter} turned; gyro {largest} followed ({spans[largest]:.3g} V), "
            f"gyro {letter} did not ({found.full_scale_v:.3g} V).",
            "see which axis turned, and whether the outputs are connected to the right channels",
        )


def _alone(recording: Recording) -> bool:
    """Whether one axis alone was turned in the recording: else the others' outputs tell nothing."""
    return len(set(recording.stream("points").si("axis").tolist())) == 1


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _other_lines(found: RateGyroResult) -> tuple[Beside, ...]:
    """Linearity by the lines that paper 4 compares."""
    words = {
        "end_point": say("linearity from the end-point line"),
        "two_halves": say("linearity from the line of two halves"),
        "minimax": say("linearity from the minimax line, the least possible"),
    }
    return tuple(Beside(words[name], found.linearity[name], "1") for name in LINE_METHODS if name in words)


def _linearity_beside(
    readings: StrokeReadings, found: RateGyroResult, table: RateTable
) -> tuple[Beside, ...]:
    """Whether U may judge the class's limit (paper 4), and the linearity by Monte Carlo (JCGM 101)."""
    line = found.lines["least_squares"]
    worst = int(np.abs(line.residual_v).argmax())
    budget = linearity_budget(readings, line, table, METER, worst)
    check = budget.against_limit(LINEARITY_LIMIT)
    generator = np.random.default_rng(SEED)
    drawn = monte_carlo_linearity(readings, "least_squares", table, METER, generator, TRIALS)
    low, high = (float(bound) for bound in drawn.point_interval[:, worst])
    verdict = say("good enough") if check.good_enough else say("not good enough")
    agree = say("agrees") if gum_holds(budget, (low, high)) else say("does not agree")
    return (
        Beside(
            say(
                "U (k = 2) of the linearity over the class's limit of {limit} %: {verdict}, 1/3 is allowed",
                limit=f"{100 * LINEARITY_LIMIT:g}",
                verdict=verdict,
            ),
            check.ratio,
            "1",
        ),
        Beside(
            say("half of the 95 % interval at this point by Monte Carlo: the budget {agree}", agree=agree),
            0.5 * (high - low),
            "1",
        ),
        Beside(
            say("linearity that a straight gyro would show here, 95 %"),
            drawn.straight_line_95,
            "1",
        ),
    )

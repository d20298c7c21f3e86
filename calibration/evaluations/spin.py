"""Profile 'spin': zeros, sensitivity ratio and orthogonality of two magnetometer channels (paper 1, 5.4)."""

# pyright: strict
from dataclasses import replace

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.magnetometer_spin import SpinCoefficients, spin_ellipse, spin_min_max
from calibration.algorithms.roll_error import RollLatency, roll_of_latency_rad
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    believed_number,
    believed_sensor,
    method_evaluation,
    refused,
    stream_with,
)
from calibration.evaluations.spin_roll import SpinRoll, roll_against_stand
from calibration.records.attitude_contents import CLOCK_DRIFT
from calibration.records.content_parts import quantity, record_table
from calibration.records.making import RecordContent, covariance_block
from calibration.records.record_parts import CalibratedQuantity, Model, RecordTable
from protocol.language import say
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import factor_to_si

TURNING_PART = 0.02
"""Of the highest rate: below it the stand is at rest, and its samples are of one direction."""
RANGE_MARGIN = 0.002
SECTORS = 36
CRYSTAL_LIMIT = 1e-4
"""Relative: beyond it a clock is no crystal's."""
U_STAND_FIELD_T = 1e-8
"""Standard uncertainty of what the stand's own motors add, part of it in step with the turn."""


def evaluate_spin(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """The two channels across the axis of spin.

    Raises:
        CalibrationError: no magnetometer, nothing that tells the axis of spin, a stand that did not turn,
            saturated channels, phases with a hole, no ellipse.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut", "mag_x", "mag_y", "mag_z")
    axis, turning = _spin(recording, dut)
    first, second = (f"mag_{'xyz'[(axis + step) % 3]}" for step in (1, 2))
    both = dut.si(first, second)
    there = np.isfinite(both).all(axis=1)
    saturated = there & (np.abs(both) >= _limit_si(recording)).any(axis=1)
    used = turning & there & ~saturated
    not_used = [
        NotUsed(what, int(count), why)
        for what, count, why in (
            (say("samples at rest"), (~turning).sum(), say("one direction only")),
            (say("samples"), (~there & turning).sum(), say("missing (NaN)")),
            (say("samples of the magnetometer"), (saturated & turning).sum(), say("at the end of the range")),
        )
        if count
    ]
    if saturated.sum() > 0.5 * max(int(there.sum()), 1):
        raise refused(
            recording,
            f"The magnetometer is at the end of its range in {int(saturated.sum())} of {len(dut)} samples.",
            "spin in a weaker field, or choose a wider range",
            "stream dut",
        )
    found = spin_ellipse(both[used, 0], both[used, 1])
    paper = spin_min_max(both[used, 0], both[used, 1])
    roll = roll_against_stand(recording, dut, axis, found, both, used)
    content = _content(found, first[-1], second[-1])
    content = replace(content, tables=(_distances(found, both[used]),))
    if roll is not None and roll.latency is not None:
        content = replace(content, quantities=(*content.quantities, *_latency(roll.latency)))
    beside = (*_beside(paper, found), *_of_roll(roll))
    result = SensorResult("mag", content, recordings, beside)
    assumptions = [
        say("spin about body {axis}; the field across it is steady", axis="xyz"[axis]),
        say(
            "field of the stand's own motors {field} nT (standard uncertainty)",
            field=f"{U_STAND_FIELD_T * 1e9:g}",
        ),
        say("what the field along the axis adds through the cross-axis sensitivity is in the zeros"),
        *_clock_words(roll),
    ]
    if found.outliers:
        why = say("far from the ellipse")
        not_used.append(NotUsed(say("samples of the magnetometer"), found.outliers, why))
    return method_evaluation(recordings, [result], assumptions, not_used)


def _limit_si(recording: Recording) -> float:
    limit, unit = believed_number(recording, "mag", "range"), believed_sensor(recording, "mag").get("unit")
    if limit is None or not isinstance(unit, str):
        return float("inf")
    return limit * factor_to_si(unit) * (1.0 - RANGE_MARGIN)


def _spin(recording: Recording, dut: Stream) -> tuple[int, np.ndarray]:
    """Axis of spin, and which samples of the unit were taken in it: by the stand, else by the gyros."""
    names = ("rate_x", "rate_y", "rate_z")
    joined = recording.test.get("triggered") is not False
    if "stand" in recording.streams and recording.streams["stand"].has(*names):
        stand = recording.streams["stand"]
        rates, time_s = stand.si(*names), stand.time_s()
        axis = int(np.nansum(np.abs(rates), axis=0).argmax())
        rate = np.interp(dut.time_s(), time_s, rates[:, axis]) if joined else None
    elif dut.has("gyro_x", "gyro_y", "gyro_z"):
        rates = dut.si("gyro_x", "gyro_y", "gyro_z")
        axis = int(np.nansum(np.abs(rates), axis=0).argmax())
        rate = rates[:, axis]
    else:
        raise refused(
            recording,
            "Neither the stand's rates nor gyros tell about which axis the unit was spun.",
            "record the stand's rate_x, rate_y, rate_z",
        )
    highest = float(np.nanmax(np.abs(rates[:, axis])))
    if highest <= 0.0:
        raise refused(recording, "The stand did not turn.", "spin the unit all the way round")
    if rate is None:
        return axis, np.ones(len(dut), dtype=np.bool_)
    return axis, np.nan_to_num(np.abs(rate)) > TURNING_PART * highest


def _content(found: SpinCoefficients, x: str, y: str) -> RecordContent:
    """`x`, `y`: the channels across the axis, in its right-handed order."""
    names = (f"hard_iron_{x}", f"hard_iron_{y}", f"sensitivity_ratio_{x}{y}")
    names += (f"nonorthogonality_{x}{y}", "field_across_axis")
    symbols = (f"d_{x}", f"d_{y}", "K_y", "alpha", "B")
    units = ("T", "T", "1", "rad", "T")
    values = (found.zero_x, found.zero_y, found.ratio_y, found.nonorthogonality_rad, found.radius)
    covariance = _with_stand_field(found)
    return RecordContent(
        method="magnetometer",
        model=Model(
            name="spin", equation=f"{x} = d_{x} + B cos(theta - alpha); {y} = d_{y} + (B / K_y) sin(theta)"
        ),
        quantities=tuple(
            CalibratedQuantity(
                name=name, symbol=symbol, value=value, unit=unit, standard_uncertainty=float(u)
            )
            for name, symbol, value, unit, u in zip(
                names, symbols, values, units, np.sqrt(np.diag(covariance)), strict=True
            )
        ),
        covariance=(covariance_block(names, covariance),),
    )


def _distances(found: SpinCoefficients, output: FloatArray) -> RecordTable:
    """Mean distance of the outputs from the ellipse over the angle of the spin, in `SECTORS` of a turn.

    `output`: shape (n, 2), T. The model is solved for the angle, and its radius for what is left.
    """
    sine = (output[:, 1] - found.zero_y) * found.ratio_y / found.radius
    alpha = found.nonorthogonality_rad
    cosine = ((output[:, 0] - found.zero_x) / found.radius - sine * np.sin(alpha)) / np.cos(alpha)
    sector = np.floor(np.arctan2(sine, cosine) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    distance = found.radius * (np.hypot(cosine, sine) - 1.0)
    counts = np.bincount(sector, minlength=SECTORS)
    seen = counts > 0
    sums = np.bincount(sector, weights=distance, minlength=SECTORS)
    middle = 2.0 * np.pi * (np.arange(SECTORS) + 0.5) / SECTORS
    return record_table(
        "distance_from_the_ellipse",
        ("angle", "rad", middle[seen]),
        ("mean_distance", "T", sums[seen] / counts[seen]),
        note="mean over sectors of a turn",
    )


def _latency(latency: RollLatency) -> list[CalibratedQuantity]:
    """With the drift of the clocks where the spins told it."""
    found = [quantity("roll_latency", "tau", latency.latency_s, "s", latency.latency_standard_uncertainty_s)]
    if latency.clock_drift is not None:
        found.append(quantity(CLOCK_DRIFT, "d", latency.clock_drift[0], "1", latency.clock_drift[1]))
    return found


def _clock_words(roll: SpinRoll | None) -> list[str]:
    """How fast the unit's clock runs, and whether a crystal does."""
    if roll is None or roll.latency is None or roll.latency.clock_drift is None:
        return []
    drift, u = roll.latency.clock_drift
    ppm = {"ppm": f"{drift * 1e6:.1f}", "doubt": f"{u * 1e6:.2g}"}
    words = [say("the unit's clock runs {ppm} ± {doubt} ppm fast by the spins, taken out", **ppm)]
    if abs(drift) - 2.0 * u > CRYSTAL_LIMIT:
        words.append(
            say(
                "no crystal is {limit} ppm off: look at how the unit stamps its samples, and for lost ones",
                limit=f"{CRYSTAL_LIMIT * 1e6:g}",
            )
        )
    return words


def _of_roll(roll: SpinRoll | None) -> tuple[Beside, ...]:
    """Of the corrected roll, against the stand's encoder."""
    if roll is None:
        return (Beside(say("error of the roll against the stand's angle"), None, "rad"),)
    return (
        Beside(say("spin rate of the error of the roll"), roll.rate_rad_s, "rad/s"),
        Beside(
            say("error of the roll at that rate, standard deviation"), roll.error.standard_deviation, "rad"
        ),
        Beside(say("of it once a turn: a zero that is wrong"), roll.error.once_per_turn, "rad"),
        Beside(
            say("of it twice a turn: ratio or orthogonality that is wrong"), roll.error.twice_per_turn, "rad"
        ),
        Beside(
            say("lag of the roll at that rate by the latency"),
            None if roll.latency is None else roll_of_latency_rad(roll.latency.latency_s, roll.rate_rad_s),
            "rad",
        ),
    )


def _with_stand_field(found: SpinCoefficients) -> FloatArray:
    """Of (dX, dY, K_y, alpha, B): the fit's covariance, and the stand's field in each of them."""
    covariance: FloatArray = np.zeros((5, 5)) if found.covariance is None else found.covariance.copy()
    part = U_STAND_FIELD_T / found.radius
    of_field = np.array([U_STAND_FIELD_T, U_STAND_FIELD_T, np.sqrt(2.0) * part, part, U_STAND_FIELD_T])
    return covariance + np.diag(of_field**2)


def _beside(paper: SpinCoefficients, found: SpinCoefficients) -> tuple[Beside, ...]:
    return (
        Beside(say("zero of the first channel by extremes, paper 1, eq (5)"), paper.zero_x, "T"),
        Beside(say("zero of the second channel by extremes, eq (5)"), paper.zero_y, "T"),
        Beside(say("sensitivity ratio by extremes, eq (6)"), paper.ratio_y, "1"),
        Beside(say("orthogonality by one sample, eq (8)"), paper.nonorthogonality_rad, "rad"),
        Beside(say("distance from the ellipse, rms"), found.residual_rms, "T"),
    )

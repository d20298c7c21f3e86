"""The gyros of a multi-position session, from gravity turned between its rests."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients
from calibration.algorithms.screening import MAX_PERIOD_RATIO, NotUsed, saturated
from calibration.algorithms.turned_gravity import (
    GravitySession,
    Turn,
    TurnedGravityFit,
    fit_turned_gravity,
    turns_between,
)
from calibration.evaluation import GyroBias, Residual
from calibration.sensor_knowledge import axes, sensor_range
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

TURNS_LOST = "samples missing or at the end of the range: the turn was not seen whole"
NamedRows = list[tuple[str, NDArray[np.intp]]]


@dataclass(frozen=True)
class TurnedGyros:
    """Coefficients with what a person is told of them."""

    fit: TurnedGravityFit
    residuals: tuple[Residual, ...]
    sentences: tuple[str, ...]


def gyros_from_turned_gravity(
    recording: Recording,
    rows: NamedRows,
    acc: TriadCoefficients,
    bias: GyroBias,
    gravity_m_s2: float,
    not_used: list[NotUsed],
) -> TurnedGyros | None:
    """Matrix and bias of the gyros; None where the turns cannot carry them, which goes to `not_used`.

    Args:
        recording: with gyro_x … in its stream 'dut'.
        rows: name and usable rows of each rest, in time order.
        acc: coefficients of the accelerometer from the same rests.
        bias: of the gyros in the rests.
        gravity_m_s2: at the site.
        not_used: is added to.
    """
    stream = recording.stream("dut")
    time_s, gyro = stream.time_s(), stream.si(*axes("gyro"))
    bounds = [(int(index[0]), int(index[-1]) + 1) for _, index in rows]
    bad = ~np.isfinite(gyro).all(axis=1) | saturated(gyro, sensor_range(recording, "gyro"))
    spacing = np.diff(time_s)
    bad[1:] |= spacing > MAX_PERIOD_RATIO * float(np.median(spacing))
    worse = np.concatenate([[0], np.cumsum(bad)])
    usable = [bool(worse[after[1]] == worse[before[0]]) for before, after in itertools.pairwise(bounds)]
    lost = usable.count(False)
    if lost:
        not_used.append(NotUsed(say("turns between rests"), lost, say(TURNS_LOST)))
    session = GravitySession(
        time_s=time_s,
        gyro_rad_s=gyro,
        specific_force_m_s2=acc.compensate(stream.si(*axes("acc"))),
        rests=tuple(bounds),
        turns=turns_between(len(bounds), usable),
        bias_rad_s=bias.bias_rad_s,
        bias_deviation_rad_s=bias.standard_uncertainty_rad_s * np.sqrt(bias.degrees_of_freedom + 1),
        white_density=_white_density(rows, gyro, float(np.median(spacing))),
        gravity_m_s2=gravity_m_s2,
        acc=acc,
    )
    try:
        fit = fit_turned_gravity(session, f"recording {recording.recording_id}")
    except CalibrationError as error:
        not_used.append(NotUsed(say("gyro matrix"), len(stream), error.what))
        return None
    for turn in fit.outliers:
        why = say("gravity was turned otherwise than the gyros say: moved at a rest, or hit")
        not_used.append(NotUsed(_name(rows, turn), 1, why))
    residuals = tuple(
        Residual(_name(rows, turn), (float(angle),), "rad")
        for turn, angle in zip(fit.turns, fit.residuals_rad, strict=True)
    )
    return TurnedGyros(fit, residuals, _sentences(fit))


def _sentences(fit: TurnedGravityFit) -> tuple[str, ...]:
    sentences = [
        say("gyros: gravity as turned between {count} pairs of rests", count=len(fit.turns)),
        say("gyros' body axes are those of the accelerometer: misalignment to them is in M"),
    ]
    if fit.direction_rad > 0.0:
        sentences.append(
            say(
                "gravity's direction scatters by {angle}° from rest to rest (standard deviation): it is in "
                "the uncertainties",
                angle=f"{np.degrees(fit.direction_rad):.2g}",
            )
        )
    return tuple(sentences)


def _name(rows: NamedRows, turn: Turn) -> str:
    return f"{rows[turn.before][0]} → {rows[turn.after][0]}"


def _white_density(rows: NamedRows, gyro: FloatArray, period_s: float) -> float:
    """Of the noisiest gyro, from neighbouring samples at rest: (rad/s)^2 s."""
    differences = np.concatenate([np.diff(gyro[index], axis=0) for _, index in rows])
    differences = differences[np.isfinite(differences).all(axis=1)]
    return float((differences**2).mean(axis=0).max()) / 2.0 * period_s if len(differences) else 0.0

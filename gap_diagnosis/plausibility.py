# pyright: strict
"""Mistakes of a bench that are no gap: an axis with the wrong sign, axes exchanged, units mixed up.

They are known by correlation and gain: no sensor effect turns an axis round or is wrong by 57.3. A recording
with one is refused, since every effect that were found in it would be the mistake's.
"""

import math

import numpy as np

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.belief import QUANTITY
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.observation import AXES, Observation, SensorOutput
from protocol.errors import Fault
from protocol.units_of_measure import KNOWN_UNITS, factor_to_si, quantity_of

AGREES, DISAGREES, CLEARLY = 0.9, 0.5, 0.02
"""|correlation| of an axis with the one that it shows, the largest with its own, and what it is more by."""
GAIN_TOLERANCE = 0.15
"""Of the logarithm: a scale factor is never so wrong, and no two units are so near."""
LEAST_GAIN_CORRELATION = 0.9
MAX_ROWS = 20_000
MOVES: dict[SensorName, float] = {"gyro": 1e-2, "acc": 0.5, "mag": 2e-6}
"""SI, rms: what moves less is too near to noise and bias."""


def refuse_mistakes(observation: Observation) -> None:
    """Look for a mistake in every triad.

    Raises:
        DiagnosisError: there is one; it says which.
    """
    for sensor in ("gyro", "acc", "mag"):
        output = observation.outputs.get(sensor)
        if output is not None:
            where = f"recording {observation.recording_id}, columns {sensor}_x, {sensor}_y, {sensor}_z"
            _refuse_wrong_unit(sensor, output, where)
            _refuse_wrong_axes(sensor, output, where)


def _rows(output: SensorOutput) -> tuple[FloatArray, FloatArray, list[int]]:
    """(m, k) values and predictions of the axes that the unit has, and which those are."""
    axes = [axis for axis in range(3) if np.isfinite(output.values_si[:, axis]).any()]
    known = np.isfinite(output.values_si[:, axes]).all(axis=1) & np.isfinite(output.predicted_si).all(axis=1)
    rows = np.flatnonzero(known)
    rows = rows[:: max(1, math.ceil(len(rows) / MAX_ROWS))]
    return output.values_si[rows], output.predicted_si[rows], axes


def _refuse_wrong_axes(sensor: SensorName, output: SensorOutput, where: str) -> None:
    values, predicted, axes = _rows(output)
    moving = [axis for axis in axes if len(values) > 100 and predicted[:, axis].std() > MOVES[sensor]]
    moving = [axis for axis in moving if values[:, axis].std() > 0]
    for axis in moving:
        others = [o for o in range(3) if o == axis or (o in moving)]
        found = {other: _correlation(values[:, axis], predicted[:, other]) for other in others}
        shown = max(found, key=lambda other: abs(found[other]))
        name = f"{sensor}_{AXES[axis]}"
        is_other = (
            shown != axis and abs(found[shown]) > AGREES and abs(found[shown]) > abs(found[axis]) + CLEARLY
        )
        if found[axis] < -AGREES and not is_other:
            raise DiagnosisError(
                f"{name} has the wrong sign: it shows the stand's motion turned round "
                f"(correlation {found[axis]:.3f}).",
                where=where,
                fault=Fault.DATA,
                remedy="turn the sign of this column, or tell the stand's motion in the unit's axes.",
            )
        if is_other and found[axis] < DISAGREES:
            sign = "" if found[shown] > 0 else "−"
            raise DiagnosisError(
                f"Axes are exchanged: {name} shows what the stand reports for {sign}{AXES[shown]} "
                f"(correlation {found[shown]:.3f}, with its own {found[axis]:.3f}).",
                where=where,
                fault=Fault.DATA,
                remedy="name the columns by the unit's axes, or tell the stand's motion in those.",
            )


def _correlation(one: FloatArray, other: FloatArray) -> float:
    return float(np.corrcoef(one, other)[0, 1])


def _refuse_wrong_unit(sensor: SensorName, output: SensorOutput, where: str) -> None:
    """All axes that move have one gain, and it is the ratio of two units."""
    gains = _gains(sensor, output)
    if not gains or max(gains) / min(gains) > math.exp(2 * GAIN_TOLERANCE):
        return
    gain = math.exp(float(np.mean(np.log(gains))))
    if abs(math.log(gain)) < 2 * GAIN_TOLERANCE:
        return
    units = [unit for unit in KNOWN_UNITS if quantity_of(unit) == QUANTITY[sensor]]
    for said in units:
        for meant in units:
            ratio = factor_to_si(said) / factor_to_si(meant)
            if said != meant and abs(math.log(gain / ratio)) < GAIN_TOLERANCE:
                raise DiagnosisError(
                    f"The {sensor} is {gain:.4g} times what the stand reports: a column in '{meant}' was "
                    f"taken for one in '{said}', or the stand's the other way round.",
                    where=where,
                    fault=Fault.DATA,
                    remedy="correct the unit of the unit's or of the stand's columns in recording.json.",
                )


def _gains(sensor: SensorName, output: SensorOutput) -> list[float]:
    """Of each axis that moves clearly by the larger of the two; specific force counts at rest as well."""
    values, predicted, axes = _rows(output)
    gains: list[float] = []
    if len(values) <= 100:
        return gains
    if sensor == "acc" and len(axes) == 3:
        length, told = (
            float(np.linalg.norm(values.mean(axis=0))),
            float(np.linalg.norm(predicted.mean(axis=0))),
        )
        if told > MOVES["acc"] and length > 0:
            gains.append(length / told)
    for axis in axes:
        y, u = values[:, axis] - values[:, axis].mean(), predicted[:, axis] - predicted[:, axis].mean()
        if min(y.std(), u.std()) <= 0 or max(y.std(), u.std()) < MOVES[sensor]:
            continue
        if abs(_correlation(y, u)) > LEAST_GAIN_CORRELATION:
            gains.append(float(y.std() / u.std()))
    return gains

# pyright: strict
"""Values that stand at their extreme while the prediction goes beyond, inside the believed range.

A stop is seen, on each axis by itself, where many values are one and the same extreme, where they would not
be by chance of the quantum, and where what is predicted lies beyond it. Where nothing is predicted, the
extreme must come in runs and far more often than values near it. A stop at both sides, or at the only side
that was reached, is the catalogue's saturation; one that the other side of the same axis, driven as far,
does not have is not in the catalogue.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import SI_UNIT, FloatArray, SensorName
from gap_diagnosis.doubtful_samples import RANGE_MARGIN, piled_up
from gap_diagnosis.lattice import sample_noise
from gap_diagnosis.observation import AXES, Oddity, SensorOutput, SetAside, TimingFinding

LEAST_STOPPED = 6
PER_SAMPLE = 5.0
"""Log likelihood ratio of one sample at the stop."""
TIMES_THE_NEXT = 5.0
"""As many values as there are in an equal step below the stop, so many times."""
BEYOND_SIGMAS = 3.0
SAME_RANGE = 0.02
LEAST_BEYOND = 0.5
"""Of the samples at the stop: those whose prediction lies at it or beyond."""


@dataclass(frozen=True)
class Stop:
    """One side of one axis: `level_si` signed, `count` of rows at it, `rows` (n,)."""

    axis: int
    level_si: float
    rows: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Rows at the stop."""
        return int(self.rows.sum())


def clipped(
    sensor: SensorName, output: SensorOutput, sent_si: FloatArray
) -> tuple[SensorOutput, TimingFinding | None, list[Oddity], list[SetAside]]:
    """The triad with stopped samples as missing; the finding; what the catalogue has not.

    `sent_si`: (n, 3) as sent, with what has been set aside in `output` already.
    """
    stops: list[Stop] = []
    oddities: list[Oddity] = []
    for axis in range(output.values_si.shape[1]):
        values, predicted = sent_si[:, axis], output.predicted_si[:, axis]
        sides = {sign: _stop(axis, sign, values, predicted, output.quantum_si) for sign in (1.0, -1.0)}
        sides |= {s: _unseen_stop(axis, s, values, predicted) for s, stop in sides.items() if stop is None}
        end_si = (1.0 - RANGE_MARGIN) * output.range_si - output.quantum_si
        found = {
            sign: stop for sign, stop in sides.items() if stop is not None and abs(stop.level_si) < end_si
        }
        stops += found.values()
        if len(found) == 1:
            ((sign, stop),) = found.items()
            meant = np.where(np.isfinite(predicted), predicted, values)
            if _goes_on(-sign, abs(stop.level_si), values, meant, output.quantum_si):
                oddities.append(_one_sided(sensor, stop))
        if len(found) == 2 and not _alike(list(found.values())):
            oddities.append(_one_sided(sensor, min(found.values(), key=lambda stop: abs(stop.level_si))))
    if not stops:
        return output, None, [], []
    values = output.values_si.copy()
    said: list[SetAside] = []
    for stop in stops:
        values[stop.rows, stop.axis] = np.nan
        said.append(SetAside(f"{sensor}_{AXES[stop.axis]}", stop.count, "stands at its extreme"))
    output = dataclasses.replace(output, values_si=values)
    odd = {oddity.channel for oddity in oddities}
    regular = [stop for stop in stops if f"{sensor}_{AXES[stop.axis]}" not in odd]
    return output, _finding(sensor, regular, output.quantum_si) if regular else None, oddities, said


def _stop(
    axis: int, sign: float, values: FloatArray, predicted: FloatArray, quantum_si: float
) -> Stop | None:
    known = np.isfinite(values) & np.isfinite(predicted)
    if known.sum() < 10 * LEAST_STOPPED:
        return None
    outward, meant = sign * values, sign * predicted
    level = float(outward[known].max())
    span = float(np.ptp(values[known]))
    with np.errstate(invalid="ignore"):
        rows: NDArray[np.bool_] = known & (outward >= level - 1e-9 * span)
    count = int(rows.sum())
    if count < LEAST_STOPPED or span <= 0 or level <= 0:
        return None
    step = max(quantum_si, 1e-3 * span)
    below = int(((outward >= level - 1.5 * step) & known & ~rows).sum())
    below = min(below, int(((outward >= level - 10.5 * step) & known & ~rows).sum() / 5))
    noise = max(sample_noise(values), quantum_si)
    beyond = meant[rows] - level
    goes_beyond = np.mean(beyond > 0) > LEAST_BEYOND and float(beyond.max()) > BEYOND_SIGMAS * noise
    if not goes_beyond or count < TIMES_THE_NEXT * below:
        return None
    return Stop(axis, sign * level, rows)


def _unseen_stop(axis: int, sign: float, values: FloatArray, predicted: FloatArray) -> Stop | None:
    """Runs of one and the same extreme where nobody tells the motion, more of them than of values near."""
    unseen: FloatArray = np.where(np.isfinite(predicted), np.nan, values)
    if not np.isfinite(unseen).any():
        return None
    level = float(np.nanmax(sign * unseen))
    with np.errstate(invalid="ignore"):
        rows: NDArray[np.bool_] = piled_up(unseen) & (sign * unseen >= level)
        beyond = bool((sign * values > level).any())
    if rows.sum() < LEAST_STOPPED or level <= 0.0 or beyond:
        return None
    return Stop(axis, sign * level, rows)


def _goes_on(sign: float, level: float, values: FloatArray, predicted: FloatArray, quantum_si: float) -> bool:
    """Values of the other side that follow the prediction beyond this level."""
    beyond = (sign * values > level * (1.0 + SAME_RANGE) + 2.0 * quantum_si) & (sign * predicted > level)
    return int(beyond.sum()) >= LEAST_STOPPED


def _alike(stops: list[Stop]) -> bool:
    one, other = (abs(stop.level_si) for stop in stops)
    return abs(one - other) < SAME_RANGE * max(one, other)


def _one_sided(sensor: SensorName, stop: Stop) -> Oddity:
    name = f"{sensor}_{AXES[stop.axis]}"
    said = f"{name} clips at one side: at {stop.level_si:.5g} {SI_UNIT[sensor]}, in {stop.count} samples"
    return Oddity(said, name, math.exp(-min(PER_SAMPLE * stop.count, 600.0)))


def _finding(sensor: SensorName, stops: list[Stop], quantum_si: float) -> TimingFinding:
    levels = np.array([abs(stop.level_si) for stop in stops])
    range_si = float(np.average(levels, weights=[stop.count for stop in stops]))
    uncertainty = math.hypot(float(np.ptp(levels)) / math.sqrt(12.0), quantum_si / math.sqrt(12.0))
    count = sum(stop.count for stop in stops)
    names = ", ".join(sorted({f"{sensor}_{AXES[stop.axis]}" for stop in stops}))
    unit = SI_UNIT[sensor]
    said = f"{names} stops at {range_si:.5g} {unit} in {count} samples although the motion goes on."
    return TimingFinding(
        f"{sensor}.saturation",
        (sensor,),
        "range_si",
        range_si,
        max(uncertainty, 1e-6 * range_si),
        unit,
        min(PER_SAMPLE * count, 1e6),
        said,
        channels=tuple(sorted({f"{sensor}_{AXES[stop.axis]}" for stop in stops})),
    )

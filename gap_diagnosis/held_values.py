# pyright: strict
"""A channel that repeats its last value now and then while the triad's others go on: not in the catalogue.

Of values without a quantum no two in a row are equal; of values with one, steps of none are as frequent as
those of one and two quanta have it (P0 = P1^(4/3) / P2^(1/3), a normal step); the quantum is the believed one
or that of the digits in which the values were written. Looked at where the frame as a whole is new, and only
on channels whose noise crosses a quantum: others stand still by themselves. What the triad's other channels
do nearly as often is the writing's, too.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from dut_emulator.effects.effect import SensorName
from gap_diagnosis.frames import is_slower
from gap_diagnosis.lattice import lattice_of
from gap_diagnosis.observation import AXES, Oddity, SensorOutput, SetAside

LEAST_FRAMES = 200
LEAST_SHARE = 2e-3
CROSSING = 0.75
"""Of two quanta's steps, relative to one's, where the noise crosses quanta."""
EXCESS = 1.5
TIMES_THE_OTHERS = 4.0
LARGEST_P = 1e-6


def held_channels(
    sensor: SensorName, output: SensorOutput
) -> tuple[SensorOutput, list[Oddity], list[SetAside]]:
    """The triad with held values as missing; what was seen."""
    steps = np.diff(output.values_si, axis=0)
    same = steps == 0.0
    there = [axis for axis in range(3) if np.isfinite(steps[:, axis]).sum() > LEAST_FRAMES]
    oddities: list[Oddity] = []
    notes: list[SetAside] = []
    kept = output.values_si
    if len(there) < 2:
        return output, [], []
    new = ~same[:, there].all(axis=1)
    share = {axis: np.count_nonzero(same[new, axis]) / max(np.count_nonzero(new), 1) for axis in there}
    for axis in there:
        others = max(share[other] for other in there if other != axis)
        if share[axis] < TIMES_THE_OTHERS * others:
            continue
        known = new & np.isfinite(steps[:, axis])
        held = known & same[:, axis]
        count, number = int(held.sum()), int(known.sum())
        written = None if output.quantum_si > 0 else lattice_of(output.values_si[:, axis])
        quantum_si = output.quantum_si if written is None else written.quantum_si
        chance = _chance(np.abs(steps[known, axis]), quantum_si)
        if chance is None or count < LEAST_SHARE * number:
            continue
        expected = EXCESS * chance * number + 1.0
        p = float(gammainc(count, expected)) * len(there)  # pyright: ignore[reportUnknownArgumentType]
        if p > LARGEST_P or is_slower(np.flatnonzero(held), count / number):
            continue
        name = f"{sensor}_{AXES[axis]}"
        percent = 100.0 * (count / number - chance) / (1.0 - chance)
        oddities.append(Oddity(f"{name} holds its last value in {percent:.2g} % of the frames", name, p))
        notes.append(SetAside(name, count, "repeats its last value"))
        again: NDArray[np.bool_] = np.concatenate([[False], held])
        kept = np.where(again[:, np.newaxis] & (np.arange(3) == axis), np.nan, kept)
    return (dataclasses.replace(output, values_si=kept) if notes else output), oddities, notes


def _chance(sizes: NDArray[np.float64], quantum_si: float) -> float | None:
    """Of equal values by the quantum; None where the noise does not cross it."""
    if quantum_si <= 0:
        different = len(np.unique(sizes[:5000]))
        return 0.0 if different > 0.5 * min(len(sizes), 5000) else None
    codes = np.minimum(np.rint(sizes / quantum_si), 3.0).astype(np.int64)
    _, one, two, _ = (np.bincount(codes, minlength=4) / max(len(codes), 1)).tolist()
    if two < CROSSING * one or one <= 0:
        return None
    return min(float((0.5 * one) ** (4.0 / 3.0) / (0.5 * two) ** (1.0 / 3.0)), 1.0 - math.ulp(1.0))

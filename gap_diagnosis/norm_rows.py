# pyright: strict
"""Which samples a norm can be asked of: a magnetometer's all, an accelerometer's at rest alone.

In motion an accelerometer measures more than gravity. A rest is a second or more in which every window is
still: neither accelerometer nor gyro, where there is one, scatters much more than in the stillest windows.
A rest held by hand counts too; what the hand does is in the scatter from rest to rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray

WINDOW_S = 0.25
LEAST_WINDOWS = 4
"""In a row, the first and the last of them not used: the unit is just being laid down or taken up."""
TIMES_THE_STILLEST = 3.0
STILLEST_SHARE = 0.1
LARGEST_DEVIATION_M_S2 = 0.2
LARGEST_RATE_RAD_S = 0.1
"""A bias of some °/s and a hand's tremor; 6 °/s are a turn."""
TREMOR = 0.5
ROWS_PER_REST = 4
SAME_DIRECTION = 0.02
"""Of the vector's length: rests no further apart are one attitude."""


@dataclass(frozen=True)
class Rests:
    """Rests of one recording, each as `ROWS_PER_REST` means.

    Attributes:
        time_s: (r,) of each mean.
        values_si: (r, 3).
        samples: (r,) that each is the mean of.
        deviation_si: of one sample inside the rests.
    """

    time_s: FloatArray
    values_si: FloatArray
    samples: NDArray[np.int64]
    deviation_si: float

    @property
    def count(self) -> int:
        """How many rests."""
        return len(self.time_s) // ROWS_PER_REST


def rests_of(time_s: FloatArray, acc_si: FloatArray, gyro_si: FloatArray | None, period_s: float) -> Rests:
    """The rests in samples (n, 3); NaN is a sample that must not be used.

    gyro_si: (n, 3), or None without one.
    """
    size = max(2, round(WINDOW_S / period_s))
    windows = len(time_s) // size
    still = _still(acc_si, gyro_si, windows, size)
    means: list[FloatArray] = []
    times: list[float] = []
    counts: list[int] = []
    squares: list[FloatArray] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int64), [0]])))
    for first, last in edges.reshape(-1, 2).tolist():
        if last - first < LEAST_WINDOWS:
            continue
        rows = np.arange((first + 1) * size, (last - 1) * size)
        for part in np.array_split(rows, ROWS_PER_REST):
            mean = np.asarray(acc_si[part].mean(axis=0), dtype=np.float64)
            means.append(mean)
            times.append(float(time_s[part].mean()))
            counts.append(len(part))
            squares.append(np.mean((acc_si[part] - mean) ** 2, axis=0))
    deviation = float(np.sqrt(np.mean(squares))) if squares else 0.0
    return Rests(np.array(times), np.array(means).reshape(-1, 3), np.array(counts, dtype=np.int64), deviation)


def attitudes(values_si: FloatArray) -> int:
    """How many directions of rests (r, 3), in their rows, are no repetition of an earlier one."""
    means = values_si.reshape(-1, ROWS_PER_REST, 3).mean(axis=1)
    directions = means / np.linalg.norm(means, axis=1, keepdims=True)
    kept: list[FloatArray] = []
    for one in directions:
        if all(float(np.linalg.norm(one - other)) > SAME_DIRECTION for other in kept):
            kept.append(one)
    return len(kept)


def _still(acc_si: FloatArray, gyro_si: FloatArray | None, windows: int, size: int) -> NDArray[np.bool_]:
    """(windows,)"""
    acc, gyro = _cut(acc_si, windows, size), None if gyro_si is None else _cut(gyro_si, windows, size)
    scatter = acc.std(axis=1).max(axis=1)
    still = _quiet(scatter) & (scatter < LARGEST_DEVIATION_M_S2)
    if gyro is not None:
        turning = gyro.std(axis=1).max(axis=1)
        still &= _quiet(turning) | (turning < TREMOR * LARGEST_RATE_RAD_S)
        still &= np.abs(gyro.mean(axis=1)).max(axis=1) < LARGEST_RATE_RAD_S
    return still


def _quiet(scatter: FloatArray) -> NDArray[np.bool_]:
    known = scatter[np.isfinite(scatter)]
    if not len(known):
        return np.zeros(len(scatter), dtype=bool)
    with np.errstate(invalid="ignore"):
        return np.asarray(scatter <= TIMES_THE_STILLEST * float(np.quantile(known, STILLEST_SHARE)))


def _cut(values: FloatArray, windows: int, size: int) -> FloatArray:
    return values[: windows * size].reshape(windows, size, -1)

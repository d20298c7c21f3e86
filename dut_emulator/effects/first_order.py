# pyright: strict
"""The recursion y_k = φ y_(k−1) + x_k, the same to the last bit however long the chunk is."""

from itertools import accumulate
from typing import Any, cast

import numpy as np

from dut_emulator.effects.effect import FloatArray

SHORT_CHUNK = 512
"""Up to here plain Python is as fast, and spares a bench the seconds that scipy.signal takes to load."""


def first_order(drive: FloatArray, phi: float, memory: FloatArray) -> FloatArray:
    """Run the recursion down each column.

    Args:
        drive: x, shape (n, k).
        phi: the coefficient, dimensionless.
        memory: φ y_(−1), shape (k,).

    Returns:
        y, shape (n, k).
    """
    if len(drive) > SHORT_CHUNK:
        from scipy.signal import lfilter  # pyright: ignore[reportUnknownVariableType, reportMissingTypeStubs]

        filtered = cast(
            "tuple[Any, Any]", lfilter([1.0], [1.0, -phi], drive, axis=0, zi=memory[np.newaxis, :])
        )
        return filtered[0]

    def step(y: float, x: float) -> float:
        return phi * y + x

    process = np.empty_like(drive)
    for column in range(drive.shape[1]):
        driven: list[float] = drive[:, column].tolist()
        if driven:
            driven[0] += float(memory[column])
            process[:, column] = list(accumulate(driven, step))
    return process

# pyright: strict
"""The recursion y_k = φ y_(k−1) + f0 x_k + f1 x_(k−1), the same to the last bit however long the chunk is."""

from typing import Any, cast

import numpy as np

from dut_emulator.effects.effect import FloatArray

SHORT_CHUNK = 512
"""Up to here plain Python is as fast, and spares a bench the seconds that scipy.signal takes to load."""


def first_order(
    inputs: FloatArray, phi: float, memory: FloatArray, feed: tuple[float, float] = (1.0, 0.0)
) -> FloatArray:
    """Run the recursion down each column.

    Args:
        inputs: x, shape (n, k).
        phi: the coefficient φ, dimensionless.
        memory: φ y_(−1) + f1 x_(−1), shape (k,).
        feed: f0 and f1.

    Returns:
        y, shape (n, k), each column in one piece.
    """
    if len(inputs) > SHORT_CHUNK:
        from scipy.signal import lfilter  # pyright: ignore[reportUnknownVariableType, reportMissingTypeStubs]

        filtered = cast("tuple[Any, Any]", lfilter(feed, (1.0, -phi), inputs.T, zi=memory[:, np.newaxis]))
        return filtered[0].T
    process = np.empty(inputs.shape, order="F")
    now, later = feed
    for column, rest in enumerate(memory.tolist()):
        y: list[float] = []
        for x in inputs[:, column].tolist():
            y.append(rest + now * x)
            rest = later * x + phi * y[-1]
        process[:, column] = y
    return process

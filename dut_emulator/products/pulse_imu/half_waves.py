# pyright: strict
"""How much of a rate of pulses is positive and how much negative: integrals before anything is cut. Pure.

A panel is two half-steps. Over it the rate is the parabola through its three nodes (Simpson's rule: the
error is h⁴ / 2880 of the fourth derivative), and where it changes sign it is split at the parabola's own
roots. So the difference of the two integrals is Simpson's, however often the sign changes.
"""

import numpy as np

from dut_emulator.effects.effect import FloatArray


def half_wave_integrals(
    first: FloatArray, middle: FloatArray, last: FloatArray, panel_s: float
) -> tuple[FloatArray, FloatArray]:
    """∫ max(y, 0) dt and ∫ max(−y, 0) dt over panels of `panel_s`, both of the nodes' shape.

    Args:
        first, middle, last: the rate at begin, middle and end of each panel, any one shape.
        panel_s: length of a panel.
    """
    half_s = 0.5 * panel_s
    net = (first + 4.0 * middle + last) * (half_s / 3.0)
    positive, negative = np.maximum(net, 0.0), np.maximum(-net, 0.0)
    mixed = (np.minimum(np.minimum(first, middle), last) < 0) & (
        np.maximum(np.maximum(first, middle), last) > 0
    )
    if mixed.any():
        up, down = _split(first[mixed], middle[mixed], last[mixed])
        positive[mixed], negative[mixed] = up * half_s, down * half_s
    return positive, negative


def _split(first: FloatArray, middle: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) positive and negative area of the parabola over u in [−1, 1]."""
    slope, bend = 0.5 * (last - first), 0.5 * (first + last) - middle
    inside = slope**2 - 4.0 * bend * middle
    root = np.sqrt(np.maximum(inside, 0.0))
    larger = -0.5 * (slope + np.copysign(root, slope))
    nowhere = np.ones_like(middle)
    one = np.divide(larger, bend, out=nowhere.copy(), where=np.abs(bend) > np.abs(larger))
    other = np.divide(middle, larger, out=nowhere.copy(), where=np.abs(larger) > np.abs(middle))
    edges = np.sort(np.clip(np.stack([-nowhere, one, other, nowhere]), -1.0, 1.0), axis=0)
    areas = np.diff(edges * (middle + edges * (0.5 * slope + edges * bend / 3.0)), axis=0)
    return np.maximum(areas, 0.0).sum(axis=0), np.maximum(-areas, 0.0).sum(axis=0)

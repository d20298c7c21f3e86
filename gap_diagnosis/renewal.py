# pyright: strict
"""Sensors that renew their values at a rate of their own, behind frames that come at another.

A magnetometer of 100 Hz in frames of 286 Hz repeats itself, or is interpolated, in a pattern that has lines
where multiples of the two rates differ, and what it measures has images of the motion about them. These lines
are no tone from outside. Such a sensor is told by the pattern itself: rows that repeat the one before, on all
axes at once, come at a frequency, while copies by chance come at any time.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.observation import Observation

LEAST_REPEATED, MOST_REPEATED = 0.05, 0.95
TIMES_CHANCE = 5.0
"""All axes repeat together so much more often than if each did by its quantum alone."""
LEAST_POWER = 100.0
"""Over the median: noise reaches 20 with a hundred thousand lines."""
LEAST_ROWS = 2000


def repeats(values_si: FloatArray) -> FloatArray | None:
    """(n − 1,) 1 where a row (n, 3) repeats the one before; None where it does not do so by a clock."""
    there = [axis for axis in range(values_si.shape[1]) if np.isfinite(values_si[:, axis]).any()]
    if not there or len(values_si) < LEAST_ROWS:
        return None
    same: NDArray[np.bool_] = values_si[1:, there] == values_si[:-1, there]
    all_same: NDArray[np.bool_] = np.logical_and.reduce(same, axis=1)
    together = np.count_nonzero(all_same) / len(same)
    by_chance = math.prod(np.count_nonzero(same[:, n]) / len(same) for n in range(len(there)))
    if not LEAST_REPEATED < together < MOST_REPEATED or (
        len(there) > 1 and together < TIMES_CHANCE * by_chance
    ):
        return None
    return all_same.astype(np.float64)


def renews_by_itself(observation: Observation, sensor: str) -> bool:
    """Whether a triad's repeated rows come in a pattern of a frequency, as a second clock makes them."""
    pattern = _pattern(observation, sensor)
    if pattern is None:
        return False
    power = np.abs(np.fft.rfft((pattern - pattern.mean()) * np.hanning(len(pattern)))) ** 2
    return bool(power.max() > LEAST_POWER * np.median(power))


def renewal_words(observation: Observation, sensor: str) -> str:
    """What is to be said of such a sensor."""
    pattern = _pattern(observation, sensor)
    share = 0.0 if pattern is None else 100.0 * float(pattern.mean())
    return (
        f"{share:.0f} % of the frames repeat the one before, in a pattern: the sensor renews its values at a "
        "rate of its own, which makes lines and images of the motion; none of them is called a tone"
    )


def _pattern(observation: Observation, sensor: str) -> FloatArray | None:
    output = next((one for name, one in observation.outputs.items() if name == sensor), None)
    return None if output is None else repeats(output.values_si)

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
COMMON_SHARE = 0.5
"""Of what an axis repeats: beyond what all axes do together by their quanta alone, so much is common."""
LEAST_POWER = 100.0
"""Over the median of lines near by: noise reaches 20 with a hundred thousand lines."""
LEAST_HZ, LINES_NEAR_BY = 1.0, 256
"""Below, a rest between motions repeats itself too."""
LEAST_ROWS = 2000


def repeats(values_si: FloatArray) -> FloatArray | None:
    """(n − 1,) 1 where a row (n, 3) repeats the one before; None where it does not do so by a clock."""
    there = [axis for axis in range(values_si.shape[1]) if np.isfinite(values_si[:, axis]).any()]
    if not there or len(values_si) < LEAST_ROWS:
        return None
    same: NDArray[np.bool_] = values_si[1:, there] == values_si[:-1, there]
    all_same: NDArray[np.bool_] = np.logical_and.reduce(same, axis=1)
    together = np.count_nonzero(all_same) / len(same)
    alone = [np.count_nonzero(same[:, n]) / len(same) for n in range(len(there))]
    by_chance = math.prod(alone) if len(alone) > 1 else 0.0
    if not LEAST_REPEATED < together < MOST_REPEATED:
        return None
    if (
        together - by_chance < COMMON_SHARE * (max(alone) - by_chance)
        or max(alone) < by_chance + LEAST_REPEATED
    ):
        return None
    return all_same.astype(np.float64)


def renews_by_itself(observation: Observation, sensor: str) -> bool:
    """Whether a triad's repeated rows come in a pattern of a frequency, as a second clock makes them."""
    pattern = _pattern(observation, sensor)
    if pattern is None:
        return False
    power = np.abs(np.fft.rfft((pattern - pattern.mean()) * np.hanning(len(pattern)))) ** 2
    first = math.ceil(LEAST_HZ * len(pattern) * observation.sample_period_s)
    count = (len(power) - first) // LINES_NEAR_BY
    if count < 1:
        return False
    near_by = power[first : first + count * LINES_NEAR_BY].reshape(count, LINES_NEAR_BY)
    return bool((near_by.max(axis=1) > LEAST_POWER * np.median(near_by, axis=1)).any())


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

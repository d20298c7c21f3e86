# pyright: strict
"""How an instrument reads: gain and zero error of the instrument at hand, noise, resolution.

    reading = round((true · (1 + g) + z + ν) / q) · q

g and z are drawn once for an instrument (its calibration state), ν for each reading. Noise depends on
the instrument's seed, the moment and a label of what is connected, so that a reading is the same in
whatever order the sockets of a bench come. Omitted: temperature coefficients and ageing.
"""

import zlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Accuracy:
    """Standard uncertainties of one function of an instrument, in the unit of its readings.

    Attributes:
        gain_uncertainty: relative standard uncertainty of the gain.
        zero_uncertainty: standard uncertainty of the zero.
        noise_deviation: standard deviation of a reading's noise.
        relative_noise_deviation: the same relative to the reading, added in quadrature.
        resolution: least significant digit.
    """

    gain_uncertainty: float
    zero_uncertainty: float
    noise_deviation: float
    resolution: float
    relative_noise_deviation: float = 0.0


class Reading:
    """One function of one instrument: turns true values into readings.

    Args:
        accuracy: of the function.
        seed: of the instrument.
        name: of the function; its gain and zero are drawn independently of other functions.
    """

    def __init__(self, accuracy: Accuracy, seed: int, name: str) -> None:
        self.accuracy = accuracy
        self._seed = (seed, zlib.crc32(name.encode()))
        gain, zero = np.random.default_rng(self._seed).standard_normal(2)
        self.gain_error = float(gain) * accuracy.gain_uncertainty
        self.zero_error = float(zero) * accuracy.zero_uncertainty

    def of(self, true: float, now_s: float, label: str = "", averaging: float = 1.0) -> float:
        """A reading of a true value; noise falls with the square root of `averaging`. inf stays inf."""
        if not np.isfinite(true):
            return float("inf")
        moment = np.random.default_rng((*self._seed, round(now_s * 1e6), zlib.crc32(label.encode())))
        deviation = float(
            np.hypot(self.accuracy.noise_deviation, self.accuracy.relative_noise_deviation * true)
        )
        noise = float(moment.standard_normal()) * deviation / averaging**0.5
        value = true * (1 + self.gain_error) + self.zero_error + noise
        return round(value / self.accuracy.resolution) * self.accuracy.resolution

# pyright: strict
"""A running stream on the link: when its samples are due, and samples as frames."""

from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import FloatArray
from dut_emulator.products.mems_ahrs.sampling import AhrsSamples
from protocol.frames import encode_equal_frames
from protocol.mems_ahrs import (
    ACC_LSB_G,
    ATTITUDE_LSB_DEG,
    GYRO_LSB_DEG_S,
    SAMPLE_DTYPE,
    TEMPERATURE_LSB_C,
    FrameType,
)
from protocol.units_of_measure import factor_to_si

BLOCK_S = 0.25
"""Samples leave the unit in blocks of this time, and the rest of one when something else is to be done."""
_INSTANT_TOLERANCE = 1e-6
"""Share of a period by which an instant may lie ahead of 'now' through rounding."""
_WORD = 32767


@dataclass
class Stream:
    """Sample k (from 0) is taken at started_s + (k + 1) · period_s. `taken`: so many have been."""

    rate_hz: int
    compensated: bool
    started_s: float
    taken: int = 0

    @property
    def period_s(self) -> float:
        """Between samples."""
        return 1.0 / self.rate_hz

    def due(self, now_s: float, *, whole_blocks: bool) -> int:
        """How many samples are to be sent now."""
        ripe = int((now_s - self.started_s) / self.period_s + _INSTANT_TOLERANCE) - self.taken
        return ripe - ripe % max(1, round(BLOCK_S * self.rate_hz)) if whole_blocks else ripe

    def next_block_s(self) -> float:
        """When the next whole block is complete."""
        return self.started_s + (self.taken + max(1, round(BLOCK_S * self.rate_hz))) * self.period_s

    def instants_s(self, count: int) -> FloatArray:
        """(count,) the next sampling instants."""
        numbers = np.arange(self.taken + 1, self.taken + count + 1, dtype=np.float64)
        return self.started_s + numbers * self.period_s

    def encode(self, samples: AhrsSamples, unit_time_us: FloatArray) -> bytes:
        """The next samples as frames; counts them as taken. Rows that the link lost are left out."""
        count = len(unit_time_us)
        rows = np.zeros(count, dtype=SAMPLE_DTYPE)
        rows["counter"] = np.arange(self.taken, self.taken + count)
        rows["time_us"] = np.rint(unit_time_us)
        kept = np.isfinite(samples.gyro_rad_s).all(axis=1) & np.isfinite(samples.acc_m_s2).all(axis=1)
        rows["gyro"][kept] = _words(samples.gyro_rad_s[kept], GYRO_LSB_DEG_S * factor_to_si("deg/s"))
        rows["acc"][kept] = _words(samples.acc_m_s2[kept], ACC_LSB_G * factor_to_si("g"))
        temperatures = _words(samples.temperature_c, TEMPERATURE_LSB_C)
        rows["temp"], rows["temp_gyro"], rows["temp_acc"] = temperatures.T
        rows["attitude"] = _words(samples.attitude_rad, ATTITUDE_LSB_DEG * factor_to_si("deg"))
        rows["flags"] = samples.flags
        sent = rows[kept]
        payloads = sent.view(np.uint8).reshape(len(sent), SAMPLE_DTYPE.itemsize)
        frames = encode_equal_frames(int(FrameType.STREAM_SAMPLE), self.taken % 256, payloads)
        self.taken += count
        return frames


def _words(values: FloatArray, quantum: float) -> FloatArray:
    """Whole numbers of a quantum that a 16-bit word holds."""
    return np.clip(np.rint(values / quantum), -_WORD, _WORD)

# pyright: strict
"""A raw stream: sampling instants by the unit's crystal, and samples as frames on the wire."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.products.gnc_module.inertial_sensors import SensorSamples
from protocol.frames import encode_equal_frames
from protocol.gnc_module import SAMPLE_DTYPE, FrameType

BLOCK_S = 0.25
"""Samples leave the unit in blocks of this time, and the rest of one when the stream is stopped."""
MAX_SAMPLES_PER_OUTPUT = 4096
_INSTANT_TOLERANCE = 1e-6
"""Share of a period by which an instant may lie ahead of 'now' through rounding."""


@dataclass
class SampleStream:
    """A running stream. Sample k (from 0) is taken at started_s + (k + 1) · period_s.

    `period_s` is the true period: the commanded one by the unit's crystal. `taken`: samples sent so far;
    it is the counter of the next sample.
    """

    rate_hz: int
    compensated: bool
    started_s: float
    period_s: float
    taken: int = 0

    @property
    def samples_per_block(self) -> int:
        """Samples that leave together."""
        return max(1, round(BLOCK_S * self.rate_hz))

    def due(self, now_s: float, *, whole_blocks: bool) -> int:
        """How many samples are to be sent now."""
        ripe = int((now_s - self.started_s) / self.period_s + _INSTANT_TOLERANCE) - self.taken
        return ripe - ripe % self.samples_per_block if whole_blocks else ripe

    def next_block_s(self) -> float:
        """When the next whole block is complete."""
        return self.started_s + (self.taken + self.samples_per_block) * self.period_s

    def instants_s(self, count: int) -> NDArray[np.float64]:
        """(count,) the next sampling instants."""
        return (
            self.started_s
            + np.arange(self.taken + 1, self.taken + count + 1, dtype=np.float64) * self.period_s
        )

    def encode(self, samples: SensorSamples, unit_time_us: NDArray[np.float64]) -> bytes:
        """The next samples as frames, but for those that get lost; counts all as taken."""
        count = len(unit_time_us)
        rows = np.zeros(count, dtype=SAMPLE_DTYPE)
        rows["counter"] = np.arange(self.taken, self.taken + count)
        rows["time_us"] = unit_time_us
        rows["gyro"], rows["acc"], rows["mag"] = samples.gyro, samples.acc, samples.mag
        rows["temp"], rows["status"] = samples.temperature, samples.status
        payloads = rows.view(np.uint8).reshape(count, SAMPLE_DTYPE.itemsize)
        first = self.taken
        self.taken += count
        if not samples.lost.any():
            return encode_equal_frames(int(FrameType.STREAM_SAMPLE), first % 256, payloads)
        kept = np.flatnonzero(~samples.lost)
        pieces = np.split(
            kept, np.flatnonzero(np.diff(kept) > 1) + 1
        )  # frames in a row have sequences in a row
        return b"".join(
            encode_equal_frames(int(FrameType.STREAM_SAMPLE), (first + int(piece[0])) % 256, payloads[piece])
            for piece in pieces
            if len(piece)
        )

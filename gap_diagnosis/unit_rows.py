# pyright: strict
"""The rows of an observation: the unit's samples, and an empty row for each frame that is known to be lost.

A frame counts as lost where the counter skips it, or, without a counter, where a pause is a whole number of
periods. Its row has a time and no values, as a lost frame of the emulator has. A longer pause than
`MAX_LOST_IN_A_ROW` is a hole: nothing is put in, a new piece begins.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.holes import MIXED_STEPS, median_period_s, sample_period_s
from protocol.errors import Fault
from protocol.recordings import Recording

MAX_LOST_IN_A_ROW = 20
LEAST_SAMPLES = 32
"""Fewer cannot tell a gap from noise."""
WHOLE_PERIOD = 0.25
"""A pause is so near to a whole number of periods if frames were lost in it."""
COUNTER_BITS = (8, 16, 32)


@dataclass(frozen=True)
class UnitRows:
    """Where the unit's samples lie among the rows.

    Attributes:
        time_s: (n,) on the unit's clock.
        row_of_sample: (m,) the row of each sample; the other rows are lost frames.
        period_s: of the unit's samples.
        lost: frames that were lost between the samples, those inside holes included as far as counted.
        counter: (m,) unwrapped; None without one that counts.
    """

    time_s: FloatArray
    row_of_sample: NDArray[np.int64]
    period_s: float
    lost: int
    counter: NDArray[np.int64] | None

    def spread(self, samples: FloatArray) -> FloatArray:
        """(m, …) samples on the rows, (n, …); NaN where a frame was lost."""
        if len(self.row_of_sample) == len(self.time_s):
            return samples
        rows = np.full((len(self.time_s), *samples.shape[1:]), np.nan)
        rows[self.row_of_sample] = samples
        return rows


def unit_rows(recording: Recording) -> UnitRows:
    """The rows of a recording.

    Raises:
        DiagnosisError: fewer samples than `LEAST_SAMPLES`, or time stands still.
        RecordingError: there is no stream of the unit.
    """
    stream = recording.stream("dut")
    time_s = stream.time_s()
    where = f"recording {recording.recording_id}, stream dut"
    if len(time_s) < LEAST_SAMPLES:
        raise DiagnosisError(
            f"{len(time_s)} samples tell nothing of a gap; it takes {LEAST_SAMPLES} at least.",
            where=where,
            fault=Fault.DATA,
            remedy="record for longer.",
        )
    period_s = sample_period_s(time_s)
    if not period_s > 0:
        raise DiagnosisError(
            "The unit's clock stands still: all samples have one time.",
            where=f"{where}, column {stream.time}",
            fault=Fault.DATA,
            remedy="write the time of each sample.",
        )
    counter = unwrapped_counter(np.asarray(stream.columns["counter"])) if stream.has("counter") else None
    skipped = _skipped(time_s, period_s, counter)
    inside = np.where(skipped <= MAX_LOST_IN_A_ROW, skipped, 0)
    row_of_sample = np.arange(len(time_s))
    row_of_sample[1:] += np.cumsum(inside)
    times = time_s
    if inside.any():
        times = np.interp(np.arange(int(row_of_sample[-1]) + 1), row_of_sample, time_s)
    return UnitRows(times, row_of_sample, period_s, int(skipped.sum()), counter)


def _skipped(time_s: FloatArray, period_s: float, counter: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """(m − 1,) frames that are missing between a sample and the next."""
    if counter is not None:
        return np.maximum(np.diff(counter) - 1, 0)
    steps = np.diff(time_s) / period_s
    whole = np.rint(steps)
    pause = (steps > MIXED_STEPS) & (np.abs(steps - whole) < WHOLE_PERIOD)
    return np.where(pause, whole - 1, 0).astype(np.int64)


def unwrapped_counter(counter: NDArray[np.generic]) -> NDArray[np.int64] | None:
    """A frame counter that goes on where its word wraps round; None for one that does not count by ones.

    The word is the narrowest that holds all values; it wraps where it steps back by more than half its span.
    A counter that steps back otherwise has been reset, or the frames are not in order: None as well.
    """
    values = np.asarray(counter, dtype=np.float64)
    if len(values) < 2 or not np.isfinite(values).all() or (values != np.rint(values)).any():
        return None
    steps = np.diff(values)
    if (steps < 0).any():
        bits = next((bits for bits in COUNTER_BITS if values.max() < 2.0**bits and values.min() >= 0), None)
        if bits is None:
            return None
        wraps = steps < -(2.0 ** (bits - 1))
        steps = steps + wraps * 2.0**bits
    if (steps < 0).any() or np.median(steps) != 1:
        return None
    return np.concatenate([values[:1], values[0] + np.cumsum(steps)]).astype(np.int64)


def has_even_steps(time_s: FloatArray) -> bool:
    """True if most steps are one period, so that a longer one means something."""
    steps, period_s = np.diff(time_s), median_period_s(time_s)
    return bool(np.mean(np.abs(steps - period_s) < WHOLE_PERIOD * period_s) > 0.5)

# pyright: strict
"""Block means of an observation: as few rows as keep what the motion tells.

A row becomes the mean of m samples. The largest m is taken for which

    rows     come at 10 Hz or more, or as `MAX_ROWS` a recording allow;
    motion   the derivative of every predicted output keeps 99.5 % of its rms. A mean of m samples passes
             |sin(πfmT) / (m sin(πfT))| of a wave f, and the difference of two rows the same again. Only what
             the unit's own samples show too counts, by the co-spectrum of values and prediction: noise of an
             optical reference is no motion;
    gimbals  do not turn by more than 5° in a row, so that ripple and eccentricity of the stand stay visible.

Means are taken inside a piece, over the samples that have both value and prediction.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName, Stimulus
from gap_diagnosis.holes import stretches
from gap_diagnosis.observation import Observation, SensorOutput

LEAST_ROW_RATE_HZ = 10.0
MAX_ROWS = 60_000
KEPT_SHARE = 0.995
LARGEST_GIMBAL_STEP_RAD = math.radians(5.0)
LEAST_SHARE_OF_BLOCK = 0.5
"""A mean of fewer of its samples than this share is missing."""
MAX_ROWS_CUT_OFF = 0.05
"""Share of the samples that may be lost at the ends of pieces."""
WINDOW = 1024
"""Samples of one spectrum: 5 s at 200 Hz, with a line each 0.2 Hz."""
MAX_WINDOWS = 2000
SIGNIFICANT = 4.0
"""A band counts as motion if its co-spectrum is so many standard deviations above nothing."""
BAND_LINES = 8
_VECTORS = (
    *("time_s", "temperature_c", "rate_rad_s", "specific_force_m_s2", "field_t", "supply_v"),
    *("supply_current_a", "angles_rad", "earth_rate_rad_s", "position_m"),
)


def decimated(observation: Observation, samples_per_row: int | None = None) -> Observation:
    """The observation in block means.

    `sample_period_s` stays that of the unit; `stimulus.sample_period_s` is that of the rows.

    Args:
        observation: of single samples.
        samples_per_row: m; None: the largest that keeps the information.

    Raises:
        ValueError: the rows are means already, or m is not positive.
    """
    if observation.samples_per_row != 1:
        raise ValueError("These rows are means already.")
    size = block_size(observation) if samples_per_row is None else samples_per_row
    if size < 1:
        raise ValueError("A row needs a sample.")
    if size == 1:
        return observation
    blocks = _Blocks(observation.piece, size)
    stimulus = dataclasses.replace(
        _averaged_stimulus(observation.stimulus, blocks),
        sample_period_s=observation.stimulus.sample_period_s * size,
    )
    return dataclasses.replace(
        observation,
        stimulus=stimulus,
        outputs={sensor: _averaged_output(one, blocks) for sensor, one in observation.outputs.items()},
        usable=observation.usable[blocks.first],
        piece=observation.piece[blocks.first],
        samples_per_row=size,
    )


def block_size(observation: Observation) -> int:
    """The largest number of samples per row that keeps the information; see the module."""
    period_s = observation.sample_period_s
    for_rows = math.ceil(len(observation) / MAX_ROWS)
    size = max(math.floor(1.0 / (LEAST_ROW_RATE_HZ * period_s) + 1e-6), for_rows, 1)
    size = min(size, max(for_rows, _largest_for_gimbals(observation.stimulus)))
    size = min(size, _largest_for_pieces(observation.piece, size))
    for sensor, output in observation.outputs.items():
        if sensor != "temperature" and size > 1:
            size = _largest_for_motion(output, observation.piece, size)
    return size


def _largest_for_gimbals(stimulus: Stimulus) -> int:
    """So many samples turn the fastest gimbal by `LARGEST_GIMBAL_STEP_RAD`."""
    if stimulus.angles_rad is None:
        return len(stimulus.time_s)
    steps = np.abs(np.diff(stimulus.angles_rad, axis=0)).max(axis=1)
    steps = steps[np.isfinite(steps)]
    fastest = float(np.quantile(steps, 0.99)) if len(steps) else 0.0
    return max(1, math.floor(LARGEST_GIMBAL_STEP_RAD / fastest)) if fastest > 0 else len(stimulus.time_s)


def _largest_for_pieces(piece: NDArray[np.int64], largest: int) -> int:
    """Blocks that lose no more than `MAX_ROWS_CUT_OFF` of the samples at the ends of pieces."""
    lengths = np.array([last - first for first, last in stretches(piece)])
    for size in range(largest, 1, -1):
        if (lengths % size).sum() <= MAX_ROWS_CUT_OFF * lengths.sum():
            return size
    return 1


def _largest_for_motion(output: SensorOutput, piece: NDArray[np.int64], largest: int) -> int:
    """Blocks that keep the derivative of every axis."""
    starts = _windows(output, piece)
    if not len(starts):
        return largest
    taper = np.hanning(WINDOW)
    frequency = np.arange(WINDOW // 2 + 1) / WINDOW  # cycles per sample
    size = largest
    for axis in range(3):
        values, predicted = output.values_si[:, axis], output.predicted_si[:, axis]
        if np.isnan(values).all():
            continue
        power = _motion_power(values, predicted, starts, taper)
        power *= np.sin(np.pi * frequency) ** 2  # of the derivative
        while size > 1 and (power * _passed(frequency, size)).sum() < KEPT_SHARE**2 * power.sum():
            size -= 1
    return size


def _windows(output: SensorOutput, piece: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) first rows of windows inside pieces, half overlapping, without a hole in the prediction."""
    starts = np.concatenate(
        [np.empty(0, dtype=np.int64)]
        + [np.arange(first, last - WINDOW + 1, WINDOW // 2) for first, last in stretches(piece)]
    )
    unseen = np.concatenate([[0], np.cumsum(np.isnan(output.predicted_si).any(axis=1))])
    starts = starts[unseen[starts + WINDOW] == unseen[starts]]
    return starts[:: math.ceil(len(starts) / MAX_WINDOWS)] if len(starts) else starts


def _motion_power(
    values: FloatArray, predicted: FloatArray, starts: NDArray[np.int64], taper: FloatArray
) -> FloatArray:
    """(WINDOW / 2 + 1,) what values and prediction have in common, per line; 0 in bands without any."""
    lines = len(taper) // 2 + 1
    cross, power_v, power_p, count = np.zeros(lines), np.zeros(lines), np.zeros(lines), 0
    for some in np.array_split(starts, max(1, len(starts) // 64)):
        rows = some[:, np.newaxis] + np.arange(len(taper))
        shown = predicted[rows]
        seen = np.where(np.isnan(values[rows]), shown, values[rows])  # only to choose m
        shown_lines = np.fft.rfft((shown - shown.mean(axis=1, keepdims=True)) * taper)
        seen_lines = np.fft.rfft((seen - seen.mean(axis=1, keepdims=True)) * taper)
        cross += (seen_lines * shown_lines.conj()).real.sum(axis=0)
        power_v += (np.abs(seen_lines) ** 2).sum(axis=0)
        power_p += (np.abs(shown_lines) ** 2).sum(axis=0)
        count += len(some)
    common = np.zeros(lines)
    for first in range(1, lines, BAND_LINES):
        band = slice(first, min(first + BAND_LINES, lines))
        shared, shown_power = float(cross[band].sum()), float(power_p[band].sum())
        if shared > 0:  # one gain for the band; what it leaves is noise
            left = float(power_v[band].sum()) - shared * shared / shown_power
            if shared**2 > SIGNIFICANT**2 * 0.5 * shown_power * max(left, 0.0) / (count * BAND_LINES):
                common[band] = np.maximum(cross[band], 0.0)
    return common


def _passed(frequency: FloatArray, size: int) -> FloatArray:
    """Power of the derivative that means of `size` samples pass, by frequency in cycles per sample."""
    below = size * np.sin(np.pi * frequency)
    share = np.divide(np.sin(np.pi * frequency * size), below, out=np.ones_like(frequency), where=below > 0)
    return share**4


class _Blocks:
    """Blocks of `size` rows inside pieces; what is left at the end of a piece is left out."""

    def __init__(self, piece: NDArray[np.int64], size: int) -> None:
        spans = [(first, (last - first) // size) for first, last in stretches(piece)]
        self.size = size
        self.spans = [(first, first + count * size) for first, count in spans if count]
        self.first = np.concatenate(
            [np.empty(0, dtype=np.int64), *(np.arange(first, last, size) for first, last in self.spans)]
        )

    def cut(self, values: FloatArray) -> FloatArray:
        """(n,) → (blocks, size)."""
        if len(self.spans) == 1:
            first, last = self.spans[0]
            return values[first:last].reshape(-1, self.size)
        parts = [values[first:last] for first, last in self.spans]
        return np.concatenate([np.empty(0), *parts]).reshape(-1, self.size)

    def mean(self, values: FloatArray, weight: FloatArray | None = None) -> FloatArray:
        """(n,) → (blocks,) means, NaN with `weight` below its least; without, of every sample."""
        cut = self.cut(values)
        if weight is None:
            return cut.mean(axis=1)
        number = weight.sum(axis=1)
        total = np.where(weight > 0, cut, 0.0).sum(axis=1)
        return np.where(number >= LEAST_SHARE_OF_BLOCK * self.size, total / np.maximum(number, 1.0), np.nan)


def _averaged_stimulus(stimulus: Stimulus, blocks: _Blocks) -> Stimulus:
    changed: dict[str, FloatArray] = {}
    for name in _VECTORS:
        values = getattr(stimulus, name)
        if values is None:
            continue
        if values.ndim == 1:
            changed[name] = blocks.mean(values)
        else:
            changed[name] = _by_axis(values, blocks)
    return dataclasses.replace(stimulus, dcm_local_from_body=None, **changed)  # pyright: ignore[reportArgumentType]


def _by_axis(values: FloatArray, blocks: _Blocks) -> FloatArray:
    out = np.empty((len(blocks.first), values.shape[1]), order="F")
    for axis in range(values.shape[1]):
        out[:, axis] = blocks.mean(values[:, axis])
    return out


def _averaged_output(output: SensorOutput, blocks: _Blocks) -> SensorOutput:
    """Values and prediction over the same samples; the prediction alone where there are no values."""
    shape = (len(blocks.first), output.values_si.shape[1])
    values, predicted = np.empty(shape, order="F"), np.empty(shape, order="F")
    for axis in range(shape[1]):
        there = np.isfinite(blocks.cut(output.values_si[:, axis]))
        there &= np.isfinite(blocks.cut(output.predicted_si[:, axis]))
        weight = there.astype(np.float64)
        values[:, axis] = blocks.mean(output.values_si[:, axis], weight)
        of_both = blocks.mean(output.predicted_si[:, axis], weight)
        alone = blocks.mean(output.predicted_si[:, axis])
        predicted[:, axis] = np.where(np.isnan(of_both), alone, of_both)
    return dataclasses.replace(output, values_si=values, predicted_si=predicted)


def rows_by_sensor(observation: Observation) -> Mapping[SensorName, int]:
    """How many rows of each triad have value and prediction on an axis."""
    return {
        sensor: int(np.isfinite(output.residual_si).any(axis=1).sum())
        for sensor, output in observation.outputs.items()
    }

"""From samples to block means, with a record of what was left out: gaps, NaN, outliers, saturation.

A sample that is left out for its own value makes a mean that was selected by noise. So one saturated sample
takes its whole block; only outliers far beyond any noise are taken out one by one, and are counted.
"""

# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.correlated_fit import Blocks, FloatArray, refused
from calibration.algorithms.screening import MAX_PERIOD_RATIO, NotUsed, saturated

MIN_BLOCK_SAMPLES = 4
MAX_LOST_FRACTION = 0.1
"""A block that lost more of its samples than this is not used."""
OUTLIER_SIGMAS = 8.0
"""Of the samples about their block's median; 1e6 normal samples reach 5.1."""
MAX_OUTLIER_FRACTION = 0.01
"""More outliers than this are no outliers: the noise is another, and nothing is taken out."""
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class BlockRecord:
    """Blocks of one stretch and what is not in them.

    Attributes:
        blocks: means of the outputs, shape (k, m).
        inputs: means of the inputs over the same samples, shape (k, c).
        not_used: what, how many samples, why.
        offered: blocks that the stretch would have had.
    """

    blocks: Blocks
    inputs: FloatArray
    not_used: tuple[NotUsed, ...]
    offered: int

    @property
    def lost_fraction(self) -> float:
        """Part of the blocks that is not there."""
        return 1.0 - len(self.blocks.middle_s) / max(self.offered, 1)


def block_means(
    name: str,
    time_s: FloatArray,
    output: FloatArray,
    block_s: float,
    *,
    inputs: FloatArray | None = None,
    range_limit: float | None = None,
    expected: FloatArray | None = None,
) -> BlockRecord:
    """Cut a stretch into blocks of `block_s` from its first sample on; an incomplete last one is left.

    Args:
        name: of the stretch, for the record.
        time_s: shape (n,), running forward.
        output: shape (n, m), SI.
        block_s: length of a block, s.
        inputs: shape (n, c), averaged over the same samples; None: none.
        range_limit: magnitude at and above which an output is saturated; None: not looked for.
        expected: shape (n, m), what the output is expected to do inside a block (outliers are looked for in
            the difference); None: it stays.

    Raises:
        CalibrationError: shapes that do not fit, time that does not run forward, blocks too short.
    """
    time_s, output = np.asarray(time_s, dtype=np.float64), np.asarray(output, dtype=np.float64)
    given = np.zeros((len(time_s), 0)) if inputs is None else np.asarray(inputs, dtype=np.float64)
    period = _checked_period(name, time_s, output, given, block_s)
    index = np.floor((time_s - time_s[0]) / block_s + 1e-6).astype(np.intp)
    per_block = block_s / period
    offered = int((time_s[-1] - time_s[0] + period) / block_s + 1e-6)
    not_used: list[NotUsed] = []
    missing = np.isnan(np.column_stack([output, given]).sum(axis=1) * 0.0)
    clipped = saturated(output, range_limit) & ~missing
    tail = index >= offered
    bad = missing | clipped
    wild = _outliers(output if expected is None else output - expected, index, ~bad)
    _note(not_used, name, missing, "missing values (NaN)")
    _note(not_used, name, wild, f"outliers beyond {OUTLIER_SIGMAS:g} standard deviations")
    used = ~(missing | clipped | wild | tail)
    counts = np.bincount(index[used], minlength=offered)[:offered]
    in_saturated = np.bincount(index[clipped & ~tail], minlength=offered)[:offered] > 0
    if clipped.any():
        why = "saturated: at the end of the range; their blocks are not used"
        not_used.append(NotUsed(name, int(clipped.sum()), why))
    holes = max(round(offered * per_block) - int((~tail).sum()), 0) if _has_gaps(time_s, period) else 0
    if holes:
        not_used.append(NotUsed(name, holes, "never came: gaps in time"))
    full = (counts >= (1.0 - MAX_LOST_FRACTION) * per_block) & (counts >= MIN_BLOCK_SAMPLES) & ~in_saturated
    if (thin := int(counts[~full].sum())) > 0:
        not_used.append(NotUsed(name, thin, "in blocks with saturated samples or too many lost ones"))
    sums = [
        np.bincount(index[used], weights=column[used], minlength=offered)[:offered][full] / counts[full]
        for column in (*output.T, *given.T, time_s)
    ]
    means = np.stack(sums, axis=1) if offered else np.zeros((0, output.shape[1] + given.shape[1] + 1))
    channels = output.shape[1]
    lasting = np.asarray(counts[full] * period, dtype=np.float64)
    blocks = Blocks(means[:, -1], lasting, means[:, :channels])
    return BlockRecord(blocks, means[:, channels:-1], tuple(not_used), offered)


def span_s(time_s: FloatArray) -> float:
    """Of a record, with the last sample's own period; 0 for fewer than two samples."""
    if len(time_s) < 2:
        return 0.0
    return float(time_s[-1] - time_s[0]) + float(np.median(np.diff(time_s)))


def joined(records: list[BlockRecord]) -> BlockRecord:
    """Blocks of several stretches on one clock, in their order."""
    blocks = Blocks(
        np.concatenate([record.blocks.middle_s for record in records]),
        np.concatenate([record.blocks.duration_s for record in records]),
        np.concatenate([record.blocks.means for record in records]),
    )
    return BlockRecord(
        blocks,
        np.concatenate([record.inputs for record in records]),
        tuple(note for record in records for note in record.not_used),
        sum(record.offered for record in records),
    )


def _checked_period(
    name: str, time_s: FloatArray, output: FloatArray, inputs: FloatArray, block_s: float
) -> float:
    if output.ndim != 2 or len(output) != len(time_s) or len(inputs) != len(time_s) or len(time_s) < 2:
        raise refused(
            f"{len(time_s)} times do not go with outputs {output.shape} and inputs {inputs.shape}.",
            name,
            "hand over one row of outputs and inputs for each time, at least two.",
        )
    spacing = np.diff(time_s)
    if not (np.isfinite(time_s).all() and spacing.min() > 0):
        raise refused("The time does not run forward.", name, "look at the unit's clock.")
    period = float(np.median(spacing))
    if block_s < MIN_BLOCK_SAMPLES * period * (1 - 1e-6):
        raise refused(
            f"Blocks of {block_s:g} s hold fewer than {MIN_BLOCK_SAMPLES} samples.", name, "make them longer."
        )
    # The median is rounded with the time stamps; the mean of the steps that are no gaps is not.
    return float(spacing[spacing <= MAX_PERIOD_RATIO * period].mean())


def _has_gaps(time_s: FloatArray, period: float) -> bool:
    return bool((np.diff(time_s) > MAX_PERIOD_RATIO * period).any())


def _outliers(values: FloatArray, index: NDArray[np.intp], usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples far from their own block's median, shape (n,)."""
    far = np.zeros(len(values), dtype=np.bool_)
    if not usable.any():
        return far
    rows = np.flatnonzero(usable)
    starts = np.flatnonzero(np.diff(index[rows], prepend=-1))
    ends = np.append(starts[1:], len(rows))
    centred = values[rows].copy()
    for first, last in zip(starts, ends, strict=True):
        centred[first:last] -= np.median(centred[first:last], axis=0)
    sigma = _MAD_TO_SIGMA * np.median(np.abs(centred), axis=0)
    # A coarse quantum can make the median deviation zero; then the quantum's own size is the measure.
    sigma = np.where(sigma > 0, sigma, np.sqrt(np.mean(centred**2, axis=0)))
    wild = (np.abs(centred) > OUTLIER_SIGMAS * np.maximum(sigma, 1e-300)).any(axis=1)
    if wild.mean() <= MAX_OUTLIER_FRACTION:
        far[rows[wild]] = True
    return far


def _note(not_used: list[NotUsed], name: str, which: NDArray[np.bool_], why: str) -> None:
    if which.any():
        not_used.append(NotUsed(name, int(which.sum()), why))

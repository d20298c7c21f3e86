"""Threshold and resolution from small steps of the input (IEEE 528; GJB 2426A: 阈值, 分辨率).

    threshold   the smallest input, on both sides of zero, from which on the output is at least half of what
                the scale factor leads to expect
    resolution  the same for the smallest *change* of the input about a working point that is not zero

Each step stands between stretches at the base. One regression gives the response ratio of every step,

    y = base + trend t + sum rho_j K r_j [at step j]

with the covariance that slow noise makes. A step *answers* if rho - z u > 1/2, *does not* if rho + z u < 1/2;
between them nobody can tell. The figure is then known to lie in a bracket: above the largest step that does
not answer and at most the smallest from which on all answer. Undecided steps widen the bracket; they are not
rounded to a side.

The base holds the Earth rate and the bias, both constant as long as the attitude stays: turn about the
Earth's axis or come back to one attitude, else hand the Earth rate over with the steps.
"""

# pyright: strict
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.block_means import BlockRecord, block_means, joined, span_s
from calibration.algorithms.correlated_fit import FloatArray, SlowTerms, fit_correlated, refused
from calibration.algorithms.screening import NotUsed

EXPECTED_PART = 0.5
"""Of the response that the scale factor leads to expect."""
DECISION_SIGMAS = 2.0
BLOCKS_PER_STRETCH = 4
MIN_STEPS = 3


@dataclass(frozen=True)
class Stretch:
    """A stretch at one input.

    Attributes:
        name: for the record.
        time_s, output: shape (n,), SI.
        step: the input less the base, SI; 0: at the base.
        known_input: what acts besides and is known (Earth rate along the axis less that at the base), SI.
    """

    name: str
    time_s: FloatArray
    output: FloatArray
    step: float
    known_input: float = 0.0


@dataclass(frozen=True)
class SmallestStep:
    """Threshold or resolution.

    Attributes:
        above, at_most: the bracket, SI; above 0 where even the smallest step answers.
        value: its upper end, the smallest input that was seen to be answered (IEEE 528).
        standard_uncertainty: of the figure inside the bracket, (at_most - above) / sqrt(12).
        steps: inputs, ascending, shape (s,).
        ratio: response over expected response, shape (s,), with `covariance` (s, s).
        undecided: steps that noise leaves open.
        noise, not_used: what was assumed; what was left out.
    """

    above: float
    at_most: float
    steps: FloatArray
    ratio: FloatArray
    covariance: FloatArray
    undecided: tuple[float, ...]
    noise: str
    not_used: tuple[NotUsed, ...]

    @property
    def value(self) -> float:
        """Upper end of the bracket."""
        return self.at_most

    @property
    def standard_uncertainty(self) -> float:
        """Of a figure that is as likely anywhere in the bracket."""
        return (self.at_most - self.above) / math.sqrt(12.0)


def smallest_step(
    stretches: Sequence[Stretch],
    scale_factor: float,
    *,
    scale_factor_standard_uncertainty: float = 0.0,
    range_limit: float | None = None,
    known_slow: SlowTerms | None = None,
    where: str = "threshold",
) -> SmallestStep:
    """Threshold (base at zero input) or resolution (base at a working point) of one channel.

    Args:
        stretches: in the order in which they were recorded; steps of three or more sizes on both sides, with
            the base before, between and after.
        scale_factor: K, output over input; with its standard uncertainty.
        range_limit: a stretch with a saturated sample is left out.
        known_slow: see `correlated_fit`.
        where: for errors.

    Raises:
        CalibrationError: too few steps, one side only, no base, or no step that is answered.
    """
    records: list[BlockRecord] = []
    steps: list[float] = []
    lost: list[NotUsed] = []
    for one in stretches:
        output = one.output - scale_factor * one.known_input
        block_s = span_s(one.time_s) / BLOCKS_PER_STRETCH
        record = block_means(one.name, one.time_s, output[:, None], block_s, range_limit=range_limit)
        lost.extend(record.not_used)
        if any("saturated" in note.why for note in record.not_used) or len(record.inputs) == 0:
            lost.append(NotUsed(one.name, len(one.time_s), "whole stretch: saturated or mostly lost"))
            continue
        records.append(record)
        steps += [one.step] * len(record.inputs)
    applied = np.array(steps)
    sizes = np.unique(applied[applied != 0.0])
    _check_steps(applied, sizes, where)
    whole = joined(records)
    time_s = whole.blocks.middle_s - whole.blocks.middle_s.mean()
    columns = [scale_factor * size * (applied == size) for size in sizes.tolist()]
    names = [f"step {size:.4g}" for size in sizes.tolist()]
    design = np.column_stack([*columns, np.ones(len(time_s)), time_s])
    fit = fit_correlated(design, whole.blocks, [*names, "base", "trend"], where, known_slow)
    count = len(sizes)
    ratio = fit.values[0, :count]
    relative = scale_factor_standard_uncertainty / scale_factor
    covariance = fit.covariance[0, :count, :count] + relative**2 * np.outer(ratio, ratio)
    doubt = DECISION_SIGMAS * np.sqrt(np.einsum("ii->i", covariance))
    answers, silent = ratio - doubt > EXPECTED_PART, ratio + doubt < EXPECTED_PART
    above, at_most = _bracket(np.abs(sizes), answers, silent, where)
    open_steps = tuple(float(size) for size in sizes[~answers & ~silent])
    return SmallestStep(above, at_most, sizes, ratio, covariance, open_steps, fit.noise[0], tuple(lost))


def _check_steps(applied: FloatArray, sizes: FloatArray, where: str) -> None:
    both = bool((sizes > 0).any() and (sizes < 0).any())
    if len(sizes) < MIN_STEPS or not both or not (applied == 0.0).any():
        raise refused(
            f"{len(sizes)} sizes of steps, {'on both sides' if both else 'on one side only'}, "
            f"{'with' if (applied == 0.0).any() else 'without'} the base: {MIN_STEPS} or more on both sides "
            "and the base are needed.",
            where,
            "add the steps that are missing.",
        )


def _bracket(sizes: FloatArray, answers: FloatArray, silent: FloatArray, where: str) -> tuple[float, float]:
    """Of both sides together: the larger threshold counts (IEEE 528)."""
    failing = sizes[~answers.astype(np.bool_)]
    beyond = sizes[sizes > failing.max(initial=0.0)]
    if len(beyond) == 0:
        raise refused(
            f"The largest step, {sizes.max():.4g}, is not surely answered.",
            where,
            "go to larger steps, or stay longer at each.",
        )
    above = float(sizes[silent.astype(np.bool_)].max(initial=0.0))
    return above, float(beyond.min())

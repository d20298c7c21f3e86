"""Scale factor, non-linearity, asymmetry, cross-coupling and bias from rate staircases.

    y = b + M w,  w = rate of the stand + Earth rate, both in body axes

    scale_factor_error      m_ii - 1: of the line by least squares through all dwells (IEEE 952, GJB 2426A)
    scale_factor_nonlinearity   largest residual of that line over the largest output m_ii w_max (GJB 2426A,
                            标度因数非线性度); times 1e6: ppm of full scale. That of the line whose largest
                            residual is smallest (minimax) is beside it.
    scale_factor_asymmetry  2 (K+ - K-) / (K+ + K-), K+ and K- on both sides of one bias (IEEE 528: difference
                            of the scale factors over the scale factor). Paper 5's K_ax is half of it.

The repeatability of the scale factor is `bias_figures.repeatability` of its values over runs. Rates are true
rates: a table's own scale error (`rate_standard_uncertainty`) moves all of M and is in the covariance.
A staircase with a horizontal spin axis turns the Earth rate through the dwells: it has to come sample by
sample (`earth_rate_body_rad_s`); there is no default.
"""

# pyright: strict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.block_means import BlockRecord, block_means, joined, span_s
from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.correlated_fit import (
    Blocks,
    CorrelatedFit,
    FloatArray,
    SlowTerms,
    fit_correlated,
    refused,
)
from calibration.algorithms.rate_gyro import line_weights
from calibration.algorithms.screening import NotUsed

BLOCKS_PER_DWELL = 4
MIN_LEVELS_PER_SIDE = 2
MIN_RATE_PART = 1e-3
"""Dwells slower than this part of the fastest are rests: they tell the bias, on neither side of zero."""
SAME_LEVEL_PART = 2e-3
"""Rates closer than this part of the fastest are one level."""


@dataclass(frozen=True)
class Dwell:
    """A stretch at one rate; all arrays on one clock and in body axes.

    Attributes:
        name: for the record.
        time_s: shape (n,).
        output_rad_s: of the m gyros, shape (n, m).
        rate_body_rad_s: of the stand, relative to the laboratory, at these times, shape (n, 3).
        earth_rate_body_rad_s: at these times, shape (n, 3).
    """

    name: str
    time_s: FloatArray
    output_rad_s: FloatArray
    rate_body_rad_s: FloatArray
    earth_rate_body_rad_s: FloatArray


@dataclass(frozen=True)
class AxisFigures:
    """What a staircase about body axis i says of the gyro along it; all with their standard uncertainty.

    Attributes:
        axis: 0, 1, 2.
        scale_factor_error, bias_rad_s: value and standard uncertainty.
        asymmetry: likewise, 1.
        rates_rad_s: of the levels, shape (n,), ascending; each the mean of the dwells at it.
        residuals: of the levels over full scale, shape (n,), with `residual_covariance` (n, n).
        nonlinearity: the largest magnitude of them, with the standard uncertainty of that residual.
        nonlinearity_of_noise: what the largest of n would be on average for a perfectly straight gyro.
        nonlinearity_minimax: of the line with the smallest largest residual.
        full_scale_rad_s: largest output of the line, bias left out.
    """

    axis: int
    scale_factor_error: tuple[float, float]
    bias_rad_s: tuple[float, float]
    asymmetry: tuple[float, float]
    rates_rad_s: FloatArray
    residuals: FloatArray
    residual_covariance: FloatArray
    nonlinearity: tuple[float, float]
    nonlinearity_of_noise: float
    nonlinearity_minimax: float
    full_scale_rad_s: float


@dataclass(frozen=True)
class StaircaseFigures:
    """Three staircases together.

    Attributes:
        matrix: rows of M, one a gyro, shape (m, 3).
        bias_rad_s: shape (m,).
        covariance: of the rows one after another and the biases, shape (4 m, 4 m).
        coefficients: the same of a triad; None: of fewer gyros.
        axes: one for each gyro.
        condition: of the design.
        noise: per gyro, in words.
        not_used: dwells, samples, why.
    """

    matrix: FloatArray
    bias_rad_s: FloatArray
    covariance: FloatArray
    coefficients: TriadCoefficients | None
    axes: tuple[AxisFigures, ...]
    condition: float
    noise: tuple[str, ...]
    not_used: tuple[NotUsed, ...]


def staircase_figures(
    dwells: Sequence[Dwell],
    *,
    sensors: tuple[int, ...] = (0, 1, 2),
    range_rad_s: float | None = None,
    rate_standard_uncertainty: float = 0.0,
    known_slow: SlowTerms | None = None,
    where: str = "rate staircase",
) -> StaircaseFigures:
    """All figures from dwells about three axes, in the order in which they were recorded.

    Args:
        dwells: about each axis both directions, rests if there are.
        sensors: body axis that each gyro lies along.
        range_rad_s: end of the range; a dwell with a saturated sample is left out as a whole.
        rate_standard_uncertainty: relative, common to all rates of the stand.
        known_slow: see `correlated_fit`.
        where: for errors.

    Raises:
        CalibrationError: an axis or a direction is missing (named), too little is left.
    """
    record, not_used = _observe(dwells, range_rad_s, where)
    inputs = record.inputs[:, :3] + record.inputs[:, 3:]
    turned = _turned_axis(record.inputs[:, :3])
    if still := [axis for number, axis in enumerate("xyz") if not (turned == number).any()]:
        what = (
            f"No usable dwell turns about body {', '.join(still)}: the Earth's rate alone carries no column."
        )
        raise refused(what, where, "add a staircase about it.")
    design = np.column_stack([inputs, np.ones(len(inputs))])
    names = ("rate about x", "rate about y", "rate about z", "bias")
    fit = fit_correlated(design, record.blocks, names, where, known_slow)
    axes = tuple(
        _axis_figures(_AxisData(record.blocks, inputs, turned == axis, row, axis), fit, (where, known_slow))
        for row, axis in enumerate(sensors)
    )
    covariance = _covariance(fit, rate_standard_uncertainty)
    return StaircaseFigures(
        matrix=fit.values[:, :3],
        bias_rad_s=fit.values[:, 3],
        covariance=covariance,
        coefficients=_coefficients(fit, covariance) if sensors == (0, 1, 2) else None,
        axes=axes,
        condition=fit.condition,
        noise=fit.noise,
        not_used=not_used,
    )


def find_dwells(
    rate_rad_s: FloatArray, time_s: FloatArray, *, tolerance_rad_s: float, least_s: float, settle_s: float
) -> list[tuple[int, int]]:
    """(first, past the last) sample of each stretch where all rates (n, c) stay within a tolerance.

    `settle_s` is left out at the beginning: filters and the stand settle there. NaN ends a stretch.
    """
    steps = np.abs(np.diff(rate_rad_s, axis=0)).max(axis=1)
    stays = np.where(steps <= tolerance_rad_s, 1, 0)
    begins = np.flatnonzero(np.diff(stays, prepend=0) == 1)
    ends = np.flatnonzero(np.diff(stays, append=0) == -1) + 1
    found: list[tuple[int, int]] = []
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        start = int(np.count_nonzero(time_s < time_s[first] + settle_s))
        if last + 1 > start and time_s[last] - time_s[start] >= least_s:
            found.append((start, last + 1))
    return found


def _observe(
    dwells: Sequence[Dwell], range_rad_s: float | None, where: str
) -> tuple[BlockRecord, tuple[NotUsed, ...]]:
    """Blocks of all usable dwells."""
    records: list[BlockRecord] = []
    lost: list[NotUsed] = []
    for dwell in dwells:
        record = block_means(
            dwell.name,
            dwell.time_s,
            dwell.output_rad_s,
            span_s(dwell.time_s) / BLOCKS_PER_DWELL,
            inputs=np.concatenate([dwell.rate_body_rad_s, dwell.earth_rate_body_rad_s], axis=1),
            range_limit=range_rad_s,
        )
        lost.extend(record.not_used)
        if any("saturated" in note.why for note in record.not_used):
            lost.append(NotUsed(dwell.name, len(dwell.time_s), "whole dwell: part of it is saturated"))
        elif len(record.blocks.middle_s) < BLOCKS_PER_DWELL // 2:
            lost.append(NotUsed(dwell.name, len(dwell.time_s), "whole dwell: too little of it is there"))
        else:
            records.append(record)
    if not records:
        raise refused("No dwell can be used.", where, "look at what was not used, and record again.")
    return joined(records), tuple(lost)


def _turned_axis(rates: FloatArray) -> NDArray[np.intp]:
    """Axis of each block's rate; -1 at rest."""
    fastest = np.abs(rates).max(initial=0.0)
    axis = np.argmax(np.abs(rates), axis=1)
    return np.where(np.abs(rates).max(axis=1) > MIN_RATE_PART * fastest, axis, -1).astype(np.intp)


@dataclass(frozen=True)
class _AxisData:
    """Blocks of all staircases, their true rates, which of them turn about this axis; the gyro's column."""

    blocks: Blocks
    inputs: FloatArray
    mine: NDArray[np.bool_]
    row: int
    axis: int

    def own(self, fit: CorrelatedFit) -> tuple[Blocks, FloatArray, NDArray[np.bool_]]:
        """Blocks about this axis and at rest, less their cross-coupling by `fit`; their rates; which turn."""
        still = np.abs(self.inputs).max(axis=1) <= MIN_RATE_PART * np.abs(self.inputs).max()
        rows = self.mine | still
        coupling = fit.values[self.row, :3].copy()
        coupling[self.axis] = 0.0
        output = self.blocks.means[rows, self.row] - self.inputs[rows] @ coupling
        blocks = Blocks(self.blocks.middle_s[rows], self.blocks.duration_s[rows], output[:, None])
        return blocks, self.inputs[rows, self.axis], self.mine[rows]


def _axis_figures(data: _AxisData, fit: CorrelatedFit, how: tuple[str, SlowTerms | None]) -> AxisFigures:
    row, axis = data.row, data.axis
    where, known_slow = f"{how[0]}, {'xyz'[axis]} axis", how[1]
    gyro, rate, mine = data.own(fit)
    _check_sides(axis, rate[mine], where)
    sides = np.column_stack([np.maximum(rate, 0.0), np.minimum(rate, 0.0), np.ones(len(rate))])
    split = fit_correlated(sides, gyro, ("positive rates", "negative rates", "bias"), where, known_slow)
    scale = float(fit.values[row, axis])
    if scale <= 0.0:
        what = f"Gyro {'xyz'[axis]} does not follow the rate: its scale factor is {scale:.2g}."
        raise refused(what, where, "see whether it answers at all, and its sign.")
    full_scale = scale * float(np.abs(rate[mine]).max())
    # Each level's own mean in one fit, then the line's operator on them: noise and its memory go through.
    columns, rates, names = _levels(rate, mine)
    # What the Earth adds differs a little between blocks of one level: refer all to the level's own rate.
    at_level = gyro.means - scale * (rate - columns @ rates)[:, None]
    gyro = Blocks(gyro.middle_s, gyro.duration_s, at_level)
    levels = fit_correlated(columns, gyro, names, where, known_slow)
    outputs = levels.values[0]
    design = np.column_stack([np.ones(len(rates)), rates])
    operator = np.eye(len(rates)) - design @ line_weights("least_squares", rates, outputs)
    residual = operator @ outputs / full_scale
    covariance = operator @ levels.covariance[0] @ operator.T / full_scale**2
    largest = int(np.argmax(np.abs(residual)))
    minimax = outputs - design @ (line_weights("minimax", rates, outputs) @ outputs)
    return AxisFigures(
        axis=axis,
        scale_factor_error=(scale - 1.0, float(fit.standard_uncertainty[row, axis])),
        bias_rad_s=(float(fit.values[row, 3]), float(fit.standard_uncertainty[row, 3])),
        asymmetry=_asymmetry(split),
        rates_rad_s=rates,
        residuals=residual,
        residual_covariance=covariance,
        nonlinearity=(float(abs(residual[largest])), float(covariance[largest, largest] ** 0.5)),
        nonlinearity_of_noise=_largest_of_noise(covariance),
        nonlinearity_minimax=float(np.abs(minimax).max() / full_scale),
        full_scale_rad_s=full_scale,
    )


def _check_sides(axis: int, rates: FloatArray, where: str) -> None:
    for sign, words in ((1.0, "positive"), (-1.0, "negative")):
        levels = {round(float(value), 3) for value in rates[sign * rates > 0]}
        if len(levels) < MIN_LEVELS_PER_SIDE:
            raise refused(
                f"Body {'xyz'[axis]} turns at {len(levels)} {words} rates; {MIN_LEVELS_PER_SIDE} are needed.",
                where,
                "let the staircase go to both sides.",
            )


def _asymmetry(split: CorrelatedFit) -> tuple[float, float]:
    """2 (K+ - K-) / (K+ + K-) and its standard uncertainty."""
    plus, minus = (float(value) for value in split.values[0, :2])
    gradient = 4.0 * np.array([minus, -plus]) / (plus + minus) ** 2
    variance = float(gradient @ split.covariance[0, :2, :2] @ gradient)
    return 2.0 * (plus - minus) / (plus + minus), float(np.sqrt(variance))


def _levels(rate: FloatArray, mine: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """One column of ones for each level, rest among them: (blocks, levels); rates, ascending; names."""
    order = np.argsort(np.where(mine, rate, 0.0))
    ordered = np.where(mine, rate, 0.0)[order]
    label = np.concatenate([[0], np.cumsum(np.diff(ordered) > SAME_LEVEL_PART * np.abs(ordered).max())])
    columns = np.zeros((len(rate), int(label[-1]) + 1))
    columns[order, label] = 1.0
    rates = np.asarray((columns.T @ rate) / columns.sum(axis=0), dtype=np.float64)
    return columns, rates, tuple(f"level {np.degrees(one):.4g} deg/s" for one in rates.tolist())


def _largest_of_noise(covariance: FloatArray) -> float:
    """Mean of the largest magnitude of residuals that are noise alone: 2000 fixed draws."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    draws = np.random.default_rng(0).standard_normal((2000, len(covariance)))
    return float(np.abs(draws @ root.T).max(axis=1).mean())


def _covariance(fit: CorrelatedFit, relative: float) -> FloatArray:
    """Of the rows of M one after another and the biases, the gyros' noise independent, (4 m, 4 m)."""
    gyros = len(fit.values)
    covariance = np.zeros((4 * gyros, 4 * gyros))
    for gyro in range(gyros):
        own = [3 * gyro, 3 * gyro + 1, 3 * gyro + 2, 3 * gyros + gyro]
        covariance[np.ix_(own, own)] = fit.covariance[gyro]
    common = np.concatenate([fit.values[:, :3].ravel(), np.zeros(gyros)])
    return covariance + relative**2 * np.outer(common, common)


def _coefficients(fit: CorrelatedFit, covariance: FloatArray) -> TriadCoefficients:
    return TriadCoefficients(
        quantity="angular_rate",
        matrix=fit.values[:, :3],
        bias=fit.values[:, 3],
        covariance=covariance,
        residual_rms=float(np.sqrt((fit.residuals**2).mean())),
        degrees_of_freedom=3 * fit.degrees_of_freedom,
    )

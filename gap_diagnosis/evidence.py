# pyright: strict
"""How much better a block of effects explains the data than noise alone.

    Q = 2 [ln max_a Σ_λ π_λ L_λ(a) − ln Σ_λ π_λ L_λ(0)]
    ln B = ln mean_g (1 + g)^(−k/2) exp(½ g/(1+g) Q),    g = d²/k,  d on a log grid

Q is the gain of the likelihood, slow noise summed over; the g-prior puts an effect's whitened signal-to-noise
ratio d anywhere between 2 and 200. Everything is done for many blocks of one size, and for data and simulated
nulls (last axis j), at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES, Block
from gap_diagnosis.observation import Channel
from gap_diagnosis.whitened import ChannelSystem

SIGNALS = np.geomspace(2.0, 200.0, 12)
"""Whitened signal-to-noise ratios d that the prior holds equally likely."""
STEPS_OF_DATA, STEPS_OF_NULLS = 5, 1
RIDGE = 1e-5
"""Share of a column's own square: keeps columns that the nuisances take whole from dividing by nought."""


def log_bayes_factor(gain: FloatArray, k: int | NDArray[np.int64]) -> FloatArray:
    """ln B of a gain Q with k parameters; shapes broadcast."""
    count = np.maximum(np.asarray(k, dtype=np.float64), 1.0)[..., np.newaxis]
    g = SIGNALS**2 / count
    each = -0.5 * count * np.log1p(g) + 0.5 * (g / (1.0 + g)) * np.asarray(gain)[..., np.newaxis]
    return log_mean_exp(each, -1)


def log_mean_exp(values: FloatArray, axis: int) -> FloatArray:
    """ln of the mean of exp along an axis."""
    return log_sum_exp(values, axis) - np.log(values.shape[axis])


def log_sum_exp(values: FloatArray, axis: int) -> FloatArray:
    """ln of the sum of exp along an axis."""
    top = np.max(values, axis=axis, keepdims=True)
    return np.squeeze(top, axis) + np.log(np.sum(np.exp(values - top), axis=axis))


@dataclass(frozen=True)
class Gains:
    """Of blocks that were evaluated together.

    Attributes:
        blocks: indices, b of them.
        gain: (b, j) Q.
        amplitude: (b, j, k) of the scaled columns.
    """

    blocks: tuple[int, ...]
    gain: FloatArray
    amplitude: FloatArray


def gains(
    systems: Mapping[Channel, ChannelSystem],
    blocks: Sequence[Block],
    chosen: Sequence[int],
    columns: slice,
    steps: int,
) -> list[Gains]:
    """Q of each chosen block alone, for the data and nulls in `columns` of the last axis."""
    groups: dict[tuple[tuple[Channel, ...], int], list[int]] = {}
    for index in chosen:
        block = blocks[index]
        groups.setdefault((tuple(block.columns), len(block.scalars)), []).append(index)
    return [
        _of_group(systems, [blocks[i] for i in members], members, channels, columns, steps)
        for (channels, _), members in groups.items()
    ]


def _of_group(
    systems: Mapping[Channel, ChannelSystem],
    blocks: Sequence[Block],
    members: Sequence[int],
    channels: Sequence[Channel],
    columns: slice,
    steps: int,
) -> Gains:
    terms = [_terms(systems[c], np.stack([b.columns[c] for b in blocks]), columns) for c in channels]
    gain, amplitude = profile(terms, steps)
    return Gains(tuple(members), gain, amplitude)


@dataclass(frozen=True)
class Terms:
    """One channel's part of blocks of k scalars.

    Attributes:
        gram: (b, h, k, k).
        cross: (b, h, k, j).
        log_weighted: (h, j) likelihood of no effect times the level's prior.
    """

    gram: FloatArray
    cross: FloatArray
    log_weighted: FloatArray


def _terms(system: ChannelSystem, index: NDArray[np.int64], columns: slice) -> Terms:
    """`index` (b, k) of columns with the nuisances counted, -1 for none."""
    use = slice(0, system.believed)
    place = np.where(index < 0, 0, index - NUISANCES)
    there = index >= 0
    gram = system.gram[use][:, place[:, :, np.newaxis], place[:, np.newaxis, :]]
    gram = np.moveaxis(gram, 0, 1) * (
        there[:, np.newaxis, :, np.newaxis] & there[:, np.newaxis, np.newaxis, :]
    )
    cross = system.cross[use, :, columns][:, place]
    cross = np.moveaxis(cross, 0, 1) * there[:, np.newaxis, :, np.newaxis]
    log_weighted = system.log_likelihood[use, columns] + system.log_weight[use, np.newaxis]
    return Terms(gram, cross, log_weighted)


def profile(terms: Sequence[Terms], steps: int) -> tuple[FloatArray, FloatArray]:
    """(b, j) Q and (b, j, k) amplitudes that a few steps of expectation and maximisation reach."""
    count = terms[0].gram.shape[0]
    k = terms[0].gram.shape[-1]
    j = terms[0].cross.shape[-1]
    weights = [np.broadcast_to(_softmax(t.log_weighted, 0), (count, *t.log_weighted.shape)) for t in terms]
    amplitude = np.zeros((count, j, k))
    gained = [np.zeros((count, *t.log_weighted.shape)) for t in terms]
    for _ in range(steps):
        gram = np.zeros((count, j, k * k))
        cross = np.zeros((count, k, j))
        for term, weight in zip(terms, weights, strict=True):
            gram += np.swapaxes(weight, 1, 2) @ term.gram.reshape(count, -1, k * k)
            cross += np.sum(weight[:, :, np.newaxis] * term.cross, axis=1)
        gram = gram.reshape(count, j, k, k)
        diagonal = gram[..., np.arange(k), np.arange(k)]
        gram[..., np.arange(k), np.arange(k)] += RIDGE * diagonal + 1e-12
        amplitude = np.linalg.solve(gram, np.swapaxes(cross, 1, 2)[..., np.newaxis])[..., 0]
        by_column = np.swapaxes(amplitude, 1, 2)
        squares = (by_column[:, :, np.newaxis] * by_column[:, np.newaxis]).reshape(count, k * k, j)
        for index, term in enumerate(terms):
            linear = np.sum(by_column[:, np.newaxis] * term.cross, axis=2)
            gained[index] = linear - 0.5 * (term.gram.reshape(count, -1, k * k) @ squares)
            weights[index] = _softmax(term.log_weighted + gained[index], 1)
    total = np.zeros((count, j))
    for term, gain in zip(terms, gained, strict=True):
        total += log_sum_exp(term.log_weighted + gain, 1) - log_sum_exp(term.log_weighted, 0)
    return np.maximum(2.0 * total, 0.0), np.asarray(amplitude, dtype=np.float64)


def _softmax(values: FloatArray, axis: int) -> FloatArray:
    scaled = np.exp(values - np.max(values, axis=axis, keepdims=True))
    return scaled / np.sum(scaled, axis=axis, keepdims=True)

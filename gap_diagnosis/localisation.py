# pyright: strict
"""Where the gap lies: channels times cells, with one error rate for all of them together.

Three families of statistics, each for the data and for every simulated null: cells and whole regimes
(deterministic), the level of white and slow noise (stochastic), and the effects of the catalogue, which are
templates. A family's p is its rank among its own nulls; the p of the whole is the rank of the smallest one
(minimum p, after Westfall and Young, *Resampling-Based Multiple Testing*, 1993). Beyond the last null the
tail of a cell's own distribution is used, times the number of cells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfc, gammaincc  # pyright: ignore[reportMissingTypeStubs]

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES, CellGroup
from gap_diagnosis.evidence import Terms, log_mean_exp, log_sum_exp, profile
from gap_diagnosis.observation import Channel
from gap_diagnosis.prepared import Prepared
from gap_diagnosis.search import Scan
from gap_diagnosis.whitened import ChannelSystem

SMALLEST_P = 1e-300


@dataclass(frozen=True)
class CellFinding:
    """One cell of one channel.

    Attributes:
        channel, variable, low, high, unit: where.
        sigmas: mean residual over its standard uncertainty, signed.
        excess_si: mean residual, SI.
        p_adjusted: family-wise over all cells and regimes.
    """

    channel: Channel
    variable: str
    low: float
    high: float
    unit: str
    sigmas: float
    excess_si: float
    p_adjusted: float


@dataclass(frozen=True)
class NoiseFinding:
    """A channel's noise against the belief; `ratio` of deviations."""

    channel: Channel
    kind: str
    ratio: float
    p_adjusted: float


@dataclass(frozen=True)
class Localisation:
    """What lies where.

    Attributes:
        p: of 'nothing anywhere'.
        p_families: 'cells', 'noise', 'effects'.
        cells: every cell.
        noises: white and slow level of every channel.
        beyond_nulls: True where a p is a fitted tail.
    """

    p: float
    p_families: Mapping[str, float]
    cells: tuple[CellFinding, ...]
    noises: tuple[NoiseFinding, ...]
    beyond_nulls: bool


def localise(
    prepared: Prepared, systems: Mapping[Channel, ChannelSystem], scanned: Scan, *, white: bool = True
) -> Localisation:
    """Test everything against the nulls that `systems` carry; `white`: the level of the white noise too."""
    statistics, cells = _cell_statistics(prepared, systems)
    noise_statistics, noises = _noise_statistics(prepared, systems, white=white)
    weighed = list(scanned.log_bayes_factor.values()) or [
        np.zeros(next(iter(systems.values())).cross.shape[-1])
    ]
    templates = log_mean_exp(np.array(weighed), 0)
    families = {
        "cells": statistics.max(axis=0) if len(statistics) else np.zeros_like(templates),
        "noise": noise_statistics.max(axis=0) if len(noise_statistics) else np.zeros_like(templates),
        "effects": templates,
    }
    ranks = {name: ranks_of(values) for name, values in families.items()}
    p = smallest_rank_p(list(ranks.values()))
    beyond = any(float(r[0]) <= 1.0 / len(r) for r in ranks.values())
    if beyond:  # a tail: Bonferroni over cells, or the evidence itself (Markov: p ≤ 1 / B)
        tails = [float(np.exp(-min(float(templates[0]), 690.0)))]
        for members, name in ((len(statistics), "cells"), (len(noise_statistics), "noise")):
            if members:  # without any, no statistic is as unlikely as none
                tails.append(members * 10.0 ** -float(families[name][0]))
        p = max(min(p, 3.0 * min(tails)), SMALLEST_P)
    top_cells, top_noise = families["cells"], families["noise"]
    return Localisation(
        p=p,
        p_families={name: float(r[0]) for name, r in ranks.items()},
        cells=tuple(_adjusted(cell, top_cells, len(statistics)) for cell in cells),
        noises=tuple(_adjusted_noise(one, top_noise, len(noise_statistics)) for one in noises),
        beyond_nulls=beyond,
    )


def ranks_of(values: FloatArray) -> FloatArray:
    """(j,) share of all columns, data and nulls alike, that are at least as large as each."""
    return (len(values) - np.searchsorted(np.sort(values), values, side="left")) / len(values)


def smallest_rank_p(ranks: Sequence[FloatArray]) -> float:
    """p of the data (column 0) by the smallest of its families' ranks.

    Data and nulls are ranked together: only so are they exchangeable where there is no gap, and p is exact.
    """
    smallest: FloatArray = np.min(np.array(ranks), axis=0)
    return float(np.count_nonzero(smallest <= smallest[0])) / len(smallest)


def _minus_log10_p(square: FloatArray, freedom: int) -> FloatArray:
    """−log10 of the chance of a chi square as large."""
    half: FloatArray = 0.5 * np.maximum(square, 0.0)
    p: FloatArray = erfc(np.sqrt(half)) if freedom == 1 else gammaincc(0.5 * freedom, half)
    far = half / np.log(10.0) - 0.5 * freedom  # where p is nought to the computer
    return np.where(
        p > SMALLEST_P, -np.log10(np.maximum(p, SMALLEST_P)), np.maximum(far, -np.log10(SMALLEST_P))
    )


_Cell = tuple[CellFinding, float]


def _cell_statistics(
    prepared: Prepared, systems: Mapping[Channel, ChannelSystem]
) -> tuple[FloatArray, list[_Cell]]:
    """(statistics, j) −log10 p of every cell and every regime; the cells with the statistic of the data."""
    rows: list[FloatArray] = []
    cells: list[_Cell] = []
    for group in prepared.design.cells:
        if group.channel not in systems:
            continue
        system = systems[group.channel]
        rows.append(_regime_statistic(group, system))
        of_cells, found = _each_cell(group, system)
        rows += of_cells
        cells += found
    return np.array(rows), cells


def _regime_statistic(group: CellGroup, system: ChannelSystem) -> FloatArray:
    use = slice(0, system.believed)
    place = group.columns[:-1] - NUISANCES  # the cells add up to a constant, which is the bias's
    terms = Terms(
        system.gram[use][:, place][:, :, place][np.newaxis],
        system.cross[use][:, place][np.newaxis],
        system.log_likelihood[use] + system.log_weight[use, np.newaxis],
    )
    gain, _ = profile([terms], 1)
    return _minus_log10_p(gain[0], len(place))


def _each_cell(group: CellGroup, system: ChannelSystem) -> tuple[list[FloatArray], list[_Cell]]:
    use = slice(0, system.believed)
    weighted = system.log_likelihood[use] + system.log_weight[use, np.newaxis]
    weight = np.exp(weighted - log_sum_exp(weighted, 0))  # (h, j)
    place = group.columns - NUISANCES
    information = system.gram[use][:, place, place].T @ weight  # (cells, j)
    cross = np.einsum("hj,hcj->cj", weight, system.cross[use][:, place])
    usual = np.median(np.abs(information), axis=1, keepdims=True)
    seen = information > 1e-6 * usual + 1e-300
    sigmas = np.where(seen, cross / np.sqrt(np.where(seen, information, 1.0)), 0.0)
    statistics = list(_minus_log10_p(sigmas**2, 1))
    cells = [
        (
            CellFinding(
                group.channel,
                group.regime.variable,
                float(group.regime.edges[cell]),
                float(group.regime.edges[cell + 1]),
                group.regime.unit,
                float(sigmas[cell, 0]),
                float(cross[cell, 0] / information[cell, 0]) if seen[cell, 0] else 0.0,
                1.0,
            ),
            float(statistics[cell][0]),
        )
        for cell in range(len(place))
    ]
    return statistics, cells


_Noise = tuple[NoiseFinding, float]


def _noise_statistics(
    prepared: Prepared, systems: Mapping[Channel, ChannelSystem], *, white: bool
) -> tuple[FloatArray, list[_Noise]]:
    """White level against its spread, slow level beyond the belief; of each channel."""
    rows: list[FloatArray] = []
    found: list[_Noise] = []
    for channel, system in systems.items():
        noise = prepared.noise[channel]
        if white and noise.log_white_ratio is not None:
            ratios = np.concatenate([[noise.log_white_ratio], noise.null_log_white_ratios])
            statistic = _minus_log10_p((ratios / noise.belief.white_spread) ** 2, 1)
            rows.append(statistic)
            one = NoiseFinding(channel, "white", float(np.exp(noise.log_white_ratio)), 1.0)
            found.append((one, float(statistic[0])))
        first = system.believed
        if first < len(system.log_weight):
            weighted = system.log_likelihood + system.log_weight[:, np.newaxis]
            excess = log_sum_exp(weighted[first:], 0) - log_sum_exp(weighted[:first], 0)
            statistic = excess / np.log(10.0)
            rows.append(statistic)
            likeliest = noise.levels.level_si[int(np.argmax(system.log_likelihood[:, 0]))]
            ratio = float(likeliest / noise.levels.level_si[first // 2])
            found.append((NoiseFinding(channel, "slow", ratio, 1.0), float(statistic[0])))
    return np.array(rows), found


def _family_wise(statistic: float, largest: FloatArray, members: int) -> float:
    nulls = largest[1:]
    above = int(np.count_nonzero(nulls >= statistic))
    if above:
        return (1 + above) / (len(nulls) + 1)
    return max(min(1.0 / (len(nulls) + 1), members * 10.0 ** -min(statistic, 300.0)), SMALLEST_P)


def _adjusted(cell: _Cell, largest: FloatArray, members: int) -> CellFinding:
    one, statistic = cell
    p = _family_wise(statistic, largest, members)
    return CellFinding(one.channel, one.variable, one.low, one.high, one.unit, one.sigmas, one.excess_si, p)


def _adjusted_noise(noise: _Noise, largest: FloatArray, members: int) -> NoiseFinding:
    one, statistic = noise
    return NoiseFinding(one.channel, one.kind, one.ratio, _family_wise(statistic, largest, members))

# pyright: strict
"""Is what passes for slow noise a normal process, or does it jump?

A step, a burst, a bias that switches between two levels: slow noise of a large enough level explains them
all, as it explains anything. But then the whole of it comes at a few moments. With the noise C at its likely
level, slow noise as a random walk that rises from knot to knot as much, and x a step at one moment, the mean
taken off in the metric of C,

    z = xᵀC⁻¹r / √(xᵀC⁻¹x)

asks whether the residual rises there by more than such noise does, and is standard normal whenever that is.
(In noise that returns to its mean a step would seem to be everywhere.) The deviation is taken from the bulk
of all z where it is larger: a level that is off is not a jump. p is that of the largest by Student's
distribution, of half as many degrees as there are knots, times the number of moments. With s = λ L u on the
knots, L Lᵀ = S, hat functions B, row noise σ:

    C⁻¹ = (I − q² B G Bᵀ) / σ²,    G = L (I + q² LᵀBᵀB L)⁻¹ Lᵀ,    q = λ/σ
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse  # pyright: ignore[reportMissingTypeStubs]
from scipy.special import stdtr  # pyright: ignore[reportMissingTypeStubs]

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES
from gap_diagnosis.noise_model import Knots, SlowShape, without_columns
from gap_diagnosis.observation import Channel
from gap_diagnosis.prepared import Prepared
from gap_diagnosis.search import Cause
from gap_diagnosis.whitened import ChannelSystem

BULK, NORMAL_BULK = 0.9, 0.789
"""Share of all z, by size, whose root mean square is their deviation; that of standard normal numbers."""
CLEARLY_P = 0.001
"""Below it a jump is one: noise that is rough between two knots reaches 0.01 in a twentieth of the runs."""
LEAST_SEEN = 1e-6
"""Share of a step's square that the noise and the mean leave, at least."""


@dataclass(frozen=True)
class Jump:
    """The clearest step of one run: when, on the observation's time, and how likely by chance."""

    channel: Channel
    recording: int
    at_s: float
    p: float


def jumps_of_noise(
    prepared: Prepared,
    systems: Mapping[Channel, ChannelSystem],
    causes: Sequence[Cause],
    columns: Mapping[Channel, Mapping[int, FloatArray]],
) -> list[Jump]:
    """The clearest jump of each channel whose slow noise is a cause, the least likely first.

    columns: channel → recording → (n, k) what else acts there, bias and matrix with it.
    """
    found: list[Jump] = []
    for cause in causes:
        for channel in cause.channels if cause.trial < 0 else ():
            system, noise = systems[channel], prepared.noise[channel]
            mine = (np.arange(len(system.shape)) >= system.believed) & np.isin(system.shape, cause.shapes)
            level = int(np.argmax(np.where(mine, system.log_likelihood[:, 0], -np.inf)))
            for index, knots in noise.knots.items():
                use = prepared.design.channels[channel].rows[index]
                output = prepared.observations[index].outputs[channel.sensor]
                own = columns.get(channel, {}).get(index)
                if own is None:
                    own = prepared.design.channels[channel].matrices[index][:, :NUISANCES]
                left = without_columns(output.residual_si[use, channel.axis], own)
                shape, si = int(system.shape[level]), float(noise.levels.level_si[level])
                found.append(
                    Jump(channel, index, *clearest_step(knots, shape, si, noise.white_si[index], left))
                )
    return sorted(found, key=lambda jump: jump.p)


def clearest_step(
    knots: Knots, shape: int, level_si: float, white_si: float, residual: FloatArray
) -> tuple[float, float]:
    """When the residual (n,), SI, steps most beyond such noise, and p of as large a step anywhere."""
    time_s = np.asarray(knots.hats @ knots.time_s, dtype=np.float64)
    moments = np.sort(np.concatenate([knots.time_s[1:-1], 0.5 * (knots.time_s[1:] + knots.time_s[:-1])]))
    z = step_scores(knots, shape, level_si / white_si, time_s, residual / white_si, moments)
    freedom = len(knots.time_s) // 2
    if not freedom:
        return float(time_s[0]), 1.0
    bulk = np.sort(np.abs(z))[: int(np.ceil(BULK * len(z)))]
    z = z / max(1.0, float(np.sqrt(np.mean(bulk**2))) / NORMAL_BULK)
    largest = int(np.argmax(np.abs(z)))
    p = 2.0 * float(stdtr(freedom, -abs(float(z[largest])))) * len(z)
    return float(moments[largest]), min(p, 1.0)


def _as_walk(shape: SlowShape, time_s: FloatArray) -> FloatArray:
    """(k, k) of a random walk that rises from knot to knot as the shape does."""
    step_s = float(np.median(np.diff(time_s)))
    rise = float(shape.covariance(np.array([0.0, step_s])) @ np.array([1.0, -1.0]) @ np.array([1.0, -1.0]))
    since_s = time_s - time_s[0] + step_s * len(time_s)
    return rise / step_s * np.minimum(since_s[:, np.newaxis], since_s)


def step_scores(
    knots: Knots, shape: int, ratio: float, time_s: FloatArray, scaled: FloatArray, moments: FloatArray
) -> FloatArray:
    """(m,) z of a step at each moment. ratio: q; scaled (n,): residual over the white noise of a row."""
    covariance = _as_walk(knots.shapes[shape], knots.time_s)
    ridge = 1e-9 * float(covariance[0, 0]) * np.eye(len(covariance))
    root = np.asarray(np.linalg.cholesky(covariance + ridge), dtype=np.float64)
    overlap = np.asarray((knots.hats.T @ knots.hats).toarray(), dtype=np.float64)
    inner = np.eye(len(root)) + ratio**2 * (root.T @ overlap @ root)
    weight = ratio**2 * (root @ np.linalg.solve(inner, root.T))
    # a step's sums are those of all bins from its moment on; the first, over all rows, is a constant
    bins = np.searchsorted(moments, time_s, side="right")
    rows = np.arange(len(bins))
    there: Any = sparse.csr_matrix((np.ones(len(bins)), (rows, bins)), shape=(len(bins), len(moments) + 1))
    summed = _from_here_on(np.asarray((knots.hats.T @ there).toarray(), dtype=np.float64))
    count = _from_here_on(np.asarray(there.sum(axis=0), dtype=np.float64))[0]
    of_scaled = _from_here_on(np.asarray(there.T @ scaled, dtype=np.float64)[np.newaxis])[0]
    later = np.maximum(np.arange(len(count))[:, np.newaxis], np.arange(len(count)))
    gram = count[later] - summed.T @ weight @ summed
    cross = of_scaled - summed.T @ (weight @ knots.summed(scaled[:, np.newaxis])[:, 0])
    share = gram[0] / gram[0, 0]
    square = np.einsum("kk->k", gram) - share * gram[0]
    seen = square > LEAST_SEEN * np.einsum("kk->k", gram)
    z = np.where(seen, cross - share * cross[0], 0.0) / np.sqrt(np.where(seen, square, 1.0))
    return np.asarray(z[1:], dtype=np.float64)


def _from_here_on(values: FloatArray) -> FloatArray:
    """Sums over the last axis from each place to the end."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]

# pyright: strict
"""Is what passes for slow noise a normal process, or does it jump?

A step, a burst, a bias that switches between two levels: slow noise of a large enough level explains them
all, as it explains anything. But then the whole of it comes at a few moments. With the noise C at its likely
level, slow noise as a random walk that rises from knot to knot as much, and x a step at one moment, bias,
matrix and what else acts taken off in the metric of C,

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
from gap_diagnosis.noise_model import Knots, SlowShape
from gap_diagnosis.observation import Channel
from gap_diagnosis.prepared import Prepared
from gap_diagnosis.search import Cause
from gap_diagnosis.whitened import ChannelSystem

BULK, NORMAL_BULK = 0.9, 0.789
"""Share of all z, by size, whose root mean square is their deviation; that of standard normal numbers."""
CLEARLY_P = 0.001
"""Below it a jump is one: noise that is rough between two knots reaches 0.01 in a twentieth of the runs."""
EDGE = 2
"""So many knots at either end tell of no step."""
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
                residual = output.residual_si[use, channel.axis]
                shape, si = int(system.shape[level]), float(noise.levels.level_si[level])
                found.append(
                    Jump(
                        channel, index, *clearest_step(knots, shape, si, noise.white_si[index], residual, own)
                    )
                )
    return sorted(found, key=lambda jump: jump.p)


def clearest_step(
    knots: Knots, shape: int, level_si: float, white_si: float, residual: FloatArray, columns: FloatArray
) -> tuple[float, float]:
    """When the residual (n,), SI, steps most beyond such noise, and p of as large a step anywhere.

    columns (n, k): what else acts, the bias with it; taken off as the noise asks for.
    """
    inner = knots.time_s[EDGE:-EDGE]
    freedom = len(inner) // 2
    if not freedom:
        return float(knots.time_s[0]), 1.0
    at_knots, between = inner, 0.5 * (inner[1:] + inner[:-1])
    moments = np.concatenate([at_knots, between])
    scores = step_scores(knots, shape, level_si / white_si, residual / white_si, moments, columns)
    parts = np.split(scores, [len(at_knots)])
    z = np.concatenate([_scaled(part) for part in parts])
    largest = int(np.argmax(np.abs(z)))
    p = 2.0 * float(stdtr(freedom, -abs(float(z[largest])))) * len(z)
    return float(moments[largest]), min(p, 1.0)


def _scaled(z: FloatArray) -> FloatArray:
    """Over their own deviation, where that is above 1. Noise is rough between knots, and lines are not: z at
    knots and between them have different ones."""
    bulk = np.sort(np.abs(z))[: int(np.ceil(BULK * len(z)))]
    return z / max(1.0, float(np.sqrt(np.mean(bulk**2))) / NORMAL_BULK) if len(z) else z


def _as_walk(shape: SlowShape, time_s: FloatArray) -> FloatArray:
    """(k, k) of a random walk that rises from knot to knot as the shape does."""
    step_s = float(np.median(np.diff(time_s)))
    rise = float(shape.covariance(np.array([0.0, step_s])) @ np.array([1.0, -1.0]) @ np.array([1.0, -1.0]))
    since_s = time_s - time_s[0] + step_s * len(time_s)
    return rise / step_s * np.minimum(since_s[:, np.newaxis], since_s)


def step_scores(
    knots: Knots,
    shape: int,
    ratio: float,
    scaled: FloatArray,
    moments: FloatArray,
    columns: FloatArray,
) -> FloatArray:
    """(m,) z of a step at each moment.

    ratio: q; scaled (n,): residual over the white noise of a row; columns (n, k): what is taken off.
    """
    covariance = _as_walk(knots.shapes[shape], knots.time_s)
    ridge = 1e-9 * float(covariance[0, 0]) * np.eye(len(covariance))
    root = np.asarray(np.linalg.cholesky(covariance + ridge), dtype=np.float64)
    overlap = np.asarray((knots.hats.T @ knots.hats).toarray(), dtype=np.float64)
    inner = np.eye(len(root)) + ratio**2 * (root.T @ overlap @ root)
    weight = ratio**2 * (root @ np.linalg.solve(inner, root.T))
    order = np.argsort(moments)
    # a step's sums are those of all bins from its moment on
    time_s = np.asarray(knots.hats @ knots.time_s, dtype=np.float64)
    bins = np.searchsorted(moments[order], time_s, side="right")
    shape_of = (len(bins), len(moments) + 1)
    there: Any = sparse.csr_matrix((np.ones(len(bins)), (np.arange(len(bins)), bins)), shape=shape_of)

    def of_steps(values: FloatArray) -> FloatArray:
        """(k, m) sums of values (n, k) over the rows from each moment on."""
        return _from_here_on(np.asarray((there.T @ values).T, dtype=np.float64))[:, 1:]

    fixed = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    summed = _from_here_on(np.asarray((knots.hats.T @ there).toarray(), dtype=np.float64))[:, 1:]
    summed_fixed, summed_scaled = knots.summed(fixed), knots.summed(scaled[:, np.newaxis])[:, 0]
    count = of_steps(np.ones((len(bins), 1)))[0]
    square = count - np.einsum("km,kl,lm->m", summed, weight, summed)
    cross = of_steps(scaled[:, np.newaxis])[0] - summed.T @ (weight @ summed_scaled)
    among = fixed.T @ fixed - summed_fixed.T @ weight @ summed_fixed
    across = of_steps(fixed) - summed_fixed.T @ weight @ summed
    solved = np.asarray(np.linalg.pinv(among, rcond=1e-9, hermitian=True), dtype=np.float64) @ across
    left = square - np.sum(solved * across, axis=0)
    cross = cross - solved.T @ (fixed.T @ scaled - summed_fixed.T @ (weight @ summed_scaled))
    seen = left > LEAST_SEEN * count
    z = np.empty(len(moments))
    z[order] = np.where(seen, cross, 0.0) / np.sqrt(np.where(seen, left, 1.0))
    return z


def _from_here_on(values: FloatArray) -> FloatArray:
    """Sums over the last axis from each place to the end."""
    return np.cumsum(values[..., ::-1], axis=-1)[..., ::-1]

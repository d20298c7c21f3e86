# pyright: strict
"""Sufficient statistics of a channel: Gram matrices in the metric of the noise, nuisances projected out.

With C_λ = σ² I + λ² B S Bᵀ and the modes Z of the slow noise (see `noise_model`),

    XᵀC⁻¹X = (XᵀX − Σ_k w_k z_k z_kᵀ) / σ²,    w_k = λ² / (1 + λ² Λ_k),    ln|C| = Σ_k ln(1 + λ² Λ_k)

for every level λ from one pass over the rows. Simulated nulls are drawn from the same statistics: what white
noise and slow noise of a drawn level add to Xᵀn and Zᵀn is normal with a known covariance, so that a null
costs as many operations as there are columns, not rows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES
from gap_diagnosis.noise_model import Knots, Levels

RIDGE = 1e-9


@dataclass(frozen=True)
class RecordingMoments:
    """One channel of one recording, divided by its white noise: amplitudes stay in SI per scaled column.

    Attributes:
        gram: (p, p) XᵀX.
        seen: (k, p) Zᵀ X along the modes of the slow noise.
        strengths: (k,) Λ.
        cross: (p, j) Xᵀ r: column 0 is the data, the others are simulated nulls.
        seen_cross: (k, j) Zᵀ r.
        square: rᵀ r of the data.
        rows: n.
    """

    gram: FloatArray
    seen: FloatArray
    strengths: FloatArray
    cross: FloatArray
    seen_cross: FloatArray
    square: float
    rows: int


@dataclass(frozen=True)
class ChannelSystem:
    """A channel over some recordings at each level of its slow noise, bias and matrix projected out.

    Attributes:
        gram: (h, p, p) of the trials' columns, without the nuisances.
        cross: (h, p, j).
        log_likelihood: (h, j) of no effect, but for a constant.
        log_weight: (h,) prior of the levels.
        believed: the first so many levels carry the belief.
    """

    gram: FloatArray
    cross: FloatArray
    log_likelihood: FloatArray
    log_weight: FloatArray
    believed: int


def moments(
    matrix: FloatArray,
    residual: FloatArray,
    knots: Knots,
    white_si: float,
    null_levels: FloatArray,
    rng: np.random.Generator,
) -> RecordingMoments:
    """Statistics of the data and of a simulated null for each of `null_levels` (in units of white noise).

    matrix (n, p), residual (n,) in SI, `white_si` the standard deviation of a row's white noise.
    """
    gram = matrix.T @ matrix / white_si**2
    seen = knots.seen(matrix) / white_si
    scaled = residual / white_si
    cross, seen_cross = matrix.T @ scaled / white_si, knots.seen(scaled[:, np.newaxis])
    drawn, seen_drawn = _nulls(gram, seen, knots, null_levels, rng)
    return RecordingMoments(
        gram=gram,
        seen=seen,
        strengths=knots.strengths,
        cross=np.concatenate([cross[:, np.newaxis], drawn], axis=1),
        seen_cross=np.concatenate([seen_cross, seen_drawn], axis=1),
        square=float(scaled @ scaled),
        rows=len(residual),
    )


def _nulls(
    gram: FloatArray, seen: FloatArray, knots: Knots, levels: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Xᵀn (p, j) and Zᵀn (k, j) of noise alone, white plus slow of each level.

    Along the modes white noise has the covariance ZᵀZ = diag(Λ); given it, Xᵀw is normal with mean
    seenᵀ Λ⁻¹ Zᵀw and what is left of XᵀX as covariance.
    """
    strengths = knots.strengths
    held = strengths > 1e-9 * max(float(strengths[-1]), 1e-300)
    along = rng.standard_normal((len(strengths), len(levels))) * np.sqrt(strengths)[:, np.newaxis]
    share = np.zeros_like(seen)
    share[held] = seen[held] / strengths[held, np.newaxis]
    left = gram - share.T @ seen
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    left /= scale[:, np.newaxis] * scale
    left = 0.5 * (left + left.T)
    left[np.diag_indices_from(left)] += 1e-8
    try:
        root = np.linalg.cholesky(left)
    except np.linalg.LinAlgError:  # columns that repeat each other, to rounding
        values, vectors = np.linalg.eigh(left)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
    white = scale[:, np.newaxis] * (root @ rng.standard_normal((len(gram), len(levels)))) + share.T @ along
    slow = rng.standard_normal((len(strengths), len(levels))) * levels
    return white + seen.T @ slow, along + strengths[:, np.newaxis] * slow


def channel_system(
    by_recording: Mapping[int, RecordingMoments],
    mounts: Sequence[str],
    levels: Mapping[int, FloatArray],
    of: Levels,
    matrix_prior_si: float,
) -> ChannelSystem:
    """Recordings of one channel together.

    levels: recording → (h,) in units of its own white noise; matrix_prior_si: standard deviation of the
    matrix's columns as they are scaled.
    """
    parts: dict[str, list[int]] = {}
    for index in by_recording:
        parts.setdefault(mounts[index], []).append(index)
    gram = cross = likelihood = 0.0
    for group in parts.values():
        mount_gram = mount_cross = 0.0
        for index in group:
            one_gram, one_cross, one_likelihood = _of_recording(by_recording[index], levels[index])
            mount_gram = mount_gram + one_gram
            mount_cross = mount_cross + one_cross
            likelihood = likelihood + one_likelihood
        inner_gram, inner_cross, of_matrix = _without(
            np.asarray(mount_gram), np.asarray(mount_cross), NUISANCES - 1, 1.0 / matrix_prior_si**2
        )
        gram, cross, likelihood = gram + inner_gram, cross + inner_cross, likelihood + of_matrix
    return ChannelSystem(
        np.asarray(gram), np.asarray(cross), np.asarray(likelihood), of.log_weight, of.believed
    )


def _of_recording(one: RecordingMoments, levels: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """At each level, the bias of the run projected out: (h, p − 1, p − 1), (h, p − 1, j), (h, j)."""
    weights = levels[:, np.newaxis] ** 2 / (1.0 + levels[:, np.newaxis] ** 2 * one.strengths)
    log_determinant = np.sum(np.log1p(levels[:, np.newaxis] ** 2 * one.strengths), axis=1)
    root = np.sqrt(weights)[:, :, np.newaxis] * one.seen
    gram = one.gram - np.swapaxes(root, 1, 2) @ root
    cross = one.cross - one.seen.T @ (weights[:, :, np.newaxis] * one.seen_cross)
    explained = np.sum(weights[:, :, np.newaxis] * one.seen_cross**2, axis=1)
    inner_gram, inner_cross, of_bias = _without(gram, cross, 1, RIDGE * float(one.gram[0, 0]))
    return inner_gram, inner_cross, 0.5 * (explained - log_determinant[:, np.newaxis]) + of_bias


def _without(
    gram: FloatArray, cross: FloatArray, count: int, precision: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The first `count` columns summed over, with a normal prior of this precision: Schur complements."""
    head = gram[:, :count, :count] + precision * np.eye(count)
    solved = np.linalg.solve(head, gram[:, :count, count:])
    solved_cross = np.linalg.solve(head, cross[:, :count])
    inner_gram = gram[:, count:, count:] - np.swapaxes(gram[:, :count, count:], 1, 2) @ solved
    inner_cross = cross[:, count:] - np.swapaxes(gram[:, :count, count:], 1, 2) @ solved_cross
    _, log_determinant = np.linalg.slogdet(head / precision)
    gain = 0.5 * np.sum(cross[:, :count] * solved_cross, axis=1)
    return inner_gram, inner_cross, gain - 0.5 * log_determinant[:, np.newaxis]

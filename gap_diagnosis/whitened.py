# pyright: strict
"""Sufficient statistics of a channel: Gram matrices in the metric of the noise, nuisances projected out.

With C_λ = σ² I + λ² B S Bᵀ and the modes Z of the slow noise (see `noise_model`),

    XᵀC⁻¹X = (XᵀX − Σ_k w_k z_k z_kᵀ) / σ²,    w_k = λ² / (1 + λ² Λ_k),    ln|C| = Σ_k ln(1 + λ² Λ_k)

for every level λ from one pass over the rows. Simulated nulls are drawn from the same statistics: what white
noise and slow noise of a drawn level add to Xᵀn and Zᵀn is normal with a known covariance, so that a null
costs as many operations as there are columns, not rows.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import NUISANCES
from gap_diagnosis.noise_model import Knots, Levels

RIDGE = 1e-9


@dataclass(frozen=True)
class NullNoise:
    """Slow noise of simulated nulls: (j,) levels, and which shape."""

    level_si: FloatArray
    shape: int = 0


@dataclass(frozen=True)
class RecordingMoments:
    """One channel of one recording, divided by its white noise: amplitudes stay in SI per scaled column.

    Attributes:
        gram: (p, p) XᵀX.
        summed: (k, p) Bᵀ X, on the knots of the slow noise.
        cross: (p, j) Xᵀ r: column 0 is the data, the others are simulated nulls.
        summed_cross: (k, j) Bᵀ r.
        knots: shapes of the slow noise, their modes Z = B m.
        rows: n.
    """

    gram: FloatArray
    summed: FloatArray
    cross: FloatArray
    summed_cross: FloatArray
    knots: Knots
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
        shape: (h,) which shape of slow noise a level is of.
    """

    gram: FloatArray
    cross: FloatArray
    log_likelihood: FloatArray
    log_weight: FloatArray
    believed: int
    shape: NDArray[np.int64]

    def of_data(self, columns: int) -> "ChannelSystem":
        """The first columns alone, without the simulated nulls: what a search weighs."""
        return dataclasses.replace(
            self,
            gram=self.gram[:, :columns, :columns].copy(),
            cross=self.cross[:, :columns, :1].copy(),
            log_likelihood=self.log_likelihood[:, :1].copy(),
        )


def moments(
    matrix: FloatArray,
    residual: FloatArray,
    knots: Knots,
    white_si: float,
    nulls: NullNoise,
    rng: np.random.Generator,
) -> RecordingMoments:
    """Statistics of the data and of simulated nulls.

    matrix (n, p), residual (n,) in SI, `white_si` the standard deviation of a row's white noise.
    """
    gram = matrix.T @ matrix / white_si**2
    summed = knots.summed(matrix) / white_si
    scaled = residual / white_si
    cross, summed_cross = matrix.T @ scaled / white_si, knots.summed(scaled[:, np.newaxis])
    drawn, summed_drawn = _nulls(gram, summed, knots, nulls, white_si, rng)
    return RecordingMoments(
        gram=gram,
        summed=summed,
        cross=np.concatenate([cross[:, np.newaxis], drawn], axis=1),
        summed_cross=np.concatenate([summed_cross, summed_drawn], axis=1),
        knots=knots,
        rows=len(residual),
    )


def _nulls(
    gram: FloatArray,
    summed: FloatArray,
    knots: Knots,
    nulls: NullNoise,
    white_si: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Xᵀn (p, j) and Bᵀn (k, j) of noise alone, white plus slow of each level.

    Along the modes white noise has the covariance ZᵀZ = diag(Λ); given it, Xᵀw is normal with mean
    (Zᵀ X)ᵀ Λ⁻¹ Zᵀw and what is left of XᵀX as covariance. Bᵀ = m⁻ᵀ Zᵀ.
    """
    count = len(nulls.level_si)
    if not count:
        return np.zeros((len(gram), 0)), np.zeros((len(summed), 0))
    strengths, modes = knots.modes[nulls.shape]
    seen = modes.T @ summed
    held = strengths > 1e-9 * max(float(strengths[-1]), 1e-300)
    along = rng.standard_normal((len(strengths), count)) * np.sqrt(strengths)[:, np.newaxis]
    share = np.zeros_like(seen)
    share[held] = seen[held] / strengths[held, np.newaxis]
    left = gram - share.T @ seen
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    left /= scale[:, np.newaxis] * scale
    left = 0.5 * (left + left.T)
    left[np.diag_indices_from(left)] += 1e-11
    try:
        root = np.linalg.cholesky(left)
    except np.linalg.LinAlgError:  # columns that repeat each other, to rounding
        values, vectors = np.linalg.eigh(left)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
    white = scale[:, np.newaxis] * (root @ rng.standard_normal((len(gram), count))) + share.T @ along
    slow = rng.standard_normal((len(strengths), count)) * (nulls.level_si / white_si)
    along = along + strengths[:, np.newaxis] * slow
    return white + seen.T @ slow, np.asarray(np.linalg.solve(modes.T, along), dtype=np.float64)


def channel_system(
    by_recording: Mapping[int, RecordingMoments],
    mounts: Sequence[str],
    white_si: Mapping[int, float],
    of: Levels,
    matrix_prior_si: float,
) -> ChannelSystem:
    """Recordings of one channel together.

    white_si: recording → its white noise; matrix_prior_si: standard deviation of the matrix's columns as
    they are scaled.
    """
    parts: dict[str, list[int]] = {}
    for index in by_recording:
        parts.setdefault(mounts[index], []).append(index)
    gram = cross = None
    likelihood = 0.0
    for group in parts.values():
        mount_gram = mount_cross = None
        for index in group:
            one_gram, one_cross, one_likelihood = recording_system(by_recording[index], of, white_si[index])
            mount_gram = _plus(one_gram, mount_gram)
            mount_cross = _plus(one_cross, mount_cross)
            likelihood = likelihood + one_likelihood
        inner_gram, inner_cross, of_matrix = _without(
            np.asarray(mount_gram), np.asarray(mount_cross), NUISANCES - 1, 1.0 / matrix_prior_si**2
        )
        gram, cross = _plus(inner_gram, gram), _plus(inner_cross, cross)
        likelihood = likelihood + of_matrix
    return ChannelSystem(
        np.asarray(gram), np.asarray(cross), np.asarray(likelihood), of.log_weight, of.believed, of.shape
    )


def _plus(new: FloatArray, total: FloatArray | None) -> FloatArray:
    """The sum in `new`'s place: these are the largest arrays of a diagnosis."""
    if total is not None:
        new += total
    return new


def recording_system(
    one: RecordingMoments, of: Levels, white_si: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """At each level, the bias of the run projected out: (h, p − 1, p − 1), (h, p − 1, j), (h, j).

    The bias leaves by one more row of what is taken off: with slow noise taken off, s = (XᵀC⁻¹X)₀₀ + its
    prior's precision, and the row is (XᵀC⁻¹X)₀ / √s. The matrix of all columns is gone through once a level.
    """
    columns, simulated = len(one.gram) - 1, one.cross.shape[1]
    gram = np.empty((len(of), columns, columns))
    cross = np.empty((len(of), columns, simulated))
    likelihood = np.empty((len(of), simulated))
    precision = RIDGE * float(one.gram[0, 0])
    for shape, (strengths, modes) in enumerate(one.knots.modes):
        seen, seen_cross = modes.T @ one.summed, modes.T @ one.summed_cross
        taken = np.empty((len(strengths) + 1, columns))
        taken_cross = np.empty((len(strengths) + 1, simulated))
        for level in np.flatnonzero(of.shape == shape):
            square = (of.level_si[level] / white_si) ** 2
            root = np.sqrt(square / (1.0 + square * strengths))[:, np.newaxis]
            np.multiply(root, seen[:, 1:], out=taken[:-1])
            np.multiply(root, seen_cross, out=taken_cross[:-1])
            ones = root[:, 0] * seen[:, 0]
            head = float(one.gram[0, 0] - ones @ ones) + precision
            taken[-1] = (one.gram[0, 1:] - ones @ taken[:-1]) / np.sqrt(head)
            taken_cross[-1] = (one.cross[0] - ones @ taken_cross[:-1]) / np.sqrt(head)
            np.subtract(one.gram[1:, 1:], taken.T @ taken, out=gram[level])
            np.subtract(one.cross[1:], taken.T @ taken_cross, out=cross[level])
            explained = np.einsum("kj,kj->j", taken_cross, taken_cross)
            log_determinant = np.sum(np.log1p(square * strengths)) + np.log(head / precision)
            likelihood[level] = 0.5 * (explained - log_determinant)
    return gram, cross, likelihood


def _without(
    gram: FloatArray, cross: FloatArray, count: int, precision: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The first `count` columns summed over, with a normal prior of this precision: Schur complements."""
    head = gram[:, :count, :count] + precision * np.eye(count)
    solved = np.linalg.solve(head, gram[:, :count, count:])
    solved_cross = np.linalg.solve(head, cross[:, :count])
    inner_gram = np.swapaxes(gram[:, :count, count:], 1, 2) @ -solved
    inner_gram += gram[:, count:, count:]
    inner_cross = np.swapaxes(gram[:, :count, count:], 1, 2) @ -solved_cross
    inner_cross += cross[:, count:]
    _, log_determinant = np.linalg.slogdet(head / precision)
    gain = 0.5 * np.sum(cross[:, :count] * solved_cross, axis=1)
    return inner_gram, inner_cross, gain - 0.5 * log_determinant[:, np.newaxis]

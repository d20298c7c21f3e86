# pyright: strict
"""How far a parameter varies from unit to unit, stand to stand, mount to mount: variance components.

    y_i = μ + u_unit(i) + s_stand(i) + m_i + e_i,    e_i ~ N(0, V_i) known,    one estimate i for each mount

μ, u, s and m are normal about nought with the standard deviations σ_lot, σ_unit, σ_stand, σ_mount: each is
absent (σ = 0) with a prior probability, else log-uniform on a grid that is scaled by the measurement's own
uncertainties. All combinations are weighed by their marginal likelihood (Searle, Casella, McCulloch, Variance
Components, 1992, ch. 9: the Bayesian form); nothing is maximised, so that two stands or three units give wide
intervals, not wrong ones.

Levels that split these estimates alike (lot and stand, where there is one stand) cannot be told apart by any
data: they are one part here, with all their names.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray

Level = Literal["lot", "unit", "stand", "mount"]
LEVELS: tuple[Level, ...] = ("lot", "unit", "stand", "mount")
GRID_STEPS, COARSE_STEPS, MANY_STANDS = 12, 6, 12
SMALLEST_SHARE, LARGEST_SHARE = 0.5, 300.0
"""Standard deviations on the grid, over the median uncertainty of an estimate."""
LARGEST_OVER_VALUES = 3.0
"""The grid reaches at least so many times the largest value."""
PRIOR_PRESENT: Mapping[Level, float] = {"lot": 0.2, "unit": 0.2, "stand": 0.1, "mount": 0.05}
LEVEL_95 = (0.025, 0.975)
NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class VariancePart:
    """What one level adds, or levels that these estimates do not tell apart.

    Attributes:
        levels: names; several where their partitions are the same.
        present: posterior probability that it adds anything.
        explains_most: posterior probability that the largest mean square is this part's.
        deviation: posterior median of σ; 0 where it is more likely absent.
        interval95: of σ, the chance of absence included.
        mean_square: posterior mean of what it adds, squared, over what it was seen on.
        members: code of a unit, stand … → (value, standard uncertainty); empty for mounts.
    """

    levels: tuple[Level, ...]
    present: float
    explains_most: float
    deviation: float
    interval95: tuple[float, float]
    mean_square: float
    members: Mapping[int, tuple[float, float]]


@dataclass(frozen=True)
class VarianceParts:
    """All parts of one parameter; `nothing`: posterior probability that it is nought everywhere.

    `log_evidence`: ln of the marginal likelihood over that of nought everywhere.
    """

    parts: tuple[VariancePart, ...]
    nothing: float
    log_evidence: float


def variance_parts(
    value: FloatArray,
    standard_uncertainty: FloatArray,
    units: NDArray[np.int64],
    stands: NDArray[np.int64],
    prior: Mapping[Level, float] = PRIOR_PRESENT,
) -> VarianceParts:
    """Weigh every combination of levels and of their standard deviations.

    Args:
        value: (n,) one estimate for each mount of a unit on a stand.
        standard_uncertainty: (n,) of it, positive.
        units, stands: (n,) codes from 0 on.
        prior: probability that a level adds anything.
    """
    classes = partitions(units, stands)
    steps = GRID_STEPS if int(stands.max()) < MANY_STANDS else COARSE_STEPS
    scale = float(np.median(standard_uncertainty))
    largest = max(LARGEST_SHARE, LARGEST_OVER_VALUES * float(np.abs(value).max(initial=0.0)) / scale)
    deviations = scale * np.concatenate([[0.0], np.geomspace(SMALLEST_SHARE, largest, steps)])
    representative = {levels[0]: levels for levels in classes}
    grids: dict[Level, FloatArray] = {
        level: deviations if level in representative else np.zeros(1) for level in LEVELS
    }
    table = _weighed(value, standard_uncertainty, units, stands, grids)
    log_prior = np.zeros(tuple(len(grids[level]) for level in LEVELS))
    for axis, level in enumerate(LEVELS):
        if level in representative:
            absent = float(np.prod([1.0 - prior[one] for one in representative[level]]))
            each = np.full(len(deviations), np.log((1.0 - absent) / steps))
            each[0] = np.log(absent)
            log_prior += each.reshape([-1 if i == axis else 1 for i in range(len(LEVELS))])
    score = table.log_likelihood + log_prior
    top = float(score.max())
    weight = np.exp(score - top)
    total = float(weight.sum())
    weight /= total
    log_evidence = top + float(np.log(total)) - float(table.log_likelihood[0, 0, 0, 0])
    dominant = np.argmax(table.mean_square, axis=0)
    something = np.ones(weight.shape, dtype=bool)
    something[0, 0, 0, 0] = False
    parts: list[VariancePart] = []
    for axis, level in enumerate(LEVELS):
        if level not in representative:
            continue
        marginal = weight.sum(axis=tuple(i for i in range(len(LEVELS)) if i != axis))
        parts.append(
            VariancePart(
                representative[level],
                present=1.0 - float(marginal[0]),
                explains_most=float(weight[something & (dominant == axis)].sum()),
                deviation=_quantile(deviations, marginal, 0.5),
                interval95=_interval(deviations, marginal),
                mean_square=float(np.sum(weight * table.mean_square[axis])),
                members=_members(table, level, weight),
            )
        )
    return VarianceParts(tuple(parts), float(weight[0, 0, 0, 0]), log_evidence)


def partitions(units: NDArray[np.int64], stands: NDArray[np.int64]) -> tuple[tuple[Level, ...], ...]:
    """Levels, those together that split the estimates alike."""
    codes = {
        "lot": np.zeros(len(units), dtype=np.int64),
        "unit": units,
        "stand": stands,
        "mount": np.arange(len(units)),
    }
    found: dict[tuple[int, ...], list[Level]] = {}
    for level in LEVELS:
        _, first, inverse = np.unique(codes[level], return_index=True, return_inverse=True)
        found.setdefault(tuple(int(first[i]) for i in inverse), []).append(level)
    return tuple(tuple(levels) for levels in found.values())


def _interval(deviations: FloatArray, probability: FloatArray) -> tuple[float, float]:
    low, high = LEVEL_95
    return _quantile(deviations, probability, low), _quantile(deviations, probability, high)


def _quantile(deviations: FloatArray, probability: FloatArray, at: float) -> float:
    """Of σ: 0 up to the chance of absence, then the grid's steps taken as evenly filled in the logarithm."""
    if at <= probability[0]:
        return 0.0
    logs = np.log(deviations[1:])
    step = logs[1] - logs[0]
    edges = np.concatenate([logs - 0.5 * step, [logs[-1] + 0.5 * step]])
    reached = probability[0] + np.concatenate([[0.0], np.cumsum(probability[1:])])
    return float(np.exp(np.interp(at, reached, edges)))


@dataclass(frozen=True)
class _Table:
    """Over the grid (lot, unit, stand, mount): likelihood, mean squares, and what each member comes to.

    Attributes:
        log_likelihood: (l, u, s, m).
        mean_square: (4, l, u, s, m) of what is realised, conditional means.
        common: (l, u, s, m, 1 + S) of the lot and each stand.
        common_covariance: (l, u, s, m, 1 + S, 1 + S).
        of_unit: (u, m, U, 2 + S) each unit's mean is column 0 less the others times `common`.
        unit_variance: (u, m, U) with `common` known.
    """

    log_likelihood: FloatArray
    mean_square: FloatArray
    common: FloatArray
    common_covariance: FloatArray
    of_unit: FloatArray
    unit_variance: FloatArray


def _weighed(
    value: FloatArray,
    standard_uncertainty: FloatArray,
    units: NDArray[np.int64],
    stands: NDArray[np.int64],
    grids: Mapping[Level, FloatArray],
) -> _Table:
    """Lot and stand are few columns Z; unit and mount are summed over block by block (Woodbury)."""
    count, common_count, unit_count = len(value), int(stands.max()) + 2, int(units.max()) + 1
    both = np.zeros((count, 1 + common_count))
    both[:, 0] = value
    both[:, 1] = 1.0
    both[np.arange(count), 2 + stands] = 1.0
    incidence = np.zeros((unit_count, count))
    incidence[units, np.arange(count)] = 1.0
    shape = tuple(len(grids[level]) for level in LEVELS)
    of_units = (shape[1], shape[3], unit_count)
    table = _Table(
        np.empty(shape),
        np.empty((len(LEVELS), *shape)),
        np.empty((*shape, common_count)),
        np.empty((*shape, common_count, common_count)),
        np.empty((*of_units, 1 + common_count)),
        np.empty(of_units),
    )
    scale = np.empty((shape[0], shape[2], common_count))
    scale[:, :, 0] = grids["lot"][:, np.newaxis]
    scale[:, :, 1:] = grids["stand"][np.newaxis, :, np.newaxis]
    for m, mount in enumerate(grids["mount"]):
        weights = 1.0 / (standard_uncertainty**2 + mount**2)
        summed = incidence @ (weights[:, np.newaxis] * both)
        heaviness = incidence @ weights
        for u, unit in enumerate(grids["unit"]):
            shrink = unit**2 / (1.0 + unit**2 * heaviness)
            solved = weights[:, np.newaxis] * (both - (shrink[:, np.newaxis] * summed)[units])
            determinant = float(np.sum(np.log1p(unit**2 * heaviness)) - np.sum(np.log(weights)))
            _fill(table, (u, m), both.T @ solved, determinant, scale)
            table.of_unit[u, m] = unit**2 * (incidence @ solved)
            table.unit_variance[u, m] = shrink
            for level, affine in ((1, table.of_unit[u, m]), (3, mount**2 * solved)):
                table.mean_square[level, :, u, :, m] = _mean_square(affine, table.common[:, u, :, m])
    table.mean_square[0] = table.common[..., 0] ** 2
    table.mean_square[2] = np.mean(table.common[..., 1:] ** 2, axis=-1)
    return table


def _mean_square(affine: FloatArray, common: FloatArray) -> FloatArray:
    """Of column 0 less the others times `common` (l, s, 1 + S), over the rows: (l, s)."""
    inner = affine.T @ affine / len(affine)
    return (
        inner[0, 0]
        - 2.0 * common @ inner[1:, 0]
        + np.einsum("lsi,ij,lsj->ls", common, inner[1:, 1:], common, optimize=True)
    )


def _fill(
    table: _Table, at: tuple[int, int], inner: FloatArray, determinant: float, scale: FloatArray
) -> None:
    """Likelihood and conditional means of lot and stands at one (unit, mount), for all (lot, stand).

    inner: (2 + S, 2 + S) [y Z]ᵀ A⁻¹ [y Z]; scale: (l, s, 1 + S) σ of each column.
    """
    u, m = at
    gram, cross = inner[1:, 1:], inner[1:, 0]
    scaled = scale[..., :, np.newaxis] * gram * scale[..., np.newaxis, :]
    scaled[..., np.arange(len(gram)), np.arange(len(gram))] += 1.0
    inverse = np.linalg.inv(scaled)
    projected = scale * cross
    half = np.einsum("lsij,lsj->lsi", inverse, projected)
    _, log_determinant = np.linalg.slogdet(scaled)
    gained = np.einsum("lsi,lsi->ls", projected, half)
    table.log_likelihood[:, u, :, m] = 0.5 * (gained - inner[0, 0] - determinant - log_determinant)
    table.common[:, u, :, m] = scale * half
    table.common_covariance[:, u, :, m] = scale[..., :, np.newaxis] * inverse * scale[..., np.newaxis, :]


def _members(table: _Table, level: Level, weight: FloatArray) -> dict[int, tuple[float, float]]:
    """Mean and standard uncertainty of each unit, each stand or the lot, over the whole grid."""
    if level == "mount":
        return {}
    if level == "unit":
        mean, square = _unit_moments(table, weight)
        columns = range(len(mean))
    else:
        mean = np.einsum("lusm,lusmi->i", weight, table.common)
        variance = np.einsum("lusmii->lusmi", table.common_covariance)
        square = np.einsum("lusm,lusmi->i", weight, table.common**2 + variance)
        columns = range(1) if level == "lot" else range(1, len(mean))
    return {
        code: (float(mean[i]), float(np.sqrt(max(square[i] - mean[i] ** 2, 0.0))))
        for code, i in enumerate(columns)
    }


def _unit_moments(table: _Table, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(U,) mean and mean square of each unit's part."""
    mean, square = np.zeros(table.of_unit.shape[2]), np.zeros(table.of_unit.shape[2])
    for u, m in np.argwhere(weight.sum(axis=(0, 2)) > NEGLIGIBLE):
        here, common = weight[:, u, :, m], table.common[:, u, :, m]
        own, others = table.of_unit[u, m, :, 0], table.of_unit[u, m, :, 1:]
        share = float(here.sum())
        first = np.einsum("ls,lsi->i", here, common)
        second = np.einsum("ls,lsi,lsj->ij", here, common, common, optimize=True) + np.einsum(
            "ls,lsij->ij", here, table.common_covariance[:, u, :, m]
        )
        mean += share * own - others @ first
        square += share * (own**2 + table.unit_variance[u, m]) - 2.0 * own * (others @ first)
        square += np.einsum("ui,ij,uj->u", others, second, others, optimize=True)
    return mean, square

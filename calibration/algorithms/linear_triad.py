"""Least squares for y = M u + b with known inputs, and an honest covariance.

For each output axis i: y_k = m_i . u_k + b_i + e_k, Cov(e) = V. Generalised least squares gives
(m_i, b_i) and their covariance for one V. What is not known of V (the slow noise) is averaged over:
each hypothesis counts with its prior times its restricted likelihood, and the covariance is the
mean of the covariances plus the spread of the estimates (law of total variance).

Restricted likelihood: Patterson & Thompson, Biometrika 58 (1971) 545.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray, Quantity, TriadCoefficients
from calibration.algorithms.noise_covariance import (
    NoiseHypothesis,
    Observations,
    noise_hypotheses,
    slow_noise_grid,
)
from calibration.algorithms.slow_noise_grid import can_whiten, whitened_products
from protocol.errors import CalibrationError, Fault

MIN_EXCITATION = 0.1
"""Smallest singular value of the runs' inputs, in units of the largest input, that carries a coefficient."""
NAMED_PART = 0.3
"""Part of the missing direction above which an axis is named."""
MAX_CHI_SQUARE_SIGMAS = 3.0
"""Residuals further above the noise than this widen the covariance (Birge ratio)."""
EXCITATION_WORDS: dict[Quantity, str] = {
    "acceleration": "specific force along body {axis}",
    "angular_rate": "turn about body {axis}",
}


@dataclass(frozen=True)
class LinearFit:
    """A fit with its residuals.

    Attributes:
        coefficients: with covariance.
        residuals: output less model of each observation, shape (k, 3), SI.
        chi_square_ratio: chi-square per degree of freedom under the likeliest hypothesis.
        likeliest: words of that hypothesis.
        posterior: its weight among all, 0 … 1.
        weights: of all hypotheses, in their order.
    """

    coefficients: TriadCoefficients
    residuals: FloatArray
    chi_square_ratio: float
    likeliest: str
    posterior: float
    weights: tuple[float, ...]


def check_excitation(quantity: Quantity, true_input: FloatArray, where: str) -> None:
    """Refuse inputs (runs, 3) that cannot carry a matrix and a bias, and name what is missing.

    Raises:
        CalibrationError: naming the input that is missing.
    """
    remedy_words = EXCITATION_WORDS[quantity]
    largest = float(np.abs(true_input).max(initial=0.0))
    if len(true_input) == 0 or largest == 0.0:
        raise _degenerate(
            "There is no input to calibrate against.", where, remedy_words.format(axis="x, y and z")
        )
    design = np.column_stack([true_input / largest, np.ones(len(true_input))])
    _, singular, directions = np.linalg.svd(np.vstack([design, np.zeros((4, 4))]), full_matrices=False)
    if singular[-1] >= MIN_EXCITATION:
        return
    missing = directions[-1]
    axes = [axis for axis, part in zip("xyz", missing[:3], strict=True) if abs(part) > NAMED_PART]
    if abs(missing[3]) > NAMED_PART:
        what = (
            f"the bias and the scale factor of {', '.join(axes) or 'an axis'} cannot be told apart: "
            "the other direction is missing"
        )
    else:
        what = "nothing excites " + ", ".join(remedy_words.format(axis=axis) for axis in axes)
    raise _degenerate(
        f"The runs cannot carry nine matrix elements and three biases: {what} "
        f"(smallest singular value {singular[-1]:.2g}, bound {MIN_EXCITATION:g}).",
        where,
        " and ".join(remedy_words.format(axis=f"{axis}, both ways") for axis in axes or ("x", "y", "z")),
    )


def fit_linear_triad(
    quantity: Quantity, observations: Observations, hypotheses: tuple[NoiseHypothesis, ...], where: str
) -> LinearFit:
    """M, b and their covariance from observations with known inputs.

    Args:
        quantity: what the triad measures.
        observations: means of outputs with true inputs.
        hypotheses: covariances to weigh, prior weights adding up to 1.
        where: names the data in errors.

    Raises:
        CalibrationError: the geometry is degenerate.
    """
    _check_runs(quantity, observations, where)
    design = _design(observations)
    solved = [_solve(design, observations.output, hypothesis.covariance) for hypothesis in hypotheses]
    stacked = _Solutions(
        np.array([s.estimate for s in solved]),
        np.array([s.covariance for s in solved]),
        np.array([s.log_likelihood for s in solved]),
        np.array([s.chi_square for s in solved]),
    )
    prior = np.array([hypothesis.prior for hypothesis in hypotheses])
    return _averaged(quantity, observations, stacked, prior, lambda index: hypotheses[index].words)


def fit_with_unknown_slow_noise(quantity: Quantity, observations: Observations, where: str) -> LinearFit:
    """The same, slow noise of no known level averaged over.

    Where no reference has an error of its own the covariances of the three axes are of one shape, and
    all hypotheses are whitened together (`slow_noise_grid`).

    Raises:
        CalibrationError: the geometry is degenerate.
    """
    _check_runs(quantity, observations, where)
    grid = slow_noise_grid(observations)
    if observations.reference_covariance.any() or not can_whiten(observations.duration_s, grid.correlation_s):
        return fit_linear_triad(quantity, observations, noise_hypotheses(observations, (), True), where)
    design = _design(observations)
    products, log_determinant = whitened_products(
        np.column_stack([design, observations.output]),
        observations.middle_s,
        observations.duration_s,
        grid.level,
        grid.correlation_s,
    )
    normal, right, squares = products[:, :4, :4], products[:, :4, 4:], products[:, 4:, 4:]
    inverse: FloatArray = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    estimate = inverse @ right  # (h, 4, 3)
    left_over = np.einsum("hii->hi", squares) - np.einsum("hpi,hpi->hi", right, estimate)
    chi_square = (np.maximum(left_over, 0.0) / grid.density).sum(axis=1)
    # The three axes' densities change ln det V and ln det of the normal matrices by the same for all.
    log_likelihood = -0.5 * (chi_square + 3.0 * (log_determinant + np.linalg.slogdet(normal)[1]))
    covariance = inverse[:, None] * grid.density[:, None, None]
    solutions = _Solutions(estimate, covariance, log_likelihood, chi_square)
    return _averaged(quantity, observations, solutions, grid.prior, grid.words)


@dataclass(frozen=True)
class _Solutions:
    estimate: FloatArray  # (h, 4, 3)
    covariance: FloatArray  # (h, 3, 4, 4)
    log_likelihood: FloatArray  # (h,), up to what is common to all
    chi_square: FloatArray  # (h,)


def _check_runs(quantity: Quantity, observations: Observations, where: str) -> None:
    runs = np.arange(len(observations.run_names))
    check_excitation(quantity, _run_means(observations.true_input, observations.run, runs), where)


def _design(observations: Observations) -> FloatArray:
    return np.column_stack([observations.true_input, np.ones(len(observations.output))])


def _averaged(
    quantity: Quantity,
    observations: Observations,
    solved: _Solutions,
    prior: FloatArray,
    words: Callable[[int], str],
) -> LinearFit:
    """The mean over the hypotheses, by prior and likelihood."""
    log_weights = np.log(prior) + solved.log_likelihood
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    best = int(weights.argmax())

    mean = np.einsum("h,hpi->pi", weights, solved.estimate)
    spread = solved.estimate - mean
    per_axis = np.einsum("h,hipq->ipq", weights, solved.covariance)
    per_axis += np.einsum("h,hpi,hqi->ipq", weights, spread, spread)

    freedom = observations.output.size - mean.size
    chi_square_ratio = float(solved.chi_square[best]) / freedom if freedom > 0 else 1.0
    if freedom > 0 and chi_square_ratio > 1.0 + MAX_CHI_SQUARE_SIGMAS * np.sqrt(2.0 / freedom):
        per_axis = per_axis * chi_square_ratio
    design = _design(observations)
    residuals = observations.output - design @ mean
    coefficients = TriadCoefficients(
        quantity=quantity,
        matrix=mean[:3].T,
        bias=mean[3],
        covariance=_assemble(per_axis),
        residual_rms=float(np.sqrt((residuals**2).mean())),
        degrees_of_freedom=max(freedom, 0),
    )
    return LinearFit(
        coefficients,
        residuals,
        chi_square_ratio,
        words(best),
        float(weights[best]),
        tuple(float(weight) for weight in weights),
    )


@dataclass(frozen=True)
class _Solution:
    estimate: FloatArray  # (4, 3): m_ix m_iy m_iz b_i in column i
    covariance: FloatArray  # (3, 4, 4)
    log_likelihood: float
    chi_square: float


def _solve(design: FloatArray, output: FloatArray, covariance: FloatArray) -> _Solution:
    """Generalised least squares of the three output axes at once; `covariance` (3, k, k)."""
    factor = np.linalg.cholesky(covariance)
    columns = np.concatenate([np.tile(design, (3, 1, 1)), output.T[:, :, None]], axis=2)  # (3, k, 5)
    white = np.linalg.solve(factor, columns)
    white_design, white_output = white[:, :, :4], white[:, :, 4:]
    normal = white_design.transpose(0, 2, 1) @ white_design
    parameter_covariance: FloatArray = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    estimate = parameter_covariance @ (white_design.transpose(0, 2, 1) @ white_output)  # (3, 4, 1)
    chi_square = float(((white_output - white_design @ estimate) ** 2).sum())
    log_determinant = 2.0 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
    log_likelihood = -0.5 * (chi_square + log_determinant + float(np.linalg.slogdet(normal)[1].sum()))
    return _Solution(estimate[:, :, 0].T, parameter_covariance, log_likelihood, chi_square)


def _assemble(per_axis: FloatArray) -> FloatArray:
    """(3, 4, 4) per output axis → (12, 12) in the order of `PARAMETER_NAMES`."""
    full = np.zeros((12, 12))
    for axis in range(3):
        index = np.array([3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis])
        full[np.ix_(index, index)] = (per_axis[axis] + per_axis[axis].T) / 2.0
    return full


def _run_means(values: FloatArray, run: np.ndarray, runs: np.ndarray) -> FloatArray:
    return np.array([values[run == index].mean(axis=0) for index in runs])


def _degenerate(what: str, where: str, missing: str) -> CalibrationError:
    return CalibrationError(what, where=where, fault=Fault.DATA, remedy=f"record also: {missing}.")

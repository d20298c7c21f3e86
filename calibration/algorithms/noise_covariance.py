"""What the data say of their own noise: a white density and a slow, correlated part.

A mean over a capture has the variance S / D of white noise of density S over the duration D, plus
that of the bias instability, which does not shrink with D. The slow part is a Gauss-Markov term
(IEEE 952); its level and correlation time are not fitted but averaged over (`linear_triad`),
because a session of a few minutes never tells them apart sharply.
"""

# pyright: strict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

BLOCKS_PER_REST = 8
"""Parts that a rest is cut into: their differences tell the white density."""
SLOW_TO_WHITE_RATIOS = tuple(float(r) for r in np.geomspace(0.25, 64.0, 9))
"""Levels of the slow noise that are weighed, relative to the white noise of one capture's mean."""
CORRELATION_SPANS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0)
"""Correlation times that are weighed, relative to the length of the session."""
WHITE_WORDS = "white noise"
RELATIVE_NOISE_FLOOR = 1e-9
"""Noise is never taken below this part of the largest output: a covariance must be invertible."""


@dataclass(frozen=True)
class Observations:
    """Means of outputs over stretches of time, with the true mean input there.

    Attributes:
        true_input: shape (k, 3), SI.
        output: shape (k, 3), SI.
        middle_s, duration_s: of each stretch, shape (k,).
        run: index of the pose or rotation that each stretch belongs to, shape (k,).
        run_names: of the runs.
        reference_covariance: of each run's true input, shape (runs, 3, 3): what is known of the
            stand's or the hand's own error.
    """

    true_input: FloatArray
    output: FloatArray
    middle_s: FloatArray
    duration_s: FloatArray
    run: NDArray[np.intp]
    run_names: tuple[str, ...]
    reference_covariance: FloatArray


@dataclass(frozen=True)
class NoiseHypothesis:
    """One possible covariance of the observations, shape (3, k, k): one matrix per output axis."""

    covariance: FloatArray
    prior: float
    words: str


@dataclass(frozen=True)
class SlowNoiseGrid:
    """White noise and levels and correlation times of slow noise, all of the same shape on each axis.

    Attributes:
        density: white, of each axis, shape (3,), SI^2 s.
        level: of the slow noise for a white density of 1, shape (h,); the first is 0: white alone.
        correlation_s: shape (h,).
        prior: weights that add up to 1, shape (h,).
    """

    density: FloatArray
    level: FloatArray
    correlation_s: FloatArray
    prior: FloatArray

    def words(self, index: int) -> str:
        """What hypothesis `index` says."""
        if index == 0:
            return WHITE_WORDS
        return slow_words(SLOW_TO_WHITE_RATIOS[(index - 1) % len(SLOW_TO_WHITE_RATIOS)])


def white_density(observations: Observations) -> FloatArray:
    """White noise density S of each output, shape (3,), SI^2 s, from neighbouring blocks of one rest.

    The variance of a difference of neighbours (an Allan variance at the block's length) is free of
    the bias and of anything slower than a block. Inflated by nu / (nu - 2) for its nu degrees of
    freedom, so that it is the variance of the t distribution (JCGM 101:2008, 6.4.9.2).
    """
    same = np.flatnonzero(observations.run[1:] == observations.run[:-1])
    scale = float(np.abs(observations.output).max(initial=0.0)) or 1.0
    floor = (RELATIVE_NOISE_FLOOR * scale) ** 2 * float(np.median(observations.duration_s))
    if len(same) < 3:
        return np.full(3, floor)
    differences = observations.output[same + 1] - observations.output[same]
    per_density = 1.0 / observations.duration_s[same] + 1.0 / observations.duration_s[same + 1]
    density = (differences**2 / per_density[:, None]).mean(axis=0)
    return np.maximum(density * len(same) / (len(same) - 2), floor)


def gauss_markov_covariance(middle_s: FloatArray, duration_s: FloatArray, correlation_s: float) -> FloatArray:
    """Covariance (k, k) of means of a unit-variance Gauss-Markov process over stretches of time.

    For two stretches apart, exp(-|t1 - t2| / tau) shc(D1) shc(D2) with shc(D) = sinh(D / 2 tau) /
    (D / 2 tau); within one, 2 (tau/D)(1 - (tau/D)(1 - exp(-D/tau))). An infinite correlation time is
    a constant: ones.
    """
    half = duration_s / (2.0 * correlation_s)
    # For stretches far longer than tau the product below would be inf * 0: take them as points.
    average = np.where(half > 1e-6, np.sinh(np.minimum(half, 20.0)) / np.maximum(half, 1e-12), 1.0)
    apart = np.abs(middle_s[:, None] - middle_s[None, :])
    covariance = np.exp(-apart / correlation_s) * average[:, None] * average[None, :]
    ratio = 2.0 * half
    own = np.where(
        ratio > 1e-4, 2.0 * (ratio + np.expm1(-ratio)) / np.maximum(ratio, 1e-12) ** 2, 1.0 - ratio / 3
    )
    np.fill_diagonal(covariance, own)
    return covariance


def noise_hypotheses(
    observations: Observations, known_slow: tuple[tuple[float, float], ...], unknown_slow: bool
) -> tuple[NoiseHypothesis, ...]:
    """The noise covariances to weigh, with prior weights that add up to 1.

    Args:
        observations: the data.
        known_slow: standard deviation (SI) and correlation time (s) of each Gauss-Markov term that
            is known beforehand; with any there is one hypothesis. An infinite correlation time is
            what differs from one power-on to the next.
        unknown_slow: with nothing known: half the prior goes to white noise alone, half is spread
            evenly (log-uniform) over levels and correlation times. False: white noise alone.
    """
    density = white_density(observations)
    white = density[:, None, None] * np.diag(1.0 / observations.duration_s)
    reference = _reference_part(observations)
    base = white + reference
    if known_slow:
        slow = sum(
            (
                level**2
                * gauss_markov_covariance(observations.middle_s, observations.duration_s, correlation_s)
                for level, correlation_s in known_slow
            ),
            start=np.zeros(base.shape[1:]),
        )
        terms = " and ".join(f"{level:.2g} with {correlation_s:.3g} s" for level, correlation_s in known_slow)
        return (NoiseHypothesis(base + slow, 1.0, f"bias instability {terms}, in SI units, as stated"),)
    if not unknown_slow:
        return (NoiseHypothesis(base, 1.0, WHITE_WORDS),)
    grid = slow_noise_grid(observations)
    hypotheses = [NoiseHypothesis(base, float(grid.prior[0]), WHITE_WORDS)]
    for index in range(1, len(grid.level)):
        correlation_s = float(grid.correlation_s[index])
        shape = gauss_markov_covariance(observations.middle_s, observations.duration_s, correlation_s)
        variance = float(grid.level[index]) ** 2 * density
        covariance = base + variance[:, None, None] * shape
        hypotheses.append(NoiseHypothesis(covariance, float(grid.prior[index]), grid.words(index)))
    return tuple(hypotheses)


def slow_noise_grid(observations: Observations) -> SlowNoiseGrid:
    """Half the prior to white noise alone, half log-uniform over levels and correlation times."""
    span_s = float(np.ptp(observations.middle_s)) or float(observations.duration_s.max())
    per_run_s = float(observations.duration_s.sum()) / len(observations.run_names)
    ratios, spans = np.array(SLOW_TO_WHITE_RATIOS), np.array(CORRELATION_SPANS)
    weight = 0.5 / (len(ratios) * len(spans))
    return SlowNoiseGrid(
        density=white_density(observations),
        level=np.append(0.0, np.tile(ratios, len(spans)) / np.sqrt(per_run_s)),
        correlation_s=np.append(span_s, np.repeat(spans, len(ratios)) * span_s),
        prior=np.append(0.5, np.full(len(ratios) * len(spans), weight)),
    )


def slow_words(ratio: float) -> str:
    """A level of slow noise in words."""
    return f"bias instability of {ratio:.2g} times a capture's white noise"


def _reference_part(observations: Observations) -> FloatArray:
    """Covariance (3, k, k) that an error of a run's reference gives its outputs (M near identity)."""
    variance = np.einsum("rii->ir", observations.reference_covariance)
    same_run = observations.run[:, None] == observations.run[None, :]
    return variance[:, observations.run][:, :, None] * same_run[None]

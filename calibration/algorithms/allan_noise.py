"""The five noises of an Allan plot, and how sure its points are under them.

sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + R^2 tau^2 / 2
(IEEE 952 annex C: quantization, random walk, bias instability, rate random walk, rate ramp).

For Gaussian noise the squared second differences z of the integral have
Cov(z1^2, z2^2) = 2 C^2 + 4 mu1 mu2 C, with C their covariance and mu their means (of the ramp).
C follows from the generalised autocovariance of the integral: -N^2 |t| / 2, B^2 t^2 ln|t| / (2 pi),
K^2 |t|^3 / 12, and Q^2 at t = 0 only. Summed over all pairs of terms of two taus it is the covariance
of two Allan variances; on the diagonal it gives the equivalent degrees of freedom, 2 sigma^4 / Var, of
a chi-squared distribution: Greenhall & Riley, 'Uncertainty of stability variances based on finite
differences' (PTTI 2003), as NIST SP 1065 (Riley 2008) uses it. Here the noise may be any mixture.

The lag sum takes every lag near the kinks of C and fewer elsewhere (trapezoids): within 1 % in degrees
of freedom. White samples are taken as independent; Greenhall & Riley average the integral over tau_0,
which differs below m of about 30. Flicker and rate random walk are those of continuous time.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from calibration.algorithms.allan_variance import AllanDeviation, FloatArray

TERMS = ("quantization", "random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
LAGS_PER_STEP = 32
"""Lags per m around a kink; shorter taus have all their lags."""
TAIL_LAGS = 48
TAIL_STEPS = 3
"""Flicker's correlation beyond the overlap falls with the square of the lag; cut off this many m away."""
_SECOND_DIFFERENCE = np.array([1.0, -2.0, 1.0])


@dataclass(frozen=True)
class NoiseModel:
    """Coefficients of IEEE 952, for samples in `unit`; zero: absent.

    Attributes:
        quantization: Q, unit s.
        random_walk: N, unit s^0.5: angle random walk of a rate, velocity random walk of a specific force.
        bias_instability: B, unit: the flat floor is 0.664 B.
        rate_random_walk: K, unit / s^0.5.
        rate_ramp: R, unit / s.
    """

    quantization: float = 0.0
    random_walk: float = 0.0
    bias_instability: float = 0.0
    rate_random_walk: float = 0.0
    rate_ramp: float = 0.0

    @property
    def squares(self) -> FloatArray:
        """(Q^2, N^2, B^2, K^2, R^2), shape (5,)."""
        return np.array([getattr(self, name) for name in TERMS], dtype=np.float64) ** 2

    def deviation(self, tau_s: FloatArray) -> FloatArray:
        """Expected Allan deviation, shape of `tau_s`."""
        return np.sqrt(variance_shapes(tau_s) @ self.squares)


@dataclass(frozen=True)
class AllanIntervals:
    """What a point of an Allan plot is good for.

    Attributes:
        lower, upper: of sigma, shape (k,), at `level`.
        standard_uncertainty: sigma / sqrt(2 nu), shape (k,).
        degrees_of_freedom: nu, shape (k,).
        level: of the interval, 0 … 1.
    """

    lower: FloatArray
    upper: FloatArray
    standard_uncertainty: FloatArray
    degrees_of_freedom: FloatArray
    level: float


def variance_shapes(tau_s: FloatArray) -> FloatArray:
    """sigma^2 per unit of Q^2, N^2, B^2, K^2, R^2, shape (k, 5)."""
    tau = np.asarray(tau_s, dtype=np.float64)
    flat = np.full_like(tau, 2.0 * np.log(2.0) / np.pi)
    return np.stack([3.0 / tau**2, 1.0 / tau, flat, tau / 3.0, tau**2 / 2.0], axis=-1)


def confidence_intervals(measured: AllanDeviation, noise: NoiseModel, level: float = 0.95) -> AllanIntervals:
    """Chi-squared intervals around measured deviations, for the noise that is there.

    Args:
        measured: overlapping or modified deviations.
        noise: its proportions matter, not its size: `NoiseModel(random_walk=1.0)` for white noise,
            or the model that was fitted.
        level: two-sided, 0 … 1.
    """
    freedom = degrees_of_freedom(measured, noise)
    tail = (1.0 - level) / 2.0
    # chdtri(nu, p) has p above it.
    lower = measured.deviation * np.sqrt(freedom / chdtri(freedom, tail))
    upper = measured.deviation * np.sqrt(freedom / chdtri(freedom, 1.0 - tail))
    uncertainty = measured.deviation / np.sqrt(2.0 * freedom)
    return AllanIntervals(lower, upper, uncertainty, freedom, level)


def degrees_of_freedom(measured: AllanDeviation, noise: NoiseModel) -> FloatArray:
    """Equivalent degrees of freedom of each variance, shape (k,); the ramp adds none and is left out."""
    squares = noise.squares[:4]
    if not squares.any():
        raise ValueError("A noise of nothing has no degrees of freedom: name at least one that is random.")
    period = 1.0 / measured.rate_hz
    freedom = np.empty(len(measured.factors))
    for index, factor in enumerate(measured.factors):
        m = int(factor)
        averaged = measured.kind == "modified" and m > 1
        terms = int(measured.terms[index])
        products, _ = _lag_sums(m, m, terms, terms, averaged)
        scaled = squares * period ** np.arange(4)
        variance = _variance_at_zero(m, averaged) @ scaled
        freedom[index] = max(1.0, terms**2 * variance**2 / (scaled @ products @ scaled))
    return freedom


@dataclass(frozen=True)
class VarianceCovariance:
    """Covariance of overlapping Allan variances at several taus, for any mixture of the five noises."""

    products: FloatArray  # (k, k, 4, 4): sums over lags of C_p C_q
    sums: FloatArray  # (k, k, 4): sums over lags of C_p
    weights: FloatArray  # (k, k): 1 / (terms_i terms_j 4 tau_i^2 tau_j^2)
    ramp_means: FloatArray  # (k, k): tau_i^2 tau_j^2
    period_s: float

    def of(self, squares: FloatArray) -> FloatArray:
        """V, shape (k, k), for (Q^2, N^2, B^2, K^2, R^2)."""
        scaled = squares[:4] * self.period_s ** np.arange(4)
        random = 2.0 * np.einsum("p,ijpq,q->ij", scaled, self.products, scaled)
        with_ramp = 4.0 * squares[4] * self.ramp_means * (self.sums @ scaled)
        return self.weights * (random + with_ramp)


@lru_cache(maxsize=8)
def variance_covariance(factors: tuple[int, ...], sample_count: int, rate_hz: float) -> VarianceCovariance:
    """For overlapping variances at tau = factors / rate. It depends on no data: kept for the next record."""
    count = len(factors)
    products, sums = np.empty((count, count, 4, 4)), np.empty((count, count, 4))
    terms = [sample_count + 1 - 2 * m for m in factors]
    for i in range(count):
        for j in range(i, count):
            products[i, j], sums[i, j] = _lag_sums(factors[i], factors[j], terms[i], terms[j], False)
            products[j, i], sums[j, i] = products[i, j], sums[i, j]
    tau = np.array(factors) / rate_hz
    per_variance = 1.0 / (np.array(terms, dtype=np.float64) * 2.0 * tau**2)
    return VarianceCovariance(
        products, sums, np.outer(per_variance, per_variance), np.outer(tau**2, tau**2), 1.0 / rate_hz
    )


def _lag_sums(m1: int, m2: int, terms1: int, terms2: int, averaged: bool) -> tuple[FloatArray, FloatArray]:
    """Sums over all pairs of terms of C_p C_q (4, 4) and of C_p (4,); lags in samples, tau_0 = 1."""
    lags = _lags(m1, m2)
    lags = lags[(lags > -terms2) & (lags < terms1)]
    edges = np.concatenate([[lags[0] - 1], lags, [lags[-1] + 1]])
    widths = (edges[2:] - edges[:-2]) / 2.0
    pairs = np.minimum(terms1, terms2 + lags) - np.maximum(0, lags)
    covariance = _covariance(lags.astype(np.float64), m1, m2, averaged)
    products = (covariance * (pairs * widths)) @ covariance.T
    sums = covariance @ (pairs * widths)
    if not averaged:
        # Quantization is there at single lags only: exact, not by trapezoids.
        single = covariance[0] != 0.0
        exact = covariance[:, single] * pairs[single]
        products[0] = exact @ covariance[0, single]
        products[:, 0] = products[0]
        sums[0] = exact[0].sum()
    return products, sums


def _lags(m1: int, m2: int) -> NDArray[np.int64]:
    """Lags i - j, increasing: all within 3 m of a kink if m is small, else about `LAGS_PER_STEP` a step."""
    m, longer = min(m1, m2), max(m1, m2)
    reach = TAIL_STEPS * longer
    near = np.arange(-3.0, 3.0 + 1e-9, 1.0 / min(m, LAGS_PER_STEP)) * m
    far = 3.0 * m + np.geomspace(1.0, reach + 1.0, TAIL_LAGS)
    around = np.concatenate([near, far, -far])
    kinks = np.array([a * m1 - b * m2 for a in range(3) for b in range(3)], dtype=np.float64)
    lags = np.unique(np.round(np.concatenate([*(around - kink for kink in kinks), -kinks])))
    return lags[(lags >= -2 * m1 - reach) & (lags <= 2 * m2 + reach)].astype(np.int64)


def _covariance(lags: FloatArray, m1: int, m2: int, averaged: bool) -> FloatArray:
    """C of two second differences `lags` apart, per unit of Q^2, N^2, B^2, K^2, shape (4, k)."""
    total = np.zeros((4, len(lags)))
    for a in range(3):
        for b in range(3):
            weight = _SECOND_DIFFERENCE[a] * _SECOND_DIFFERENCE[b]
            distance = np.abs(lags + a * m1 - b * m2)
            total += weight * (_averaged(distance, m1) if averaged else integral_autocovariance(distance))
    return total


def integral_autocovariance(distance: FloatArray) -> FloatArray:
    """Generalised autocovariance of the integral at lags >= 0 in samples, tau_0 = 1, per unit of
    Q^2, N^2, B^2, K^2, shape (4, k)."""
    logarithm = np.log(np.maximum(distance, 1.0))  # of 0: times zero
    flicker = distance**2 * logarithm / (2.0 * np.pi)
    return np.stack([(distance == 0.0).astype(np.float64), -distance / 2.0, flicker, distance**3 / 12.0])


def _averaged(distance: FloatArray, m: int) -> FloatArray:
    """The same of the integral averaged over m samples: the second difference of its double integral."""

    def twice_integrated(lag: FloatArray) -> FloatArray:
        t = np.abs(lag)
        flicker = t**4 * np.log(np.maximum(t, 1.0)) / (24.0 * np.pi)
        return np.stack([t / 2.0, -(t**3) / 12.0, flicker, t**5 / 240.0])

    ends = twice_integrated(distance + m) + twice_integrated(distance - m)
    return (ends - 2.0 * twice_integrated(distance)) / float(m) ** 2


def _variance_at_zero(m: int, averaged: bool) -> FloatArray:
    return _covariance(np.zeros(1), m, m, averaged)[:, 0]

"""Wavelet variance: a second, differently blind look at the noises of an Allan plot.

nu^2(j) = mean of W_j^2, W_j the maximal-overlap coefficients of Daubechies' D(4) at scale 2^j samples,
without those that the ends of the record touch (Percival & Walden, Wavelet Methods for Time Series Analysis
(2000), section 8.3). The Haar wavelet would give half the overlapping Allan variance; D(4) has two vanishing
moments: a ramp of rate or a warm-up along a line is not seen at all, where it bends an Allan plot
and is taken for rate random walk. What both agree on is noise.

Q, N, B, K follow as from an Allan plot, each scale's variance and its own variance from the autocovariance
of the integral. Scales are taken as independent, which D(4) makes them nearly.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calibration.algorithms.allan_coefficients import AllanFit, fit_squares
from calibration.algorithms.allan_noise import TERMS, integral_autocovariance
from calibration.algorithms.allan_variance import FloatArray
from protocol.errors import CalibrationError, Fault

MIN_COEFFICIENTS = 8
"""Independent coefficients (about M / 2^j) below which a scale tells too little for normal statistics."""
MAX_SCALES = 24
DIRECT_LENGTH = 64
"""Of the shorter sequence, below which a convolution is summed directly."""
_ROOT_3 = np.sqrt(3.0)
_SCALING = np.array([1.0 + _ROOT_3, 3.0 + _ROOT_3, 3.0 - _ROOT_3, 1.0 - _ROOT_3]) / 8.0
_WAVELET = _SCALING[::-1] * np.array([1.0, -1.0, 1.0, -1.0])


@dataclass(frozen=True)
class WaveletVariance:
    """Wavelet variances of one record.

    Attributes:
        tau_s: 2^(j-1) tau_0 of scale j: comparable with an Allan plot's tau, shape (k,), s.
        variance: nu^2, shape (k,), unit of the samples squared.
        coefficients: averaged at each scale, shape (k,).
        rate_hz: 1 / tau_0.
    """

    tau_s: FloatArray
    variance: FloatArray
    coefficients: tuple[int, ...]
    rate_hz: float


def wavelet_variance(samples: FloatArray, rate_hz: float) -> WaveletVariance:
    """D(4) wavelet variances at all scales that the record carries.

    Args:
        samples: shape (n,), uniform, any unit.
        rate_hz: samples a second.

    Raises:
        CalibrationError: missing samples, or a record too short for one scale.
    """
    smooth = np.asarray(samples, dtype=np.float64)
    if smooth.ndim != 1 or not np.isfinite(smooth).all() or not rate_hz > 0.0:
        raise _refused("A wavelet variance needs one channel without missing samples, and its rate.")
    smooth = smooth - smooth.mean()
    variances: list[float] = []
    counts: list[int] = []
    for scale in range(1, MAX_SCALES + 1):
        step = 2 ** (scale - 1)
        count = len(smooth) - 3 * step
        if count < MIN_COEFFICIENTS * 2**scale:
            break
        detail, smoother = np.zeros(count), np.zeros(count)
        for tap in range(4):
            delayed = smooth[(3 - tap) * step : (3 - tap) * step + count]
            detail += _WAVELET[tap] * delayed
            smoother += _SCALING[tap] * delayed
        variances.append(float(np.square(detail).mean()))  # not BLAS: its threads cost more than the sum
        counts.append(count)
        smooth = smoother
    if not variances:
        raise _refused(f"{len(samples)} samples do not carry one scale.")
    tau_s = np.array([2.0**scale / rate_hz for scale in range(len(variances))])
    return WaveletVariance(tau_s, np.array(variances), tuple(counts), rate_hz)


def fit_wavelet_coefficients(measured: WaveletVariance, terms: tuple[str, ...] = TERMS[:4]) -> AllanFit:
    """Q, N, B, K of the chosen terms; a ramp is not seen and not fitted (its square stays 0).

    Raises:
        CalibrationError: too few scales, unknown terms or a ramp, a constant record.
    """
    if not terms or any(name not in TERMS[:4] for name in terms):
        raise _refused(f"The terms of a wavelet variance are {', '.join(TERMS[:4])}.")
    if len(measured.tau_s) < len(terms) + 1:
        raise _refused(f"{len(measured.tau_s)} scales do not carry {len(terms)} coefficients.")
    if measured.variance.min() <= 0.0:
        raise _refused("The record is constant: its variance is 0.")
    period = 1.0 / measured.rate_hz
    powers = period ** (np.arange(4) - 2.0)
    expected = [_expected(scale) for scale in range(1, len(measured.tau_s) + 1)]
    shapes = np.zeros((len(expected), 5))
    shapes[:, :4] = [variance * powers for variance, _ in expected]
    products = np.array([product * np.outer(powers, powers) for _, product in expected])
    between = _Independent(products, np.array(measured.coefficients, dtype=np.float64))
    chosen = [TERMS.index(name) for name in TERMS[:4] if name in terms]
    return fit_squares(measured.tau_s, measured.variance, shapes, chosen, between)


@dataclass(frozen=True)
class _Independent:
    products: FloatArray  # (k, 4, 4): sums over lags of the coefficients' squared autocovariance
    counts: FloatArray

    def of(self, squares: FloatArray) -> FloatArray:
        return np.diag(2.0 * np.einsum("p,kpq,q->k", squares[:4], self.products, squares[:4]) / self.counts)


@lru_cache(maxsize=MAX_SCALES)
def _expected(scale: int) -> tuple[FloatArray, FloatArray]:
    """Variance (4,) and sum over lags of autocovariance products (4, 4) of W_j; tau_0 = 1."""
    smooth, filtered = np.ones(1), np.ones(1)
    for level in range(1, scale + 1):
        spread = np.zeros(3 * 2 ** (level - 1) + 1)
        spread[:: 2 ** (level - 1)] = _WAVELET
        filtered = _convolve(smooth, spread)
        spread[:: 2 ** (level - 1)] = _SCALING
        smooth = _convolve(smooth, spread)
    of_integral = np.convolve(filtered, [1.0, -1.0])
    length = len(of_integral)
    correlation = _convolve(of_integral, of_integral[::-1])  # lags -(length - 1) … length - 1
    lags = np.abs(np.arange(-3 * length, 3 * length + 1, dtype=np.float64))
    whole = slice(len(correlation) - 1, len(lags))  # where the two overlap fully
    covariance = np.stack([_convolve(row, correlation)[whole] for row in integral_autocovariance(lags)])
    return covariance[:, covariance.shape[1] // 2].copy(), covariance @ covariance.T


def _convolve(first: FloatArray, second: FloatArray) -> FloatArray:
    """By FFT where both are long: scipy.signal does the same, and takes seconds to load."""
    length = len(first) + len(second) - 1
    if min(len(first), len(second)) < DIRECT_LENGTH:
        return np.convolve(first, second)
    size = 1 << (length - 1).bit_length()
    return np.fft.irfft(np.fft.rfft(first, size) * np.fft.rfft(second, size), size)[:length]


def _refused(what: str) -> CalibrationError:
    return CalibrationError(
        what, where="wavelet variance", fault=Fault.DATA, remedy="look at the recording, or record longer."
    )

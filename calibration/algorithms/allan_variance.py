"""Overlapping and modified Allan deviation of uniform samples.

With y the samples (any unit), tau_0 their period, x their running integral less the mean,

    overlapping   sigma^2(m tau_0) = sum (x[i+2m] - 2 x[i+m] + x[i])^2 / (2 (m tau_0)^2 (N + 1 - 2m))
    modified      the same of x averaged over m samples, N + 2 - 3m terms

IEEE 952 annex C; NIST SP 1065 (Riley 2008), eq (11) and (14). Out of scope: non-overlapping forms
(the same value with fewer degrees of freedom) and records with gaps: those are refused.

How it is fast: the record is walked once, in blocks that stay in the cache for all taus. Differences
are taken in place, and each block's sum of squares is added by itself, so that rounding stays at 1e-15.
"""

# pyright: strict
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import CalibrationError, Fault

FloatArray = NDArray[np.float64]
AllanKind = Literal["overlapping", "modified"]

BLOCK = 8192
"""Samples handled at a time: three buffers of 64 KiB. Measured best of 2048 … 8192."""
MIN_SAMPLES = 16
MIN_TERMS = 2
DEFAULT_TAUS = 48
MAX_TAUS = 100_000
LONGEST_PART = 4
"""Taus offered by default end at the record's length over this."""


@dataclass(frozen=True)
class AllanDeviation:
    """Allan deviations of one record.

    Attributes:
        kind: which estimate.
        tau_s: averaging times, increasing, shape (k,), s.
        factors: m = tau / tau_0, shape (k,).
        deviation: sigma(tau), shape (k,), in the unit of the samples.
        terms: squared differences averaged, shape (k,).
        sample_count: N, of the record.
        rate_hz: 1 / tau_0.
    """

    kind: AllanKind
    tau_s: FloatArray
    factors: NDArray[np.int64]
    deviation: FloatArray
    terms: NDArray[np.int64]
    sample_count: int
    rate_hz: float

    def minimum(self) -> tuple[float, float]:
        """The curve's lowest point: tau (s) and sigma. Flicker alone would put sigma at 0.664 B."""
        lowest = int(self.deviation.argmin())
        return float(self.tau_s[lowest]), float(self.deviation[lowest])


def logarithmic_taus(sample_count: int, rate_hz: float, count: int = DEFAULT_TAUS) -> FloatArray:
    """At most `count` averaging times (s), evenly spaced in the logarithm, from one sample to N / 4."""
    factors = np.geomspace(1.0, max(1.0, sample_count / LONGEST_PART), count)
    return np.unique(np.round(factors)) / rate_hz


def overlapping_allan_deviation(
    samples: FloatArray, rate_hz: float, taus_s: FloatArray | None = None
) -> AllanDeviation:
    """Overlapping Allan deviation.

    Args:
        samples: y, shape (n,), uniform, any unit: rates or specific forces, not their integral.
        rate_hz: samples a second.
        taus_s: averaging times, any order, each at least half a period: rounded to whole periods,
            doubles dropped. None: `logarithmic_taus`.

    Raises:
        CalibrationError: samples are missing or too few, or a tau is longer than the record carries.
    """
    factors = _factors("overlapping", samples, rate_hz, taus_s)
    integral = _integral(samples)
    sums = np.zeros(len(factors))
    first, second = np.empty(BLOCK), np.empty(BLOCK)
    steps = [int(factor) for factor in factors]
    for begin in range(0, len(integral), BLOCK):
        start = integral[begin : begin + BLOCK]
        for index, m in enumerate(steps):
            count = min(BLOCK, len(integral) - 2 * m - begin)
            if count <= 0:
                break  # and so for all longer taus
            middle = integral[begin + m : begin + m + count]
            later, earlier = first[:count], second[:count]
            np.subtract(integral[begin + 2 * m : begin + 2 * m + count], middle, out=later)
            np.subtract(middle, start[:count], out=earlier)
            np.subtract(later, earlier, out=later)
            sums[index] += later.dot(later)
    terms = len(integral) - 2 * factors
    return _result("overlapping", samples, rate_hz, factors, terms, np.sqrt(sums / (2.0 * terms)) / factors)


def modified_allan_deviation(
    samples: FloatArray, rate_hz: float, taus_s: FloatArray | None = None
) -> AllanDeviation:
    """Modified Allan deviation: tells white noise of the angle, as quantization leaves it (slope -3/2), from
    flicker of the angle (-1); the overlapping form shows both as -1.

    Arguments and errors as for `overlapping_allan_deviation`; a tau needs three of itself in the record.
    """
    factors = _factors("modified", samples, rate_hz, taus_s)
    integral = _integral(samples)
    steps = [int(factor) for factor in factors]
    # The sum of m second differences moves on by the third difference x3 - 3 x2 + 3 x1 - x0.
    moving = np.array(
        [integral[2 * m : 3 * m].sum() - 2.0 * integral[m : 2 * m].sum() + integral[:m].sum() for m in steps]
    )
    sums = moving**2
    outer, inner = np.empty(BLOCK), np.empty(BLOCK)
    for begin in range(0, len(integral), BLOCK):
        start = integral[begin : begin + BLOCK]
        for index, m in enumerate(steps):
            count = min(BLOCK, len(integral) - 3 * m - begin)
            if count <= 0:
                break
            third, difference = outer[:count], inner[:count]
            at = begin + m
            np.subtract(integral[at + m : at + m + count], integral[at : at + count], out=difference)
            np.multiply(difference, 3.0, out=difference)
            np.subtract(integral[at + 2 * m : at + 2 * m + count], start[:count], out=third)
            np.subtract(third, difference, out=third)
            np.cumsum(third, out=third)
            np.add(third, moving[index], out=third)
            moving[index] = third[-1]
            sums[index] += third.dot(third)
    terms = len(integral) - 3 * factors + 1
    deviation = np.sqrt(sums / (2.0 * terms)) / factors.astype(np.float64) ** 2
    return _result("modified", samples, rate_hz, factors, terms, deviation)


def _integral(samples: FloatArray) -> FloatArray:
    """x / tau_0, shape (n + 1,), from 0. The mean carries nothing and would cost digits."""
    integral = np.empty(len(samples) + 1)
    integral[0] = 0.0
    np.cumsum(samples - samples.mean(), out=integral[1:])
    return integral


def _factors(
    kind: AllanKind, samples: FloatArray, rate_hz: float, taus_s: FloatArray | None
) -> NDArray[np.int64]:
    count = len(samples)
    if samples.ndim != 1 or count < MIN_SAMPLES:
        raise _refused(
            f"An Allan deviation needs one channel of at least {MIN_SAMPLES} samples, not {samples.shape}.",
            "record longer",
        )
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise _refused(f"The sample rate {rate_hz} Hz is none.", "give the rate of the samples")
    missing = int((~np.isfinite(samples)).sum())
    if missing:
        raise _refused(
            f"{missing} of {count} samples are missing (NaN).",
            "record anew, or use the longest part without a gap: a filled gap is not the unit's noise",
        )
    span = 2 if kind == "overlapping" else 3
    longest = (count + span - 1 - MIN_TERMS) // span
    wanted = logarithmic_taus(count, rate_hz) if taus_s is None else np.asarray(taus_s, dtype=np.float64)
    if wanted.ndim != 1 or not 0 < len(wanted) <= MAX_TAUS or not np.isfinite(wanted).all():
        raise _refused(f"The averaging times are not 1 to {MAX_TAUS} numbers.", "name them in seconds")
    factors = np.unique(np.round(wanted * rate_hz)).astype(np.int64)
    if factors[0] < 1 or factors[-1] > longest:
        raise _refused(
            f"An averaging time lies outside {1 / rate_hz:g} … {longest / rate_hz:g} s: {count} samples "
            f"at {rate_hz:g} Hz do not carry it.",
            "ask for others, or record longer",
        )
    return factors


def _result(
    kind: AllanKind,
    samples: FloatArray,
    rate_hz: float,
    factors: NDArray[np.int64],
    terms: NDArray[np.int64],
    deviation: FloatArray,
) -> AllanDeviation:
    return AllanDeviation(kind, factors / rate_hz, factors, deviation, terms, len(samples), rate_hz)


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="Allan deviation", fault=Fault.DATA, remedy=remedy + ".")

"""Noise of a chosen autocovariance or spectrum by FFT: another way than the recursions of the emulator."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def white(rng: np.random.Generator, count: int, channels: int, density: float, period_s: float) -> Array:
    """(count, channels) samples of a density in SI^2 s."""
    return rng.standard_normal((count, channels)) * np.sqrt(density / period_s)


def exponential(
    rng: np.random.Generator, count: int, channels: int, sigma: float, correlation_s: float, period_s: float
) -> Array:
    """(count, channels) samples with autocovariance sigma^2 exp(-|t| / tau): circulant embedding."""
    lags = period_s * np.arange(4 * count)
    around = np.exp(-np.minimum(lags, lags[-1] + period_s - lags) / correlation_s)
    power = np.maximum(np.fft.rfft(around).real, 0.0)
    noise = np.fft.rfft(rng.standard_normal((len(lags), channels)), axis=0)
    return sigma * np.fft.irfft(noise * np.sqrt(power)[:, None], n=len(lags), axis=0)[:count]


def flicker(rng: np.random.Generator, count: int, channels: int, b: float, period_s: float) -> Array:
    """(count, channels) samples of the two-sided spectrum B^2 / (2 pi f), down to f = 1 / (8 T)."""
    length = 8 * count
    frequency = np.fft.rfftfreq(length, period_s)
    shape = np.zeros(len(frequency))
    shape[1:] = b / np.sqrt(2.0 * np.pi * frequency[1:])
    noise = np.fft.rfft(rng.standard_normal((length, channels)) / np.sqrt(period_s), axis=0)
    return np.fft.irfft(noise * shape[:, None], n=length, axis=0)[:count]


def check_coverage(pulls: Array, *, less: float = 0.0, more: float = 0.12) -> None:
    """68 and 95 % intervals hold the truth as often as they say, within 3.5 sigma of the count.

    Args:
        pulls: (estimate - truth) / standard uncertainty, first axis independent records.
        less, more: how far below or above the stated rate it may be besides.
    """
    number = len(pulls)
    for width, stated in ((1.0, 0.6827), (1.96, 0.95)):
        covered = (np.abs(pulls) <= width).mean(axis=0)
        margin = 3.5 * np.sqrt(stated * (1.0 - stated) / number)
        assert np.all(covered >= stated - margin - less), (width, covered)
        assert np.all(covered <= min(1.0, stated + margin + more)), (width, covered)

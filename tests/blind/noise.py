"""Noise of a channel: white plus Gauss–Markov terms; its synthesis by circulant embedding, its whitening.

Synthesis (Davies & Harte 1987) has exactly the stated autocovariance and no recursion. Whitening is the
steady-state innovations filter in cascade form; that the process starts in its stationary state, not in
the filter's, is made exact by random columns for the initial state (see `initial_columns`).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst, irfft, next_fast_len, rfft
from scipy.linalg import solve_discrete_are

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one channel at its output rate.

    Attributes:
        rate_hz: output rate.
        white: standard deviation of a sample.
        terms: (standard deviation, correlation time in s) of each Gauss–Markov term.
        random_walk: increments per square root of a second.
    """

    rate_hz: float
    white: float
    terms: tuple[tuple[float, float], ...]
    random_walk: float = 0.0

    def scaled(self, factor: float) -> "ChannelNoise":
        """All of it larger by a factor."""
        terms = tuple((sigma * factor, tau) for sigma, tau in self.terms)
        return replace(self, white=self.white * factor, terms=terms, random_walk=self.random_walk * factor)

    def drawn(self, rng: np.random.Generator, rows: int) -> Array:
        """One realisation of `rows` samples."""
        noise = rng.normal(0, self.white, rows)
        for sigma, tau in self.terms:
            noise += _exponential(rng, rows, sigma, tau * self.rate_hz)
        if self.random_walk:
            noise += self.random_walk * np.sqrt(rows / self.rate_hz) * _brownian(rng, rows)
        return noise

    def spectrum(self, angular: Array) -> Array:
        """Two-sided power spectral density per sample at angular frequencies (rad/sample)."""
        total = np.full_like(angular, self.white**2)
        for sigma, tau in self.terms:
            phi = np.exp(-1 / (tau * self.rate_hz))
            total += sigma**2 * (1 - phi**2) / (1 + phi**2 - 2 * phi * np.cos(angular))
        if self.random_walk:
            total += self.random_walk**2 / self.rate_hz / (2 - 2 * np.cos(angular))
        return total


def _exponential(rng: np.random.Generator, rows: int, sigma: float, tau_samples: float) -> Array:
    size = next_fast_len(2 * rows, real=True)
    distance = np.minimum(np.arange(size), size - np.arange(size))
    eigenvalues = np.maximum(rfft(sigma**2 * np.exp(-distance / tau_samples)).real, 0)
    half = rng.normal(size=(2, len(eigenvalues)))
    spectrum = (half[0] + 1j * half[1]) * np.sqrt(eigenvalues / 2)
    spectrum[0] = half[0, 0] * np.sqrt(eigenvalues[0])
    if size % 2 == 0:
        spectrum[-1] = half[0, -1] * np.sqrt(eigenvalues[-1])
    return irfft(spectrum, size)[:rows] * np.sqrt(size)


def _brownian(rng: np.random.Generator, rows: int) -> Array:
    """Wiener process on (0, 1] by its Karhunen–Loève series."""
    order = (np.arange(rows) + 0.5) * np.pi
    return np.asarray(dst(rng.normal(size=rows) / order, type=4)) / np.sqrt(2)


class InnovationsFilter:
    """Whitens columns of one channel; a random walk is taken as a very slow Gauss–Markov term."""

    def __init__(self, noise: ChannelNoise) -> None:
        terms = list(noise.terms)
        if noise.random_walk:
            slow = 2e4
            terms.append((noise.random_walk * np.sqrt(slow / 2), slow))
        self._phi = np.array([np.exp(-1 / (tau * noise.rate_hz)) for _, tau in terms])
        self._poles = self._phi_sorted = self._phi
        self._std, self._initial = noise.white, np.zeros((0, 0))
        if terms:
            self._solve(noise, terms)

    def _solve(self, noise: ChannelNoise, terms: list[tuple[float, float]]) -> None:
        variance = np.diag([sigma**2 for sigma, _ in terms])
        transition, seen = np.diag(self._phi), np.ones((1, len(terms)))
        driven = variance * (1 - self._phi**2)
        covariance = np.asarray(solve_discrete_are(transition, seen.T, driven, [[noise.white**2]]))
        innovation = float(covariance.sum() + noise.white**2)
        gain = covariance.sum(axis=1, keepdims=True) / innovation
        self._poles = np.sort(np.linalg.eigvals(transition @ (np.eye(len(terms)) - gain @ seen)).real)
        self._phi_sorted = np.sort(self._phi)
        self._std = float(np.sqrt(innovation))
        values, vectors = np.linalg.eigh(variance - covariance)
        self._initial = vectors * np.sqrt(np.maximum(values, 0))

    def __call__(self, columns: Array) -> Array:
        """(rows, m) whitened to unit variance, from a zero state."""
        out = np.asarray(columns, dtype=float) / self._std
        for phi, pole in zip(self._phi_sorted, self._poles, strict=True):
            driven = out.copy()
            driven[1:] -= phi * out[:-1]
            out = _recursion(driven, pole)
        return out

    def initial_columns(self, rows: int) -> Array:
        """(rows, states): whitened columns with standard normal weights, what the filter's start misses."""
        decays = self._phi[None, :] ** np.arange(rows)[:, None]
        return self(decays @ self._initial)


def _recursion(driven: Array, pole: float) -> Array:
    """y[k] = pole y[k-1] + driven[k], by running sums of pole^-k driven[k] in short blocks; in place."""
    rows = len(driven)
    length = int(np.clip(12 / -np.log(pole), 1, 512))
    powers = pole ** np.arange(length)
    carried = np.zeros(driven.shape[1])
    for start in range(0, rows, length):
        block = driven[start : start + length]
        size = len(block)
        block[0] += pole * carried
        block /= powers[:size, None]
        np.cumsum(block, axis=0, out=block)
        block *= powers[:size, None]
        carried = block[-1].copy()
    return driven

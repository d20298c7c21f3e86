"""What a quantum does to a mean: nothing where noise spreads over several of them, else up to half of one.

Rounding to multiples of q adds to the mean of a normal variable (m, sigma) the sum over k of

    (-1)^k  q / (pi k)  exp(-2 pi^2 k^2 sigma^2 / q^2)  sin(2 pi k m / q)

(Widrow & Kollar, Quantization Noise, 2008, ch. 5: moments of the rounded normal). Where m lies between quanta
is not known; over all places the mean square is half the sum of the squared factors: q^2 / 12 without noise,
(q / pi)^2 / 2 times exp(-4 pi^2 sigma^2 / q^2) with some.

sigma cannot be read off the samples' standard deviation: samples that toggle between two neighbours may have
half a quantum of noise or nearly none. It is weighed instead by its likelihood for how often each quantum
came (normal, interval-censored), each stretch of the record with its own mean, so that slow wander is not
taken for noise that spreads the samples at each instant.
"""

# pyright: strict
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from calibration.algorithms.coefficients import FloatArray

STRETCHES, LEAST_SAMPLES = 20, 50
"""Most stretches of a record, and the fewest samples that one of them has where there are two."""
AMPLE_NOISE = 0.7
"""Of the quantum: beyond it rounding moves a mean by less than 2e-5 of the quantum."""
SIGMAS: FloatArray = np.geomspace(0.01, AMPLE_NOISE, 36, dtype=np.float64)
"""Of the quantum, evenly by their logarithms: what is known of a scale that nothing is known of."""
ON_LATTICE = 0.05
_TERMS, _STEPS = 200, 20
_LEAST_LIKELIHOOD = 1e-300


def rms_error(sigma: FloatArray, quantum: float) -> FloatArray:
    """Root mean square, over all places between quanta, of what rounding adds to a mean; as `sigma`."""
    k = np.arange(1, _TERMS + 1, dtype=np.float64)
    factors = (
        quantum / (math.pi * k) * np.exp(-2.0 * (math.pi * k * np.asarray(sigma)[..., None] / quantum) ** 2)
    )
    return np.sqrt(0.5 * (factors**2).sum(axis=-1))


def lattice_step(samples: FloatArray) -> float | None:
    """The smallest step between samples of one channel if all lie on its multiples; None: they do not."""
    seen = np.unique(samples[np.isfinite(samples)])
    if len(seen) < 2:
        return None
    places = (seen - seen[0]) / float(np.diff(seen).min())
    whole = np.rint(places)
    if float(np.abs(places - whole).max()) > ON_LATTICE:
        return None
    return float(seen[-1] - seen[0]) / float(whole[-1])


def mean_uncertainty(samples: FloatArray, quantum: float) -> float:
    """Standard uncertainty of a channel's mean by its quantum, of the samples' unit; 0 where noise is ample.

    Args:
        samples: shape (n,), in order of time; not finite ones are left out.
        quantum: the step that they are rounded to.
    """
    places = np.rint(samples[np.isfinite(samples)] / quantum)
    count = max(1, min(STRETCHES, len(places) // LEAST_SAMPLES))
    stretches = [part for part in np.array_split(places, count) if len(part)]
    if not stretches:
        return 0.0
    freedom = max(len(places) - count, 1)
    within = sum(float(((part - part.mean()) ** 2).sum()) for part in stretches) / freedom
    if within > AMPLE_NOISE**2 + 1.0 / 12.0:
        return 0.0
    likelihood = _log_likelihood(_occurrences(stretches))
    weight = np.exp(likelihood - likelihood.max())
    return quantum * math.sqrt(float(weight @ rms_error(SIGMAS, 1.0) ** 2) / float(weight.sum()))


def _occurrences(stretches: list[FloatArray]) -> NDArray[np.float64]:
    """How often each of the quanta from the least to the largest that came, (stretches, quanta).

    Each stretch begins at its own least quantum.
    """
    counts = [np.bincount((part - part.min()).astype(np.intp)) for part in stretches]
    table = np.zeros((len(counts), max(len(one) for one in counts)))
    for row, one in zip(table, counts, strict=True):
        row[: len(one)] = one
    return table


def _log_likelihood(counts: NDArray[np.float64]) -> FloatArray:
    """Of each of `SIGMAS`, every stretch with the mean that suits it best (it is concave in the mean)."""
    upper: FloatArray = np.arange(counts.shape[1], dtype=np.float64) + 0.5
    sigma = SIGMAS[:, None]

    def at(mean: FloatArray) -> FloatArray:
        below = ndtr((upper - 1.0 - mean[..., None]) / sigma[..., None])
        part = np.asarray(ndtr((upper - mean[..., None]) / sigma[..., None]) - below, dtype=np.float64)
        return (counts * np.log(np.maximum(part, _LEAST_LIKELIHOOD))).sum(axis=-1)

    low = np.full((len(SIGMAS), len(counts)), -0.5)
    high = np.broadcast_to((counts > 0).cumsum(axis=1).argmax(axis=1) + 0.5, low.shape).copy()
    for _ in range(_STEPS):
        third = (high - low) / 3.0
        rising = at(low + third) < at(high - third)
        low, high = np.where(rising, low + third, low), np.where(rising, high, high - third)
    return at(0.5 * (low + high)).sum(axis=1)

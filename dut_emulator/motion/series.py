# pyright: strict
"""Truncated Taylor series in time, so that derivatives of a motion follow from its formulas and not by hand.

A series is an array (order + 1, n): row k is the k-th derivative over k! at each of n moments. (R. E. Moore,
*Methods and Applications of Interval Analysis*, 1979, chapter 3; recursions for the functions used here.)
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def product(one: FloatArray, other: FloatArray) -> FloatArray:
    """To the lower order of the two."""
    order = min(len(one), len(other))
    result = np.empty((order, one.shape[1]))
    for k in range(order):
        result[k] = one[0] * other[k]
        for i in range(1, k + 1):
            result[k] += one[i] * other[k - i]
    return result


def derivative(series: FloatArray) -> FloatArray:
    """One order lower."""
    return series[1:] * np.arange(1, len(series))[:, np.newaxis]


def antiderivative(series: FloatArray, value: FloatArray) -> FloatArray:
    """One order higher, with this value (n,)."""
    return np.concatenate([value[np.newaxis], series / np.arange(1, len(series) + 1)[:, np.newaxis]])


def sine_cosine(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of an angle in rad: s' = c a', c' = −s a'."""
    sine, cosine = np.empty_like(angle), np.empty_like(angle)
    sine[0], cosine[0] = np.sin(angle[0]), np.cos(angle[0])
    for k in range(1, len(angle)):
        sine[k] = sum(j * angle[j] * cosine[k - j] for j in range(1, k + 1)) / k
        cosine[k] = -sum(j * angle[j] * sine[k - j] for j in range(1, k + 1)) / k
    return sine, cosine


def angle_of(sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """atan2(y, x) in rad, for x² + y² > 0: a' (x² + y²) = x y' − y x'."""
    slope = product(cosine[:-1], derivative(sine)) - product(sine[:-1], derivative(cosine))
    square = product(sine, sine) + product(cosine, cosine)
    quotient = np.empty_like(slope)
    for k in range(len(slope)):
        quotient[k] = slope[k] - sum(square[i] * quotient[k - i] for i in range(1, k + 1))
        quotient[k] /= square[0]
    return antiderivative(quotient, np.arctan2(sine[0], cosine[0]))

"""The closed forms of paper 1, corrected: six positions, eq (2), and turns, eq (1), (3), (4).

They hold for nominal, symmetric runs and equal noise. The product evaluates sessions by
`linear_triad`, which equals these forms there and gives the covariance; tests hold the two together.
"""

# pyright: strict
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def six_position(output_means: FloatArray, specific_force: FloatArray) -> tuple[FloatArray, FloatArray]:
    """K_a (3, 3) and nabla (3,) of f = K_a N + nabla, paper 1, eq (2).

    The printed F = N_A K lacks the column of ones that carries the bias, and its K is the
    transpose of K_a: here [N_A 1] X = F, K_a = X[:3]^T, nabla = X[3].

    Args:
        output_means: N_A, shape (n, 3), means per position, in the sensor's unit.
        specific_force: F, shape (n, 3).
    """
    augmented = np.column_stack([output_means, np.ones(len(output_means))])
    solution: FloatArray = np.asarray(
        np.linalg.lstsq(augmented, specific_force, rcond=None)[0], dtype=np.float64
    )
    return solution[:3].T.copy(), solution[3].copy()


def turn_pairs(
    integrals: Mapping[str, FloatArray], turns: float, capture_s: float
) -> tuple[FloatArray, FloatArray]:
    """M (3, 3) and n_0 (3,) of N = M w + n_0 from turns both ways, paper 1, eq (3), (4).

    Printed eq (3) is the transpose of the forward matrix M; eq (1) needs K_g = inv(M). Printed
    eq (4) divides by an angle: the bias is the sum of the four cross-axis integrals over 4 T.

    Args:
        integrals: 'x+' 'x-' 'y+' 'y-' 'z+' 'z-' → integral of the three outputs, shape (3,).
        turns: N, whole turns about each axis each way.
        capture_s: T, the same for all six.
    """
    matrix = np.empty((3, 3))
    bias = np.zeros(3)
    for column, axis in enumerate("xyz"):
        plus, minus = integrals[f"{axis}+"], integrals[f"{axis}-"]
        matrix[:, column] = (plus - minus) / (4.0 * math.pi * turns)
        cross = [row for row in range(3) if row != column]
        bias[cross] += (plus[cross] + minus[cross]) / (4.0 * capture_s)
    return matrix, bias

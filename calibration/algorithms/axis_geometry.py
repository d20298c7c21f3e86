"""What a triad's matrix says of its geometry: scale factors, a rotation, and what is no rotation.

    M = S E,   S = diag |m_i|,   rows of E: unit input axes of the sensors in body axes
    E = N R    polar decomposition: R the nearest rotation, N symmetric, N = I where the axes are orthogonal

Nine numbers: three scale factors; three of the *misalignment* (rotation vector phi of the triad as a whole;
the stand's mounting error is in it and cannot be told apart); three of the *non-orthogonality* (n_xy, n_xz,
n_yz, rad: half of what the axes' angles lack to 90 deg; mounting cannot change them).

*Cross-coupling* m_ij / m_ii holds both, n_ij - [phi x]_ij: two triads with the same figures can be a perfect
triad that is mounted askew, or a skewed one that is mounted well. A single sensor cannot tell a tilted input
axis from *cross-axis sensitivity* (IEEE 1293): both are the same row of M, and no linear test separates them.
Only N is of the unit alone.
"""

# pyright: strict
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray, TriadCoefficients

_STEP = 1e-6
"""Of the central differences; M is near the identity and smooth there."""


@dataclass(frozen=True)
class AxisGeometry:
    """Nine numbers with their covariance, in this order: scale factors - 1, phi, non-orthogonality.

    Attributes:
        scale_factor_error: |m_i| - 1, shape (3,). Differs from m_ii - 1 in second order of the angles.
        misalignment_rad: phi, shape (3,): turning the body axes by phi gives the triad's.
        nonorthogonality_rad: n_xy, n_xz, n_yz, shape (3,).
        covariance: shape (9, 9); the mounting's uncertainty is in that of phi.
    """

    scale_factor_error: FloatArray
    misalignment_rad: FloatArray
    nonorthogonality_rad: FloatArray
    covariance: FloatArray

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Shape (9,)."""
        return np.sqrt(np.einsum("ii->i", self.covariance))

    def misalignment_share(self) -> float:
        """Part of the cross-coupling's sum of squares that a better mounting would take away, 0 … 1."""
        turned = 2.0 * float(self.misalignment_rad @ self.misalignment_rad)
        skewed = 2.0 * float(self.nonorthogonality_rad @ self.nonorthogonality_rad)
        return turned / (turned + skewed) if turned + skewed > 0 else 0.0


def axis_geometry(
    coefficients: TriadCoefficients, mounting_standard_uncertainty_rad: float = 0.0
) -> AxisGeometry:
    """Decompose M.

    Args:
        coefficients: M with its covariance.
        mounting_standard_uncertainty_rad: of the unit on the stand, about each axis.
    """
    elements = np.asarray(coefficients.matrix, dtype=np.float64).ravel()
    jacobian = np.empty((9, 9))
    for column in range(9):
        step = np.zeros(9)
        step[column] = _STEP
        change = decompose((elements + step).reshape(3, 3)) - decompose((elements - step).reshape(3, 3))
        jacobian[:, column] = change / (2.0 * _STEP)
    covariance = jacobian @ coefficients.covariance[:9, :9] @ jacobian.T
    covariance[3:6, 3:6] += np.eye(3) * mounting_standard_uncertainty_rad**2
    nine = decompose(elements.reshape(3, 3))
    return AxisGeometry(nine[:3], nine[3:6], nine[6:], (covariance + covariance.T) / 2.0)


def relative_misalignment(first: AxisGeometry, second: AxisGeometry) -> tuple[FloatArray, FloatArray]:
    """phi of `first` less that of `second` (rad) and its covariance (3, 3), for small angles.

    Of gyros against accelerometers on one mount: the mounting drops out, so hand over geometries without
    its uncertainty.
    """
    covariance = first.covariance[3:6, 3:6] + second.covariance[3:6, 3:6]
    return first.misalignment_rad - second.misalignment_rad, covariance


def decompose(matrix: FloatArray) -> FloatArray:
    """(3, 3) → scale factor errors, rotation vector, non-orthogonality: (9,)."""
    scale = np.linalg.norm(matrix, axis=1)
    left, strengths, right = np.linalg.svd(matrix / scale[:, None])
    rotation = left @ right
    skew = (left * strengths) @ left.T
    return np.concatenate([scale - 1.0, _rotation_vector(rotation), skew[[0, 0, 1], [1, 2, 2]]])


def _rotation_vector(rotation: FloatArray) -> FloatArray:
    """Of R whose rows are the turned axes: R = exp(-[phi x])."""
    sines = 0.5 * np.array(
        [
            rotation[1, 2] - rotation[2, 1],
            rotation[2, 0] - rotation[0, 2],
            rotation[0, 1] - rotation[1, 0],
        ]
    )
    sine = float(np.linalg.norm(sines))
    angle = float(np.arctan2(sine, (np.trace(rotation) - 1.0) / 2.0))
    return sines * (angle / sine if sine > 1e-12 else 1.0)

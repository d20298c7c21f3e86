"""Hard and soft iron of a three-axis magnetometer from turning it all ways in one field.

    h = K (m - b),   |h| = the field,   K symmetric

m: output; b: hard iron, the output in no field; K: soft iron, scale factors and non-orthogonality together,
which the magnitude alone cannot tell apart. A rotation of the sensor against the body leaves |h| as it is:
K is the symmetric one of all that fit, and aligning it takes another reference.
"""

from dataclasses import dataclass

import numpy as np

from calibration.algorithms.allan_variance import FloatArray
from calibration.algorithms.ellipsoid_fit import EllipsoidFit, fit_ellipsoid, propagate
from protocol.errors import CalibrationError, Fault

MIN_DIRECTION_PART = 0.02
"""Least eigenvalue of the directions' mean outer product, 1/3 when they fill the sphere evenly."""
DIRECTIONS = 2000
"""Outputs, at least half as many, that are looked at for the directions."""
UPPER = tuple((row, column) for row in range(3) for column in range(row, 3))


@dataclass(frozen=True)
class MagnetometerCoefficients:
    """Compensation of a magnetometer.

    Attributes:
        compensation: K, shape (3, 3), symmetric, unit of `field` per unit of the output.
        hard_iron: b, shape (3,), unit of the output.
        covariance: of (K row by row from its diagonal on, b), shape (9, 9).
        field: |h| that K was scaled to; 1 where the field is not known: h is then a direction.
        radii: of the ellipsoid, increasing, shape (3,), unit of the output.
        distance_rms: of the outputs used from the ellipsoid, unit of the output.
        outliers: outputs left out.
        sample_count: outputs in all.
        widened: factor by which slow residuals widened the covariance.
    """

    compensation: FloatArray
    hard_iron: FloatArray
    covariance: FloatArray
    field: float
    radii: FloatArray
    distance_rms: float
    outliers: int
    sample_count: int
    widened: float

    def compensate(self, output: FloatArray) -> FloatArray:
        """h = K (m - b): (n, 3) or (3,)."""
        return (np.asarray(output, dtype=np.float64) - self.hard_iron) @ self.compensation

    def compensation_standard_uncertainty(self) -> FloatArray:
        """u(K), shape (3, 3)."""
        uncertainty = np.zeros((3, 3))
        for position, (row, column) in enumerate(UPPER):
            uncertainty[row, column] = uncertainty[column, row] = np.sqrt(self.covariance[position, position])
        return uncertainty

    def hard_iron_standard_uncertainty(self) -> FloatArray:
        """u(b), shape (3,), unit of the output."""
        return np.sqrt(np.diag(self.covariance)[6:])

    def magnitude_spread(self, output: FloatArray) -> float:
        """Standard deviation of |h| over the field: what is left, outliers and all."""
        return float(np.linalg.norm(self.compensate(output), axis=1).std(ddof=1) / self.field)


def hard_and_soft_iron(output: FloatArray, field: float | None = None) -> MagnetometerCoefficients:
    """Fit the ellipsoid of outputs.

    Args:
        output: m, shape (n, 3), in time order, any unit. Rests are welcome but carry one direction each.
        field: magnitude of the local field in the wanted unit; None: h has magnitude 1.

    Raises:
        CalibrationError: missing values, directions that leave an axis out, too many outliers.
    """
    if field is not None and not (np.isfinite(field) and field > 0.0):
        raise _refused(f"A field of {field} is none.", "give its magnitude, or nothing")
    values = np.asarray(output, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != 3:
        raise _refused(f"Outputs of shape {values.shape} have not three channels.", "give x, y and z")
    scale = 1.0 if field is None else float(field)
    fit = fit_ellipsoid(values, "magnetometer, three axes")

    def of_ellipsoid(centre: FloatArray, shape: FloatArray) -> FloatArray:
        root = _root(shape) * scale
        return np.concatenate([[root[row, column] for row, column in UPPER], centre])

    elements, covariance = propagate(fit, of_ellipsoid)
    compensation = np.zeros((3, 3))
    for position, (row, column) in enumerate(UPPER):
        compensation[row, column] = compensation[column, row] = elements[position]
    found = MagnetometerCoefficients(
        compensation=compensation,
        hard_iron=elements[6:],
        covariance=covariance,
        field=scale,
        radii=np.sort(1.0 / np.sqrt(np.linalg.eigvalsh(fit.shape))),
        distance_rms=fit.distance_rms,
        outliers=fit.outliers,
        sample_count=len(values),
        widened=fit.widened,
    )
    _check_directions(found, fit, values)
    return found


def _check_directions(found: MagnetometerCoefficients, fit: EllipsoidFit, output: FloatArray) -> None:
    used = np.flatnonzero(fit.used)
    directions = found.compensate(output[used[:: len(used) // DIRECTIONS + 1]])
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    least, axes = np.linalg.eigh(directions.T @ directions / len(directions))
    if least[0] < MIN_DIRECTION_PART:
        missing = "xyz"[int(np.abs(axes[:, 0]).argmax())]
        raise _refused(
            f"Hardly any output has the field along {missing} "
            f"(part {least[0]:.3f}, bound {MIN_DIRECTION_PART}).",
            f"turn the unit so that {missing} points along the field, both ways",
        )


def _root(matrix: FloatArray) -> FloatArray:
    """Symmetric square root of a positive definite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return (vectors * np.sqrt(values)) @ vectors.T


def _refused(what: str, remedy: str) -> CalibrationError:
    return CalibrationError(what, where="magnetometer, three axes", fault=Fault.DATA, remedy=remedy + ".")

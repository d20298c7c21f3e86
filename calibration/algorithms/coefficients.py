"""The coefficients of a sensor triad, and what follows from them.

One model for gyros and accelerometers, the one that recordings call `believed`:

    y = M u + b          y: the sensor's output, u: the true input (body axes, SI), b: bias
    u = K (y - b)        K = inv(M): compensation

Row i of M is the sensitivity of sensor i, in units of output per unit of input: for outputs in
nominal SI scaling M is near the identity and b has the unit of the input. b is the *output* at
zero input; `bias_input_referred` is K b (paper 1 calls it epsilon = K_g n_0).

Order of the covariance (12, 12): m_xx m_xy m_xz m_yx m_yy m_yz m_zx m_zy m_zz b_x b_y b_z.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocol.errors import CalibrationError, Fault

FloatArray = NDArray[np.float64]
Quantity = Literal["angular_rate", "acceleration"]

SI_UNIT: dict[Quantity, str] = {"angular_rate": "rad/s", "acceleration": "m/s^2"}
PARAMETER_NAMES = (
    *(f"m_{row}{column}" for row in "xyz" for column in "xyz"),
    *(f"b_{row}" for row in "xyz"),
)
MAX_CONDITION = 100.0
"""A matrix further from invertible than this is no triad: a dead or doubled axis."""
_SYMMETRY_TOLERANCE = 1e-9


@dataclass(frozen=True)
class TriadCoefficients:
    """Coefficients of three sensors in the model y = M u + b.

    Attributes:
        quantity: what is measured; decides the SI unit of y, u and b.
        matrix: M, shape (3, 3), output per input (1).
        bias: b, shape (3,), SI.
        covariance: of (M row by row, b), shape (12, 12), SI.
        residual_rms: of the fit, SI of the output; 0 degrees of freedom leave it 0.
        degrees_of_freedom: observations less fitted parameters.

    Raises:
        CalibrationError: wrong shapes, values that are not finite, a covariance that is not
            symmetric with a non-negative diagonal, or a matrix that cannot be inverted.
    """

    quantity: Quantity
    matrix: FloatArray
    bias: FloatArray
    covariance: FloatArray
    residual_rms: float
    degrees_of_freedom: int

    def __post_init__(self) -> None:
        for name, shape in (("matrix", (3, 3)), ("bias", (3,)), ("covariance", (12, 12))):
            array = np.array(getattr(self, name), dtype=np.float64)  # a copy of our own
            if array.shape != shape:
                raise _refused(f"The {name} has shape {array.shape}, not {shape}.")
            if not np.isfinite(array).all():
                raise _refused(f"The {name} holds values that are not finite.")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.quantity not in SI_UNIT:
            raise _refused(f"'{self.quantity}' is not a quantity of a triad: {', '.join(SI_UNIT)}.")
        if not (np.isfinite(self.residual_rms) and self.residual_rms >= 0 and self.degrees_of_freedom >= 0):
            raise _refused("The residual or its degrees of freedom are negative or not finite.")
        scale = np.abs(self.covariance).max(initial=0.0)
        asymmetry = np.abs(self.covariance - self.covariance.T).max()
        if asymmetry > _SYMMETRY_TOLERANCE * scale or np.diag(self.covariance).min() < 0:
            raise _refused("The covariance is not that of real parameters.")
        condition = float(np.linalg.cond(self.matrix))
        if not condition < MAX_CONDITION:
            raise _refused(
                f"The matrix cannot be inverted (condition {condition:.3g}, bound {MAX_CONDITION:g}): "
                "an axis is dead, or two axes see the same input."
            )

    @property
    def unit(self) -> str:
        """SI unit of outputs, inputs and biases."""
        return SI_UNIT[self.quantity]

    @property
    def compensation(self) -> FloatArray:
        """K = inv(M), shape (3, 3)."""
        return np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)

    def compensate(self, output: FloatArray) -> FloatArray:
        """u = K (y - b): (n, 3) or (3,) outputs to inputs, SI, body axes (paper 1, eq (1), (2))."""
        return (np.asarray(output, dtype=np.float64) - self.bias) @ self.compensation.T

    def predict(self, true_input: FloatArray) -> FloatArray:
        """y = M u + b: (n, 3) or (3,) inputs to outputs, SI."""
        return np.asarray(true_input, dtype=np.float64) @ self.matrix.T + self.bias

    def matrix_standard_uncertainty(self) -> FloatArray:
        """u(M), shape (3, 3)."""
        return np.sqrt(np.diag(self.covariance)[:9]).reshape(3, 3)

    def bias_standard_uncertainty(self) -> FloatArray:
        """u(b), shape (3,), SI."""
        return np.sqrt(np.diag(self.covariance)[9:])

    def compensation_covariance(self) -> FloatArray:
        """Covariance of (K row by row, b), shape (12, 12): dK = -K dM K."""
        jacobian = np.eye(12)
        jacobian[:9, :9] = -np.kron(self.compensation, self.compensation.T)
        return jacobian @ self.covariance @ jacobian.T

    def compensation_standard_uncertainty(self) -> FloatArray:
        """u(K), shape (3, 3)."""
        return np.sqrt(np.diag(self.compensation_covariance())[:9]).reshape(3, 3)

    def scale_factor_error(self) -> FloatArray:
        """m_ii - 1, shape (3,): relative to the nominal scale factor that the data came with."""
        return np.diag(self.matrix) - 1.0

    def scale_factor_standard_uncertainty(self) -> FloatArray:
        """u(m_ii), shape (3,)."""
        return np.diag(self.matrix_standard_uncertainty()).copy()

    def cross_coupling(self) -> FloatArray:
        """m_ij / m_ii, shape (3, 3), zero diagonal: small angles (rad) of the input axes to the body axes."""
        coupling = self.matrix / np.diag(self.matrix)[:, None]
        np.fill_diagonal(coupling, 0.0)
        return coupling

    def cross_coupling_standard_uncertainty(self) -> FloatArray:
        """u(m_ij / m_ii), shape (3, 3), zero diagonal."""
        uncertainty = np.zeros((3, 3))
        for i in range(3):
            for j in range(3):
                if i == j:
                    continue
                gradient = np.zeros(12)
                gradient[3 * i + j] = 1.0 / self.matrix[i, i]
                gradient[3 * i + i] = -self.matrix[i, j] / self.matrix[i, i] ** 2
                uncertainty[i, j] = np.sqrt(max(gradient @ self.covariance @ gradient, 0.0))
        return uncertainty

    def nonorthogonality_rad(self) -> FloatArray:
        """Departure of the input axes' angles from 90 deg for the pairs xy, xz, yz, shape (3,).

        Free of how the unit was mounted: what remains of the cross-coupling when a common rotation
        (misalignment) is taken away.
        """
        axes = self.matrix / np.linalg.norm(self.matrix, axis=1, keepdims=True)
        return np.arcsin(np.clip([axes[0] @ axes[1], axes[0] @ axes[2], axes[1] @ axes[2]], -1.0, 1.0))

    def with_input_uncertainty(self, relative: float) -> "TriadCoefficients":
        """The same coefficients when all inputs share a scale error of this relative standard uncertainty.

        Gravity at an unknown site is such an error: it moves all of M together and leaves b.
        """
        elements = self.matrix.ravel()
        covariance = self.covariance.copy()
        covariance[:9, :9] += relative**2 * np.outer(elements, elements)
        return replace(self, covariance=covariance)

    def bias_input_referred(self) -> FloatArray:
        """K b, shape (3,), SI: the bias as an input (paper 1: epsilon = K_g n_0)."""
        return self.compensation @ self.bias


def _refused(what: str) -> CalibrationError:
    return CalibrationError(
        what,
        where="coefficients of a triad",
        fault=Fault.DATA,
        remedy="look at the recording that the coefficients were fitted to.",
    )

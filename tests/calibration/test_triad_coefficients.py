"""Coefficients of a triad: what they compute, and what they refuse to hold."""

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.algorithms.coefficients import PARAMETER_NAMES, TriadCoefficients
from protocol.errors import CalibrationError, Fault

small = st.floats(-0.1, 0.1, allow_subnormal=False)
near_identity = arrays.arrays(np.float64, (3, 3), elements=small).map(lambda m: np.eye(3) + m)
vectors = arrays.arrays(np.float64, (4, 3), elements=st.floats(-100, 100, allow_subnormal=False))


def coefficients(
    matrix: object, bias: object = (0.1, 0.2, 0.3), covariance: object = None
) -> TriadCoefficients:
    chosen = np.eye(12) * 1e-6 if covariance is None else np.array(covariance)
    return TriadCoefficients("angular_rate", np.array(matrix), np.array(bias), chosen, 0.0, 3)


@given(near_identity, arrays.arrays(np.float64, 3, elements=small), vectors)
def test_compensation_inverts_the_forward_model(
    matrix: np.ndarray, bias: np.ndarray, true: np.ndarray
) -> None:
    triad = coefficients(matrix, bias)
    np.testing.assert_allclose(triad.compensate(triad.predict(true)), true, atol=1e-10)
    np.testing.assert_allclose(triad.compensate(triad.predict(true[0])), true[0], atol=1e-10)


@given(near_identity, st.integers(0, 2**32 - 1))
def test_uncertainty_of_the_inverse_follows_its_derivative(matrix: np.ndarray, seed: int) -> None:
    """First-order propagation against finite differences of inv(M) along the covariance's own axes."""
    root = np.random.default_rng(seed).normal(size=(12, 12)) * 1e-4
    triad = coefficients(matrix, covariance=root @ root.T)
    step = 1e-4
    moved = np.empty((12, 12))
    for column in range(12):
        change = step * root[:, column]
        plus = np.linalg.inv(matrix + change[:9].reshape(3, 3))
        minus = np.linalg.inv(matrix - change[:9].reshape(3, 3))
        moved[:9, column] = ((plus - minus) / (2 * step)).ravel()
        moved[9:, column] = root[9:, column]
    np.testing.assert_allclose(triad.compensation_covariance(), moved @ moved.T, rtol=1e-5, atol=1e-14)


def test_derived_terms_have_their_hand_computed_values() -> None:
    covariance = np.zeros((12, 12))
    covariance[0, 0], covariance[1, 1], covariance[0, 1] = 4e-6, 9e-6, 3e-6
    covariance[1, 0] = covariance[0, 1]
    triad = coefficients([[1.02, 0.0102, 0], [0, 0.99, 0], [0, 0, 1]], covariance=covariance)
    assert PARAMETER_NAMES[:2] == ("m_xx", "m_xy")
    np.testing.assert_allclose(triad.scale_factor_error(), [0.02, -0.01, 0.0], atol=1e-15)
    assert triad.cross_coupling()[0, 1] == pytest.approx(0.01)
    expected = np.sqrt(9e-6 / 1.02**2 + 4e-6 * 0.01**2 / 1.02**2 - 2 * 0.01 / 1.02**2 * 3e-6)
    assert triad.cross_coupling_standard_uncertainty()[0, 1] == pytest.approx(expected)
    assert triad.nonorthogonality_rad()[0] == pytest.approx(np.arctan(0.01))
    np.testing.assert_allclose(triad.scale_factor_standard_uncertainty(), [2e-3, 0, 0])


def test_a_rotated_mounting_is_no_nonorthogonality() -> None:
    turned = np.array([[np.cos(0.02), np.sin(0.02), 0], [-np.sin(0.02), np.cos(0.02), 0], [0, 0, 1]])
    triad = coefficients(turned)
    assert np.abs(triad.nonorthogonality_rad()).max() < 1e-15
    assert np.abs(triad.cross_coupling()).max() > 0.019


def test_a_common_error_of_the_inputs_moves_the_matrix_as_one() -> None:
    triad = coefficients(np.diag([1.0, 2.0, 0.5]), covariance=np.zeros((12, 12))).with_input_uncertainty(1e-3)
    np.testing.assert_allclose(np.diag(triad.matrix_standard_uncertainty()), [1e-3, 2e-3, 5e-4])
    assert triad.covariance[0, 4] == pytest.approx(2e-6)  # fully correlated
    assert np.abs(triad.bias_standard_uncertainty()).max() == 0.0


@pytest.mark.parametrize(
    ("matrix", "bias", "covariance", "words"),
    [
        (np.eye(2), (0, 0, 0), None, "shape"),
        (np.eye(3), (0, np.nan, 0), None, "finite"),
        (np.diag([1, 1, 0.0]), (0, 0, 0), None, "axis is dead"),
        ([[1, 0, 0], [1, 0, 0], [0, 0, 1]], (0, 0, 0), None, "cannot be inverted"),
        (np.eye(3), (0, 0, 0), -np.eye(12), "covariance"),
        (np.eye(3), (0, 0, 0), np.triu(np.ones((12, 12))), "covariance"),
    ],
)
def test_what_cannot_be_true_is_refused(matrix: object, bias: object, covariance: object, words: str) -> None:
    with pytest.raises(CalibrationError, match=words) as refusal:
        coefficients(matrix, bias, covariance)
    assert refusal.value.fault is Fault.DATA
    assert refusal.value.remedy


def test_coefficients_cannot_be_changed_afterwards() -> None:
    source = np.eye(3)
    triad = coefficients(source)
    source[0, 0] = 7.0
    assert triad.matrix[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        triad.matrix[0, 0] = 2.0

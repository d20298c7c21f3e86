"""Paper 1's six positions and turns. The figures were computed independently with numpy from the physics."""

import numpy as np
import pytest

from calibration.algorithms.earth import earth_rotation_body
from calibration.algorithms.linear_triad import fit_linear_triad
from calibration.algorithms.noise_covariance import NoiseHypothesis, Observations
from calibration.algorithms.paper_forms import six_position, turn_pairs

# Non-orthogonal on purpose: a pure rotation hides a transposed inverse.
M_COUNTS = np.array([[1000.0, 8.0, -5.0], [-3.0, 1020.0, 6.0], [4.0, -7.0, 990.0]])
INTEGRALS = {
    "x+": np.array([19030.649739, -161.551949, 150.402599]),
    "x-": np.array([-18668.462104, -48.454614, -0.393848]),
    "y+": np.array([330.805198, 19122.662734, -56.954548]),
    "y-": np.array([29.212303, -19330.431346, 206.939235]),
    "z+": np.array([85.746751, 8.103898, 18737.143241]),
    "z-": np.array([274.242311, -218.090773, -18584.977483]),
}
TURNS, CAPTURE_S = 3, 15.0
FORCE_G = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
N_A = np.array(
    [
        [1.022, -0.017, 0.0315],
        [-0.982, -0.013, 0.0285],
        [0.023, 0.983, 0.0275],
        [0.017, -1.013, 0.0325],
        [0.019, -0.011, 1.031],
        [0.021, -0.019, -0.971],
    ]
)


def test_turn_pairs_give_the_forward_matrix_and_its_bias() -> None:
    matrix, bias = turn_pairs(INTEGRALS, TURNS, CAPTURE_S)
    np.testing.assert_allclose(matrix, M_COUNTS, atol=2e-6)
    np.testing.assert_allclose(bias, [12.000109, -6.999891, 4.999891], atol=1e-6)
    # Eq (1) with K_g = inv(M): the true rate comes back. With the printed, transposed matrix it does not.
    output = np.array([1006.5, -518.2, 309.5])
    compensation = np.linalg.inv(matrix)
    np.testing.assert_allclose(
        compensation @ output - compensation @ bias, [0.999999892, -0.500000108, 0.30000011], atol=1e-8
    )
    transposed = np.linalg.inv(matrix.T)
    wrong = transposed @ (output - bias)
    np.testing.assert_allclose(wrong, [0.991716901, -0.506788483, 0.315655985], atol=1e-7)
    # Printed eq (4) divides by an angle, 8 pi N, instead of 4 T.
    np.testing.assert_allclose(
        bias * 4 * CAPTURE_S / (8 * np.pi * TURNS), [9.549384, -5.570336, 3.978787], atol=1e-6
    )


def test_six_positions_need_the_column_of_ones_and_the_transpose() -> None:
    compensation, nabla = six_position(N_A, FORCE_G)
    np.testing.assert_allclose(
        compensation,
        [
            [0.997996499, -0.002997462, 0.001008977],
            [0.002005967, 1.001987953, -0.004001944],
            [-0.001490489, 0.002506959, 0.998989492],
        ],
        atol=1e-9,
    )
    np.testing.assert_allclose(nabla, [-0.020035161, 0.015109758, -0.029902271], atol=1e-9)
    assert np.abs(N_A @ compensation.T + nabla - FORCE_G).max() < 1e-12
    assert np.abs(N_A @ compensation + nabla - FORCE_G).max() == pytest.approx(0.006636, rel=1e-3)


def test_least_squares_equals_the_closed_forms_for_symmetric_runs() -> None:
    """Turns both ways of equal length, and six positions: the general fit is the paper's, corrected."""
    angles = {"+": 2 * np.pi * TURNS, "-": -2 * np.pi * TURNS}
    inputs = np.array([np.eye(3)["xyz".index(name[0])] * angles[name[1]] for name in INTEGRALS]) / CAPTURE_S
    outputs = np.array(list(INTEGRALS.values())) / CAPTURE_S
    fit = fit_linear_triad("angular_rate", *_white(inputs, outputs, 1.0), "turns")
    matrix, _bias = turn_pairs(INTEGRALS, TURNS, CAPTURE_S)
    np.testing.assert_allclose(fit.coefficients.matrix, matrix, rtol=0, atol=1e-9)
    # The least-squares bias also uses the runs along each axis: the mean of all six.
    np.testing.assert_allclose(fit.coefficients.bias, outputs.mean(axis=0), atol=1e-9)

    fit = fit_linear_triad("acceleration", *_white(FORCE_G, N_A, 1e-6), "six positions")
    compensation, nabla = six_position(N_A, FORCE_G)
    np.testing.assert_allclose(fit.coefficients.compensation, compensation, atol=1e-10)
    np.testing.assert_allclose(-fit.coefficients.bias_input_referred(), nabla, atol=1e-10)
    # Theory for 1 mg on each position's mean: sigma / sqrt(2) for the matrix, sigma / sqrt(6) for the bias.
    np.testing.assert_allclose(fit.coefficients.matrix_standard_uncertainty(), 1e-3 / np.sqrt(2), rtol=1e-9)
    np.testing.assert_allclose(fit.coefficients.bias_standard_uncertainty(), 1e-3 / np.sqrt(6), rtol=1e-9)


def test_earth_rate_leaks_through_the_rest_after_the_turn_unless_it_is_modelled() -> None:
    """Three turns in 5 s about the vertical, then 10 s of rest at 34.2 deg: 8.293 deg/h in a cross axis."""
    time_s = np.linspace(0.0, CAPTURE_S, 30_001)
    angle = np.clip(time_s / 5.0, 0.0, 1.0) * 2 * np.pi * TURNS
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    rows = [[np.cos(angle), np.sin(angle), zero], [-np.sin(angle), np.cos(angle), zero], [zero, zero, one]]
    dcm = np.array(rows).transpose(2, 0, 1)
    rotation = earth_rotation_body(dcm, time_s, np.radians(34.2))
    deg_per_hour = np.degrees(rotation / CAPTURE_S) * 3600
    assert np.hypot(*deg_per_hour[:2]) == pytest.approx(8.293449554708108, rel=1e-4)
    assert deg_per_hour[2] == pytest.approx(-15.041067 * np.sin(np.radians(34.2)), rel=1e-5)
    whole = time_s <= 5.0
    trimmed = earth_rotation_body(dcm[whole], time_s[whole], np.radians(34.2))
    assert np.hypot(*trimmed[:2]) < 1e-3 * np.hypot(*rotation[:2])


def _white(
    inputs: np.ndarray, outputs: np.ndarray, variance: float
) -> tuple[Observations, tuple[NoiseHypothesis, ...]]:
    count = len(inputs)
    observations = Observations(
        inputs,
        outputs,
        np.arange(count, dtype=np.float64),
        np.ones(count),
        np.arange(count),
        tuple(map(str, range(count))),
        np.zeros((count, 3, 3)),
    )
    covariance = np.tile(np.eye(count) * variance, (3, 1, 1))
    return observations, (NoiseHypothesis(covariance, 1.0, "white"),)

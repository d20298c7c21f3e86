"""Paper 2's temperature compensation. The oracle was computed independently from the physics, in g."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calibration.algorithms.coefficients import TriadCoefficients
from calibration.algorithms.temperature_compensation import (
    TemperatureModel,
    ThermalReadings,
    fit_temperature,
    hat_weights,
    ramp_hysteresis,
)
from protocol.errors import CalibrationError

VECTORS = json.loads((Path(__file__).parent / "vectors_temperature.json").read_text(encoding="utf-8"))
G = 9.80665
ROOM_C = 25.0
K, D = np.array(VECTORS["K_room"]), np.array(VECTORS["D_room"])
ROOM = TriadCoefficients("acceleration", K, D * G, np.zeros((12, 12)), 0.0, 0)
NODES = np.arange(-40.0, 75.0, 5.0)
ANGLES = np.arange(8) * np.pi / 4
CIRCLE = np.column_stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(8)])
POSES = np.concatenate([CIRCLE, CIRCLE[:, [2, 0, 1]], CIRCLE[:, [1, 2, 0]]])  # 45 deg steps in three planes


def emulated(inputs_g: np.ndarray, temperature_c, cross_per_c: float = 0.0) -> np.ndarray:
    """The oracle's sensor: outputs in m/s^2 of inputs (m, 3) in g at temperatures (m,)."""
    t = (np.asarray(temperature_c, dtype=float) - ROOM_C)[..., None]
    sensed = inputs_g @ K.T + cross_per_c * t * inputs_g[:, [1, 2, 0]]
    gain = 1 + np.array([2e-4, -1.5e-4, 1e-4]) * t
    bias = D + np.array([3e-4, -2e-4, 4e-4]) * t + np.array([2e-6, 1e-6, -3e-6]) * t**2
    return G * (gain * sensed + bias + np.array([1e-3, -8e-4, 5e-4]) * t / 45 * (inputs_g @ K.T) ** 2)


def run(
    poses: np.ndarray,
    temperatures_c: np.ndarray,
    generator: np.random.Generator | None = None,
    noise: float = 0.0,
    ramp: int = 0,
    extra: float = 0.0,
) -> ThermalReadings:
    """Every pose at every temperature; `extra` m/s^2 of bias, in the middle of the range."""
    inputs = np.tile(poses, (len(temperatures_c), 1))
    temperature = np.repeat(temperatures_c, len(poses))
    hump = extra * np.exp(-(((temperature - 45.0) / 10.0) ** 2))
    output = emulated(inputs, temperature) + hump[:, None] * np.array([1.0, 0.0, 0.0])
    if generator is not None:
        output = output + generator.normal(0.0, noise, output.shape)
    room = emulated(inputs, np.full(len(inputs), ROOM_C))
    return ThermalReadings(output, room, temperature, np.full(len(inputs), ramp))


@pytest.fixture(scope="module")
def fitted() -> TemperatureModel:
    return fit_temperature(run(POSES, NODES), ROOM, ROOM_C)


def test_every_node_of_the_oracle(fitted: TemperatureModel) -> None:
    np.testing.assert_array_equal(fitted.node_c, NODES)
    in_g = fitted.coefficients * np.array([G, 1.0, 1.0 / G])
    for place, node in enumerate(NODES):
        np.testing.assert_allclose(in_g[place], VECTORS["coef_at_nodes"][f"{node:.0f}"], atol=6e-10)
    np.testing.assert_allclose(in_g[-1], VECTORS["coef_abc_fit_on_N"], atol=6e-10)
    assert (in_g[NODES == ROOM_C] == 0.0).all()


def test_the_oracles_reading_is_compensated(fitted: TemperatureModel) -> None:
    output = emulated(np.array([VECTORS["test_E"]]), [VECTORS["T"]])
    np.testing.assert_allclose(output[0] / G, VECTORS["test_N"], atol=6e-10)
    found = fitted.compensate(output, np.array([VECTORS["T"]]))
    np.testing.assert_allclose(found.input_si[0] / G, VECTORS["E_out_fit_on_N"], atol=6e-10)
    error = np.abs(found.input_si[0] / G - VECTORS["test_E"]).max()
    assert error == pytest.approx(VECTORS["err_fit_on_N_g"], rel=1e-3)
    uncompensated = np.abs(ROOM.compensate(output)[0] / G - VECTORS["test_E"]).max()
    assert uncompensated == pytest.approx(VECTORS["err_no_comp_g"], rel=1e-6)
    # Fitted on the true input but evaluated on the output, the same polynomial errs a thousand times more.
    hot = run(POSES, np.array([ROOM_C, VECTORS["T"]]))
    at_hot = hot.temperature_c == VECTORS["T"]
    swapped = []
    for axis in range(3):
        true = POSES[:, axis]
        design = np.column_stack([true**2, true, np.ones(24)])
        sigma = (hot.output - hot.room_output)[at_hot, axis] / G
        swapped.append(np.linalg.lstsq(design, sigma, rcond=None)[0])
    n = output[0] / G
    wrong = np.linalg.solve(K, n - [c @ [x**2, x, 1.0] for c, x in zip(swapped, n, strict=True)] - D)
    expected = VECTORS["err_if_coef_fitted_on_E_but_evaluated_on_N_g"]
    assert np.abs(wrong - VECTORS["test_E"]).max() == pytest.approx(expected, rel=1e-4)


def test_interpolated_nodes_beat_the_nearest_segment(fitted: TemperatureModel) -> None:
    middles = 0.5 * (NODES[:-1] + NODES[1:])
    temperature = np.concatenate([np.linspace(-40.0, 70.0, 1101), middles - 1e-7, middles + 1e-7])
    inputs = np.tile(VECTORS["test_E"], (len(temperature), 1))
    output = emulated(inputs, temperature)
    errors = {}
    for lookup in ("interpolated", "nearest_node"):
        back = ROOM.compensate(output - fitted.sigma(output, temperature, lookup))
        errors[lookup] = np.abs(back / G - inputs).max()
    assert errors["interpolated"] == pytest.approx(VECTORS["max_err_g_interpolated_5C"], rel=1e-3)
    assert errors["nearest_node"] == pytest.approx(VECTORS["max_err_g_nearest_5C_segment"], rel=1e-3)


def test_a_remounted_six_position_test_is_worse() -> None:
    """Paper 2's comparison: mounted anew at each temperature, 30 mg; with the frozen matrix, 5 mg."""
    generator = np.random.default_rng(12)
    six = np.concatenate([np.eye(3), -np.eye(3)])
    tests = generator.normal(size=(50, 3))
    tests /= np.linalg.norm(tests, axis=1, keepdims=True)
    remounted, rows = [], []
    for node in NODES:
        tilt = generator.normal(0.0, np.radians(0.7), 3)
        turn = Rotation.from_rotvec(tilt).as_matrix()
        at_node, noise = np.full(6, node), generator.normal(0.0, 1e-3, (6, 3))
        seen = emulated(six @ turn, at_node) + noise * G
        solution = np.linalg.lstsq(np.column_stack([seen, np.ones(6)]), six * G, rcond=None)[0]
        outputs = emulated(tests, np.full(50, node))
        back = np.column_stack([outputs, np.ones(50)]) @ solution
        remounted.append(np.abs(back / G - tests).max())
        mounted = POSES @ turn
        noise = generator.normal(0.0, 1e-3, (len(POSES), 3))
        hot, room = emulated(mounted, np.full(24, node)), emulated(mounted, np.full(24, ROOM_C))
        rows.append((hot + noise * G, room, np.full(24, node), np.zeros(24, dtype=int)))
    readings = ThermalReadings(*(np.concatenate(column) for column in zip(*rows, strict=True)))
    frozen = fit_temperature(readings, ROOM, ROOM_C)
    outputs = np.concatenate([emulated(tests, np.full(50, node)) for node in NODES])
    back = frozen.compensate(outputs, np.repeat(NODES, 50)).input_si
    error = np.abs(back / G - np.tile(tests, (len(NODES), 1))).max()
    assert max(remounted) > 0.02
    assert error < 0.005


def test_a_cross_coupling_that_moves_stays_in_the_residue(fitted: TemperatureModel) -> None:
    inputs = np.array([[0.0, 1.0, 0.0]])
    moved = emulated(inputs, [70.0], cross_per_c=2e-5) - emulated(inputs, [70.0])
    assert np.abs(moved / G).max() == pytest.approx(9e-4, rel=0.02)
    readings = run(POSES, NODES)
    output = emulated(np.tile(POSES, (len(NODES), 1)), readings.temperature_c, cross_per_c=2e-5)
    blind = fit_temperature(
        ThermalReadings(output, readings.room_output, readings.temperature_c, readings.ramp), ROOM, ROOM_C
    )
    assert (blind.residual_rms_si > 10 * fitted.residual_rms_si).all()


def test_beyond_the_calibrated_range_is_said(fitted: TemperatureModel) -> None:
    assert fitted.calibrated_range_c == (-40.0, 70.0)
    output = np.tile(emulated(np.array([[0.1, 0.2, 0.9]]), [70.0]), (3, 1))
    found = fitted.compensate(output, np.array([70.0, 80.0, -55.0]))
    np.testing.assert_array_equal(found.beyond_calibrated_range, [False, True, True])
    np.testing.assert_array_equal(found.input_si[0], found.input_si[1])  # held, not continued
    assert np.isfinite(found.standard_uncertainty_si[0]).all()
    assert np.isnan(found.standard_uncertainty_si[1:]).all()


def test_soaks_between_the_nodes_and_a_linear_order_do_equally(fitted: TemperatureModel) -> None:
    soaks = np.linspace(-40.0, 70.0, 61)
    between = fit_temperature(run(POSES, soaks), ROOM, ROOM_C)
    np.testing.assert_allclose(between.coefficients[:, :, 2], fitted.coefficients[:, :, 2], atol=4e-4 * G)
    two = fit_temperature(run(POSES, NODES), ROOM, ROOM_C, order="linear")
    assert (two.coefficients[:, :, 0] == 0).all()
    assert (two.residual_rms_si > 3 * fitted.residual_rms_si).all()
    extended = fit_temperature(run(POSES, np.append(NODES, 73.0)), ROOM, ROOM_C)
    assert extended.left_out == len(POSES)
    assert extended.calibrated_range_c == (-40.0, 70.0)


def test_hysteresis_is_found_where_it_is() -> None:
    generator = np.random.default_rng(3)
    up = run(POSES, NODES, generator, 1e-4, ramp=1, extra=0.02)
    down = run(POSES, NODES, generator, 1e-4, ramp=-1)
    both = ThermalReadings(
        *(np.concatenate([getattr(up, name), getattr(down, name)]) for name in vars(up)),
    )
    x, y, _ = ramp_hysteresis(both, ROOM, ROOM_C)
    assert x.difference_si == pytest.approx(0.02, abs=4 * x.standard_uncertainty_si)
    assert x.temperature_c == 45.0
    assert abs(y.difference_si) < 5 * y.standard_uncertainty_si
    assert 0 < y.standard_uncertainty_si < 2e-4
    with pytest.raises(CalibrationError, match="while cooling"):
        ramp_hysteresis(up, ROOM, ROOM_C)


def test_stated_uncertainties_cover_the_truth_at_their_rate() -> None:
    """200 units: sigma at each node, at three inputs, against the noise-free fit."""
    nodes = np.array([15.0, 20.0, 25.0, 30.0, 35.0])
    truth = fit_temperature(run(POSES, nodes), ROOM, ROOM_C)
    output = emulated(np.array([[0.6, -0.3, 0.74], [-0.9, 0.1, 0.4], [0.2, 0.9, -0.3]]), np.full(3, 33.0))
    at = np.array([16.0, 33.0, 35.0])
    pulls, returned = [], []
    for seed in range(200):
        found = fit_temperature(run(POSES, nodes, np.random.default_rng(seed), 2e-3), ROOM, ROOM_C)
        pulls.append(found.sigma(output, at) - truth.sigma(output, at))
        pulls[-1] /= found.sigma_standard_uncertainty(output, at)
        back = found.compensate(output, at)
        returned.append(
            (back.input_si - truth.compensate(output, at).input_si) / back.standard_uncertainty_si
        )
    for values in (np.abs(pulls), np.abs(returned)):
        assert (values < 1.0).mean() == pytest.approx(0.683, abs=0.05)
        assert (values < 1.96).mean() == pytest.approx(0.95, abs=0.025)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-60, 90), min_size=1, max_size=20))
def test_weights_are_a_partition(temperatures: list[float]) -> None:
    weights = hat_weights(NODES, np.array(temperatures))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights @ NODES, np.clip(temperatures, -40.0, 70.0), atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.floats(0.1, 20.0))
def test_a_change_of_units_changes_the_coefficients_only(scale: float) -> None:
    nodes = np.array([20.0, 25.0, 30.0])
    base = run(POSES, nodes)
    scaled = ThermalReadings(base.output * scale, base.room_output * scale, base.temperature_c, base.ramp)
    one, two = fit_temperature(base, ROOM, ROOM_C), fit_temperature(scaled, ROOM, ROOM_C)
    np.testing.assert_allclose(
        two.sigma(scaled.output, base.temperature_c),
        scale * one.sigma(base.output, base.temperature_c),
        atol=1e-9 * scale,
    )


def test_missing_excitation_is_named() -> None:
    two_sides = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]] * 4) / np.sqrt(3)
    with pytest.raises(CalibrationError, match=r"axis x do not tell square from constant"):
        fit_temperature(run(two_sides, NODES), ROOM, ROOM_C)
    fit_temperature(run(two_sides, NODES), ROOM, ROOM_C, order="linear")
    with pytest.raises(CalibrationError, match="At 45 deg C"):
        fit_temperature(run(POSES, NODES[NODES != 45.0]), ROOM, ROOM_C)
    with pytest.raises(CalibrationError, match="Room temperature is not within"):
        fit_temperature(run(POSES, np.array([40.0, 45.0])), ROOM, ROOM_C)
    readings = run(POSES, NODES)
    holed = readings.output.copy()
    holed[17, 1] = np.nan
    with pytest.raises(CalibrationError, match="output of reading 17 is missing"):
        ThermalReadings(holed, readings.room_output, readings.temperature_c, readings.ramp)
    with pytest.raises(CalibrationError, match="do not carry"):
        fit_temperature(run(POSES[:2], NODES), ROOM, ROOM_C)

"""Warm-ups of paper 2's cooling schemes, integrated here by matrix exponential, and fitted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from calibration.algorithms.thermal_network import (
    AIR,
    AMBIENT,
    MEASURED_SCHEMES,
    PASTE,
    POTTED,
    SIMULATED_SCHEMES,
    ThermalNetwork,
    WarmUp,
    fit_thermal_network,
    which_scheme,
)
from protocol.errors import CalibrationError

NODES = ("processor", "sensors", "housing")
EDGES = (("processor", "sensors"), ("processor", "housing"), ("sensors", "housing"), ("housing", AMBIENT))
CAPACITY = np.array([12.0, 18.0, 60.0])
CONDUCTANCE = {
    AIR: np.array([0.10, 0.10, 0.06, 0.20]),
    PASTE: np.array([0.10, 0.45, 0.06, 0.20]),
    POTTED: np.array([0.60, 0.90, 0.80, 0.45]),
}
POWER = np.array([1.3, 0.2, 0.0])


def laplacian(conductance: np.ndarray) -> np.ndarray:
    """By hand, edge by edge."""
    a, b, c, d = conductance
    return np.array([[a + b, -a, -b], [-a, a + c, -c], [-b, -c, b + c + d]])


def rises(conductance: np.ndarray, time_s: np.ndarray, power: np.ndarray) -> np.ndarray:
    """From ambient, stepping an augmented matrix exponential over an even time grid."""
    system = np.zeros((4, 4))
    system[:3, :3] = -laplacian(conductance) / CAPACITY[:, None]
    system[:3, 3] = power / CAPACITY
    step = expm(system * (time_s[1] - time_s[0]))
    state = np.array([0.0, 0.0, 0.0, 1.0])
    out = []
    for _ in time_s:
        out.append(state[:3])
        state = step @ state
    return np.array(out)


def warm_up(
    scheme: str, generator=None, noise: float = 0.0, power: np.ndarray = POWER, end_s=1800.0
) -> WarmUp:
    time_s = np.linspace(0.0, end_s, 91)
    clean = 70.0 + rises(CONDUCTANCE[scheme], time_s, power)
    return WarmUp(
        time_s, clean if generator is None else clean + generator.normal(0, noise, clean.shape), power, 70.0
    )


@pytest.mark.parametrize("scheme", [AIR, PASTE, POTTED])
def test_a_clean_warm_up_gives_the_network_back(scheme: str) -> None:
    found = fit_thermal_network([warm_up(scheme)], NODES, EDGES)
    np.testing.assert_allclose(found.capacity_j_k, CAPACITY, rtol=1e-4)
    np.testing.assert_allclose(found.conductance_w_k, CONDUCTANCE[scheme], rtol=1e-4)
    expected = np.linalg.solve(laplacian(CONDUCTANCE[scheme]), POWER)
    rise, _ = found.steady_rise_k(POWER)
    np.testing.assert_allclose(rise, expected, rtol=1e-5)
    settling = found.settling_s(POWER)
    long = np.linspace(0.0, 8000.0, 8001)
    hottest = rises(CONDUCTANCE[scheme], long, POWER)[:, expected.argmax()]
    assert settling == pytest.approx(long[np.argmax(hottest >= 0.95 * expected.max())], abs=2.0)


def test_the_network_tells_the_cooling_scheme() -> None:
    generator = np.random.default_rng(2)
    settled = []
    for scheme in (AIR, PASTE, POTTED):
        one, other = (warm_up(scheme, generator, 0.05, power) for power in (POWER, POWER[[1, 0, 2]]))
        found = fit_thermal_network([one, other], NODES, EDGES)
        rise, u = found.steady_rise_k(POWER)
        verdict = which_scheme(float(rise.max()), float(u[rise.argmax()]), SIMULATED_SCHEMES)
        assert verdict.scheme.name == scheme
        assert verdict.clear
        settled.append(found.settling_s(POWER))
    assert min(settled) == settled[2]


@pytest.mark.parametrize(
    ("rise", "u", "schemes", "name", "clear"),
    [
        (16.0, 1.0, SIMULATED_SCHEMES, AIR, True),
        (20.0, 1.0, MEASURED_SCHEMES, AIR, True),
        (8.0, 1.0, MEASURED_SCHEMES, PASTE, True),
        (4.0, 0.5, SIMULATED_SCHEMES, POTTED, True),
        (11.0, 0.5, SIMULATED_SCHEMES, PASTE, False),
        (6.0, 0.5, SIMULATED_SCHEMES, PASTE, False),
    ],
)
def test_a_rise_near_a_boundary_is_not_clear(rise, u, schemes, name, clear) -> None:
    verdict = which_scheme(rise, u, schemes)
    assert (verdict.scheme.name, verdict.clear) == (name, clear)
    assert verdict.next_scheme is not verdict.scheme


def test_two_powers_and_a_node_without_a_sensor() -> None:
    first, second = warm_up(AIR), warm_up(AIR, power=np.array([0.2, 1.0, 0.3]))
    for record in (first, second):
        record.temperature_c[:, 2] = np.nan
    found = fit_thermal_network([first, second], NODES, EDGES)
    np.testing.assert_allclose(found.conductance_w_k, CONDUCTANCE[AIR], rtol=1e-3)
    assert found.capacity_standard_uncertainty.shape == (3,)
    assert (found.conductance_standard_uncertainty < 0.01 * found.conductance_w_k).all()


@given(st.lists(st.floats(0.01, 5.0), min_size=4, max_size=4), st.floats(0.0, 5000.0))
def test_a_rise_never_passes_its_end(conductance: list[float], time_s: float) -> None:
    network = ThermalNetwork(NODES, EDGES, CAPACITY, np.array(conductance), np.zeros((7, 7)), 0.0, 10)
    steady, _ = network.steady_rise_k(POWER)
    rise = network.rise_k(np.array([0.0, time_s]), POWER, np.zeros(3))
    np.testing.assert_allclose(rise[0], 0.0, atol=1e-9 * steady.max())
    assert (rise[1] <= steady * (1 + 1e-9) + 1e-9).all()
    # All heat leaves through the housing.
    assert steady[2] == pytest.approx(POWER.sum() / conductance[3], rel=1e-9)


def test_what_cannot_be_told_is_named() -> None:
    clean = warm_up(AIR)
    with pytest.raises(CalibrationError, match="No warm-up has a known power"):
        fit_thermal_network([WarmUp(clean.time_s, clean.temperature_c, np.zeros(3), 70.0)], NODES, EDGES)
    with pytest.raises(CalibrationError, match="'sensors' has no path"):
        fit_thermal_network([clean], NODES, (("processor", "housing"), ("housing", AMBIENT)))
    with pytest.raises(CalibrationError, match="'board' of the edge"):
        fit_thermal_network([clean], NODES, (*EDGES, ("board", AMBIENT)))
    with pytest.raises(CalibrationError, match="do not tell the conductance"):
        fit_thermal_network([clean], NODES, (*EDGES, ("housing", AMBIENT)))
    with pytest.raises(CalibrationError, match="does not run forward"):
        fit_thermal_network([WarmUp(clean.time_s[::-1], clean.temperature_c, POWER, 70.0)], NODES, EDGES)
    with pytest.raises(CalibrationError, match="fewer temperatures"):
        fit_thermal_network([WarmUp(clean.time_s[:3], clean.temperature_c[:3], POWER, 70.0)], NODES, EDGES)

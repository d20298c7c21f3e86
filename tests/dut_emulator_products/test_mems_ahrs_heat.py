"""The thermal design of the MEMS attitude unit: paper 2's figures, by an integrator of the test's own."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dut_emulator.products.mems_ahrs import cooling
from dut_emulator.products.mems_ahrs.cooling import AS_MEASURED, AS_SIMULATED, Cooling
from dut_emulator.products.mems_ahrs.product import MemsAhrs
from dut_emulator.products.mems_ahrs.thermal_network import AMBIENT, ThermalNetwork, ThermalState
from dut_emulator.recording.recorder import recorded
from protocol.errors import TestloomError

AMBIENT_C = 70.0
FIGURES = [  # paper 2, 2.1.1 (simulated) and 2.1.2 (measured): rise of the hottest point, K
    (AS_SIMULATED, Cooling.AIR, 16.0),
    (AS_SIMULATED, Cooling.PASTE, 8.0),
    (AS_SIMULATED, Cooling.POTTED, 4.0),
    (AS_MEASURED, Cooling.AIR, 20.0),
    (AS_MEASURED, Cooling.PASTE, 8.0),
]


def integrated(network: ThermalNetwork, power_w: np.ndarray, until_s: float, step_s: float) -> np.ndarray:
    """Rises above a constant ambient by classical Runge-Kutta: (n + 1, m)."""
    nodes = network.nodes
    capacity = np.array([network.capacity_j_k[node] for node in nodes])
    flow = np.zeros((len(nodes), len(nodes)))  # W into a node (row) for each K of rise of a node (column)
    for (one, other), conductance in network.conductance_w_k.items():
        i = nodes.index(one)
        flow[i, i] -= conductance
        if other != AMBIENT:
            j = nodes.index(other)
            flow[i, j] += conductance
            flow[j, j] -= conductance
            flow[j, i] += conductance

    def slope(rise: np.ndarray) -> np.ndarray:
        return (flow @ rise + power_w) / capacity

    rises = [np.zeros(len(nodes))]
    for _ in range(round(until_s / step_s)):
        now = rises[-1]
        k1 = slope(now)
        k2 = slope(now + step_s / 2 * k1)
        k3 = slope(now + step_s / 2 * k2)
        k4 = slope(now + step_s * k3)
        rises.append(now + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(rises)


@cache
def heated(parameters: cooling.HousingSet, scheme: Cooling, until_s: float) -> np.ndarray:
    """Rises of processor and power chips' hotter one, once a second."""
    step_s = 0.5
    power = np.array([0.26, 0.4859, 0.0, 0.0591, 0.0568, 0.0, 0.0])  # W: 0.862 W, as the parts' table says
    rises = integrated(cooling.housing(scheme, parameters), power, until_s, step_s)[::2]
    return rises[:, :2].max(axis=1)


def warmed_up_c(scheme: Cooling, parameters: cooling.HousingSet, until_s: int = 1500) -> np.ndarray:
    """(n, 7) a warm-up at full load as the product computes it, once a second from 1 s on."""
    state = ThermalState(cooling.housing(scheme, parameters), AMBIENT_C)
    return state.advance(AMBIENT_C + np.zeros(until_s), 1.0, cooling.heat_w(5.0, 200.0))


@pytest.mark.parametrize(("parameters", "scheme", "rise_k"), FIGURES)
def test_the_hottest_point_rises_as_in_the_paper(
    parameters: cooling.HousingSet, scheme: Cooling, rise_k: float
) -> None:
    rises = heated(parameters, scheme, 2500.0)
    assert rises[-1] == pytest.approx(rise_k, rel=0.1)
    infrared_c = cooling.infrared_points_c(warmed_up_c(scheme, parameters, 2500))
    np.testing.assert_allclose(infrared_c[:, 0] - AMBIENT_C, rises[1:], atol=0.01)
    assert np.argmax(infrared_c, axis=1).max() == 0, "test point 1 is the hottest"


@pytest.mark.parametrize(("scheme", "settled_s"), [(Cooling.AIR, 800.0), (Cooling.PASTE, 300.0)])
def test_the_measured_unit_settles_when_the_paper_says(scheme: Cooling, settled_s: float) -> None:
    rises = heated(AS_MEASURED, scheme, 2500.0)
    ninety_five_percent_s = float(np.argmax(rises > 0.95 * rises[-1]))
    assert ninety_five_percent_s == pytest.approx(settled_s, rel=0.1)
    if scheme is Cooling.AIR:
        assert rises[800] + AMBIENT_C == pytest.approx(90.0, abs=0.5)
        assert rises[800] > 20.0
    else:
        assert rises.max() <= 8.0


def too_hot(temperatures_c: np.ndarray) -> set[str]:
    highest_c = zip(cooling.NODES, temperatures_c.max(axis=0), strict=True)
    return {node for node, highest in highest_c if highest > cooling.RATED_MAXIMUM_C.get(node, np.inf)}


def test_what_the_paper_says_of_the_components() -> None:
    assert too_hot(warmed_up_c(Cooling.AIR, AS_SIMULATED)) >= {"power_chips", "gyro_area"}
    for parameters in (AS_SIMULATED, AS_MEASURED):
        assert too_hot(warmed_up_c(Cooling.PASTE, parameters)) == set()
    with pytest.raises(TestloomError, match="Scheme 3"):
        cooling.housing(Cooling.POTTED, AS_MEASURED)


def test_masses_and_heat_add_up() -> None:
    network = cooling.housing(Cooling.PASTE, AS_MEASURED)
    metal_and_boards = sum(network.capacity_j_k[node] for node in cooling.NODES if node != "filling")
    assert 0.095 * 700 < metal_and_boards < 0.095 * 1100, "95 g of aluminium, FR4 and silicon"
    for volts in (4.6, 5.0, 5.5):
        for rate_hz in (0.0, 50.0, 200.0):
            drawn_w = volts * cooling.supply_current_a(rate_hz)
            assert cooling.heat_w(volts, rate_hz).sum() == pytest.approx(drawn_w, rel=1e-12)
    rise = np.linalg.solve(network.laplacian_w_k, cooling.heat_w(5.0, 200.0))[cooling.CASE]
    assert rise == pytest.approx(5.0 * cooling.supply_current_a(200.0) / 3.57), "all heat leaves by the case"


def test_a_ramp_of_ambient_is_followed_exactly() -> None:
    """One node of 50 J/K behind 0.5 W/K: τ = 100 s; T = r t − r τ (1 − e^(−t/τ)) + P/G (1 − e^(−t/τ))."""
    network = ThermalNetwork({"body": 50.0}, {("body", AMBIENT): 0.5})
    times = np.arange(1, 601, dtype=np.float64) * 0.7
    state = ThermalState(network, 20.0)
    found = state.advance(20.0 + 0.05 * times, 0.7, np.array([2.0]))[:, 0]
    rest = 1.0 - np.exp(-times / 100.0)
    np.testing.assert_allclose(found, 20.0 + 0.05 * (times - 100.0 * rest) + 4.0 * rest, rtol=1e-13)


@given(st.lists(st.integers(1, 1499), unique=True, max_size=4).map(sorted))
def test_cutting_changes_nothing(cuts: list[int]) -> None:
    network = cooling.housing(Cooling.PASTE, AS_MEASURED)
    ambient = 25.0 + 20.0 * np.sin(np.arange(1500) / 200.0)
    power = cooling.heat_w(5.0, 100.0)
    whole = ThermalState(network, 25.0).advance(ambient, 0.01, power)
    state = ThermalState(network, 25.0)
    pieces = [state.advance(part, 0.01, power) for part in np.split(ambient, cuts)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


def test_a_unit_without_paste_is_recorded_as_warm_as_it_gets() -> None:
    """The warm-ups of paper 2, figure 7, at room temperature, by the integrator of this test."""
    power = np.array([0.26, 0.4859, 0.0, 0.0591, 0.0568, 0.0, 0.0])
    for scheme in (Cooling.AIR, Cooling.PASTE):
        rises = integrated(cooling.housing(scheme, AS_MEASURED), power, 900.0, 0.5)[::2]
        recording = recorded(MemsAhrs(scheme=scheme), "static", values={"duration_s": 900.0})
        dut = recording.streams["dut"].columns
        once_a_second = dut["temp_gyro"][: 900 * 200].reshape(-1, 200).mean(axis=1)
        between = (rises[:-1] + rises[1:])[:, cooling.GYRO_AREA] / 2
        np.testing.assert_allclose(once_a_second - 23.0, between, atol=0.05)

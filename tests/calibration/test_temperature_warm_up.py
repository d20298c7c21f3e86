"""Warm-ups by the route of recordings: network, covariance, scheme, refusals."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from calibration.algorithms.thermal_network import AIR, PASTE
from calibration.evaluations.by_profile import evaluate_by_profile
from calibration.evaluations.method_evaluation import MethodEvaluation
from cli.main import main
from dut_emulator.products.mems_ahrs import cooling
from dut_emulator.products.mems_ahrs.thermal_network import ThermalState
from protocol.errors import CalibrationError
from protocol.folder_form import write_folder
from protocol.mems_ahrs import SUPPLY_NOMINAL_V
from protocol.recordings import Recording, Stream
from tests.calibration.test_thermal_network import (
    CAPACITY,
    CONDUCTANCE,
    EDGES,
    NODES,
    POWER,
    laplacian,
    warm_up,
)


def recording(scheme: str = PASTE, seed: int = 1, noise_c: float = 0.03) -> Recording:
    measured = warm_up(scheme, np.random.default_rng(seed), noise_c)
    times = measured.time_s
    columns = {"t": times} | {f"temp_{node}": measured.temperature_c[:, k] for k, node in enumerate(NODES)}
    units = {"t": "s"} | {f"temp_{node}": "degC" for node in NODES}
    air = {"t": times, "temp": np.full(len(times), 70.0)}
    thermal = {"heat_w": dict(zip(NODES, POWER.tolist(), strict=True)), "edges": [list(one) for one in EDGES]}
    return Recording(
        "warm-up",
        {"serial": "U-1", "product": "mems_ahrs"},
        {"profile": "warm_up"},
        {
            "thermocouples": Stream("thermocouples", "stand", "t", units, columns),
            "stand": Stream("stand", "stand", "t", {"t": "s", "temp": "degC"}, air),
        },
        believed={"thermal": thermal},
    )


def test_the_route_gives_network_and_scheme() -> None:
    for scheme in (PASTE, AIR):
        found = evaluate_by_profile([recording(scheme)])
        (result,) = found.results
        values = {one.name: one for one in result.content.quantities}
        truth = dict(zip((f"heat_capacity_of_{node}" for node in NODES), CAPACITY, strict=True))
        truth |= {
            f"thermal_conductance_{one}_to_{other}": value
            for (one, other), value in zip(EDGES, CONDUCTANCE[scheme], strict=True)
        }
        rises = np.linalg.solve(laplacian(CONDUCTANCE[scheme]), POWER)
        truth |= {f"steady_rise_of_{node}": rise for node, rise in zip(NODES, rises, strict=True)}
        for name, value in truth.items():
            one = values[name]
            assert abs(one.value - value) < 4.0 * (one.standard_uncertainty or 0.0), name
        (block,) = result.content.covariance
        assert set(block.parameters) == set(values)
        # All heat leaves through the housing: its rise is P / G, so that both err together.
        rise, outlet = (
            block.parameters.index(n)
            for n in ("steady_rise_of_housing", "thermal_conductance_housing_to_ambient")
        )
        matrix = np.array(block.matrix)
        correlation = matrix[rise, outlet] / np.sqrt(matrix[rise, rise] * matrix[outlet, outlet])
        assert correlation == pytest.approx(-1.0, abs=1e-3)
        assert any("hottest node" in sentence for sentence in found.assumptions)


def test_by_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_folder(recording(), tmp_path / "warm-up")
    assert (
        main(["calibrate", str(tmp_path / "warm-up"), "--record", str(tmp_path / "records"), "--json"]) == 0
    )
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert result["method"] == "thermal_network"
    assert len(result["records"]) == 1


def _refused(changed: Recording, match: str) -> None:
    with pytest.raises(CalibrationError, match=match):
        evaluate_by_profile([changed])


def test_what_is_missing_is_named() -> None:
    whole = recording()
    _refused(dataclasses.replace(whole, believed={}), "what each node dissipates")
    stand = whole.streams["stand"]
    drifting = dataclasses.replace(
        stand, columns={**stand.columns, "temp": np.linspace(60.0, 70.0, len(stand))}
    )
    _refused(dataclasses.replace(whole, streams={**whole.streams, "stand": drifting}), "air changed by 10")
    _refused(dataclasses.replace(whole, streams={"stand": stand}), "no stream 'thermocouples'")


def emulated_housing(scheme: cooling.Cooling, seed: int) -> tuple[Recording, np.ndarray]:
    """Thermocouples on three of the seven nodes of an emulated unit's housing; their true steady rises."""
    housing, heat = cooling.housing(scheme, cooling.AS_MEASURED), cooling.heat_w(SUPPLY_NOMINAL_V, 200.0)
    step_s, count = 6.0, 240
    seen = [cooling.POWER_CHIPS, cooling.BOARD, cooling.CASE]
    temperature = ThermalState(housing, 70.0).advance(np.full(count, 70.0), step_s, heat)[:, seen]
    temperature = temperature + np.random.default_rng(seed).normal(0.0, 0.05, temperature.shape)
    time_s = step_s * np.arange(1, count + 1)
    chips = heat[cooling.PROCESSOR] + heat[cooling.POWER_CHIPS]
    power = {"chips": chips, "board": heat[cooling.GYRO_AREA] + heat[cooling.ACC_AREA], "case": 0.0}
    edges = [["chips", "board"], ["chips", "case"], ["board", "case"], ["case", "ambient"]]
    columns = {"t": time_s} | {f"temp_{node}": temperature[:, k] for k, node in enumerate(power)}
    units = {name: "s" if name == "t" else "degC" for name in columns}
    whole = recording()
    streams = {
        "thermocouples": Stream("thermocouples", "stand", "t", units, columns),
        "stand": whole.streams["stand"],
    }
    believed = {"thermal": {"heat_w": power, "edges": edges}}
    return (
        dataclasses.replace(whole, streams=streams, believed=believed),
        np.linalg.solve(housing.laplacian_w_k, heat)[seen],
    )


@pytest.mark.parametrize(
    ("scheme", "words", "paper_s"),
    [
        (cooling.Cooling.PASTE, PASTE, 300.0),
        pytest.param(cooling.Cooling.AIR, AIR, 800.0, marks=pytest.mark.slow),
    ],
)
def test_an_emulated_housing_shows_its_scheme(scheme: cooling.Cooling, words: str, paper_s: float) -> None:
    """Three nodes stand for seven: rises and settling time are the housing's, C and G are not."""
    warm, rises = emulated_housing(scheme, 1)
    found = evaluate_by_profile([warm])
    values = {one.name: one for one in found.results[0].content.quantities}
    for node, rise in zip(("chips", "board", "case"), rises, strict=True):
        assert values[f"steady_rise_of_{node}"].value == pytest.approx(rise, abs=0.15)
    assert values["settling_time"].value == pytest.approx(paper_s, rel=0.15)
    assert any(f"'{words}'" in one and " clearly " in one and "measured" in one for one in found.assumptions)


@pytest.mark.slow
def test_two_hundred_warm_ups_are_covered_in_all_figures() -> None:
    rises = np.linalg.solve(laplacian(CONDUCTANCE[PASTE]), POWER)
    truth = np.r_[CAPACITY, CONDUCTANCE[PASTE], rises]
    pulls = []
    for seed in range(200):
        (result,) = _evaluated(seed).results
        figures = result.content.quantities[: len(truth)]
        pulls.append(
            [
                (one.value - t) / (one.standard_uncertainty or 0.0)
                for one, t in zip(figures, truth, strict=True)
            ]
        )
    inside = np.abs(pulls)
    # weighing a memory that white noise has not costs some certainty
    assert 0.633 < (inside < 1.0).mean() < 0.8
    assert 0.925 < (inside < 1.96).mean() < 0.99


def _evaluated(seed: int) -> MethodEvaluation:
    return evaluate_by_profile([recording(seed=seed, noise_c=0.02)])

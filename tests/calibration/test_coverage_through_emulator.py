"""68 and 95 % intervals of rests, staircases and tumbles hold the emulated unit's truth at their rate.

The bias that these methods tell is that of the unit's present power-on: what it drew when it was switched on
(3 deg/h) is part of the truth here, not of the uncertainty. Held against the unit's own bias alone, 95 %
intervals of a rest hold 92, 95 and 94 % of 800 units on x, y and z (with it: 95 % and more).
"""

import dataclasses
import itertools

import numpy as np
import pytest

from calibration.evaluations.by_profile import evaluate_by_profile
from dut_emulator.effects.deterministic import Bias
from dut_emulator.products.catalogue import product_named
from dut_emulator.products.gnc_module import inertial_sensors
from dut_emulator.products.gnc_module.population import GYRO_TURN_ON_SI
from dut_emulator.recording.recorder import recorded
from tests.calibration.shaped_noise import check_coverage
from tests.calibration.test_inertial_evaluations import figures

KEPT = {"bias", "scale_factor_error", "misalignment", "white_noise", "bias_instability"}
ORDERS = {
    "static": {"values": {"duration_s": 190.0}, "rate_hz": 10.0},
    "rate_staircase": {"values": {"steps": 2.0, "dwell_s": 1.0}, "rate_hz": 50.0},
    "tumble": {"values": {"rate_deg_s": 20.0}, "rate_hz": 50.0},
}


@pytest.fixture
def powered_gyros(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Gyro bias of each power-on of the emulator, (3,) rad/s, the latest last."""
    seen: list[np.ndarray] = []
    with_turn_on = inertial_sensors.with_turn_on

    def noted(effects, sensor, deviation_si, turn_on):
        powered = with_turn_on(effects, sensor, deviation_si, turn_on)
        if sensor == "gyro":
            (bias,) = [one for one in powered if isinstance(one, Bias)]
            seen.append(np.array(bias.bias_si))
        return powered

    monkeypatch.setattr(inertial_sensors, "with_turn_on", noted)
    return seen


@pytest.mark.timeout(900)
@pytest.mark.parametrize("profile", ORDERS)
@pytest.mark.parametrize("seeds", [4, pytest.param(200, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_of_an_emulated_unit(
    profile: str, seeds: int, powered_gyros: list[np.ndarray]
) -> None:
    """Units without defect and what figures do not model (temperature, quanta), each with its own noise."""
    pulls: list[list[float]] = []
    turned_on: list[np.ndarray] = []
    product = product_named("gnc_module")
    serials = (f"C-{number}" for number in itertools.count() if not product.defects(1, f"C-{number}"))
    for run, serial in enumerate(itertools.islice(serials, seeds), start=1):
        whole = product.twin(1, serial)
        twin = dataclasses.replace(whole, effects=tuple(one for one in whole.effects if one.word in KEPT))
        recording = recorded("gnc_module", profile, twin=twin, run=run, serial=serial, **ORDERS[profile])
        believed = recording.believed["gyro"]
        true = {f"bias_{axis}": value for axis, value in zip("xyz", powered_gyros[-1], strict=True)}
        turned_on.append(powered_gyros[-1] - np.radians(believed["bias"]))
        if profile == "rate_staircase":
            true |= {f"scale_factor_{axis}": believed["matrix"][k][k] for k, axis in enumerate("xyz")}
            true |= {f"scale_factor_asymmetry_{axis}": 0.0 for axis in "xyz"}
        if profile == "tumble":
            true |= {f"g_sensitivity_{row}{column}": 0.0 for row in "xyz" for column in "xyz"}
        told = figures(evaluate_by_profile([recording]))
        pulls.append([(told[name][0] - value) / told[name][1] for name, value in true.items()])
    if seeds < 100:
        assert np.abs(pulls).max() < 4.5
        return
    assert np.std(turned_on) == pytest.approx(GYRO_TURN_ON_SI, rel=0.15)
    # wider than need be: the stated level of the instability is taken as a median over units, though the
    # recorder states the unit's own; the stand's rate is better than is taken
    check_coverage(np.array(pulls), more=0.25)

"""68 and 95 % intervals of rests, staircases and tumbles hold the emulated unit's truth at their rate."""

import dataclasses
import itertools

import numpy as np
import pytest

from calibration.evaluations.by_profile import evaluate_by_profile
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from tests.calibration.shaped_noise import check_coverage
from tests.calibration.test_inertial_evaluations import figures

KEPT = {"bias", "scale_factor_error", "misalignment", "white_noise", "bias_instability"}
ORDERS = {
    "static": {"values": {"duration_s": 190.0}, "rate_hz": 10.0},
    "rate_staircase": {"values": {"steps": 2.0, "dwell_s": 1.0}, "rate_hz": 50.0},
    "tumble": {"values": {"rate_deg_s": 20.0}, "rate_hz": 50.0},
}


@pytest.mark.timeout(900)
@pytest.mark.parametrize("profile", ORDERS)
@pytest.mark.parametrize("seeds", [4, pytest.param(200, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_of_an_emulated_unit(profile: str, seeds: int) -> None:
    """Units without defect and what figures do not model (temperature, quanta), each with its own noise."""
    pulls: list[list[float]] = []
    product = product_named("gnc_module")
    serials = (f"C-{number}" for number in itertools.count() if not product.defects(1, f"C-{number}"))
    for run, serial in enumerate(itertools.islice(serials, seeds), start=1):
        whole = product.twin(1, serial)
        twin = dataclasses.replace(whole, effects=tuple(one for one in whole.effects if one.word in KEPT))
        recording = recorded("gnc_module", profile, twin=twin, run=run, serial=serial, **ORDERS[profile])
        believed = recording.believed["gyro"]
        true = {
            f"bias_{axis}": value for axis, value in zip("xyz", np.radians(believed["bias"]), strict=True)
        }
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
    # the stated level of the instability is an rms over units whose own levels are log-normal: some lie in
    # heavier tails, most in narrower ones; the stand's rate is better than is taken
    check_coverage(np.array(pulls), less=0.02, more=0.25)

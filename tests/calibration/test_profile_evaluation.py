"""Recordings of an emulated module by profile: every figure against the unit's truth."""

import dataclasses

import numpy as np
import pytest

from calibration.profile_evaluation import evaluate_profile
from dut_emulator.recording.recorder import recorded
from protocol.bench_description import Site
from protocol.errors import CalibrationError

VALUES = {
    "static": {"duration_s": 200.0},
    "rate_staircase": {},
    "sweep": {"axis": 1.0},
    "tumble": {},
}


@pytest.mark.parametrize("profile", VALUES)
def test_figures_lie_around_the_truth(profile: str) -> None:
    recording = recorded("gnc_module", profile, values=VALUES[profile], powered_before_s=3600.0)
    found = evaluate_profile(recording)
    believed = recording.believed["gyro"]
    matrix, bias = np.array(believed["matrix"]), np.radians(believed["bias"])
    # the unit is at 24.8 degC: 0.2 degC times its largest temperature coefficients
    expected = {f"gyro_bias_{a}": (b, 1e-5) for a, b in zip("xyz", bias, strict=True)}
    expected |= {f"gyro_scale_factor_error_{a}": (matrix[i, i] - 1, 3e-5) for i, a in enumerate("xyz")}
    expected |= {f"gyro_scale_factor_{w}_{a}": (0.0, 1e-5) for w in ("asymmetry",) for a in "xyz"}
    for number, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        expected[f"gyro_nonorthogonality_{('xy', 'xz', 'yz')[number]}"] = (
            (matrix[i, j] + matrix[j, i]) / 2,
            2e-5,
        )
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        expected[f"gyro_misalignment_{'xyz'[axis]}"] = ((matrix[i, j] - matrix[j, i]) / 2, 1.2e-4)
    expected |= {f"gyro_g_sensitivity_{a}{b}": (0.0, 0.0) for a in "xyz" for b in "xyz"}
    expected |= {f"acc_quadratic_nonlinearity_{a}": (0.0, 3e-6) for a in "xyz"}
    expected |= {"gyro_gain_x": (matrix[0, 0], 3e-5), "gyro_total_delay_x": (0.0, 0.0)}
    seen = [one for one in found.quantities if one.name in expected]
    assert len(seen) >= {"static": 3, "rate_staircase": 15, "sweep": 2, "tumble": 12}[profile]
    for one in seen:
        true, besides = expected[one.name]
        assert abs(one.value - true) < 4 * np.hypot(one.standard_uncertainty, besides), one
    assert found[seen[0].name] is seen[0]
    if profile == "sweep":
        assert "not told apart" in found.words[0]


def test_the_stand_may_look_another_way() -> None:
    """At an azimuth of 60 deg the Earth rate lies otherwise in the body; the bias is the same."""
    at = Site(latitude_deg=50.0, gravity_m_s2=9.81, heading_deg=60.0)
    order = {"values": {"duration_s": 200.0}, "powered_before_s": 3600.0}
    found = evaluate_profile(recorded("gnc_module", "static", site=at, **order))
    usual = evaluate_profile(recorded("gnc_module", "static", **order))
    for axis in "xyz":
        difference = found[f"gyro_bias_{axis}"].value - usual[f"gyro_bias_{axis}"].value
        # the same noise; M is the identity to 4e-3; a wrong azimuth moves it by 5e-5
        assert abs(difference) < 6e-7


def test_what_cannot_be_evaluated_is_said() -> None:
    recording = recorded("gnc_module", "static", values={"duration_s": 20.0})
    for changed, words in (
        ({"test": {**recording.test, "profile": "spin"}}, "'spin'"),
        ({"test": {**recording.test, "triggered": False}}, "trigger"),
        ({"site": {}}, "site"),
        ({}, "20"),
    ):
        with pytest.raises(CalibrationError, match=words):
            evaluate_profile(dataclasses.replace(recording, **changed))

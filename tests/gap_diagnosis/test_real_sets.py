"""Each real set: what its notes say is there is found, and nothing is claimed that they rule out."""

import functools
from typing import Any

import numpy as np
import pytest

from gap_diagnosis.diagnosis import diagnose
from gap_diagnosis.errors import DiagnosisError
from protocol.adapters.recording_forms import read_recording
from tests.real_recordings import folder

pytestmark = [pytest.mark.recorded]
IMUCAL = tuple(
    f"imucal_ferraris/annotated-{part}"
    for part in ("x-p", "x-a", "y-p", "y-a", "z-p", "z-a", "x-rot", "y-rot", "z-rot")
)
CONSTANTS = {"acc.bias", "acc.scale_factor_error", "acc.misalignment"}
RULED_OUT = (
    "warm_up",
    "temperature",
    "hysteresis",
    "g_sensitivity",
    "nonlinearity",
    "drift",
    "mains",
    "current",
)
"""In no set's notes; most rule them out by name."""


@functools.cache
def report(*names: str) -> dict[str, Any]:
    return diagnose([read_recording(folder() / name) for name in names]).document


def values(document: dict[str, Any], effect: str) -> dict[str, float]:
    return {
        name: one["value"]
        for entry in document["which"]
        if entry["effect"] == effect
        for name, one in entry["parameters"].items()
    }


def bias_of(document: dict[str, Any]) -> np.ndarray:
    found = values(document, "acc.bias")
    return np.array([found[f"bias_si_{axis}"] for axis in "xyz"])


def scales_of(document: dict[str, Any]) -> np.ndarray:
    """(3,) relative to their mean: a norm tells no common factor."""
    found = values(document, "acc.scale_factor_error")
    scales = np.array([found.get(f"scale_factor_error_{axis}", 0.0) for axis in "xyz"])
    return scales - scales.mean()


def relative(scales: list[float]) -> np.ndarray:
    return np.array(scales) - np.mean(scales)


def claims_only(document: dict[str, Any], allowed: set[str]) -> None:
    likely = {entry["effect"] for entry in document["which"] if entry["probability"] > 0.5}
    assert likely <= allowed
    for entry in document["which"]:
        assert entry["probability"] < 0.5 or not any(word in entry["effect"] for word in RULED_OUT)


def test_a_magnetometer_with_strong_iron() -> None:
    """mag_hardiron: published centre and matrix (paramters_mag.csv), solved for y = M u + b."""
    document = report("mag_hardiron_tomisuarez/noisy")
    assert document["verdict"] == "attributed"
    assert document["sets"][0]["effects"] == ["mag.hard_iron", "mag.soft_iron"]
    claims_only(document, {"mag.hard_iron", "mag.soft_iron"})
    hard, soft = values(document, "mag.hard_iron"), values(document, "mag.soft_iron")
    assert [hard[f"field_t_{a}"] for a in "xyz"] == pytest.approx([6158.6, 252.7, 3445.6], abs=6.0)
    lower = np.array(
        [
            [1, 0, 0],
            [soft["matrix_yx"], 1 + soft["matrix_yy"], 0],
            [soft["matrix_zx"], soft["matrix_zy"], 1 + soft["matrix_zz"]],
        ]
    )
    published = np.array([[1, 0, 0], [0.0417, 0.6885, 0], [0.0156, 0.1495, 1.4759]])
    assert lower == pytest.approx(published, abs=0.012)
    axes = np.linalg.svd(lower, compute_uv=False)
    assert axes[0] / axes[2] == pytest.approx(2.2, abs=0.1)
    assert document["shrinkage"]["fraction_closed"] > 0.999
    assert {place["unit"] for place in document["where"]} == {"1"}  # counts, not uT


def test_six_poses_of_a_ferraris_session() -> None:
    """imucal: b_a / K_a and K_a / nominal of published_calibration_annotated.json; poses within 1–2°."""
    document = report(*IMUCAL)
    assert document["verdict"] == "attributed"
    claims_only(document, {"acc.bias", "acc.scale_factor_error"})
    assert bias_of(document) == pytest.approx([-0.0288, -0.2322, -0.1350], abs=0.01)
    assert scales_of(document) == pytest.approx(relative([-0.0014, -0.0040, 0.0285]), abs=0.0015)
    assert document["shrinkage"]["fraction_closed"] > 0.98
    assert sum("no stand tells how, so it is not used" in sentence for sentence in document["not_used"]) == 3


def test_a_session_of_another_unit_claims_constants_alone() -> None:
    claims_only(report("imucal_ferraris/example-session"), {*CONSTANTS, "gyro.quantization"})


@pytest.mark.parametrize(
    ("unit", "bias", "scales"),
    [
        ("imu0", [0.103, 0.097, 0.344], [0.0036, 0.0032, 0.0065]),
        ("imu1", None, None),
        ("imu2", None, None),
    ],
)
def test_units_turned_by_hand_show_constants_and_no_gyro(
    unit: str, bias: list[float] | None, scales: list[float] | None
) -> None:
    """mpu9150: the published table; its gyros are a negative control."""
    document = report(f"mpu9150_x5_rotations/{unit}-rotations")
    assert document["verdict"] == "attributed"
    claims_only(document, CONSTANTS)
    assert not any(place["channel"].startswith("gyro") for place in document["where"])
    if bias is not None and scales is not None:
        assert bias_of(document) == pytest.approx(bias, abs=0.004)
        assert scales_of(document) == pytest.approx(relative(scales), abs=0.0008)
    assert document["shrinkage"]["fraction_closed"] > 0.98


def test_ten_positions_show_the_published_bias_and_a_hand_that_moved() -> None:
    """mpu6050: params_acc.csv. The rests by hand turn by up to 1 °/s: the gyro's gap has no name."""
    document = report("mpu6050_multipos_tomisuarez/multi-position")
    claims_only(document, {*CONSTANTS, "acc.quantization"})
    assert document["verdict"] == "unattributed"
    assert "gyro" in document["unattributed"]["description"]
    assert bias_of(document) == pytest.approx([0.4259, -0.2146, -1.1014], abs=0.015)
    published = [5.986 / 6.020 - 1, 5.986 / 5.968 - 1, 5.986 / 5.859 - 1]
    assert scales_of(document) == pytest.approx(relative(published), abs=0.002)
    assert document["shrinkage"]["fraction_closed"] > 0.99


@pytest.mark.parametrize("name", ["static-449s", "static-100s"])
def test_a_gyro_at_rest_without_a_thermometer_warms_up_in_no_report(name: str) -> None:
    """mpu6050: the accelerometer's values are multiples of four counts; a drift < 0.02 °/s has no cause."""
    document = report(f"mpu6050_multipos_tomisuarez/{name}")
    claims_only(document, {"acc.quantization"})
    assert values(document, "acc.quantization")["quantum_si"] == pytest.approx(4 * 9.80665 / 16384, rel=1e-6)
    assert any("a drift is not told from warm-up" in sentence for sentence in document["not_used"])


def test_one_turn_by_hand_is_refused() -> None:
    with pytest.raises(DiagnosisError, match="no stand reports how"):
        report("mpu6050_multipos_tomisuarez/turn-x-90deg")


def test_thirty_orientations_of_a_phone() -> None:
    """acc30pos, LIS3DH: norm(S f − b) = 9.80665 with the notes' S and b; left over 2.6 ‰."""
    document = report("acc30pos_lis3dh_innalabs/lis3dh-30-orientations")
    assert document["verdict"] == "attributed"
    claims_only(document, CONSTANTS)
    assert bias_of(document) == pytest.approx([-0.121 / 1.027, -0.004 / 1.023, -0.126 / 1.040], abs=0.02)
    assert scales_of(document) == pytest.approx(relative([1 / 1.027, 1 / 1.023, 1 / 1.040]), abs=0.003)


@pytest.mark.slow
@pytest.mark.parametrize("chip", [1, 8])
def test_what_is_claimed_of_a_chip_recurs(chip: int) -> None:
    """mimu4444: scale factors repeat within 0.01–0.06 %; the range's end is the simulator's own."""
    documents = [report(f"mimu4444_array_selfcal/exp{n}-imu{chip}") for n in (1, 5)]
    for document in documents:
        claims_only(document, {*CONSTANTS, "link.aliasing"})
        assert sum("which the simulator has too" in sentence for sentence in document["not_used"]) == 3
        assert document["shrinkage"]["fraction_closed"] > 0.99
    one, other = (scales_of(document) for document in documents)
    assert one == pytest.approx(other, abs=8e-4)
    assert bias_of(documents[0]) == pytest.approx(bias_of(documents[1]), abs=0.05)

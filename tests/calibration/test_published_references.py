"""Real sensors against their published calibrations. Tolerances are those the sources' own notes allow."""

import math
from pathlib import Path

import numpy as np
import pytest

from calibration.evaluation import Evaluation
from calibration.published import compare_with_published
from calibration.recorded import Source, evaluate, together
from protocol.errors import CalibrationError
from protocol.folder_form import read_folder

pytestmark = pytest.mark.recorded
G = 9.80665


def sources(data: Path, *names: str) -> list[Source]:
    paths = [path for name in names for path in sorted(data.glob(name)) if (path / "recording.json").exists()]
    return [Source(read_folder(path), path) for path in paths]


def only(data: Path, name: str) -> Evaluation:
    (group,) = together(sources(data, name))
    return evaluate(group)


def test_the_ferraris_parts_agree_with_imucal(recorded_data: Path) -> None:
    (group,) = together(sources(recorded_data, "imucal_ferraris/annotated-*"))
    assert len(group) == 9
    found = evaluate(group)
    reference = compare_with_published(found, group[0].recording, group[0].folder)
    assert reference is not None
    by_name = {item.name: item for item in reference.comparisons}
    for axis in "xyz":
        assert abs(by_name[f"acc scale factor {axis}"].percent or 0.0) < 0.1
        assert abs(by_name[f"gyro scale factor {axis}"].percent or 0.0) < 0.5
    # Nothing differs by more than the stated uncertainty, and no uncertainty is idle.
    assert all(abs(item.normalised_error) < 1.0 for item in reference.comparisons)
    assert all(0 < item.standard_uncertainty < 0.02 for item in reference.comparisons)
    assert any("opposite sign" in remark for remark in reference.remarks)
    assert any("x +360°" in sentence for sentence in found.assumptions)
    assert 0.3 < math.degrees(_alignment(found)) < 3.0  # by hand: about 1-2 deg


def test_the_other_ferraris_session_is_evaluated_by_its_sections_and_not_compared(
    recorded_data: Path,
) -> None:
    (group,) = together(sources(recorded_data, "imucal_ferraris/example-session"))
    found = evaluate(group)
    assert compare_with_published(found, group[0].recording, group[0].folder) is None
    assert found.acc is not None
    assert found.gyro is not None
    assert np.abs(found.acc.scale_factor_error()).max() < 0.03
    assert np.abs(found.gyro.scale_factor_error()).max() < 0.04
    assert [item.count for item in found.not_used] == [5994]


def test_the_multi_position_set_agrees_with_its_parameters(recorded_data: Path) -> None:
    (group,) = together(sources(recorded_data, "mpu6050_multipos_tomisuarez/multi-position"))
    found = evaluate(group)
    reference = compare_with_published(found, group[0].recording, group[0].folder)
    assert reference is not None
    by_name = {item.name: item for item in reference.comparisons}
    count = G / 16384
    for axis in "xyz":
        assert abs(by_name[f"acc k_{axis}{axis}"].percent or 0.0) < 0.2
        assert abs(by_name[f"acc b_{axis}"].difference) < 10 * count
        assert abs(by_name[f"gyro b_{axis}"].normalised_error) < 2.0
    assert found.gyro is None
    assert "gyro matrix" in {item.what for item in found.not_used}
    assert any("non-orthogonality xy" in sentence for sentence in found.assumptions)


PUBLISHED_MPU9150 = {  # columns 1-3 of published_calibration.png: accelerometer scale (%) and bias (m/s^2)
    0: ((0.363, 0.315, 0.647), (0.103, 0.097, 0.344)),
    1: ((0.471, 0.482, 0.932), (0.090, 0.070, 0.338)),
    2: ((0.382, 0.355, 0.780), (0.096, 0.008, -0.045)),
}


@pytest.mark.parametrize("unit", PUBLISHED_MPU9150)
def test_rests_found_in_hand_rotations_give_the_published_accelerometer(
    recorded_data: Path, unit: int
) -> None:
    found = only(recorded_data, f"mpu9150_x5_rotations/imu{unit}-rotations")
    scale, bias = PUBLISHED_MPU9150[unit]
    assert found.acc is not None
    np.testing.assert_allclose(100 * found.acc.scale_factor_error(), scale, atol=0.15)
    np.testing.assert_allclose(found.acc.bias, bias, atol=0.005)
    assert found.gyro is None  # the hand moves: nothing about its matrix may be claimed from these rests


def test_thirty_orientations_give_the_scale_and_bias_of_the_norm(recorded_data: Path) -> None:
    found = only(recorded_data, "acc30pos_lis3dh_innalabs/lis3dh-30-orientations").acc
    assert found is not None
    np.testing.assert_allclose(np.diag(found.compensation), [1.027, 1.023, 1.040], rtol=0.003)
    np.testing.assert_allclose(found.bias_input_referred(), [-0.121, -0.004, -0.126], atol=0.02)
    assert found.residual_rms / G < 3e-3


@pytest.mark.parametrize("poses", [24, 31, 49])
def test_pose_means_hold_on_poses_left_out(recorded_data: Path, poses: int) -> None:
    (source,) = sources(recorded_data, f"acc30pos_lis3dh_innalabs/innalabs-{poses}-pose-means")
    found = evaluate([source]).acc
    assert found is not None
    assert found.residual_rms / G < 1e-3
    other = 49 if poses != 49 else 24
    (held_out,) = sources(recorded_data, f"acc30pos_lis3dh_innalabs/innalabs-{other}-pose-means")
    outputs = held_out.recording.stream("dut").si("acc_x", "acc_y", "acc_z")
    norms = np.linalg.norm(found.compensate(outputs), axis=1) / G
    assert np.abs(norms - 1).max() < 4e-3
    assert np.abs(np.linalg.norm(outputs, axis=1) / G - 1).max() > 8 * (norms - 1).std()


def test_one_experiment_of_the_array_predicts_another(recorded_data: Path) -> None:
    first = only(recorded_data, "mimu4444_array_selfcal/exp1-imu1").acc
    fifth = only(recorded_data, "mimu4444_array_selfcal/exp5-imu1").acc
    assert first is not None
    assert fifth is not None
    np.testing.assert_allclose(np.diag(first.matrix), np.diag(fifth.matrix), atol=6e-4)


@pytest.mark.parametrize("name", ["static-100s", "static-449s", "turn-x-90deg"])
def test_what_cannot_be_calibrated_says_what_is_missing(recorded_data: Path, name: str) -> None:
    with pytest.raises(CalibrationError, match="at least 9 rests") as refusal:
        only(recorded_data, f"mpu6050_multipos_tomisuarez/{name}")
    assert "attitudes" in refusal.value.remedy


def test_a_magnetometer_alone_has_no_method_yet(recorded_data: Path) -> None:
    with pytest.raises(CalibrationError, match="No calibration method applies"):
        only(recorded_data, "mag_hardiron_tomisuarez/noisy")


def test_half_a_ferraris_session_names_the_missing_half(recorded_data: Path) -> None:
    (group,) = together(sources(recorded_data, "imucal_ferraris/annotated-x-*"))
    with pytest.raises(CalibrationError, match="lacks y_p, y_a, z_p, z_a, y_rot, z_rot"):
        evaluate(group)


def _alignment(found: Evaluation) -> float:
    assert found.acc is not None
    return float(np.sqrt(2) * found.acc.matrix_standard_uncertainty()[0, 1])

"""Real sensors against their published calibrations. Tolerances are those the sources' own notes allow."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from calibration import gyros_from_gravity
from calibration.algorithms import turned_gravity
from calibration.algorithms.magnetometer import hard_and_soft_iron
from calibration.evaluation import Evaluation
from calibration.evaluations.by_profile import evaluate_by_profile, has_method
from calibration.published import compare_magnetometer, compare_with_published
from calibration.published_tables import table_of
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
    # Three of nine turns ran into the gyros' range, which the published scale factors rest on.
    assert found.gyro is None
    assert {"gyro matrix", "turns between rests"} <= {item.what for item in found.not_used}
    assert any("end of their range" in remark for remark in reference.remarks)
    assert any("non-orthogonality xy" in sentence for sentence in found.assumptions)


@pytest.mark.parametrize("unit", [0, 1, 2])
def test_rests_in_hand_rotations_give_the_printed_accelerometer_and_the_gyros(
    recorded_data: Path, unit: int
) -> None:
    (source,) = sources(recorded_data, f"mpu9150_x5_rotations/imu{unit}-rotations")
    found = evaluate([source])
    reference = compare_with_published(found, source.recording, source.folder)
    assert reference is not None
    by_name = {item.name: item for item in reference.comparisons}
    of_acc = [item for item in reference.comparisons if item.name.startswith("acc")]
    assert len(of_acc) == 9
    assert all(abs(item.normalised_error) < 2.0 for item in of_acc)
    for axis in "xyz":
        assert abs(by_name[f"acc m_{axis * 2}"].percent or 0.0) < 0.15
        assert abs(by_name[f"acc b_{axis}"].difference) < 0.005
        # 0.3 % but for unit 1's z, where the printed figures leave four times the residual, see below.
        assert abs(by_name[f"gyro m_{axis * 2}"].percent or 0.0) < (0.6 if unit == 1 else 0.3)
        assert abs(by_name[f"gyro b_{axis}"].difference) < 1.2e-3  # printed in steps of 1e-3 rad/s
    of_gyro = [item for item in reference.comparisons if item.name.startswith("gyro")]
    assert len(of_gyro) == 12
    # Of 36 in three units the largest of a normal quantity is beyond 2.8 in one set of five.
    assert all(abs(item.normalised_error) < 2.9 for item in of_gyro)
    assert sum(item.normalised_error**2 for item in of_gyro) < 26.2  # chi-square, 12, 99 %
    assert any("one turn after another" in remark for remark in reference.remarks)


@pytest.mark.parametrize(("unit", "printed_deg"), [(0, 0.29), (1, 0.28), (2, 0.25)])
def test_gravity_turns_as_the_gyros_here_say_on_turns_left_out(
    recorded_data: Path, unit: int, printed_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Why the gyros differ from the printed table by more than our u: fitted to three of four turns, ours
    predict the fourth better than the table does, which was fitted to all."""
    sessions: list[turned_gravity.GravitySession] = []
    fit = turned_gravity.fit_turned_gravity

    def kept(session: turned_gravity.GravitySession, where: str) -> turned_gravity.TurnedGravityFit:
        sessions.append(session)
        return fit(session, where)

    monkeypatch.setattr(gyros_from_gravity, "fit_turned_gravity", kept)
    (source,) = sources(recorded_data, f"mpu9150_x5_rotations/imu{unit}-rotations")
    found = evaluate([source])
    (session,) = sessions
    printed = table_of(source.recording)
    assert printed is not None
    assert found.gyro is not None

    def left_deg(turns: tuple[turned_gravity.Turn, ...], matrix: np.ndarray, bias: np.ndarray) -> float:
        parameters = np.concatenate([np.linalg.inv(matrix).ravel(), bias])
        residual = turned_gravity.TurnedGravity(session, turns).at(parameters)[0]
        return math.degrees(float(np.sqrt(2 * (residual**2).mean())))

    assert left_deg(session.turns, printed.gyro.matrix, printed.gyro.bias) == pytest.approx(
        printed_deg, abs=0.01
    )
    assert left_deg(session.turns, found.gyro.matrix, found.gyro.bias) < 0.09
    squares = np.zeros(2)
    for fold in range(4):
        others = session.turns[fold::4]
        kept_turns = tuple(turn for turn in session.turns if turn not in others)
        ours = fit(dataclasses.replace(session, turns=kept_turns), "three of four turns").coefficients
        squares += len(others) * np.square(
            [
                left_deg(others, ours.matrix, ours.bias),
                left_deg(others, printed.gyro.matrix, printed.gyro.bias),
            ]
        )
    ours_deg, printed_rms_deg = np.sqrt(squares / len(session.turns))
    assert ours_deg < 0.75 * printed_rms_deg


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


def test_a_long_rest_tells_the_same_noise_by_allan_and_by_wavelet_variance(recorded_data: Path) -> None:
    ((source,),) = together(sources(recorded_data, "mpu6050_multipos_tomisuarez/static-449s"))
    assert has_method(source.recording)
    found = {one.sensor: one for one in evaluate_by_profile([source.recording]).results if "_" in one.sensor}
    for channel in ("gyro_x", "gyro_y", "gyro_z", "acc_x", "acc_y", "acc_z"):
        content = found[channel].content
        walk = next(one for one in content.quantities if one.name.endswith("_random_walk"))
        by_wavelet = next(one for one in found[channel].beside if one.name.startswith("random walk"))
        assert by_wavelet.value == pytest.approx(walk.value, rel=0.1), channel
        plots = {
            table.name: {column.name: column.values for column in table.columns} for table in content.tables
        }
        assert {"allan_deviation", "modified_allan_deviation", "wavelet_deviation"} <= set(plots)
        of_plot = plots["allan_deviation"]
        lower, middle, upper = (
            np.array(of_plot[name]) for name in ("lower_limit_95", "deviation", "upper_limit_95")
        )
        assert (lower < middle).all()
        assert (middle < upper).all()
        assert (np.diff(of_plot["degrees_of_freedom"]) < 0).all()


@pytest.mark.parametrize("name", ["turn-x-90deg"])
def test_what_cannot_be_calibrated_says_what_is_missing(recorded_data: Path, name: str) -> None:
    with pytest.raises(CalibrationError, match="at least 9 rests") as refusal:
        only(recorded_data, f"mpu6050_multipos_tomisuarez/{name}")
    assert "attitudes" in refusal.value.remedy


def test_a_magnetometer_alone_is_fitted_and_compared(recorded_data: Path) -> None:
    """All agree; of the short axes a fit without regard to noise is wrong, and its doubt says so."""
    ((source,),) = together(sources(recorded_data, "mag_hardiron_tomisuarez/noisy"))
    assert has_method(source.recording)
    found = evaluate_by_profile([source.recording])
    reference = compare_magnetometer(found, source.folder)
    assert reference is not None
    by_name = {item.name: item for item in reference.comparisons}
    assert len(by_name) == 9
    for name, item in by_name.items():
        assert abs(item.normalised_error) < 2.0, name
        assert 0.0 < item.published_standard_uncertainty < 8 * item.standard_uncertainty, name
    assert 1.0 < (by_name["mag k_yy"].percent or 0.0) < 2.5
    output = source.recording.stream("dut").si("mag_x", "mag_y", "mag_z")
    fit = hard_and_soft_iron(output)
    directions = fit.compensate(output)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    noise = fit.distance_rms * np.random.default_rng(1).standard_normal(output.shape)
    simulated = directions @ np.linalg.inv(fit.compensation) + fit.hard_iron + noise
    again = hard_and_soft_iron(simulated)
    assert again.compensation[1, 1] == pytest.approx(fit.compensation[1, 1], rel=0.005)
    assert _plain_compensation(simulated)[1, 1] / fit.compensation[1, 1] == pytest.approx(0.975, abs=0.004)
    assert _plain_compensation(output)[1, 1] / fit.compensation[1, 1] == pytest.approx(0.975, abs=0.004)


def _plain_compensation(points: np.ndarray) -> np.ndarray:
    """By v^T A v + 2 b^T v = 1 and plain least squares."""
    origin, size = points.mean(axis=0), points.std()
    x, y, z = ((points - origin) / size).T
    design = np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, 2 * x, 2 * y, 2 * z])
    v, *_ = np.linalg.lstsq(design, np.ones(len(points)), rcond=None)
    shape = np.array([[v[0], v[3], v[4]], [v[3], v[1], v[5]], [v[4], v[5], v[2]]])
    values, vectors = np.linalg.eigh(shape / (1 + v[6:] @ np.linalg.solve(shape, v[6:])))
    return (vectors * np.sqrt(values)) @ vectors.T / size


def test_half_a_ferraris_session_names_the_missing_half(recorded_data: Path) -> None:
    (group,) = together(sources(recorded_data, "imucal_ferraris/annotated-x-*"))
    with pytest.raises(CalibrationError, match="lacks y_p, y_a, z_p, z_a, y_rot, z_rot"):
        evaluate(group)


def _alignment(found: Evaluation) -> float:
    assert found.acc is not None
    return float(np.sqrt(2) * found.acc.matrix_standard_uncertainty()[0, 1])

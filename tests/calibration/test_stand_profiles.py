"""Recordings `multi_position` and `rotation` of a stand: together a session, alone what each can carry."""

import dataclasses
import math

import numpy as np
import pytest

from calibration.evaluation import Evaluation
from calibration.recorded import Source, evaluate, together
from calibration.records.making import records_of
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from protocol.recordings import Recording
from tests.calibration.test_inertial_evaluations import ORIGIN

MOUNT_RAD = 1e-4
"""How far the emulated stand turns the unit's axes, each time it is mounted."""
WARM = {"powered_before_s": 3600.0}


@pytest.fixture(scope="module")
def positions() -> Recording:
    return recorded("gnc_module", "multi_position", **WARM)


@pytest.fixture(scope="module")
def turns() -> Recording:
    return recorded("gnc_module", "rotation", **WARM)


def evaluated(*recordings: Recording) -> Evaluation:
    (group,) = together([Source(recording) for recording in recordings])
    return evaluate(group)


def check(found: Evaluation, recording: Recording, kind: str) -> None:
    """Matrix and bias against the unit's own; its temperature is 0.2 degC beside that of the belief."""
    triad = found.acc if kind == "acc" else found.gyro
    assert triad is not None
    believed = recording.believed[kind]
    matrix = np.array(believed["matrix"])
    unit = math.radians(1.0) if kind == "gyro" else 9.80665
    uncertainty, besides = triad.matrix_standard_uncertainty(), 3e-5
    difference = triad.matrix - matrix
    symmetric = (difference + difference.T) / 2.0  # a mounting cannot change it
    assert (np.abs(symmetric) < 4 * np.hypot(uncertainty, besides)).all()
    assert (np.abs(difference) < 4 * np.hypot(uncertainty, MOUNT_RAD)).all()
    pull = (triad.bias - np.array(believed["bias"]) * unit) / triad.bias_standard_uncertainty()
    assert np.abs(pull).max() < 4


def test_positions_and_turns_give_both_triads(positions: Recording, turns: Recording) -> None:
    found = evaluated(positions, turns)
    assert found.method == "imu_calibration"
    for kind in ("acc", "gyro"):
        check(found, positions, kind)
    assert any("switched off" in sentence for sentence in found.assumptions)
    records = records_of(found, [positions, turns], ORIGIN)
    assert [record.sensor for record in records] == ["acc", "gyro"]
    assert all(record.stand is not None and record.stand.emulated for record in records)
    # 10 s of rest in six attitudes, 1080 deg forth and back about three axes
    assert sum("turn" in residual.name for residual in found.residuals) == 6
    assert sum("rest" in residual.name and residual.unit == "m/s^2" for residual in found.residuals) == 13


def test_each_alone_gives_what_it_can(positions: Recording, turns: Recording) -> None:
    still = evaluated(positions)
    check(still, positions, "acc")
    assert still.gyro is None
    assert still.gyro_bias is not None
    bias = np.radians(positions.believed["gyro"]["bias"])
    doubt = np.hypot(still.gyro_bias.standard_uncertainty_rad_s, 1e-5)
    assert (np.abs(still.gyro_bias.bias_rad_s - bias) < 4 * doubt).all()
    turned = evaluated(turns)
    check(turned, turns, "gyro")
    assert turned.acc is None
    (note,) = [note for note in turned.not_used if note.what == "accelerometers"]
    assert "specific force along body x" in note.why


def test_the_earth_is_not_taken_for_a_bias_of_turns(turns: Recording) -> None:
    """At a latitude of 80 deg the Earth along z is 2.5e-5 rad/s more; whole turns about x and y see none."""
    north = dataclasses.replace(turns, site={**turns.site, "latitude_deg": 80.0})
    here, there = evaluated(turns).gyro, evaluated(north).gyro
    assert here is not None
    assert there is not None
    vertical = 7.292e-5 * (math.sin(math.radians(80.0)) - math.sin(math.radians(39.96)))
    assert 0.6 * vertical < here.bias[2] - there.bias[2] < vertical
    assert here.matrix == pytest.approx(there.matrix, abs=1e-5)


def test_what_no_recording_excites_is_named(positions: Recording, turns: Recording) -> None:
    one_axis = recorded("gnc_module", "rotation", values={"axis": 3.0}, **WARM)
    with pytest.raises(CalibrationError, match="Nothing turns about body x, y"):
        evaluated(one_axis)
    both = evaluated(positions, one_axis)
    check(both, positions, "acc")
    assert both.gyro is None
    assert any("turns about body x" in note.why for note in both.not_used)
    untriggered = dataclasses.replace(turns, test={**turns.test, "triggered": False})
    with pytest.raises(CalibrationError, match="trigger"):
        evaluated(untriggered)


def test_pulses_are_calibrated_as_other_outputs_are() -> None:
    recording = recorded("pulse_imu", "multi_position", **WARM)
    found = evaluated(recording)
    assert found.acc is not None
    difference = found.acc.matrix - np.array(recording.believed["acc"]["matrix"])
    assert np.abs(difference).max() < 3 * MOUNT_RAD
    assert np.abs(np.diag(difference)).max() < 1e-4

"""Our attitude on a real sensor, turned by hand before optics (BROAD): does its up point up?

The reference gives no quaternion. Its specific force, turned by our attitude into our level frame and taken
over 30 s in which the hand comes back to about the same speed, is gravity: what is horizontal of it is our
tilt error.
"""

from pathlib import Path

import numpy as np
import pytest

from calibration.algorithms.attitude_angles import matrix_of
from calibration.algorithms.attitude_uncertainty import GateIntent, gates_of_run
from calibration.algorithms.flight_phases import initial_rest_samples
from calibration.algorithms.strapdown_attitude import OpenGates, align_at_rest, strapdown_attitude
from protocol.folder_form import read_folder

pytestmark = pytest.mark.recorded
BY_HAND = GateIntent(
    horizontal_m_s2=0.5, speed_m_s=0.1, lever_arm_m=(0.05, 0.02, 0.02), accelerometer_error_m_s2=0.1
)
WINDOW_S = 30.0
SHUT = OpenGates(0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["02-undisturbed-slow-rotation-b", "07-undisturbed-fast-rotation-b"])
def test_up_points_up_before_the_optics(recorded_data: Path, name: str) -> None:
    recording = read_folder(recorded_data / "broad" / name)
    dut, optics = recording.streams["dut"], recording.streams["stand"]
    time_s, gravity = dut.time_s(), float(recording.site["gravity_m_s2"])
    period_s = float(np.median(np.diff(time_s)))
    rate, force = dut.si("gyro_x", "gyro_y", "gyro_z"), dut.si("acc_x", "acc_y", "acc_z")
    rest = initial_rest_samples(rate, force, period_s)
    assert 20.0 < rest * period_s < 60.0, "the sets begin with a rest"
    aligned = align_at_rest(rate[:rest], force[:rest], period_s)
    bounds = gates_of_run(aligned, gravity, BY_HAND).bounds
    tilts = {}
    for kind, gates in (("corrected", bounds), ("gyros alone", SHUT)):
        run = strapdown_attitude(rate, force, period_s, aligned, gates)
        at = np.searchsorted(time_s, optics.time_s()).clip(max=len(time_s) - 1)
        seen = (matrix_of(run.quaternion[at]) @ optics.si("acc_x", "acc_y", "acc_z")[..., None])[..., 0]
        begins = np.arange(optics.time_s()[0], optics.time_s()[-1] - WINDOW_S, WINDOW_S)
        inside = [(optics.time_s() >= a) & (optics.time_s() < a + WINDOW_S) for a in begins]
        means = np.array([seen[one].mean(axis=0) for one in inside])
        np.testing.assert_allclose(means[:, 2], gravity, rtol=6e-3)
        tilts[kind] = np.degrees(np.hypot(means[:, 0], means[:, 1]) / gravity)
    assert len(tilts["corrected"]) >= 5
    assert tilts["corrected"].max() < 1.6
    assert tilts["gyros alone"][-1] > 2.0 * tilts["corrected"][-1], "what the correction is for"

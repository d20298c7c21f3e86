"""Clocks of real recordings against what their sources published (folder: TESTLOOM_DATA)."""

import numpy as np
import pytest

from gap_diagnosis.decimation import decimated
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.observation import Observation, TimingFinding
from gap_diagnosis.observing import observe
from protocol.folder_form import read_folder
from protocol.recordings import Recording
from tests.real_recordings import folder

pytestmark = pytest.mark.recorded
CERTAIN = 12.0


def real(name: str) -> Recording:
    return read_folder(folder() / name)


def certain(observed: Observation) -> dict[tuple[str, str], TimingFinding]:
    return {
        (one.effect, ",".join(one.sensors)): one
        for one in observed.timing
        if one.log_likelihood_ratio > CERTAIN
    }


def test_a_phone_and_a_board_are_joined_as_published() -> None:
    """Faizullin et al. 2021: 947848.6384083075 s; the rates then differ by 0.14 °/s rms; no drift in 5 s."""
    observed = observe(real("twistnsync_phone_mcu/twist"))
    assert observed.aligned_by_s == pytest.approx(947848.6384083075, abs=1e-4)
    assert certain(observed) == {}
    assert np.nanstd(observed.outputs["gyro"].residual_si) < 0.012


@pytest.mark.slow
@pytest.mark.parametrize(
    "trial",
    [
        "02-undisturbed-slow-rotation-b",
        "07-undisturbed-fast-rotation-b",
        "16-undisturbed-fast-translation-b",
        "25-disturbed-tapping-b",
        "36-disturbed-attached-magnet-5cm",
    ],
)
def test_a_gyro_lags_the_cameras_by_four_milliseconds(trial: str) -> None:
    found = certain(observe(real(f"broad/{trial}")))
    assert found["link.fixed_delay", "gyro"].value == pytest.approx(4.2e-3, abs=1e-4)
    assert {effect for effect, _ in found} == {"link.fixed_delay"}


@pytest.mark.slow
def test_a_walk_before_cameras_shows_no_lag_across_its_holes() -> None:
    observed = observe(real("tumvi_room_imu_mocap/room1"))
    assert not [key for key in certain(observed) if key[1] == "gyro"]
    assert 0.65 < observed.usable.mean() < 0.72
    hole_rows = np.isnan(observed.outputs["gyro"].predicted_si).any(axis=1)
    assert (hole_rows == ~observed.usable).all()
    few = decimated(observed, 4)
    assert np.isfinite(few.outputs["gyro"].residual_si[few.usable]).all()


def test_eight_chips_rest_and_clip() -> None:
    """MIMU4444: rate 0 in twenty rests, the ends of the range in the motion that nothing reports."""
    observed = observe(real("mimu4444_array_selfcal/exp1-imu1"))
    said = {one.what: one for one in observed.set_aside}
    assert said["gyro_x"].why.startswith("saturated")
    assert set(observed.outputs) == {"gyro"}
    assert (np.nanstd(observed.outputs["gyro"].residual_si[observed.usable], axis=0) < 0.005).all()
    assert certain(observed) == {}


@pytest.mark.parametrize(
    "name",
    [
        "mpu9150_x5_rotations/imu0-rotations",
        "imucal_ferraris/annotated-x-rot",
        "mag_hardiron_tomisuarez/noisy",
    ],
)
def test_turned_by_hand_without_a_reference_is_refused(name: str) -> None:
    with pytest.raises(DiagnosisError) as caught:
        observe(real(name))
    assert caught.value.remedy

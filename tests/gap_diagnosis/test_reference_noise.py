"""References that are no test stands: what is claimed beside them, and what is not."""

import numpy as np
import pytest

from gap_diagnosis.diagnosis import diagnose
from gap_diagnosis.reference_noise import reference_density
from gap_diagnosis.switched_field import NAME
from protocol.adapters.recording_forms import read_recording
from tests.real_recordings import folder

PUBLISHED_UT = {
    "32-disturbed-attached-magnet-1cm": 58.0,
    "34-disturbed-attached-magnet-3cm": 13.5,
    "36-disturbed-attached-magnet-5cm": 5.8,
}
WITHOUT_MAGNET = [
    "02-undisturbed-slow-rotation-b",
    "07-undisturbed-fast-rotation-b",
    "16-undisturbed-fast-translation-b",
    "25-disturbed-tapping-b",
    "30-disturbed-stationary-magnet-c",
]
GYRO_LAG_S = 4.2e-3
ITS_OWN_RATE = "29 % of the frames repeat the one before"
"""The magnetometer renews itself at 99.98 Hz, the frames come at 285.7 Hz: its repeats have lines at 42.9,
57.1, 85.8 and 100.0 Hz, and the motion's images lie about them (07 turns at 2.2 Hz: 40.6 and 45.1 Hz)."""


def diagnosed(name: str) -> dict:
    return diagnose([read_recording(folder() / name)]).document


def test_the_density_is_that_of_white_noise() -> None:
    noise = 0.3 * np.random.default_rng(3).standard_normal(60_000)
    found = reference_density(noise, np.zeros(60_000, dtype=np.int64), 0.005)
    assert found == pytest.approx(0.3 * 0.005**0.5, rel=0.1)


def test_noise_between_two_rows_that_is_smooth_is_seen() -> None:
    """Differences of neighbours would say a hundredth of it."""
    rng = np.random.default_rng(3)
    smooth = np.convolve(rng.standard_normal(60_100), np.ones(101) / 101.0, mode="valid")
    found = reference_density(smooth, np.zeros(60_000, dtype=np.int64), 0.005)
    assert found == pytest.approx(0.005**0.5, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("folder", PUBLISHED_UT)
def test_a_magnet_brought_near_is_a_hard_iron_in_time(folder: str) -> None:
    report = diagnosed(f"broad/{folder}")
    assert report["verdict"] == "confusable"  # the delay, with a filter's lag
    assert set(report["sets"][0]["effects"]) == {"link.fixed_delay", NAME}
    by_name = {one["effect"]: one for one in report["which"]}
    field = [one["value"] for one in by_name[NAME]["parameters"].values()]
    assert np.linalg.norm(field) * 1e6 == pytest.approx(PUBLISHED_UT[folder], abs=1.5)
    assert by_name["link.fixed_delay"]["parameters"]["delay_s"]["value"] == pytest.approx(
        GYRO_LAG_S, abs=2e-4
    )
    assert report["shrinkage"]["fraction_closed"] > 0.8


@pytest.mark.slow
@pytest.mark.parametrize("folder", WITHOUT_MAGNET)
def test_controls_show_the_gyros_lag_and_nothing_else(folder: str) -> None:
    report = diagnosed(f"broad/{folder}")
    assert report["verdict"] == "confusable"
    (entry,) = report["which"]
    assert any(ITS_OWN_RATE in sentence for sentence in report["not_used"])
    assert (entry["effect"], entry["confusable_with"]) == ("link.fixed_delay", ["gyro.bandwidth"])
    assert entry["parameters"]["delay_s"]["value"] == pytest.approx(GYRO_LAG_S, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["tumvi_room_imu_mocap/room1", "twistnsync_phone_mcu/twist"])
def test_noise_of_the_reference_is_not_the_units(folder: str) -> None:
    report = diagnosed(folder)
    assert report["which"] == []
    assert any("reference noise in bursts" in sentence for sentence in report["not_used"])

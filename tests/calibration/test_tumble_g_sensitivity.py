"""Tumbles: a gyro and accelerometer made by hand, coverage, the Earth rate's own trap, an emulated module."""

import dataclasses
import math

import numpy as np
import pytest

from calibration.algorithms.tumble_g_sensitivity import (
    Site,
    TumbleRun,
    accelerometer_quadratic,
    gyro_g_sensitivity,
)
from dut_emulator.effects.couplings import GSensitivity
from dut_emulator.effects.nonlinearity import QuadraticNonlinearity
from dut_emulator.recording.recorder import RecordingOrder, RecordingSession, recorded
from protocol.errors import CalibrationError
from tests.calibration.shaped_noise import check_coverage, exponential, white

LATITUDE, GRAVITY, EARTH_RAD_S = math.radians(40.0), 9.8, 7.292115e-5
SITE = Site(LATITUDE, GRAVITY)
PERIOD_S, TURN_S = 0.05, 40.0
G = np.array([[3e-5, -2e-5, 1e-5], [2e-5, 4e-5, -3e-5], [-1e-5, 5e-6, 2e-5]])
K2 = np.array([2e-5, -3e-5, 1e-5])
EARTH_NED = EARTH_RAD_S * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])


def turn_about(axis: int, angle: np.ndarray) -> np.ndarray:
    """(n, 3, 3), coordinates turn."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turn = np.zeros((len(angle), 3, 3))
    turn[:, axis, axis] = 1.0
    turn[:, first, first] = turn[:, second, second] = np.cos(angle)
    turn[:, first, second], turn[:, second, first] = np.sin(angle), -np.sin(angle)
    return turn


def tumbles(seed: int, sigma: float = 0.0, density: float = 1e-9, earth: float = 1.0) -> list[TumbleRun]:
    """A turn about x (north) and a turn about y (west), z up at first; output of a gyro."""
    rng = np.random.default_rng(seed)
    body_from_ned = np.diag([1.0, -1.0, -1.0])
    count = round((TURN_S + 8.0) / PERIOD_S)
    noise = white(rng, 2 * count, 3, density, PERIOD_S)
    noise += exponential(rng, 2 * count, 3, sigma, 30.0, PERIOD_S)
    runs = []
    for axis in (0, 1):
        time_s = PERIOD_S * np.arange(count)
        angle = 2 * math.pi * np.clip((time_s - 4.0) / TURN_S, 0.0, 1.0)
        rate = np.zeros((count, 3))
        rate[:, axis] = np.where((time_s >= 4.0) & (time_s < 4.0 + TURN_S), 2 * math.pi / TURN_S, 0.0)
        dcm = turn_about(axis, angle) @ body_from_ned
        force = dcm @ np.array([0.0, 0.0, -GRAVITY])
        output = (rate + earth * (dcm @ EARTH_NED)) * [1.002, 1.002, 1.0] + force @ G.T + 1e-3
        late = time_s + axis * PERIOD_S * count
        runs.append(
            TumbleRun(f"about {'xyz'[axis]}", late, output + noise[axis * count :][:count], rate, dcm)
        )
    return runs


def test_a_gyro_without_noise_gives_its_matrix_back() -> None:
    found = gyro_g_sensitivity(tumbles(0, density=0.0), SITE, matrix=np.eye(3))
    np.testing.assert_allclose(found.g_sensitivity, G, atol=2e-9)
    np.testing.assert_allclose(found.bias, 1e-3, atol=2e-8)
    assert found.fits[0].of("rate_x")[0][0] == pytest.approx(1.002, rel=1e-6)


def test_the_earth_rate_left_out_is_taken_for_g_sensitivity() -> None:
    """Spin axis north: the vertical Earth rate turns with g. Omega sin(latitude) / g on the diagonal."""
    without = gyro_g_sensitivity(tumbles(0, density=0.0, earth=0.0), SITE, matrix=np.eye(3))
    missed = EARTH_RAD_S * math.sin(LATITUDE) / GRAVITY
    np.testing.assert_allclose(np.diag(without.g_sensitivity - G)[1:], -missed, rtol=0.02)
    assert math.degrees(missed) * 3600 * GRAVITY == pytest.approx(9.67, abs=0.01)  # deg/h per g
    askew = gyro_g_sensitivity(
        tumbles(0, density=1e-12), dataclasses.replace(SITE, heading_standard_uncertainty_rad=0.01)
    )
    straight = gyro_g_sensitivity(tumbles(0, density=1e-12), SITE)
    assert (askew.standard_uncertainty() >= straight.standard_uncertainty() - 1e-15).all()


@pytest.mark.timeout(600)
@pytest.mark.parametrize("seeds", [60, pytest.param(200, marks=pytest.mark.slow)])
def test_intervals_hold_in_noise_with_a_memory(seeds: int) -> None:
    pulls = []
    for seed in range(seeds):
        found = gyro_g_sensitivity(
            tumbles(seed, sigma=3e-5), SITE, matrix=np.eye(3), known_slow=((3e-5, 30.0),)
        )
        pulls.append((found.g_sensitivity - G) / found.standard_uncertainty())
    check_coverage(np.array(pulls).reshape(seeds, 9))
    if seeds < 200:
        return
    unstated = [gyro_g_sensitivity(tumbles(seed, sigma=3e-5), SITE, matrix=np.eye(3)) for seed in range(60)]
    pulls = [(one.g_sensitivity - G) / one.standard_uncertainty() for one in unstated]
    # a wander of 30 s in 90 s is told in part only
    check_coverage(np.array(pulls).reshape(-1, 1), less=0.02, more=0.2)


def test_missing_geometry_and_damage_are_named() -> None:
    runs = tumbles(1)
    with pytest.raises(CalibrationError, match="f_x"):
        gyro_g_sensitivity(runs[:1], SITE)
    with pytest.raises(CalibrationError, match="deg in a block"):
        gyro_g_sensitivity([dataclasses.replace(runs[0], rate_body_rad_s=50 * runs[0].rate_body_rad_s)], SITE)
    torn = runs[0].output.copy()
    torn[50], torn[300, 1], torn[400, 2] = np.nan, 5.0, 0.9
    found = gyro_g_sensitivity(
        [dataclasses.replace(runs[0], output=torn), runs[1]], SITE, matrix=np.eye(3), range_rad_s=4.0
    )
    told = [note.why.split(":")[0] for note in found.not_used]
    assert "missing values (NaN)" in told
    assert "outliers beyond 8 standard deviations" in told
    assert "saturated" in told
    assert np.abs((found.g_sensitivity - G) / found.standard_uncertainty()).max() < 4.5


def test_an_accelerometer_gives_its_quadratic_term_back() -> None:
    rng = np.random.default_rng(3)
    matrix = np.eye(3) + 1e-3 * rng.standard_normal((3, 3))
    runs = []
    for run in tumbles(0):
        force = run.dcm_body_from_ned @ np.array([0.0, 0.0, -GRAVITY])
        output = force @ matrix.T + K2 * force**2 + 0.05 + 1e-3 * rng.standard_normal(force.shape)
        runs.append(dataclasses.replace(run, output=output))
    found = accelerometer_quadratic(runs, SITE)
    assert np.abs((found.quadratic[:, 0] - K2) / found.quadratic_standard_uncertainty()[:, 0]).max() < 4
    assert found.quadratic_standard_uncertainty().max() < 5e-6
    assert np.abs((found.g_sensitivity - matrix) / found.standard_uncertainty()).max() < 4.5


def test_an_emulated_module_is_tumbled() -> None:
    """A g-sensitivity and a quadratic term put in, the Earth rate of the site taken out."""
    order = {"values": {"turns": 3.0}, "powered_before_s": 3600.0}
    twin = RecordingSession(RecordingOrder("gnc_module", "tumble", **order)).twin
    twin = twin.with_effect(GSensitivity("gyro", tuple(map(tuple, 3 * G))))
    twin = twin.with_effect(QuadraticNonlinearity("acc", (2e-4, -1e-4, 0.0)))
    recording = recorded("gnc_module", "tumble", twin=twin, **order)
    believed = recording.believed["gyro"]
    where = Site(math.radians(recording.site["latitude_deg"]), recording.site["gravity_m_s2"])
    sigma = math.radians(believed["bias_instability"]["value"] / 3600)
    found = gyro_g_sensitivity(
        [run_of(recording, "gyro")], where, matrix=np.array(believed["matrix"]), known_slow=((sigma, 300.0),)
    )
    assert np.abs((found.g_sensitivity - 3 * G) / found.standard_uncertainty()).max() < 4
    assert found.standard_uncertainty().max() < 1e-5
    acc = accelerometer_quadratic([run_of(recording, "acc")], where)
    off = acc.quadratic[:, 0] - np.array([2e-4, -1e-4, 0.0])
    assert np.abs(off / np.hypot(acc.quadratic_standard_uncertainty()[:, 0], 2e-6)).max() < 4


def run_of(recording, sensor: str) -> TumbleRun:
    """Stand angles to attitudes: x east, y north, z up at zero; Rx(inner) Ry(middle) Rz(outer)."""
    dut, stand = recording.stream("dut"), recording.stream("stand")
    time_s, stand_s = dut.time_s(), stand.time_s()

    def at(names: list[str]) -> np.ndarray:
        return np.stack([np.interp(time_s, stand_s, stand.si(name)) for name in names], axis=1)

    outer, middle, inner = at(["angle_outer", "angle_middle", "angle_inner"]).T
    lab = turn_about(0, inner) @ turn_about(1, middle) @ turn_about(2, outer)
    lab_from_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    rate = at(["rate_x", "rate_y", "rate_z"])
    return TumbleRun("tumble", time_s, dut.si(*(f"{sensor}_{a}" for a in "xyz")), rate, lab @ lab_from_ned)

"""Half-cycles from a grating, against the closed forms of a crank."""

import math

import numpy as np
import pytest

from calibration.algorithms.overload_motion import half_cycles_from_grating, pulses_of_halves
from calibration.algorithms.sinusoidal_overload import KnownAccelerometer, calibrate_overload
from protocol.errors import CalibrationError

G, RADIUS_M = 9.80665, 0.15
K1, K0, KA, K2 = 1000.0 / G, 1e-3 * G, 1e-4, 1e-5 / G


def crank(phase: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Position and its second derivative by phase, in crank radii."""
    sin, cos = np.sin(phase), np.cos(phase)
    rod = np.sqrt(1 - (ratio * sin) ** 2)
    position = cos + rod / ratio
    return position, -(cos + ratio * (np.cos(2 * phase) / rod + (ratio * sin * cos) ** 2 / rod**3))


def grating(ratio: float, amplitude_g: float, cycles: float, generator, noise_m: float):
    omega = math.sqrt(amplitude_g * G / RADIUS_M)
    time_s = 3.0 + np.arange(0.0, cycles * 2 * math.pi / omega, 1e-3)
    phase = omega * (time_s - 3.0) + 0.7
    position = RADIUS_M * crank(phase, ratio)[0] + generator.normal(0.0, noise_m, len(time_s))
    return omega, time_s, position


@pytest.mark.parametrize("ratio", [0.05, 0.2, 0.3])
@pytest.mark.parametrize("amplitude_g", [1.0, 12.0])
def test_halves_of_a_slider_crank(ratio: float, amplitude_g: float) -> None:
    omega, time_s, position = grating(ratio, amplitude_g, 10.4, np.random.default_rng(1), 1e-6)
    found = half_cycles_from_grating(time_s, position)
    assert found.angular_frequency_rad_s == pytest.approx(omega, rel=1e-6)
    assert found.amplitude_m == pytest.approx(RADIUS_M, rel=1e-5)
    assert found.residual_rms_m == pytest.approx(1e-6, rel=0.15)
    count = 400_000
    phase = (np.arange(count) + 0.5) * 2 * math.pi / count
    a = RADIUS_M * omega**2 * crank(phase, ratio)[1]
    step = 2 * math.pi / omega / count
    for column, half in enumerate((a > 0, a < 0)):
        measured = [values[0, column] for values in vars(found.half_cycles).values()]
        expected = [half.sum() * step, abs(a[half].sum()) * step, (a[half] ** 2).sum() * step]
        np.testing.assert_allclose(measured, expected, rtol=3e-5)
    assert len(found.cut_s) == 2 * len(found.half_cycles.duration_s) + 1
    assert found.cut_s[0] >= time_s[0]
    assert found.cut_s[-1] <= time_s[-1]
    at_cuts = crank(omega * (found.cut_s - 3.0) + 0.7, ratio)[1]
    np.testing.assert_allclose(at_cuts, 0.0, atol=1e-4)
    # The first half is the one with A > 0.
    assert crank(omega * (found.cut_s[:2].mean(keepdims=True) - 3.0) + 0.7, ratio)[1][0] > 0


def test_from_grating_and_counters_to_the_coefficients() -> None:
    omega, time_s, position = grating(0.2, 10.0, 60.3, np.random.default_rng(2), 1e-6)
    found = half_cycles_from_grating(time_s, position)
    fine = np.linspace(time_s[0], time_s[-1], 20 * len(time_s))
    a = RADIUS_M * omega**2 * crank(omega * (fine - 3.0) + 0.7, 0.2)[1]
    rate = K1 * (1 + KA * np.sign(a)) * (K0 + a + K2 * a * np.abs(a))
    running = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(fine))])
    pulses = pulses_of_halves(found.cut_s, fine, np.floor(running))
    known = KnownAccelerometer(K1, K0, 0.0, 0.0, found.relative_uncertainty)
    result = calibrate_overload(found.half_cycles, pulses, known, found.amplitude_m)
    error = np.array([result.asymmetry - KA, result.odd_quadratic_nonlinearity_s2_m - K2])
    assert (np.abs(error) < 3 * result.standard_uncertainty).all()
    assert result.standard_uncertainty[0] < 0.5 * KA
    assert result.half_ratio == pytest.approx(0.72, abs=0.005)


def test_what_is_no_steady_motion_is_said() -> None:
    generator = np.random.default_rng(3)
    _, time_s, position = grating(0.2, 5.0, 10.0, generator, 1e-6)
    sweep = 0.15 * np.cos(18.0 * time_s + 0.4 * (time_s - 3.0) ** 2)
    with pytest.raises(CalibrationError, match="not steady"):
        half_cycles_from_grating(time_s, sweep)
    with pytest.raises(CalibrationError, match="a motion takes 3 cycles"):
        half_cycles_from_grating(time_s[:600], position[:600])
    with pytest.raises(CalibrationError, match="does not run forward"):
        half_cycles_from_grating(time_s[::-1], position)
    holed = position.copy()
    holed[5] = np.nan
    with pytest.raises(CalibrationError, match="some are missing"):
        half_cycles_from_grating(time_s, holed)
    found = half_cycles_from_grating(time_s, position)
    with pytest.raises(CalibrationError, match="not read over all"):
        pulses_of_halves(found.cut_s, time_s[400:], np.zeros(len(time_s) - 400))

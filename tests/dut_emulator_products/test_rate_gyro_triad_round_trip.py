"""An emulated calibration on the rate table comes back from the evaluation of paper 4 with what was put in.

Both sides share names only: the truth is written out here once more, from the unit's effects.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from calibration.algorithms.rate_gyro import RateGyroResult, evaluate_rate_gyro, fit_line
from calibration.algorithms.rate_gyro_uncertainty import Multimeter, linearity_budget
from calibration.algorithms.rate_table_readings import RateTable, StrokeReadings, choose_points
from dut_emulator.effects.effect import name_of
from dut_emulator.products.rate_gyro_triad.product import PRODUCT
from dut_emulator.recording.order import LABORATORY
from dut_emulator.recording.recorder import recorded
from dut_emulator.stands.rate_table_model import drawn_errors
from protocol.recordings import Recording

K = 0.050698 / math.radians(1.0)
FULL_SCALE = math.radians(100.0)
VERTICAL_EARTH_RATE = 7.292115e-5 * math.sin(math.radians(LABORATORY.latitude_deg))
TABLE = RateTable(math.radians(5.0), math.radians(1450.0), 1e-4, VERTICAL_EARTH_RATE)
CONVERTERS = Multimeter(reading_part=0.0, range_part=5e-7, range_v=10.0)  # half of 10 µV
CALIBRATION: dict[str, Any] = {
    "values": {"rest_s": 1.0, "dwell_s": 2.0, "settle_s": 0.3, "acceleration_deg_s2": 200.0},
    "powered_before_s": 1800.0,
}
UNITS = [(seed, f"U-{serial:04d}") for seed, serial in ((1, 1), (1, 2), (2, 30), (3, 7), (4, 55), (5, 90))]


def readings_of(recording: Recording, axis: int) -> StrokeReadings:
    """Means over the dwells of one axis, cycles × points, in the order of the rates."""
    dut, points = recording.stream("dut").columns, recording.stream("points").columns
    volts, time_s = dut[f"volt_{'xyz'[axis - 1]}"], dut["t"]
    sums = np.concatenate([[0.0], np.cumsum(volts)])
    first, last = (
        np.searchsorted(time_s, edge - 1e-9) for edge in (points["t"], points["t"] + points["duration"])
    )
    means = (sums[last] - sums[first]) / (last - first)
    strokes = []
    for stroke in (1, -1):
        mine = (points["axis"] == axis) & (points["stroke"] == stroke)
        strokes.append(means[mine].reshape(-1, 11)[:, ::stroke])
    rates = np.radians(points["rate"][mine][:11][::-1])
    return StrokeReadings(choose_points(rates, TABLE, locked_at_zero=True), strokes[0], strokes[1])


@dataclass(frozen=True)
class Truth:
    """A unit's axis as paper 4 would find it without noise and with an exact table."""

    sensitivity: float
    intercept_v: float
    linearity: float
    point_linearity: np.ndarray
    hysteresis: float


def truth_of(seed: int, serial: str, axis: int, temperature_c: float) -> Truth:
    """Each effect written out for a rate along one axis, warmed up, at one g along that axis."""
    effects = {name_of(effect): effect for effect in PRODUCT.twin(seed, serial).effects}
    index, excess_c = axis - 1, temperature_c - 25.0

    def of(name: str, field: str) -> Any:
        return getattr(effects[f"gyro.{name}"], field)

    rate = np.linspace(-FULL_SCALE, FULL_SCALE, 11)
    y = rate + VERTICAL_EARTH_RATE
    y = y * (1 + of("scale_factor_error", "scale_factor_error")[index])
    y = y * (1 + excess_c * of("scale_factor_temperature", "coefficients_per_c")[0][index])
    y = y + of("scale_factor_asymmetry", "asymmetry")[index] * np.abs(y)
    y = y + of("scale_factor_nonlinearity", "cubic")[index] * y**3
    y = y + of("even_nonlinearity", "square")[index] * y**2
    y = y + of("g_sensitivity", "acc")[index][index] * LABORATORY.gravity_m_s2
    y = (
        y
        + of("bias", "bias_si")[index]
        + excess_c * of("bias_temperature", "coefficients_si_per_c")[0][index]
    )
    half = of("rate_hysteresis", "amplitude_si")[index]
    mean = K * (y + half * np.array([-1, *[0] * 9, 1]))  # the loop is closed at its ends
    slope, intercept = np.polyfit(rate, mean, 1)
    off_line = (mean - slope * rate - intercept) / (mean[-1] - mean[0])
    loop = 2 * K * abs(half) / (mean[-1] - mean[0])
    return Truth(slope, intercept, np.abs(off_line).max(), off_line, loop)


@pytest.fixture(scope="module")
def calibrations() -> list[tuple[StrokeReadings, RateGyroResult, Truth]]:
    """Each unit on a table of its own, all three axes."""
    found = []
    for number, (seed, serial) in enumerate(UNITS):
        recording = recorded(
            "rate_gyro_triad", "eleven_point", seed=seed, serial=serial, stand_seed=number, **CALIBRATION
        )
        temperature_c = float(recording.stream("dut").columns["temp"].mean())
        for axis in (1, 2, 3):
            readings = readings_of(recording, axis)
            found.append(
                (readings, evaluate_rate_gyro(readings), truth_of(seed, serial, axis, temperature_c))
            )
    return found


def within(deviations: list[float], bound: float = 2.0, share: float = 0.85) -> bool:
    """Deviations in standard uncertainties: nearly all inside two of them, none beyond four."""
    sizes = np.abs(deviations)
    return bool((sizes <= bound).mean() >= share and sizes.max() <= 2 * bound)


def test_sensitivity_and_intercept_come_back_within_their_uncertainties(calibrations) -> None:
    """What the calibration cannot know is in the budget: the table's 1e-4, and for Y0 the turn-on of 0.01 °/s
    and the slow noise of some 0.007 °/s."""
    of_k, of_y0 = [], []
    for readings, result, truth in calibrations:
        line = result.lines["least_squares"]
        u_table = truth.sensitivity * 1e-4 / math.sqrt(3)
        u_k = math.hypot(readings.repeatability_v / math.sqrt(6 * 4.84), u_table)  # S_xx = 4.84 FS² = 44000
        of_k.append((line.sensitivity_v_per_rad_s - truth.sensitivity) / u_k)
        u_y0 = math.hypot(line.intercept_standard_uncertainty, K * math.radians(0.012))
        of_y0.append((line.intercept_v - truth.intercept_v) / u_y0)
        assert line.bias_v(TABLE) == pytest.approx(
            truth.intercept_v - truth.sensitivity * VERTICAL_EARTH_RATE, abs=4 * u_y0
        )
    assert within(of_k), of_k
    assert within(of_y0), of_y0
    assert np.std(of_k) > 0.3, "an uncertainty that is far too large tells nothing"


def test_one_table_s_rate_error_is_in_all_axes_of_its_unit(calibrations) -> None:
    """What only another table tells apart from the unit's scale factor: the same share for three axes."""
    shares = [effects[0].share for effects in map(drawn_errors, range(len(UNITS)))]
    found = np.array(
        [
            one.lines["least_squares"].sensitivity_v_per_rad_s / truth.sensitivity - 1
            for _, one, truth in calibrations
        ]
    ).reshape(-1, 3)
    np.testing.assert_allclose(found, np.array(shares)[:, np.newaxis].repeat(3, axis=1), atol=6e-5)
    assert np.corrcoef(found.mean(axis=1), shares)[0, 1] > 0.8


def test_linearity_and_hysteresis_come_back_within_their_uncertainties(calibrations) -> None:
    of_points, of_loop = [], []
    for readings, result, truth in calibrations:
        line = fit_line(readings)
        for point in (0, 5, 10):
            budget = linearity_budget(readings, line, TABLE, CONVERTERS, point)
            of_points.append((budget.estimate - truth.point_linearity[point]) / budget.standard_uncertainty)
        # the largest of eleven differences lies above the mean one by some uncertainties
        of_loop.append((result.hysteresis - truth.hysteresis) / result.hysteresis_standard_uncertainty - 1.3)
        assert 0 < truth.linearity < 2e-3, "the class of the paper's unit"
        assert result.linearity["minimax"] <= result.linearity["least_squares"]
    assert within(of_points), of_points
    assert within(of_loop), of_loop


def test_the_paper_s_figures_are_a_likely_unit(calibrations) -> None:
    """K = 0.050698 V/(°/s), Y0 = −1.116 mV, Y_FS = 10.1369 V, linearity of a class of 0.2 %, repeatability
    of one reading 1.5 mV by the range of both strokes: inside what the lots bring forth."""
    k = np.array(
        [math.radians(one.lines["least_squares"].sensitivity_v_per_rad_s) for _, one, _ in calibrations]
    )
    y0 = np.array([one.lines["least_squares"].intercept_v for _, one, _ in calibrations])
    full_scale = np.array([one.full_scale_v for _, one, _ in calibrations])
    assert np.abs(k.mean() / 0.050698 - 1) < 3e-3
    assert 1e-3 < k.std() / k.mean() < 6e-3
    assert abs(y0.mean() - -1.116e-3) < 1.5e-3
    assert full_scale.min() < 10.1369 < full_scale.max()
    worst = np.array([one.linearity["least_squares"] for _, one, _ in calibrations])
    assert 1e-4 < np.median(worst) < worst.max() < 2e-3
    both = [np.ptp([*readings.up_v[:, 9], *readings.down_v[:, 9]]) / 2.53 for readings, _, _ in calibrations]
    assert 5e-4 < np.median(both) < 2e-3

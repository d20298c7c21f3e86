"""Swing: lag, clock drift, scale factor error, what is left; on angles made by hand and emulated units."""

import dataclasses
import math

import numpy as np
import pytest

from calibration.algorithms.swing import SwingSamples, fit_swing, swing_cycles
from calibration.evaluations.method_evaluation import MethodEvaluation
from calibration.evaluations.swing import evaluate_swing
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.recorder import recorded
from protocol.errors import CalibrationError
from protocol.recordings import Recording
from tests.calibration.shaped_noise import check_coverage, exponential, white

AMPLITUDE, OMEGA = math.radians(80.0), 2.5
PERIOD_S = 2.0 * math.pi / OMEGA


def theta(t: np.ndarray, cycles: int) -> tuple[np.ndarray, np.ndarray]:
    """Rest, whole periods from -80 deg on, rest; its rate."""
    phase = np.clip(OMEGA * (t - 2.0), 0.0, 2.0 * math.pi * cycles)
    inside = (phase > 0.0) & (phase < 2.0 * math.pi * cycles)
    return -AMPLITUDE * np.cos(phase), np.where(inside, AMPLITUDE * OMEGA * np.sin(phase), 0.0)


def swung(
    lag_s: float = 0.0,
    drift: float = 0.0,
    scale: float = 0.0,
    cycles: int = 12,
    added: np.ndarray | float = 0.0,
) -> SwingSamples:
    """Exact angles of both sides; `added`: to the unit's."""
    end_s = 4.0 + cycles * PERIOD_S
    unit, stand = np.arange(0.0, end_s, 0.005), np.arange(0.0, end_s, 0.002)
    angle = (1.0 + scale) * theta(unit / (1.0 + drift) - lag_s, cycles)[0]
    return SwingSamples(unit, angle + added, stand, *theta(stand, cycles))


def samples_of(cycles: int = 12) -> int:
    return len(np.arange(0.0, 4.0 + cycles * PERIOD_S, 0.005))


def test_lag_drift_and_scale_of_exact_angles() -> None:
    found = fit_swing(swung(lag_s=0.0131, drift=30e-6, scale=-0.004))
    assert found.lag_s == pytest.approx(0.0131, abs=3e-6), "it grows by 75 µs in a cycle"
    assert found.clock_drift == pytest.approx(30e-6, abs=5e-9)
    assert found.scale_factor_error == pytest.approx(-0.004, abs=4e-6), "linear interpolation"
    assert found.cycles == 11, "the swing begins at its end: the first crossing is a quarter later"
    assert math.degrees(found.peak_rate_rad_s) == pytest.approx(200.0, rel=1e-3)
    assert found.period_s == pytest.approx(PERIOD_S, rel=1e-5)
    # 13 ms at 200 deg/s are paper 2's 2.6 deg; what the lag is not is 0.4 % of 80 deg
    lag_alone = fit_swing(swung(lag_s=0.013))
    assert math.degrees(lag_alone.largest_rad) == pytest.approx(2.6, abs=0.01)
    assert math.degrees(lag_alone.error.largest) < 1e-3
    assert math.degrees(found.error.largest) == pytest.approx(0.004 * 80.0, rel=0.01)
    assert found.error.sigma == pytest.approx(0.004 * AMPLITUDE / math.sqrt(2.0), rel=0.01)


def test_lags_of_many_samples_and_early_ones_are_found() -> None:
    for lag_s in (-0.2, 0.15):
        assert fit_swing(swung(lag_s=lag_s)).lag_s == pytest.approx(lag_s, abs=1e-6)


def test_a_slow_zero_does_not_matter_and_g_sensitivity_looks_like_a_lag() -> None:
    t = np.arange(samples_of()) * 0.005
    slow = 0.02 * np.sin(t / 30.0) + 1e-3 * t
    assert fit_swing(swung(lag_s=0.003, added=slow)).lag_s == pytest.approx(0.003, abs=5e-6)
    # a rate of 0.01 deg/s per g of the side that gravity falls on: sin(angle)
    rate = math.radians(0.01) * np.sin(theta(t, 12)[0])
    integral = np.cumsum(rate) * 0.005
    found = fit_swing(swung(lag_s=0.003, added=integral), {"y": integral / math.radians(0.01)})
    predicted = math.radians(0.01) * found.lag_per_error["y"]
    assert found.lag_s - 0.003 == pytest.approx(predicted, rel=0.02)
    assert 5e-6 < abs(predicted) < 5e-5


def test_what_is_no_swing_is_said() -> None:
    good = swung()
    with pytest.raises(CalibrationError, match="3 of 3 whole cycles have samples: 4 are needed"):
        fit_swing(swung(cycles=4))
    still = dataclasses.replace(good, stand_angle_rad=np.zeros_like(good.stand_angle_rad))
    with pytest.raises(CalibrationError, match="did not swing"):
        fit_swing(still)
    with pytest.raises(CalibrationError, match="does not follow the stand"):
        fit_swing(dataclasses.replace(good, unit_angle_rad=np.zeros_like(good.unit_angle_rad)))
    holed = good.unit_angle_rad.copy()
    holed[(good.unit_time_s > 10.0) & (good.unit_time_s < 11.0)] = np.nan
    with_hole = fit_swing(dataclasses.replace(good, unit_angle_rad=holed))
    assert (with_hole.cycles, with_hole.cycles_lost) == (10, 1)
    begun_anew = fit_swing(dataclasses.replace(good, breaks_s=(10.0, 10.1, 20.0)))
    assert begun_anew.cycles_lost == 2
    assert len(swing_cycles(good)) == 11


@pytest.mark.parametrize("noise", [pytest.param("white rates", marks=pytest.mark.slow), "coloured rates"])
def test_intervals_cover_on_noise_from_elsewhere(noise: str) -> None:
    """200 swings at once: lag, drift and scale factor with the scatter's uncertainty."""
    rng = np.random.default_rng(7)
    period_s, records, cycles = 0.02, 200, 10
    t = np.arange(0.0, 4.0 + cycles * PERIOD_S, period_s)
    rates = white(rng, len(t), records, (math.radians(0.3) / 60) ** 2, period_s)
    if noise == "coloured rates":
        rates = rates + exponential(rng, len(t), records, math.radians(0.02), 8.0, period_s)
    errors = np.cumsum(rates, axis=0) * period_s
    stand = np.arange(0.0, t[-1], 0.004)
    of_stand = theta(stand, cycles)
    exact = 1.002 * theta(t / (1.0 + 5e-6) - 0.0035, cycles)[0]
    pulls = []
    for k in range(records):
        found = fit_swing(SwingSamples(t, exact + errors[:, k], stand, *of_stand))
        freedom = found.cycles - 2
        widened = np.sqrt(np.diag(found.covariance) * freedom / (freedom - 2))
        off = np.array([found.lag_s - 0.0035, found.clock_drift - 5e-6, found.scale_factor_error - 0.002])
        pulls.append(off / widened)
    check_coverage(np.array(pulls), less=0.03)


def evaluated(recording: Recording) -> MethodEvaluation:
    return evaluate_swing((recording,))


def quantity(found: MethodEvaluation, sensor: str, name: str) -> tuple[float, float]:
    (content,) = (result.content for result in found.results if result.sensor == sensor)
    (one,) = (one for one in content.quantities if one.name == name)
    assert one.standard_uncertainty is not None
    return one.value, one.standard_uncertainty


def true_lag_s(product: str, serial: str, seed: int = 1) -> float:
    """Delay of the link and of the gyros' filter."""
    twin = product_named(product).twin(seed, serial)
    of_gyro = {effect.word: effect for effect in twin.effects if effect.sensor == "gyro"}
    delay = getattr(of_gyro.get("fixed_delay"), "delay_s", 0.0)
    return float(delay) + float(getattr(of_gyro.get("bandwidth"), "time_constant_s", 0.0))


def test_a_trigger_separates_the_lag_and_without_one_only_the_sum_is_told() -> None:
    values = {"cycles": 6.0}
    joined = evaluated(recorded("mems_ahrs", "swing", values=values, seed=3))
    apart = evaluated(recorded("mems_ahrs", "swing", values=values, seed=3, triggered=False))
    assert [result.sensor for result in joined.results] == ["attitude", "gyro_x"]
    lag, u = quantity(joined, "attitude", "lag")
    assert abs(lag - true_lag_s("mems_ahrs", "U-0001", 3)) < 3.0 * u
    assert u < 5e-5
    both, _ = quantity(apart, "attitude", "lag_and_clock_offset")
    assert both == pytest.approx(lag - 0.013, abs=1e-4)
    assert all(one.name != "lag" for result in apart.results for one in result.content.quantities)
    assert any("cannot separate" in sentence for sentence in apart.assumptions)
    # the error of the attitude is the same with and without: the offset is not counted as one
    assert quantity(apart, "attitude", "attitude_error")[0] == pytest.approx(
        quantity(joined, "attitude", "attitude_error")[0], rel=1e-2
    )
    beside = {one.name: one.value for one in apart.results[0].beside}
    assert beside["13 ms between clocks at 200 °/s, which is the same"] == pytest.approx(2.6)
    assert (beside["largest difference from the stand, as recorded"] or 0.0) > 1.4
    # the unit's own figures carry its scale factor error, the compensated gyro has none
    assert abs(quantity(joined, "gyro_x", "scale_factor_error")[0]) < 1e-3


def test_a_module_without_attitude_is_evaluated_by_its_gyros_and_its_crystal_is_found() -> None:
    found = evaluated(recorded("gnc_module", "swing", values={"cycles": 6.0}))
    assert [result.sensor for result in found.results] == ["gyro_x"]
    twin = product_named("gnc_module").twin(1, "U-0001")
    (drift,) = (
        one.relative_rate for one in twin.effects if (one.sensor, one.word) == ("gyro", "clock_drift")
    )
    value, u = quantity(found, "gyro_x", "clock_drift")
    assert abs(value - drift) < 3.0 * u


def test_a_swing_beyond_the_gyros_range_and_a_stand_without_angles_are_refused() -> None:
    recording = recorded("mems_ahrs", "swing", values={"cycles": 4.0, "peak_rate_deg_s": 120.0}, seed=3)
    gyro = {**recording.believed["gyro"], "range": 100.0}
    short = dataclasses.replace(recording, believed={**recording.believed, "gyro": gyro})
    with pytest.raises(CalibrationError, match="beyond the gyros' range"):
        evaluated(short)
    stand = recording.streams["stand"]
    kept = {name: column for name, column in stand.columns.items() if not name.startswith("angle")}
    blind = dataclasses.replace(stand, columns=kept, units={name: stand.units[name] for name in kept})
    with pytest.raises(CalibrationError, match="angles are not recorded"):
        evaluated(dataclasses.replace(recording, streams={**recording.streams, "stand": blind}))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_lag_of_200_emulated_units_is_covered() -> None:
    pulls: list[list[float]] = []
    dead = 0
    for number in range(1, 201):
        serial = f"U-{number:04d}"
        try:
            found = evaluated(recorded("mems_ahrs", "swing", values={"cycles": 6.0}, serial=serial))
        except CalibrationError:  # a dead gyro does not follow
            dead += 1
            continue
        if len(found.results) < 2:
            dead += 1
            continue
        true = true_lag_s("mems_ahrs", serial)
        pulls.append([(v - true) / u for v, u in (quantity(found, s, "lag") for s in ("attitude", "gyro_x"))])
    assert dead <= 10
    check_coverage(np.array(pulls), more=0.16)

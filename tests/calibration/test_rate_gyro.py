"""Paper 4: lines, linearity, budgets. The oracle figures were computed independently from the physics."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.algorithms.rate_gyro import (
    LINE_METHODS,
    evaluate_rate_gyro,
    fit_line,
    leverage,
    line_weights,
    range_repeatability,
    residuals,
)
from calibration.algorithms.rate_gyro_uncertainty import (
    LinearityTerms,
    Multimeter,
    gum_holds,
    independent_budget,
    linearity_budget,
    monte_carlo_linearity,
)
from calibration.algorithms.rate_table_readings import (
    RateTable,
    StrokeReadings,
    choose_points,
    equal_points,
)
from protocol.errors import CalibrationError, Fault

VECTORS = json.loads((Path(__file__).parent / "vectors_rate_gyro.json").read_text(encoding="utf-8"))
FIT = VECTORS["fit_vector"]
RATE = np.deg2rad(FIT["R"])
RUNS = np.array(FIT["runs_V_6x11"])
TABLE = RateTable(math.radians(5.0), math.radians(1450.0), 1e-4, earth_rate_on_axis_rad_s=4.0e-5)
METER = Multimeter(reading_part=3.5e-5, range_part=5e-6, range_v=10.0)
POINTS = choose_points(RATE, TABLE, locked_at_zero=True)
PAPER_RUNS = StrokeReadings(POINTS, RUNS[::2], RUNS[1::2])


def simulated(seed: int, noise_v: float = 1e-3, cycles: int = 3) -> StrokeReadings:
    """A perfectly linear gyro: K = 2.9 V/(rad/s), Y_0 = -1 mV."""
    noise = np.random.default_rng(seed).normal(0.0, noise_v, (2, cycles, len(RATE)))
    return StrokeReadings(POINTS, *(-0.001 + 2.9 * RATE + noise))


@pytest.mark.parametrize(
    ("method", "name"),
    [
        ("least_squares", "least_squares"),
        ("end_point", "end_point"),
        ("two_halves", "averaging_two_halves"),
        ("minimax", "minimax"),
    ],
)
def test_each_line_of_the_oracle(method, name: str) -> None:
    result, expected = evaluate_rate_gyro(PAPER_RUNS), FIT[name]
    line = result.lines[method]
    np.testing.assert_allclose(PAPER_RUNS.mean_v, FIT["mean"], atol=5e-7)
    assert PAPER_RUNS.full_scale_v == pytest.approx(FIT["YFS"], abs=1e-9)
    assert np.deg2rad(line.sensitivity_v_per_rad_s) == pytest.approx(expected["K"], abs=6e-10)
    assert line.intercept_v == pytest.approx(expected["Y0"], abs=6e-10)
    assert result.linearity[method] == pytest.approx(expected["linearity"], abs=6e-10)
    if method == "least_squares":
        assert line.scatter_v == pytest.approx(expected["s_resid_n_minus_2"], abs=6e-10)
        assert np.deg2rad(line.sensitivity_standard_uncertainty) == pytest.approx(expected["uK"], abs=6e-13)
        assert line.intercept_standard_uncertainty == pytest.approx(expected["uY0"], abs=6e-10)


def test_least_squares_is_not_the_line_of_least_nonlinearity() -> None:
    """Paper 4 says that it is."""
    linearity = evaluate_rate_gyro(PAPER_RUNS).linearity
    assert linearity["minimax"] < linearity["least_squares"] < linearity["two_halves"]
    assert min(linearity, key=linearity.__getitem__) == "minimax"


def test_hysteresis_and_repeatability_of_the_oracle_runs() -> None:
    """Runs differ by whole shifts: up +0.4 +0.1 +0.3, down -0.2 -0.5 -0.1 mV."""
    result = evaluate_rate_gyro(PAPER_RUNS)
    assert result.hysteresis * result.full_scale_v == pytest.approx((0.8 + 0.8) / 3 * 1e-3, abs=1e-9)
    pooled = math.sqrt(np.var([0.4, 0.1, 0.3], ddof=1) / 2 + np.var([0.2, 0.5, 0.1], ddof=1) / 2) * 1e-3
    assert result.repeatability * result.full_scale_v == pytest.approx(pooled, rel=1e-6)
    spread, freedom = range_repeatability(np.array([5.0693, 5.0655, 5.067, 5.068, 5.066, 5.069]))
    assert spread == pytest.approx(VECTORS["u2_yi"], abs=6e-10)
    assert spread / math.sqrt(6) == pytest.approx(VECTORS["u2_yi_if_mean_of_6"], abs=6e-10)
    assert freedom == 4.5
    with pytest.raises(CalibrationError, match="2 to 9 readings"):
        range_repeatability(np.zeros(12))


def paper_terms(u_rate: float, u_sensitivity: float = 0.000013) -> LinearityTerms:
    given_inputs = VECTORS["inputs"]
    return LinearityTerms(
        rate=given_inputs["Ri"],
        rate_unit="deg/s",
        sensitivity=given_inputs["K"],
        intercept_v=given_inputs["Y0"],
        reading_v=5.0693,
        full_scale_v=given_inputs["YFS"],
        u_rate=u_rate,
        u_sensitivity=u_sensitivity,
        u_intercept_v=0.00084,
        u_reading_v=0.00151,
    )


def test_the_papers_budget_and_its_correction_beside_it() -> None:
    printed = independent_budget(paper_terms(VECTORS["u_Ri_paper"]), "as printed")
    corrected = independent_budget(paper_terms(VECTORS["u_Ri_corrected_deg_s"]), "u(R) relative")
    sensitivities = [VECTORS["sensitivity"][name] for name in ("yi", "Y0", "K", "Ri")]
    np.testing.assert_allclose([row.sensitivity for row in printed.rows], sensitivities, atol=6e-9)
    terms = [row.contribution for row in printed.rows]
    np.testing.assert_allclose(terms, VECTORS["terms_paper"], atol=6e-13)
    assert corrected.rows[3].contribution == pytest.approx(VECTORS["term_Ri_corrected"], abs=6e-12)
    assert printed.standard_uncertainty == pytest.approx(VECTORS["u_l_paper"], abs=6e-10)
    assert corrected.standard_uncertainty == pytest.approx(VECTORS["u_l_Ri_corrected"], abs=6e-10)
    assert printed.expanded_uncertainty() == pytest.approx(VECTORS["U_k2_paper"], abs=1.2e-9)
    assert corrected.expanded_uncertainty() == pytest.approx(VECTORS["U_k2_corrected"], abs=1.2e-9)
    assert f"{corrected.expanded_uncertainty():.3%}" == "0.043%"  # not the 0.05 % of two roundings
    check = corrected.against_limit(0.002)
    assert check.good_enough
    assert check.ratio == pytest.approx(0.2153, abs=1e-4)
    assert not corrected.against_limit(0.00125).good_enough
    # Without the paper's rounding of u(K) and u(y).
    assert METER.bound_v(np.array(5.0)) == pytest.approx(VECTORS["inputs"]["dmm_mpe_V"], rel=1e-12)
    u_y = math.hypot(VECTORS["inputs"]["dmm_mpe_V"] / math.sqrt(3), VECTORS["u2_yi"])
    assert u_y == pytest.approx(VECTORS["u_yi"], abs=6e-10)
    per_volt = 1.0 / VECTORS["inputs"]["YFS"]
    u_k = VECTORS["s_resid_implied_by_uY0_0.00084"] / math.sqrt(VECTORS["Sxx_11pt"])
    unrounded = per_volt * math.hypot(u_y, 0.00084, 100.0 * u_k)
    assert unrounded == pytest.approx(VECTORS["u_l_paper_unrounded"], abs=6e-10)


def test_the_tables_rate_uncertainty_is_relative_and_none_at_rest() -> None:
    u = TABLE.rate_standard_uncertainty_rad_s(RATE)
    assert np.rad2deg(u[-1]) == pytest.approx(VECTORS["u_Ri_corrected_deg_s"], abs=6e-10)
    assert u[5] == 0.0


def test_a_residual_follows_its_own_reading() -> None:
    h = leverage(RATE)
    s, full_scale = VECTORS["s_resid_implied_by_uY0_0.00084"], VECTORS["inputs"]["YFS"]
    assert h[-1] == pytest.approx(VECTORS["leverage_end_point"], abs=6e-10)
    assert s * math.sqrt(1 - h[-1]) / full_scale == pytest.approx(
        VECTORS["sd_residual_fitted_point"], abs=1.2e-9
    )
    assert s * math.sqrt(1 + h[-1]) / full_scale == pytest.approx(
        VECTORS["sd_prediction_new_point"], abs=1.2e-9
    )
    drawn = np.random.default_rng(4).normal(0.0, s, (40_000, 11))
    relative = residuals("least_squares", RATE, drawn) / full_scale
    assert relative[:, -1].std() == pytest.approx(VECTORS["mc_sd_residual_end"], rel=0.015)
    assert np.abs(relative).max(axis=1).mean() == pytest.approx(
        VECTORS["mc_bias_max_abs_linearity"], rel=0.015
    )
    readings = simulated(1)
    budget = linearity_budget(readings, fit_line(readings), TABLE, METER, -1)
    expected = math.sqrt(1 - h[-1]) / readings.full_scale_v
    assert budget.rows[0].sensitivity == pytest.approx(expected, rel=1e-12)


def test_monte_carlo_and_gum_agree_and_a_straight_line_has_no_zero_linearity() -> None:
    readings = simulated(2)
    found = monte_carlo_linearity(readings, "least_squares", TABLE, METER, np.random.default_rng(5))
    for point in (0, 5, 10):
        budget = linearity_budget(readings, fit_line(readings), TABLE, METER, point)
        assert found.point_standard_uncertainty[point] == pytest.approx(budget.standard_uncertainty, rel=0.03)
        assert found.point_mean[point] == pytest.approx(
            budget.estimate, abs=0.04 * budget.standard_uncertainty
        )
        low, high = found.point_interval[:, point]
        assert gum_holds(budget, (float(low), float(high)))
    assert 0 < found.straight_line_mean < found.straight_line_95
    again = monte_carlo_linearity(readings, "least_squares", TABLE, METER, np.random.default_rng(5))
    assert again.maximum_interval == found.maximum_interval


@pytest.mark.parametrize("method", LINE_METHODS)
def test_monte_carlo_propagates_every_line(method) -> None:
    found = monte_carlo_linearity(simulated(3), method, TABLE, METER, np.random.default_rng(6), trials=2_000)
    assert found.maximum_interval[0] < found.maximum_mean < found.maximum_interval[1]
    if method == "end_point":
        np.testing.assert_allclose(found.point_mean[[0, -1]], 0.0, atol=1e-12)


def test_stated_uncertainties_cover_the_truth_at_their_rate() -> None:
    """300 gyros with white readings: K and Y_0 by the t of n - 2, the end's linearity by its budget."""
    k_in, end_in, linear_in = [], [], []
    blunt = Multimeter(0.0, 0.0, 10.0)
    perfect = RateTable(0.0, 100.0, 0.0, 0.0)
    for seed in range(300):
        readings = simulated(seed)
        line = fit_line(readings)
        k_in.append(abs(line.sensitivity_v_per_rad_s - 2.9) / line.sensitivity_standard_uncertainty)
        ends = evaluate_rate_gyro(readings).lines["end_point"]
        end_in.append(abs(ends.intercept_v + 0.001) / ends.intercept_standard_uncertainty)
        budget = linearity_budget(readings, line, perfect, blunt, -1)
        linear_in.append(abs(budget.estimate) / budget.standard_uncertainty)
    for pulls, one, two in ((k_in, 1.059, 2.262), (end_in, 1.059, 2.262), (linear_in, 1.011, 2.015)):
        assert (np.array(pulls) < one).mean() == pytest.approx(0.683, abs=0.08)
        assert (np.array(pulls) < two).mean() == pytest.approx(0.95, abs=0.038)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(-1000, 1000), min_size=3, max_size=25, unique=True),
    st.integers(0, 2**32 - 1),
)
def test_the_minimax_line_beats_every_other(rates: list[int], seed: int) -> None:
    rate = np.sort(np.array(rates, dtype=np.float64))
    y = np.random.default_rng(seed).normal(size=len(rate)) + 3.0 * rate
    largest = {m: float(np.abs(residuals(m, rate, y[None])[0]).max()) for m in LINE_METHODS}
    assert all(largest["minimax"] <= value + 1e-9 for value in largest.values())
    for slope_change in (-1e-3, 1e-3):
        moved = y - (line_weights("minimax", rate, y) @ y)[1] * rate - slope_change * rate
        assert np.ptp(moved) / 2 >= largest["minimax"] - 1e-9
    # The three points of the line carry it: the weights give the same residuals.
    own = y - np.column_stack([np.ones(len(rate)), rate]) @ (line_weights("minimax", rate, y) @ y)
    assert np.abs(own).max() == pytest.approx(largest["minimax"], abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.floats(-5, 5), st.floats(0.1, 10) | st.floats(-10, -0.1), st.sampled_from(LINE_METHODS))
def test_lines_follow_a_change_of_scale_and_bias(shift: float, scale: float, method) -> None:
    base = simulated(8)
    moved = StrokeReadings(POINTS, shift + scale * base.up_v, shift + scale * base.down_v)
    one, two = evaluate_rate_gyro(base), evaluate_rate_gyro(moved)
    assert two.lines[method].sensitivity_v_per_rad_s == pytest.approx(
        scale * one.lines[method].sensitivity_v_per_rad_s, rel=1e-9
    )
    assert two.linearity[method] == pytest.approx(one.linearity[method], rel=1e-6, abs=1e-12)


def test_zero_is_below_what_the_table_holds() -> None:
    eleven = equal_points(math.radians(100.0), 11)
    assert eleven[5] == 0.0
    with pytest.raises(CalibrationError, match="only be taken with the table locked") as refused:
        choose_points(eleven, TABLE, locked_at_zero=False)
    assert refused.value.fault is Fault.PLAN
    points = choose_points(eleven, TABLE, locked_at_zero=True)
    np.testing.assert_array_equal(points.locked, eleven == 0.0)
    with pytest.raises(CalibrationError, match="The table holds"):
        choose_points(np.deg2rad([-10.0, 3.0, 10.0]), TABLE, locked_at_zero=True)
    with pytest.raises(CalibrationError, match="named twice"):
        choose_points(np.deg2rad([10.0, -10.0, 10.0]), TABLE, locked_at_zero=True)
    with pytest.raises(CalibrationError, match="3 to 201 points"):
        choose_points(np.deg2rad([10.0, -10.0]), TABLE, locked_at_zero=True)
    np.testing.assert_allclose(
        choose_points(np.deg2rad([60.0, -10.0, 7.5, -90.0]), TABLE, locked_at_zero=False).rate_rad_s,
        np.deg2rad([-90.0, -10.0, 7.5, 60.0]),
    )


def test_the_earths_rotation_moves_the_bias_and_nothing_else() -> None:
    line = fit_line(PAPER_RUNS)
    assert line.bias_v(TABLE) == pytest.approx(line.intercept_v - line.sensitivity_v_per_rad_s * 4.0e-5)


def test_what_cannot_be_used_is_said() -> None:
    readings = simulated(9, cycles=3)
    holed = readings.up_v.copy()
    holed[1, 4] = np.nan
    with pytest.raises(CalibrationError, match=r"up stroke 2 at -0.349066 rad/s is missing"):
        StrokeReadings(POINTS, holed, readings.down_v)
    with pytest.raises(CalibrationError, match="at the end of the range"):
        StrokeReadings(POINTS, readings.up_v, readings.down_v, range_limit_v=5.0)
    with pytest.raises(CalibrationError, match="repeatability takes as many"):
        StrokeReadings(POINTS, readings.up_v[:1], readings.down_v[:1])
    with pytest.raises(CalibrationError, match="does not follow the rate"):
        fit_line(StrokeReadings(POINTS, readings.up_v * 0, readings.down_v * 0))
    assert readings.suspects() == ()
    spoiled = readings.down_v.copy()
    spoiled[2, 7] += 0.05
    (suspect,) = StrokeReadings(POINTS, readings.up_v, spoiled).suspects()
    assert (suspect.stroke, suspect.cycle) == ("down", 3)
    assert suspect.rate_rad_s == pytest.approx(RATE[7])
    with pytest.raises(CalibrationError, match="no point 11"):
        linearity_budget(readings, fit_line(readings), TABLE, METER, 11)
    with pytest.raises(CalibrationError, match="trials are not between"):
        monte_carlo_linearity(readings, "minimax", TABLE, METER, np.random.default_rng(0), trials=10)

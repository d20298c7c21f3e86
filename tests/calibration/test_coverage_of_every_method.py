"""Each method of a record has tests that hold its intervals: through the emulator, and on coloured noise.

A method that is new fails this test until it has both; repeatability counts once for each figure that it is
told of. The table of docs/calibration.md names the same tests.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent

EMULATED, COLOURED = 0, 1
COVERED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "imu_calibration": (
        (
            "test_coverage_stand_profiles::test_sessions_of_emulated_units_are_covered",
            "test_coverage_sessions::test_emulated_units_on_imperfect_stands_are_covered",
        ),
        (
            "test_coverage_sessions::test_sessions_on_imperfect_stands_are_covered",
            "test_coverage_stand_profiles::test_a_clock_is_told_by_turns_also_on_coloured_noise",
        ),
    ),
    "ferraris": (
        ("test_coverage_units_of_a_lot::test_ferraris_sessions_are_covered",),
        ("test_coverage_units_of_a_lot::test_ferraris_sessions_are_covered_on_coloured_noise",),
    ),
    "multi_position": (
        (
            "test_coverage_units_of_a_lot::test_unknown_attitudes_are_covered",
            "test_coverage_units_of_a_lot::test_gyros_from_gravity_are_covered",
        ),
        (
            "test_coverage_sessions::test_unknown_attitudes_are_covered_on_coloured_noise",
            "test_turned_gravity::test_intervals_cover_the_truth",
        ),
    ),
    "rate_gyro": (
        ("test_coverage_rate_gyro::test_emulated_units_are_covered",),
        ("test_coverage_rate_gyro::test_readings_of_another_code_are_covered",),
    ),
    "pure_lag": (
        ("test_coverage_pure_lag::test_emulated_gyros_are_covered",),
        ("test_coverage_pure_lag::test_bounds_are_covered_on_coloured_noise",),
    ),
    "sinusoidal_overload": (
        ("test_coverage_overload::test_emulated_units_are_covered",),
        ("test_coverage_overload::test_g_sensitivity_is_covered_on_coloured_noise",),
    ),
    "temperature_compensation": (
        ("test_coverage_over_temperature::test_two_hundred_units_are_covered_in_their_own_noise",),
        ("test_temperature_positions::test_two_hundred_units_are_covered_on_noise_of_another_maker",),
    ),
    "temperature_ramp": (
        ("test_temperature_ramp::test_two_hundred_emulated_triads_are_covered",),
        ("test_temperature_ramp::test_two_hundred_loops_are_covered",),
    ),
    "thermal_network": (
        ("test_coverage_over_temperature::test_two_hundred_warm_ups_of_the_emulators_model_are_covered",),
        ("test_coverage_over_temperature::test_warm_ups_are_covered_on_coloured_noise",),
    ),
    "magnetometer": (
        (
            "test_coverage_units_of_a_lot::test_magnetometers_turned_all_ways_are_covered",
            "test_magnetometer_coverage::test_spins_of_emulated_units_are_covered",
        ),
        ("test_magnetometer_coverage::test_iron_is_covered_also_on_coloured_noise",),
    ),
    "allan_variance": (
        ("test_coverage_units_of_a_lot::test_coefficients_of_plots_are_covered",),
        ("test_coverage_units_of_a_lot::test_coefficients_of_plots_are_covered",),
    ),
    "bias": (
        ("test_coverage_through_emulator::test_intervals_hold_the_truth_of_an_emulated_unit",),
        ("test_bias_figures::test_the_bias_holds_its_interval_where_the_slow_noise_is_stated",),
    ),
    "repeatability of bias": (
        ("test_coverage_repeatability::test_turn_on_biases_of_emulated_units_are_covered",),
        ("test_bias_figures::test_turn_on_repeatability_is_found_behind_the_noise",),
    ),
    "repeatability of scale_factor": (
        ("test_coverage_repeatability::test_turn_on_scale_factors_of_emulated_chains_are_covered",),
        ("test_coverage_repeatability::test_turn_on_scale_factors_are_covered_on_coloured_noise",),
    ),
    "rate_staircase": (
        ("test_coverage_through_emulator::test_intervals_hold_the_truth_of_an_emulated_unit",),
        ("test_scale_factor_figures::test_intervals_hold_in_white_and_in_slow_noise",),
    ),
    "frequency_response": (
        ("test_coverage_stand_profiles::test_delays_of_swept_units_are_covered",),
        ("test_frequency_response::test_intervals_hold_in_white_and_slow_noise",),
    ),
    "tumble": (
        ("test_coverage_through_emulator::test_intervals_hold_the_truth_of_an_emulated_unit",),
        ("test_tumble_g_sensitivity::test_intervals_hold_in_noise_with_a_memory",),
    ),
    "swing": (
        ("test_swing_fit::test_the_lag_of_200_emulated_units_is_covered",),
        ("test_swing_fit::test_intervals_cover_on_noise_from_elsewhere",),
    ),
    "attitude_error": (
        ("test_flight_evaluation::test_1_sigma_of_200_emulated_units_is_covered",),
        ("test_flight_evaluation::test_intervals_of_a_phase_cover_on_coloured_errors",),
    ),
}
REPEATED = "repeatability"
SPEAKS_OF = {
    "repeatability of bias": r"\bbias_repeatability\(",
    "repeatability of scale_factor": r"ScaleFactorError\(|staircase_figures\(",
}
"""What a test of that figure calls: another figure's test does not stand in for it."""
OF_200 = re.compile(r"\b(?:200|201|300)\b|UNITS|SEEDS|seeds|RECORDS|units\(|noise\(\)")


def methods_of_records() -> set[str]:
    """What makers of record contents write as method; of repeatability, what it is told of."""
    found: set[str] = set()
    repeated: set[str] = set()
    for path in (ROOT / "calibration").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            found |= {
                str(one.value.value)
                for one in node.keywords
                if one.arg == "method" and isinstance(one.value, ast.Constant)
            }
            if isinstance(node.func, ast.Name) and node.func.id == "repeatability_content":
                (figure,) = [one.value for one in node.args[:1] if isinstance(one, ast.Constant)]
                repeated.add(f"{REPEATED} of {figure}")
    assert REPEATED in found
    return (found - {REPEATED}) | repeated


def test_each_method_has_its_coverage() -> None:
    assert methods_of_records() == set(COVERED)
    assert all(tests for both in COVERED.values() for tests in both)


@pytest.mark.parametrize("method", sorted(COVERED))
def test_each_named_test_is_there_and_of_200(method: str) -> None:
    for tests in COVERED[method]:
        for name in tests:
            file, function = name.split("::")
            text = (HERE / f"{file}.py").read_text(encoding="utf-8")
            (found,) = [
                node
                for node in ast.walk(ast.parse(text))
                if isinstance(node, ast.FunctionDef) and node.name == function
            ]
            begin = min([found.lineno, *(one.lineno for one in found.decorator_list)])
            source = "\n".join(text.splitlines()[begin - 1 : found.end_lineno])
            assert "assert " in source or "check_" in source, name
            assert OF_200.search(source), name
            assert re.search(SPEAKS_OF.get(method, ""), source), name


def test_the_documentation_names_the_same_tests() -> None:
    text = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
    rows = {
        cells[1].strip(" `"): cells
        for line in text.split("## What holds the intervals", 1)[1].splitlines()
        if (cells := line.split("|")) and len(cells) == 5
    }
    for method, both in COVERED.items():
        for kind, tests in enumerate(both):
            named = rows[method][2 + kind]
            for file in {name.split("::")[0] for name in tests}:
                assert f"`{file}`" in named, (method, file)

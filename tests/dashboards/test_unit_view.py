"""A unit's view model: bars and margins against hand-computed places, problems, set-aside records."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from imagined_line import failed_then_passed, measurement

from dashboards.unit_view import limit_bar, measurement_row, unit_view
from protocol.measurements import Measurement, MeasurementSpecification
from protocol.outcomes import MeasurementOutcome, Outcome


def test_value_between_two_limits_stands_where_the_drawing_says() -> None:
    """Limits 4 and 6, a quarter of 2 on either side: the bar spans 3.5 to 6.5."""
    row = measurement_row(measurement("rail", 4.4, "V", 4.0, 6.0, u=0.1))
    assert row.bar is not None
    assert row.bar.low_at == pytest.approx(0.5 / 3)
    assert row.bar.high_at == pytest.approx(2.5 / 3)
    assert row.bar.value_at == pytest.approx(0.9 / 3)
    assert row.bar.spread == (pytest.approx(0.7 / 3), pytest.approx(1.1 / 3))
    assert row.margin == "0.4"
    assert row.margin_fraction == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("value", "edge", "off_scale"), [(3.4, 0.0, "low"), (6.6, 1.0, "high"), (6.4, 2.9 / 3, "")]
)
def test_value_outside_the_bar_is_marked(value: float, edge: float, off_scale: str) -> None:
    bar = limit_bar(value, 4.0, 6.0)
    assert bar is not None
    assert (bar.value_at, bar.off_scale) == (pytest.approx(edge), off_scale)
    row = measurement_row(measurement("rail", value, "V", 4.0, 6.0))
    assert row.outcome is MeasurementOutcome.FAIL
    assert row.margin.startswith("-")


limits = st.floats(-1e6, 1e6)


@given(limits, limits, st.floats(-1e7, 1e7))
def test_the_picture_agrees_with_the_judgement(one: float, other: float, value: float) -> None:
    """Whatever the numbers: the mark lies in the allowed band exactly when the limits are kept."""
    low, high = sorted((one, other))
    for chosen in ((low, high), (low, None), (None, high)):
        specification = MeasurementSpecification(name="x", low=chosen[0], high=chosen[1])
        bar = limit_bar(value, *chosen)
        assert bar is not None
        assert all(0 <= at <= 1 for at in (bar.value_at, bar.low_at, bar.high_at) if at is not None)
        inside = (bar.low_at is None or bar.value_at >= bar.low_at) and (
            bar.high_at is None or bar.value_at <= bar.high_at
        )
        if specification.judge(value) is MeasurementOutcome.PASS:
            assert inside
            assert bar.off_scale == ""
        elif bar.off_scale:
            assert bar.value_at in (0.0, 1.0)


@pytest.mark.parametrize("value", [None, "GNC-M1", True])
def test_what_is_no_number_has_no_bar(value: object) -> None:
    row = measurement_row(measurement("code", value, equals="GNC-M1"))  # type: ignore[arg-type]
    assert row.bar is None
    assert row.margin == ""
    assert row.equals == "GNC-M1"


def test_unmeasured_is_shown_as_unset() -> None:
    row = measurement_row(Measurement(specification=MeasurementSpecification(name="x", low=0.0, high=1.0)))
    assert (row.value, row.outcome, row.bar) == ("", MeasurementOutcome.UNSET, None)


def test_equal_limits_do_not_divide_by_zero() -> None:
    row = measurement_row(measurement("errors", 0, low=0.0, high=0.0))
    assert row.bar is not None
    assert math.isclose(row.bar.value_at, row.bar.low_at or 0.0)
    assert row.margin_fraction is None


def test_attempts_stand_in_the_order_of_their_start() -> None:
    view = unit_view(failed_then_passed())
    assert [(a.number, a.fence, a.outcome) for a in view.attempts] == [
        (1, 3, Outcome.FAIL),
        (2, 7, Outcome.ABORTED),
        (3, 9, Outcome.PASS),
        (4, 12, Outcome.PASS),
    ]
    assert [a.set_aside for a in view.attempts] == [False, True, False, False]
    assert view.set_aside == 1


def test_problems_name_the_measurement_that_failed() -> None:
    first = unit_view(failed_then_passed()).attempts[0]
    assert first.problems == ("power_rails: rail_3v3 = 3.02 V",)
    assert first.recordings == ()

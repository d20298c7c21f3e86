"""Limits are inclusive, a value that is no number is no PASS, and what was not measured is UNSET."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from protocol.measurements import Measurement, MeasurementSpecification
from protocol.outcomes import MeasurementOutcome

PASS, FAIL, UNSET, ERROR = (
    MeasurementOutcome.PASS,
    MeasurementOutcome.FAIL,
    MeasurementOutcome.UNSET,
    MeasurementOutcome.ERROR,
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def specification(**limits: object) -> MeasurementSpecification:
    return MeasurementSpecification.model_validate({"name": "value", **limits})


@given(FINITE, FINITE, FINITE)
def test_limits_are_inclusive(one, other, value):
    low, high = sorted((one, other))
    judged = specification(low=low, high=high)
    assert judged.judge(low) is judged.judge(high) is PASS
    assert (judged.judge(value) is PASS) == (low <= value <= high)
    assert judged.judge(math.nextafter(high, math.inf)) in (FAIL, ERROR)  # beyond the largest lies infinity
    assert (specification(low=low).judge(value) is PASS) == (value >= low)
    assert (specification(high=high).judge(value) is PASS) == (value <= high)


@pytest.mark.parametrize(
    "limits", [{}, {"low": 0.0}, {"high": 1.0}, {"low": 0.0, "high": 1.0}, {"equals": 1}]
)
def test_what_is_not_measured_or_no_number_never_passes(limits):
    judged = specification(**limits)
    assert judged.judge(None) is UNSET
    for value in (math.nan, math.inf, -math.inf):
        assert judged.judge(value) is ERROR


@pytest.mark.parametrize("value", [True, "0.5"])
def test_a_word_is_not_held_against_limits(value):
    assert specification(low=0.0, high=1.0).judge(value) is ERROR


@pytest.mark.parametrize(
    ("equals", "value", "outcome"),
    [
        (True, True, PASS),
        (True, False, FAIL),
        (True, 1, FAIL),
        (1, True, FAIL),
        (3, 3.0, PASS),
        (3.0, 3, PASS),
        (3, 4, FAIL),
        ("U-1", "U-1", PASS),
        ("1", 1, FAIL),
    ],
)
def test_equals_tells_numbers_words_and_truth_apart(equals, value, outcome):
    assert specification(equals=equals).judge(value) is outcome


@pytest.mark.parametrize(
    "limits",
    [
        {"low": 2.0, "high": 1.0},
        {"unit": "furlong"},
        {"equals": 1, "low": 0.0},
        {"low": math.nan},
        {"high": math.inf},
        {"standard_uncertainty": -1.0},
        {"low": "1"},
    ],
)
def test_a_specification_that_cannot_be_judged_by_is_refused(limits):
    with pytest.raises(ValidationError):
        specification(**limits)


@given(st.none() | st.booleans() | st.integers(-(2**53), 2**53) | FINITE | st.text(max_size=5))
def test_a_measurement_survives_the_wire(value):
    spec = specification(low=0.0)
    measurement = Measurement(specification=spec, value=value, outcome=spec.judge(value))
    back = Measurement.model_validate_json(measurement.model_dump_json())
    assert back == measurement
    assert type(back.value) is type(value)

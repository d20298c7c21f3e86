"""Numbers on a certificate, against figures rounded by hand."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.certificate.rounding import SUPERSCRIPTS, column, interval, plain, with_uncertainty

BACK = {written: plain_ for plain_, written in SUPERSCRIPTS.items()}


def number(text: str) -> float:
    found = re.fullmatch(r"(−?[0-9.]+)(?: × 10(.+))?", text)
    assert found
    power = (found[2] or "⁰").translate(BACK)
    return float(found[1].replace("−", "-")) * 10.0 ** int(power)


@pytest.mark.parametrize(
    ("value", "uncertainty", "written"),
    [
        (1.00023456, 1.23e-5, ("1.000235", "0.000012")),
        (-3.21e-5, 1.2e-8, ("−3.2100 × 10⁻⁵", "0.0012 × 10⁻⁵")),
        (5.0, 0.0999, ("5.00", "0.10")),  # rounds up to two digits, not three
        (12.0, 15.6, ("12", "16")),
        (123456.0, 1234.0, ("1.235 × 10⁵", "0.012 × 10⁵")),  # 123 456 would claim digits that are not known
        (2.5, 1.0, ("2.5", "1.0")),
        (9.80665, 0.0, ("9.80665", "0")),
        (-1e-9, 0.12, ("0.00", "0.12")),
    ],
)
def test_a_value_ends_where_its_uncertainty_does(
    value: float, uncertainty: float, written: tuple[str, str]
) -> None:
    assert with_uncertainty(value, uncertainty) == written


@given(st.floats(-1e8, 1e8), st.floats(1e-9, 1e6))
def test_rounding_moves_a_value_by_less_than_a_twentieth_of_its_uncertainty(value: float, u: float) -> None:
    written, spread = (number(text) for text in with_uncertainty(value, u))
    assert abs(written - value) <= 0.0501 * u + 1e-12 * abs(value)
    assert abs(spread - u) <= 0.0501 * u


def test_intervals_and_columns_end_at_one_place() -> None:
    assert interval(239.27, 245.19, 242.23) == ("239.27", "245.19", "242.23")
    assert interval(0.0, 0.00254, 0.0) == ("0", "0.00254", "0")
    assert column([1.0, 2.5, -3.123456789], 5) == (("1.0000", "2.5000", "−3.1235"), 0)
    assert column([5.0693, 5.0655, 0.0], 7) == (("5.0693", "5.0655", "0.0000"), 0)
    assert column([1e-6, -2.2222e-7], 4) == (("1.000", "−0.222"), -6)
    assert column([0.0, 100.0], 6) == (("0", "100"), 0)


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [
        (0.1, 6, "0.1"),
        (100.0, 5, "100"),
        (1.23e-9, 3, "1.23 × 10⁻⁹"),
        (9.99997e-7, 5, "1.0000 × 10⁻⁶"),
        (-2.0, 3, "−2"),
        (0.0, 3, "0"),
    ],
)
def test_a_number_alone_has_no_zeros_that_say_nothing(value: float, digits: int, written: str) -> None:
    assert plain(value, digits) == written

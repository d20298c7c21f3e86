"""Factors against figures worked out by hand, and keys that cannot be mistaken for others."""

import math

import pytest

from protocol import keys
from protocol.errors import TestloomError
from protocol.units_of_measure import KNOWN_UNITS, conversion_factor, factor_to_si, is_known_unit, quantity_of

RECORDING_UNITS = (  # those that the folder form accepts
    *("deg", "deg/s", "deg/h", "deg/sqrt(h)", "deg/s/sqrt(Hz)", "m/s/sqrt(h)", "ug/sqrt(Hz)", "rad", "rad/s"),
    *("g", "mg", "ug", "m/s^2", "uT", "gauss", "degC", "V", "ms", "us", "s", "1"),
)


@pytest.mark.parametrize(
    ("value", "unit", "si"),
    [
        (180, "deg", math.pi),
        (15.041067, "deg/h", 7.292115e-5),  # Earth rate, WGS 84
        (1, "deg/sqrt(h)", math.radians(1) / 60),  # 1 h is 60² s
        (60, "deg/sqrt(h)", math.radians(1)),
        (1, "deg/s/sqrt(Hz)", math.radians(1)),
        (1, "deg/s/g", math.radians(1) / 9.80665),
        (2, "g", 19.6133),
        (1000, "mg", 9.80665),
        (100, "ug/sqrt(Hz)", 9.80665e-4),
        (60, "m/s/sqrt(h)", 1),
        (1, "gauss", 1e-4),
        (50, "uT", 5e-5),
        (3600, "arcsec", math.radians(1)),
        (250, "us", 2.5e-4),
        (200, "Mohm", 2e8),
        (500, "ppm", 5e-4),
    ],
)
def test_factors_to_si(value, unit, si):
    assert value * factor_to_si(unit) == pytest.approx(si, rel=1e-7)


def test_the_units_of_recordings_are_known():
    assert set(RECORDING_UNITS) <= set(KNOWN_UNITS)


@pytest.mark.parametrize("unit", KNOWN_UNITS)
def test_conversion_goes_there_and_back_within_a_quantity_only(unit):
    for other in KNOWN_UNITS:
        if quantity_of(unit) == quantity_of(other):
            assert conversion_factor(unit, other) * conversion_factor(other, unit) == pytest.approx(1)
        else:
            with pytest.raises(TestloomError, match="cannot be converted"):
                conversion_factor(unit, other)


def test_an_unknown_unit_is_no_guess():
    assert not is_known_unit("Deg/s")
    with pytest.raises(TestloomError, match="'Deg/s' is not known") as caught:
        factor_to_si("Deg/s")
    assert "deg/s" in caught.value.remedy


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b", "$x", "-a", "a#", "a?", "ä", "a\n", "x" * 65])
def test_a_name_that_means_something_in_a_key_is_refused(name):
    for build in (
        lambda: keys.station_command_key(name, "s"),
        lambda: keys.station_command_key("l", name),
        lambda: keys.station_live_key("l", "s", name),
        lambda: keys.coordinator_key("l", "submit", name),
        lambda: keys.alive_key("l", name, 1),
    ):
        with pytest.raises(TestloomError, match="cannot be the name"):
            build()


def test_keys_are_those_of_the_fabric():
    assert keys.coordinator_key("demo", "submit", "s-1") == "testloom/demo/coordinator/submit/s-1"
    assert keys.station_command_key("demo", "s-1") == "testloom/demo/station/s-1/command"
    assert keys.station_live_key("demo", "s-1", "A") == "testloom/demo/station/s-1/live/A"
    assert keys.sender_of(keys.coordinator_key("demo", "renew", "s-1")) == "s-1"
    assert keys.parse_alive_key(keys.alive_key("demo", "s-1", 17_672_256_000)) == ("s-1", 17_672_256_000)


@pytest.mark.parametrize(
    "key", ["testloom/l/alive/s", "testloom/l/station/s/1", "testloom/l/alive/s/²", "x/l/alive/s/1"]
)
def test_what_is_no_alive_key_is_refused(key):
    with pytest.raises(TestloomError, match="not the key of a liveliness token"):
        keys.parse_alive_key(key)

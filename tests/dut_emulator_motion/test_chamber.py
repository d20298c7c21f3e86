"""The air of a chamber: its nodes, its ramps, and what it was told before."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dut_emulator.motion.chamber import MAX_NODES, AirPath

LEG = st.tuples(st.floats(-60.0, 100.0), st.floats(0.1, 10.0), st.floats(0.0, 1000.0))


@given(st.lists(LEG, min_size=1, max_size=6))
def test_the_air_never_jumps_nor_ramps_faster_than_it_is_told(legs: list[tuple[float, float, float]]) -> None:
    air = AirPath.through(23.0, legs)
    length_s = air.times_s[-1]
    assert length_s == pytest.approx(
        sum(
            abs(target - before) / ramp * 60 + stay
            for before, (target, ramp, stay) in zip((23.0, *(leg[0] for leg in legs)), legs, strict=False)
        )
    )
    times = np.linspace(0.0, length_s + 1.0, 2001)
    told = air.at(times)
    fastest = max(ramp for _, ramp, _ in legs) / 60
    assert np.all(np.abs(np.diff(told)) <= fastest * np.diff(times) * (1 + 1e-9) + 1e-9)
    assert air.fastest_ramp_c_per_min <= fastest * 60 * (1 + 1e-4)
    assert told[-1] == pytest.approx(legs[-1][0])
    assert air.range_c == (min(23.0, *(leg[0] for leg in legs)), max(23.0, *(leg[0] for leg in legs)))


def test_what_is_told_later_changes_nothing_before() -> None:
    air = AirPath.steady(20.0).told(80.0, 6.0, 100.0)  # 0.1 °C/s
    cut = air.told(-10.0, 3.0, 400.0)  # at 50 °C
    before = np.linspace(0.0, 400.0, 101)
    np.testing.assert_allclose(cut.at(before), air.at(before))
    assert cut.at(np.array([400.0, 460.0, 1600.0, 9000.0])) == pytest.approx([50.0, 47.0, -10.0, -10.0])


def test_a_long_history_stays_bounded() -> None:
    air = AirPath.steady(20.0)
    for step in range(2 * MAX_NODES):
        air = air.told(20.0 + step % 2, 60.0, 10.0 * step)
    assert len(air.times_s) <= MAX_NODES + 2
    assert air.at(np.array([1e9])) == pytest.approx([21.0])

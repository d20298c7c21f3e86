"""Long records are compared at a part of their rows: the same columns there, and the same verdict."""

import dataclasses

import numpy as np
import pytest

from gap_diagnosis import compared_rows
from gap_diagnosis.candidates import trials_for
from gap_diagnosis.design import designed
from gap_diagnosis.diagnosis import diagnose_observations
from gap_diagnosis.enough_rows import with_enough_rows
from tests.gap_diagnosis.synthetic_observations import DEG, generator, motion, observed


def shaken(seconds: int):
    """A made-up observation with gimbals that turn, so that the stand's effects take part."""
    stimulus = motion(float(seconds))
    angles = np.cumsum(stimulus.rate_rad_s, axis=0) * [0.1, 0.2, 0.3]
    return dataclasses.replace(stimulus, angles_rad=angles)


def test_columns_of_the_rows_compared_are_those_of_the_whole_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every trial of the catalogue that a gyro can have, plays and delays among them."""
    one = with_enough_rows(observed(generator(5), shaken(2400)), 400)
    assert 300 < np.count_nonzero(one.usable) <= 420
    trials = trials_for([one])
    cut = designed([one], trials, cells=True)
    monkeypatch.setattr(compared_rows, "FEW", 0.0)
    whole = designed([one], trials, cells=True)
    plays_and_delays = {"gyro.rate_hysteresis", "gyro.thermal_hysteresis", "link.fixed_delay"}
    assert {t.name for t in trials} >= plays_and_delays | {"stand.wobble", "gyro.warm_up"}
    assert [b.columns.keys() for b in cut.blocks] == [b.columns.keys() for b in whole.blocks]
    for channel, part in whole.channels.items():
        np.testing.assert_allclose(cut.channels[channel].scales, part.scales, rtol=1e-9)
        np.testing.assert_allclose(cut.channels[channel].matrices[0], part.matrices[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("period_s", [60.0, 30.0, 120.0])
def test_a_motion_that_repeats_itself_each_minute_is_seen_in_all_its_phases(period_s: float) -> None:
    one = observed(generator(6), motion(3600.0))
    seen = with_enough_rows(one, 360).stimulus.time_s[with_enough_rows(one, 360).usable]
    count, _ = np.histogram(seen % period_s, 10, (0.0, period_s))
    assert count.min() > 0.5 * count.mean()


def test_a_part_of_the_rows_gives_the_verdict_of_all() -> None:
    """The same effect, and its size within what leaving rows out costs."""
    stimulus = motion(2400.0)
    whole = observed(generator(7), stimulus, 0.012 * DEG / 9.8 * stimulus.specific_force_m_s2)
    few = with_enough_rows(whole, 800)
    reports = [diagnose_observations([one], frozenset(), 40).document for one in (whole, few)]
    assert [report["verdict"] for report in reports] == ["attributed", "attributed"]
    assert [[w["effect"] for w in report["which"][:1]] for report in reports] == [["gyro.g_sensitivity"]] * 2
    of_all, of_few = (report["which"][0]["parameters"] for report in reports)
    for name, one in of_all.items():
        other = of_few[name]
        cost = np.sqrt(other["standard_uncertainty"] ** 2 - one["standard_uncertainty"] ** 2)
        assert abs(other["value"] - one["value"]) < 3.5 * cost
        assert 1.0 < other["standard_uncertainty"] / one["standard_uncertainty"] < 3.0

"""p of the smallest rank over families is exact where data and nulls are alike, and its tails are bounds."""

import numpy as np
import pytest
from scipy.stats import chi2

from gap_diagnosis.candidates import trials_for
from gap_diagnosis.localisation import SMALLEST_P, _minus_log10_p, localise, ranks_of, smallest_rank_p
from gap_diagnosis.prepared import prepare
from gap_diagnosis.search import scan
from tests.gap_diagnosis.synthetic_observations import BELIEF, SLOW, generator, motion, observed

TEMPLATES = {"gyro.g_sensitivity", "gyro.even_nonlinearity", "gyro.bias_temperature", "gyro.warm_up"}


def test_p_over_three_families_is_uniform_where_data_and_nulls_are_alike():
    """Every p that is possible, 1/100 … : no more chance below it than it says (8,000 reports of no gap)."""
    rng = np.random.default_rng(5)
    reports, nulls = 8_000, 99
    families = rng.standard_normal((3, reports, nulls + 1))
    families[1] = 0.7 * families[0] + 0.3 * families[1]  # two that look at much the same
    p = np.array(
        [smallest_rank_p([ranks_of(family[number]) for family in families]) for number in range(reports)]
    )
    for level in (0.01, 0.05, 0.2, 0.5):
        share, error = np.mean(p <= level), np.sqrt(level * (1.0 - level) / reports)
        assert share < level + 4.0 * error
        assert share > level - 0.03 - 4.0 * error  # steps of up to three nulls at once


def test_ties_count_against_the_data():
    assert smallest_rank_p([ranks_of(np.zeros(100))]) == 1.0
    assert smallest_rank_p([ranks_of(np.r_[3.0, np.zeros(99)]), ranks_of(np.zeros(100))]) == 0.01


@pytest.mark.parametrize("freedom", [1, 9])
def test_tail_of_a_chi_square_goes_on_where_a_float_ends(freedom):
    square = np.array([0.1, 5.0, 400.0, 1300.0, 1400.0, 1500.0, 1e5])
    found = _minus_log10_p(square, freedom)
    assert np.all(np.diff(found) >= 0.0)
    assert found[:4] == pytest.approx(-chi2.logsf(square[:4], freedom) / np.log(10.0), rel=1e-6)
    assert -np.log10(SMALLEST_P) <= found[-1] < 1e5 / 2.0 / np.log(10.0)


@pytest.mark.slow
def test_a_report_of_no_gap_alarms_as_often_as_it_says():
    """200 units without a gap, levels drawn from their spread: p is uniform, within 4 binomial deviations."""
    stimulus, p = motion(200), []
    for seed in range(200):
        rng = generator(1000 + seed)
        slow = SLOW * np.exp(BELIEF.slow_spread * rng.standard_normal())
        observations = [observed(rng, stimulus, slow=slow)]
        trials = [one for one in trials_for(observations) if one.name in TEMPLATES]
        prepared = prepare(observations, trials, 60, rng)
        systems = prepared.systems()
        scanned = scan(systems, prepared.design, data_only=False)
        p.append(localise(prepared, systems, scanned, white=False).p)
    for level in (0.05, 0.2, 0.5, 0.8):
        share = float(np.mean(np.array(p) <= level))
        assert abs(share - level) < 4.0 * np.sqrt(level * (1.0 - level) / len(p)) + 0.03, (level, share)

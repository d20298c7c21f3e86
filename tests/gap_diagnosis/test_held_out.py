"""Held-out gains on noise alone are chance; an effect that is there gains within a run and between runs."""

import numpy as np
import pytest

from gap_diagnosis.candidates import Trial, trials_for
from gap_diagnosis.fitting import fit_set
from gap_diagnosis.held_out import Fold, HeldOut, hold_out, shrinkage_of
from gap_diagnosis.prepared import prepare
from gap_diagnosis.search import Cause
from tests.gap_diagnosis.synthetic_observations import DEG, generator, motion, observed

MOTION = motion(300)


def held(observations, name, rng):
    """The first shape of an effect on gyro_x, fitted and held out."""
    trial: Trial = next(one for one in trials_for(observations) if one.name == name)
    prepared = prepare(observations, [trial], 0, rng, cells=False)
    mine = [
        i for i, block in enumerate(prepared.design.blocks) if {c.name for c in block.columns} == {"gyro_x"}
    ]
    channels = {c for i in mine for c in prepared.design.blocks[i].columns}
    fit = fit_set(observations, prepared, [Cause(name, 0, tuple(mine), tuple(channels))])
    assert fit is not None
    return hold_out(fit, {})


@pytest.mark.parametrize("name", ["gyro.g_sensitivity", "gyro.bias_temperature"])
def test_noise_gains_nothing_within_a_run_though_its_halves_share_the_slow_noise(name):
    """Three amplitudes that change quickly, two that are slow: z has no mean and a deviation of one."""
    z = []
    for seed in range(40):
        rng = generator(100 + seed)
        one = held([observed(rng, MOTION)], name, rng)
        assert one.within_run
        z.append(one.sigmas(0))
    assert abs(np.mean(z)) < 4.0 / np.sqrt(len(z))
    assert 0.6 < np.std(z) < 1.35
    assert np.mean(np.array(z) > 2.0) <= 0.125


@pytest.mark.parametrize("freedom", [1, 3, 20])
def test_two_parts_held_out_in_turn_have_unit_variance_whatever_the_number_of_amplitudes(freedom):
    """Information G = 1 in both: u₁, u₂ ~ N(0, I), gain of part 2 is 2 u₁·u₂ − u₁², and the other way."""
    rng = np.random.default_rng(2)
    z = []
    for _ in range(4000):
        u = rng.standard_normal((2, freedom))
        parts = []
        for mine, other in ((u[0], u[1]), (u[1], u[0])):
            signal = float(mine @ mine)
            gain = 2.0 * float(mine @ other) - signal
            parts.append(Fold("", gain, signal, np.array([gain]), np.array([signal]), 0.0, 1))
        z.append(HeldOut(tuple(parts), within_run=False, freedom=(freedom,)).sigmas(0))
    assert np.mean(z) == pytest.approx(0.0, abs=4.0 / np.sqrt(4000))
    assert np.var(z) == pytest.approx(1.0, abs=0.12)


def test_an_effect_gains_between_runs_and_closes_what_theory_says():
    """k = 1: of a gap of d² a fit of the other run closes all but about 1 / d² of each."""
    rng = generator(7)
    added = np.zeros((300, 3))
    added[:, 0] = 0.012 * DEG * MOTION.specific_force_m_s2[:, 1] / 9.8
    found = held([observed(rng, MOTION, added, run=str(run)) for run in (1, 2)], "gyro.g_sensitivity", rng)
    assert not found.within_run
    assert found.gains(0)
    shrunk = shrinkage_of(found, 0.0)
    assert shrunk.before > 1.02 > shrunk.after > 0.98
    assert shrunk.fraction_closed > 0.85
    assert 0.5 < shrunk.interval_95[0] < shrunk.fraction_closed <= shrunk.interval_95[1]


@pytest.mark.parametrize(("freedom", "signal"), [(1, 8.0), (3, 8.0), (3, 20.0)])
def test_the_interval_of_the_closed_share_covers_what_is_closed(freedom, signal):
    """Two runs of d² / 2 each, amplitudes of the one tried on the other; the truth without any noise."""
    rng = np.random.default_rng(3)
    truth = np.r_[signal / np.sqrt(2.0), np.zeros(freedom - 1)]
    covered, cases = 0, 300
    for _ in range(cases):
        u = truth + rng.standard_normal((2, freedom))
        parts, missed = [], 0.0
        for mine, other in ((u[0], u[1]), (u[1], u[0])):
            gain = float(2.0 * mine @ other - mine @ mine)
            own = float(other @ other) - freedom
            missed += float(np.sum((mine - truth) ** 2))
            parts.append(Fold("", gain, float(mine @ mine), np.zeros(1), np.zeros(1), own, 1000))
        low, high = shrinkage_of(HeldOut(tuple(parts), False, (freedom,)), 0.0).interval_95
        covered += low <= 1.0 - missed / signal**2 <= high
    assert covered >= 0.92 * cases


def test_a_slow_effect_gains_within_a_run():
    rng = generator(8)
    added = np.zeros((300, 3))
    added[:, 0] = 0.03 * DEG * (MOTION.temperature_c - 25.0) / 20.0
    assert held([observed(rng, MOTION, added)], "gyro.bias_temperature", rng).gains(0)

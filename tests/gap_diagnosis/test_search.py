"""What the search, the attribution and the rivals make of observations whose cause is known."""

import numpy as np
import pytest

from gap_diagnosis.attribution import attribute
from gap_diagnosis.candidates import trials_for
from gap_diagnosis.diagnosis import diagnose_observations
from gap_diagnosis.fitting import fit_set
from gap_diagnosis.prepared import prepare
from gap_diagnosis.search import (
    EXPECTED_EFFECTS,
    ODDS_OF_A_GAP,
    UNLISTED_SHARE,
    _any_of,
    _log_prior,
    _without_columns,
    search,
)
from gap_diagnosis.unlisted import UNLISTED
from gap_diagnosis.whitened import ChannelSystem
from tests.gap_diagnosis.synthetic_observations import DEG, SLOW, generator, motion, observed

MOTION = motion(300)
RATE, FORCE = MOTION.rate_rad_s, MOTION.specific_force_m_s2 / 9.8
OFFERED = {
    "gyro.g_sensitivity",
    "gyro.even_nonlinearity",
    "gyro.scale_factor_asymmetry",
    "gyro.scale_factor_nonlinearity",
    "gyro.bias_temperature",
    "gyro.temperature_rate",
    "gyro.warm_up",
}


def on_x(column, size_si):
    added = np.zeros((len(column), 3))
    added[:, 0] = size_si * column
    return added


G_SENSITIVITY = on_x(FORCE[:, 1], 0.02 * DEG)
EVEN = on_x(RATE[:, 0] ** 2 / 9.0, 0.05 * DEG)


def searched(observations):
    trials = [one for one in trials_for(observations) if one.name in OFFERED]
    prepared = prepare(observations, trials, 0, generator(0), cells=False)
    systems = prepared.systems()
    return prepared, systems, search(systems, prepared.design, [])


@pytest.mark.parametrize(
    ("added", "names"),
    [
        (0.0, ()),
        (G_SENSITIVITY, ("gyro.g_sensitivity",)),
        (EVEN, ("gyro.even_nonlinearity",)),
        (G_SENSITIVITY + EVEN, ("gyro.even_nonlinearity", "gyro.g_sensitivity")),
    ],
)
def test_what_was_added_is_found_and_how_much(added, names):
    observations = [observed(generator(11 + run), MOTION, added, run=str(run)) for run in range(2)]
    prepared, _, found = searched(observations)
    assert found.sets[0].names == names
    assert found.probability[0] > (0.8 if names else 0.5)
    if "gyro.g_sensitivity" in names:
        fit = fit_set(observations, prepared, found.sets[0].causes)
        (one,) = [e for e in fit.effects if e.name == "gyro.g_sensitivity"]
        assert [c.name for c in one.channels] == ["gyro_x"]
        (y,) = [p for p in one.parameters if p.name.endswith("xy")]
        assert y.value == pytest.approx(0.02 * DEG / 9.8, abs=4.0 * y.standard_uncertainty)
        assert y.standard_uncertainty < 0.1 * y.value


def test_what_cannot_be_told_apart_is_a_class():
    """In a chamber that only warms up at one speed, time itself is temperature."""
    ramp = motion(300)
    ramp.temperature_c[:] = 25.0 + 20.0 * ramp.time_s / 300.0
    observations = [observed(generator(3), ramp, on_x(ramp.time_s / 300.0, 0.05 * DEG), slow=0.2 * SLOW)]
    prepared, systems, found = searched(observations)
    best = found.sets[0]
    fit = fit_set(observations, prepared, best.causes)
    of = attribute(found, systems, prepared.design, fit)
    both = {"gyro.bias_temperature", "gyro.warm_up"}
    assert best.names[0] in both
    assert both - {best.names[0]} <= set(of.confusable[best.names[0]])
    assert "gyro.g_sensitivity" not in of.confusable[best.names[0]]
    assert of.class_probability > of.probability


def test_taking_columns_out_is_fitting_them_again():
    rng = generator(2)
    x, r = rng.standard_normal((50, 5)), rng.standard_normal(50)
    system = ChannelSystem(
        (x.T @ x)[np.newaxis],
        (x.T @ r)[np.newaxis, :, np.newaxis],
        np.zeros((1, 1)),
        np.zeros(1),
        1,
        np.zeros(1),
    )
    left = _without_columns(system, [0, 3])
    taken, rest = x[:, [0, 3]], x[:, [1, 2, 4]]
    refitted = np.column_stack([c - taken @ np.linalg.lstsq(taken, c, rcond=None)[0] for c in [*rest.T, r]])
    kept = [1, 2, 4]
    assert left.gram[0][np.ix_(kept, kept)] == pytest.approx(refitted[:, :3].T @ refitted[:, :3], abs=1e-6)
    assert left.cross[0, kept, 0] == pytest.approx(refitted[:, :3].T @ refitted[:, 3], abs=1e-6)
    assert left.log_likelihood[0, 0] == pytest.approx(
        0.5 * (r @ r - refitted[:, 3] @ refitted[:, 3]), abs=1e-6
    )


def test_an_effect_on_any_axes_is_the_mean_over_all_of_them():
    odds = np.array([[0.2], [5.0], [1e-3]])
    subsets = [[i for i in range(3) if mask >> i & 1] for mask in range(1, 8)]
    mean = np.mean([np.prod(odds[one, 0]) for one in subsets])
    assert _any_of(np.log(odds))[0] == pytest.approx(np.log(mean))


def test_prior_of_one_effect_is_that_of_any_catalogue_and_a_second_is_rarer():
    one, two, unlisted = ("a",), ("a", "b"), (UNLISTED,)
    assert 20 * np.exp(_log_prior(one, 20)) == pytest.approx(40 * np.exp(_log_prior(one, 40)))
    of_all = (1.0 - UNLISTED_SHARE) * EXPECTED_EFFECTS
    assert 20 * np.exp(_log_prior(two, 20) - _log_prior(one, 20)) == pytest.approx(of_all)
    every = 20 * np.exp(_log_prior(one, 20)) + np.exp(_log_prior(unlisted, 20))
    assert every == pytest.approx(ODDS_OF_A_GAP)


def test_a_static_record_offers_no_effect_of_motion():
    """Noise and rounding of constants are no motion: no column, so no evidence."""
    still = motion(300, still=True)
    prepared, _, _ = searched([observed(generator(1), still)])
    offered = {prepared.design.trials[block.trial].name for block in prepared.design.blocks}
    assert offered <= {"gyro.warm_up"}


def test_what_a_stand_does_to_two_triads_has_one_set_of_parameters():
    one = observed(generator(1), MOTION)
    force = one.outputs["gyro"].__class__(
        MOTION.specific_force_m_s2, MOTION.specific_force_m_s2, one.outputs["gyro"].noise
    )
    both = one.__class__(**{**one.__dict__, "outputs": {**one.outputs, "acc": force}})
    trials = [trial for trial in trials_for([both]) if trial.name == "stand.non_orthogonality"]
    prepared = prepare([both], trials, 0, generator(0), cells=False)
    sensors = [{c.sensor for c in block.columns} for block in prepared.design.blocks]
    assert all(trial.tied for trial in trials)
    assert all(one == {"gyro", "acc"} for one in sensors if len(one) > 1)
    names = [name for block in prepared.design.blocks for name in block.scalars]
    assert len(names) == len(set(names))  # none is fitted twice


def report(added=0.0, *, slow=SLOW, seed=21, nulls=60):
    observations = [
        observed(generator(seed + run), MOTION, added, run=str(run), slow=slow) for run in range(2)
    ]
    return diagnose_observations(observations, frozenset(), nulls).document


def test_an_effect_that_nobody_has_listed_is_not_given_a_name():
    """Pulses of every third step of the rate: no shape of the catalogue."""
    pattern = np.repeat(np.tile([1.0, -1.0, 0.4, -0.4], 100), 5)[:300] * (np.arange(300) // 50 % 2)
    assert report(on_x(pattern, 0.02 * DEG))["verdict"] == "unattributed"


def test_noise_beyond_belief_is_called_noise():
    found = report(slow=25.0 * SLOW)
    assert found["verdict"] != "no_gap"
    likeliest = [e for s in found["sets"][:1] for e in s["effects"]]
    assert {"gyro.bias_instability", "gyro.rate_random_walk"} & set(likeliest)

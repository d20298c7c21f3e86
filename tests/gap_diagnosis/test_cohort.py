"""Which level a cause goes with: parameters with known variance components, mounts with known turns."""

import dataclasses

import numpy as np
import pytest

from dut_emulator.effects.catalogue import CATALOGUE
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording.order import RecordingOrder
from dut_emulator.recording.recorder import RecordingSession
from dut_emulator.twin import Twin
from gap_diagnosis.candidates import Trial
from gap_diagnosis.cohort import cohort_findings, document, further_recordings
from gap_diagnosis.cohort_page import cohort_html
from gap_diagnosis.decimation import decimated
from gap_diagnosis.mount_constants import RATE_SCALE, REMOUNT
from gap_diagnosis.mount_estimates import (
    MatrixEstimate,
    MountEstimate,
    ParameterEstimate,
    mount_estimates,
)
from gap_diagnosis.observing import observe
from gap_diagnosis.stillness import stilled
from gap_diagnosis.variance_parts import LEVELS, partitions, variance_parts
from protocol.language import choose_language

GSensitivity, Wobble = CATALOGUE["gyro.g_sensitivity"][0], CATALOGUE["stand.wobble"][0]
KEPT = {"misalignment", "scale_factor_error", "bias", "white_noise", "bias_instability"}
UNITS, STANDS = 6, 2
UNIT_CODES, STAND_CODES = np.repeat(np.arange(UNITS), STANDS), np.tile(np.arange(STANDS), UNITS)


def mounts(values, u=1.0, effect="gyro.g_sensitivity", name="acc_xy", matrices=lambda unit, stand: ()):
    return [
        MountEstimate(
            f"U-{unit}",
            f"tt-{stand}",
            f"m{stand}",
            (f"r-{unit}-{stand}",),
            (ParameterEstimate(effect, "gyro", name, float(value), u, "rad/s per m/s^2"),),
            matrices(unit, stand),
        )
        for unit, stand, value in zip(UNIT_CODES, STAND_CODES, values, strict=True)
    ]


@pytest.mark.parametrize(
    ("added", "effect", "level"),
    [
        (20.0 * (UNIT_CODES == 3), "gyro.g_sensitivity", "unit"),
        (20.0 * (STAND_CODES == 1), "stand.wobble", "stand"),
        (np.full(12, 20.0), "gyro.g_sensitivity", "lot"),
        (np.full(12, 20.0), "link.fixed_delay", "link"),
        (20.0 * (UNIT_CODES == 3), "link.clock_drift", "unit"),
        (np.zeros(12), "gyro.g_sensitivity", "none"),
    ],
)
def test_a_cause_is_assigned_to_where_it_was_put(added, effect, level):
    right = 0
    for seed in range(2):
        noise = np.random.default_rng(seed).standard_normal(12)
        (found,) = cohort_findings(mounts(added + noise, effect=effect)).effects
        assert sum(found.probabilities.values()) == pytest.approx(1.0, abs=1e-6)
        right += found.assigned == level
        assert found.assigned in (level, "not told apart")
    assert right == 2


def test_one_stand_cannot_tell_lot_from_stand_and_says_what_would():
    noise = np.random.default_rng(5).standard_normal(12)
    alone = [one for one in mounts(20.0 + noise) if one.stand_id == "tt-0"]
    (found,) = cohort_findings(alone).effects
    assert (found.assigned, set(found.between)) == ("not told apart", {"lot", "stand"})
    assert further_recordings(found.between) == ("Record some of these units on another stand.",)


def test_levels_that_split_the_mounts_alike_are_one():
    one = np.zeros(4, dtype=np.int64)
    assert partitions(one, one) == (("lot", "unit", "stand"), ("mount",))
    assert partitions(np.arange(4), np.arange(4)) == (("lot",), ("unit", "stand", "mount"))


def drawn_from_the_prior(rng, units, stands):
    deviations = {
        level: 0.0 if rng.random() < 0.5 else float(np.exp(rng.uniform(-0.7, 5.7))) for level in LEVELS
    }
    count = len(units)
    parts = {
        "lot": rng.standard_normal() * deviations["lot"] * np.ones(count),
        "unit": (rng.standard_normal(units.max() + 1) * deviations["unit"])[units],
        "stand": (rng.standard_normal(stands.max() + 1) * deviations["stand"])[stands],
        "mount": rng.standard_normal(count) * deviations["mount"],
    }
    u = np.exp(rng.uniform(-0.3, 0.3, count))
    return deviations, parts, sum(parts.values()) + u * rng.standard_normal(count), u


@pytest.mark.slow
def test_intervals_cover_the_variance_components_and_probabilities_are_what_they_say():
    prior = dict.fromkeys(LEVELS, 0.5)
    covered, values_covered, present, was, total = 0, 0, [], [], 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        units, stands = np.repeat(np.arange(8), 3), np.tile(np.arange(3), 8)
        deviations, parts, y, u = drawn_from_the_prior(rng, units, stands)
        for part in variance_parts(y, u, units, stands, prior).parts:
            (level,) = part.levels
            low, high = part.interval95
            covered += low <= deviations[level] <= high
            present.append(part.present)
            was.append(deviations[level] > 0.0)
            total += 1
            if level == "unit":
                truth = parts["unit"][::3]
                z = [abs(part.members[i][0] - truth[i]) <= 1.96 * part.members[i][1] + 1e-9 for i in range(8)]
                values_covered += sum(z)
    assert 0.925 <= covered / total <= 0.985  # 800 intervals of 95 %, four of one draw go together
    assert 0.925 <= values_covered / 1600 <= 0.985
    chance, truth = np.array(present), np.array(was)
    sharp = chance > 0.95
    assert truth[sharp].mean() >= 0.95
    assert abs(chance.mean() - truth.mean()) < 0.04


def turned(rotation, own, scale=0.0, sensor="gyro", u=2e-5, rng=None):
    x, y, z = rotation
    change = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) + own + scale * np.eye(3)
    return MatrixEstimate(
        sensor,
        change + u * rng.standard_normal((3, 3)),
        u**2 * np.eye(9),
        np.ones((3, 3), dtype=bool),
    )


def test_remounting_and_a_stands_rate_are_found_between_mounts_of_the_same_units():
    rng = np.random.default_rng(7)
    own = 2e-3 * rng.standard_normal((UNITS, 2, 3, 3))
    turns = 1e-3 * rng.standard_normal((UNITS, STANDS, 3))

    def matrices(unit, stand):
        return tuple(
            turned(turns[unit, stand], own[unit, k], 4e-3 * stand * (k == 0), sensor, rng=rng)
            for k, sensor in enumerate(("gyro", "acc"))
        )

    found = cohort_findings(mounts(np.zeros(12), matrices=matrices))
    assert len(found.pairs) == UNITS
    for unit, pair in enumerate(found.pairs):
        z = (np.array(pair.rotation_rad) - (turns[unit, 1] - turns[unit, 0])) / pair.standard_uncertainty_rad
        assert np.abs(z).max() < 4.5
        assert abs(pair.rate_share - 4e-3) < 5 * pair.rate_share_uncertainty
        assert pair.p > 1e-3
    by_name = {one.effect: one for one in found.constants}
    rate, remount = by_name[RATE_SCALE].parameters[0], by_name[REMOUNT].parameters[0]
    assert {p.levels[0]: p.present for p in rate.parts.parts}["stand"] > 0.9
    mount = next(p for p in remount.parts.parts if p.levels == ("mount",))
    assert mount.present > 0.9
    assert mount.interval95[0] <= 1e-3 <= mount.interval95[1]


def test_a_difference_that_is_no_rotation_is_not_called_one():
    rng = np.random.default_rng(9)

    def matrices(unit, stand):
        turn = {"gyro": (1e-3 * stand, 0, 0), "acc": (-1e-3 * stand, 0, 0)}
        return tuple(turned(turn[s], np.zeros((3, 3)), 0.0, s, rng=rng) for s in ("gyro", "acc"))

    assert all(pair.p < 1e-6 for pair in cohort_findings(mounts(np.zeros(12), matrices=matrices)).pairs)


@pytest.mark.parametrize(("language", "word"), [("en", "What would tell them apart"), ("zh", "怎样才能区分")])
def test_the_page_shows_values_levels_and_what_to_record_next(language, word):
    rng = np.random.default_rng(5)
    alone = [one for one in mounts(20.0 + rng.standard_normal(12)) if one.stand_id == "tt-0"]
    alone[0] = dataclasses.replace(alone[0], serial="U<0>")
    findings = cohort_findings(alone)
    whole = {
        "product": "imu",
        "units": [{"serial": "U<0>", "verdict": None, "effects": [], "report": None}],
        "left_out": [{"what": "a<b", "why": "damaged"}],
        **document(findings),
    }
    choose_language(language)
    try:
        page = cohort_html(findings, whole)
    finally:
        choose_language("en")
    assert word in page
    assert "<svg" in page
    assert "U&lt;0&gt;" in page
    assert "U<0>" not in page
    assert "http" not in page.replace("http://www.w3.org", "")


def emulated(unit, stand):
    """A short tumble; the second stand wobbles, and unit 3 feels specific force with its gyro."""
    product = product_named("mems_ahrs")
    kept = [one for one in product.twin(1, f"U-{unit}").effects if one.word in KEPT]
    if unit == 3:
        kept.append(GSensitivity("gyro", acc=((0.0, 2e-5, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))))
    twin = Twin("mems_ahrs", tuple(kept))
    session = RecordingSession(
        RecordingOrder(
            "mems_ahrs", "tumble", serial=f"U-{unit}", twin=twin, stand_seed=stand + 1, mount=f"m{stand + 1}"
        )
    )
    factor = 60.0 if stand else 1.0
    effects = tuple(
        dataclasses.replace(
            one,
            cosine_rad=tuple(factor * x for x in one.cosine_rad),
            sine_rad=tuple(factor * x for x in one.sine_rad),
        )
        if isinstance(one, Wobble)
        else one
        for one in session.unit.stand_effects
    )
    session.unit = dataclasses.replace(session.unit, stand_effects=effects)
    pieces = {name: [] for name in session.description.streams}
    for _, chunk in session.chunks():
        for name, columns in chunk.items():
            pieces[name].append(columns)
    streams = {
        name: dataclasses.replace(
            stream,
            columns={c: np.concatenate([piece[c] for piece in pieces[name]]) for c in stream.columns},
        )
        for name, stream in session.description.streams.items()
    }
    return dataclasses.replace(session.description, streams=streams)


@pytest.mark.slow
def test_six_emulated_units_on_two_stands_show_whose_each_effect_is():
    own = RecordingSession(RecordingOrder("mems_ahrs", "tumble", stand_seed=2)).unit.stand_effects
    (shape,) = {(one.axis, one.harmonic) for one in own if isinstance(one, Wobble)}
    wobble = tuple(Wobble(sensor, axis=shape[0], harmonic=shape[1]) for sensor in ("gyro", "acc", "mag"))
    trials = (
        Trial("stand.wobble", wobble, tied=True),
        Trial("gyro.g_sensitivity", (GSensitivity("gyro"),)),
    )
    every = [
        one
        for unit in range(1, UNITS + 1)
        for one in mount_estimates(
            [decimated(stilled(observe(emulated(unit, stand)))) for stand in range(STANDS)], trials
        )
    ]
    assert len(every) == UNITS * STANDS
    assigned = {one.effect: one for one in cohort_findings(every).effects}
    assert assigned["stand.wobble"].assigned == "stand"
    assert assigned["gyro.g_sensitivity"].assigned == "unit"
    found = next(p for p in assigned["gyro.g_sensitivity"].parameters if p.name == "acc_xy")
    unit = next(part for part in found.parts.parts if part.levels == ("unit",))
    value, u = unit.members[found.units.index("U-3")]
    lot = next(part for part in found.parts.parts if part.levels == ("lot",)).members[0]
    assert abs(value + lot[0] - 2e-5) < 4.0 * max(u, lot[1])

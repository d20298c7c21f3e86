"""A report's effects in a twin: values and units, what the twin had before, what is refused."""

import json

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.twin import Twin, parse_twin, twin_text
from gap_diagnosis.report_document import parse_report, report_text
from gap_diagnosis.twin_change import twin_with_found
from protocol.errors import TestloomError
from tests.gap_diagnosis.imagined_reports import document

DEG, G = np.pi / 180, 9.80665


def report(*entries, verdict="attributed", product="mems_ahrs"):
    whole = document(verdict) | {"product": product}
    if entries:
        names = list(dict.fromkeys(entry["effect"] for entry in entries))
        whole["which"] = [{"probability": 0.99, **entry} for entry in entries]
        whole["sets"] = [{"effects": names, "probability": 0.97}]
    return parse_report(report_text(whole))


def quantity(value, unit, uncertainty=None):
    return {"value": value, "unit": unit, "standard_uncertainty": uncertainty}


def found(twin, *entries, **more):
    return twin_with_found(twin, report(*entries, **more), "r.json")


def effect_of(change, name, sensor):
    (one,) = [
        effect
        for effect in change.twin.effects
        if effect.sensor == sensor and (effect.origin or effect.sensor) + "." + effect.word == name
    ]
    return one


@pytest.mark.parametrize("unit", ["deg/s per g", "deg/s/g"])
@pytest.mark.parametrize("name", ["acc_xy", "acc_y"])
def test_values_arrive_in_si_by_the_effects_name_or_the_column_on_its_channels(name, unit):
    entry = {"effect": "gyro.g_sensitivity", "channels": ["gyro_x"]}
    change = found(Twin("mems_ahrs"), {**entry, "parameters": {name: quantity(0.004, unit)}})
    (effect,) = change.twin.effects
    assert effect.acc[0][1] == pytest.approx(0.004 * DEG / G)
    assert np.count_nonzero(effect.acc) == 1
    assert change.twin == parse_twin(twin_text(change.twin))
    assert [(one.parameter, one.before, one.how) for one in change.changes] == [("acc_xy", None, "new")]


def test_a_stands_effect_on_two_triads_with_axis_and_shape():
    entries = [
        {
            "effect": "stand.wobble",
            "sensor": sensor,
            "axis": "outer",
            "channels": [f"{sensor}_x"],
            "parameters": {"cosine_rad_x": quantity(5.0, "arcsec")},
            "held": {"harmonic": {"value": 2.0, "unit": "1"}},
        }
        for sensor in ("gyro", "acc")
    ]
    change = found(Twin("mems_ahrs"), *entries)
    for sensor in ("gyro", "acc"):
        wobble = effect_of(change, "stand.wobble", sensor)
        assert (wobble.axis, wobble.harmonic) == ("outer", 2.0)
        assert wobble.cosine_rad[0] == pytest.approx(5 / 3600 * DEG)


def test_an_effect_that_the_twin_has_is_replaced_where_the_report_states_it():
    """What was seen is seen against the belief, which has no g-sensitivity: it is the whole."""
    own = effect_named("gyro.g_sensitivity", acc=((1e-5, 2e-5, 0), (0, 3e-5, 0), (0, 0, 0)))
    change = found(Twin("mems_ahrs", (own,)))
    (effect,) = change.twin.effects
    assert effect.acc[0][1] == pytest.approx(0.00402 * DEG / G)
    assert (effect.acc[0][0], effect.acc[1][1]) == (1e-5, 3e-5)
    assert [(one.before, one.how) for one in change.changes] == [(2e-5, "replaced")]


def test_a_lag_beside_the_believed_one_is_added():
    own = effect_named("gyro.bandwidth", time_constant_s=0.004)
    entry = {"effect": "gyro.bandwidth", "channels": ["gyro_x"]}
    change = found(Twin("", (own,)), {**entry, "parameters": {"time_constant_s": quantity(2.0, "ms")}})
    assert change.twin.effects[0].time_constant_s == pytest.approx(0.006)
    assert change.changes[0].how == "added"


def test_what_the_test_did_not_see_is_left_out():
    parameters = {
        "acc_xx": quantity(-2.4, "deg/h per g", 3.1),
        "acc_xy": quantity(0.01, "deg/s per g", 3e-4),
        "acc_xz": quantity(200.0, "rad/s per m/s^2", 300.0),  # far outside its range, and not known
    }
    entry = {"effect": "gyro.g_sensitivity", "channels": ["gyro_x"], "parameters": parameters}
    own = effect_named("gyro.g_sensitivity", acc=((1e-5, 2e-5, 0), (0, 0, 0), (0, 0, 0)))
    change = found(Twin("", (own,)), entry)
    assert change.twin.effects[0].acc[0] == pytest.approx((1e-5, 0.01 * DEG / G, 0.0))
    assert [one.how for one in change.changes] == ["left out", "replaced", "left out"]
    del parameters["acc_xy"]
    with pytest.raises(TestloomError, match="no parameter"):
        found(Twin(), entry)


def test_powers_and_shapes_and_the_order_of_acting():
    own = (
        effect_named("gyro.bias_temperature", coefficients_si_per_c=((1e-6, 2e-6, 3e-6),)),
        effect_named("gyro.quantization", quantum_si=1e-6),
    )
    entries = (
        {
            "effect": "gyro.bias_temperature",
            "channels": ["gyro_x"],
            "parameters": {"coefficients_si_per_c_2_x": quantity(1e-8, "rad/s per degC")},
        },
        {
            "effect": "gyro.thermal_hysteresis",
            "channels": ["gyro_z"],
            "parameters": {"amplitude_si_z": quantity(0.01, "deg/s")},
            "held": {"half_width_c": {"value": 15.0, "unit": "degC"}},
        },
    )
    change = found(Twin("mems_ahrs", own), *entries)
    rows = effect_of(change, "gyro.bias_temperature", "gyro").coefficients_si_per_c
    assert rows == ((1e-6, 2e-6, 3e-6), (1e-8, 0.0, 0.0))
    assert effect_of(change, "gyro.thermal_hysteresis", "gyro").half_width_c == 15.0
    assert change.twin.effects[-1].word == "quantization"


def hysteresis(width):
    return {
        "effect": "gyro.thermal_hysteresis",
        "channels": ["gyro_z"],
        "parameters": {"amplitude_si_z": quantity(0.01, "deg/s")},
        "held": {"half_width_c": {"value": width, "unit": "degC"}},
    }


def test_another_shape_would_change_what_the_report_does_not_state():
    own = effect_named("gyro.thermal_hysteresis", amplitude_si=(1e-4, 0, 1e-4), half_width_c=10.0)
    with pytest.raises(TestloomError, match="amplitude_si_x, and another half_width_c"):
        found(Twin("", (own,)), hysteresis(15.0))
    same = found(Twin("", (own,)), hysteresis(10.0)).twin.effects[0]
    assert same.amplitude_si == pytest.approx((1e-4, 0, 0.01 * DEG))
    alone = effect_named("gyro.thermal_hysteresis", amplitude_si=(0, 0, 1e-4), half_width_c=10.0)
    assert found(Twin("", (alone,)), hysteresis(15.0)).twin.effects[0].half_width_c == 15.0


def test_a_set_further_down_is_taken_when_it_is_asked_for():
    second = twin_with_found(Twin("mems_ahrs"), report(verdict="confusable"), "r.json", 2)
    assert [effect.word for effect in second.twin.effects] == ["even_nonlinearity"]
    with pytest.raises(TestloomError, match="no set number 4"):
        twin_with_found(Twin("mems_ahrs"), report(verdict="confusable"), "r.json", 4)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"effect": "gyro.humidity", "parameters": {"a": quantity(1, "1")}}, "no effect 'gyro.humidity'"),
        ({"effect": "gyro.g_sensitivity", "parameters": {}}, "no parameter"),
        ({"effect": "gyro.g_sensitivity", "parameters": {"acc_xy": quantity(1, "deg/s")}}, "acc_xy|measure"),
        ({"effect": "gyro.g_sensitivity", "parameters": {"mass": quantity(1, "1")}}, "no parameter 'mass'"),
        ({"effect": "stand.wobble", "parameters": {"cosine_rad_x": quantity(1, "arcsec")}}, "which triad"),
        ({"effect": "stand.wobble", "sensor": "gyro", "axis": "up"} | {"parameters": {
            "cosine_rad_x": quantity(1, "arcsec")}}, "no axis 'up'"),
        ({"effect": "gyro.bandwidth", "parameters": {"time_constant_s": quantity(-9, "s")}}, "outside"),
    ],
)  # fmt: skip
def test_what_cannot_be_put_into_a_twin_is_refused(entry, said):
    with pytest.raises(TestloomError, match=said):
        found(Twin("mems_ahrs"), entry)


@pytest.mark.parametrize(("verdict", "said"), [("no_gap", "no gap"), ("unattributed", "no set of effects")])
def test_a_report_without_a_named_cause_changes_nothing(verdict, said):
    with pytest.raises(TestloomError, match=said):
        found(Twin("mems_ahrs"), verdict=verdict)


def test_another_products_twin_and_a_clash_are_refused():
    with pytest.raises(TestloomError, match="fog"):
        found(Twin("fog"))
    own = effect_named("gyro.flicker_noise", coefficient_si=(1e-6, 0, 0))
    entry = {
        "effect": "gyro.bias_instability",
        "channels": ["gyro_x"],
        "parameters": {"standard_deviation_si_x": quantity(3.0, "deg/h")},
    }
    with pytest.raises(TestloomError, match="describe the same thing"):
        found(Twin("", (own,)), entry)
    assert json.loads(twin_text(found(Twin(), entry).twin))["effects"][0]["effect"] == "gyro.bias_instability"

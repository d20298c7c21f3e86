"""The twin file: what is written comes back, and what cannot be meant is refused with its place."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.effect import name_of
from dut_emulator.twin import Twin, parse_twin, read_twin, twin_text, write_twin
from protocol.errors import TestloomError
from tests.dut_emulator.effect_examples import EXAMPLES, motion


def document(*effects: dict[str, Any], **more: Any) -> str:
    return json.dumps({"format": "testloom-twin/1", "effects": list(effects), **more})


def entry(effect: str, unit: str = "1", sensor: str | None = None, **parameters: float) -> dict[str, Any]:
    given: dict[str, Any] = {
        "effect": effect,
        "parameters": {name: {"value": value, "unit": unit} for name, value in parameters.items()},
    }
    return given if sensor is None else given | {"sensor": sensor}


def test_every_effect_of_the_catalogue_comes_back_from_a_file(tmp_path: Path) -> None:
    for number, (name, effect) in enumerate(EXAMPLES.items()):
        path = tmp_path / f"{number}.json"
        write_twin(Twin("gnc_module", (effect,)), path)
        assert read_twin(path) == Twin("gnc_module", (effect,)), name


def test_units_are_converted() -> None:
    twin = parse_twin(
        document(
            entry("gyro.g_sensitivity", "deg/s per g", acc_xy=0.01),
            entry("gyro.angle_random_walk", "deg/sqrt(h)", density_si_per_sqrt_hz_z=0.3),
            entry("gyro.rate_random_walk", "deg/h per sqrt(h)", coefficient_si_per_sqrt_s_x=12.0),
        )
    )
    coupling, white, walk = (dict(vars(effect)) for effect in twin.effects)
    assert coupling["acc"][0] == pytest.approx((0.0, 0.01 * np.pi / 180 / 9.80665, 0.0))
    assert white["density_si_per_sqrt_hz"][2] == pytest.approx(0.3 * np.pi / 180 / 60)
    assert walk["coefficient_si_per_sqrt_s"][0] == pytest.approx(12 * np.pi / 180 / 3600 / 60)


def test_an_effect_is_added_where_it_belongs_and_the_chain_has_it() -> None:
    twin = Twin()
    for name in (
        "gyro.quantization on gyro",
        "gyro.bias on gyro",
        "gyro.saturation on gyro",
        "acc.bias on acc",
    ):
        twin = twin.with_effect(EXAMPLES[name])
    assert [name_of(effect) for effect in twin.effects if effect.sensor == "gyro"] == [
        "gyro.bias",
        "gyro.saturation",
        "gyro.quantization",
    ]
    whole = motion()
    chain = twin.chain("gyro")
    out = chain.apply(whole.true_input("gyro"), whole, chain.begin(np.random.SeedSequence(1)))
    biased = whole.true_input("gyro") + np.array((0.01, -0.02, 0.03))
    by_hand = np.rint(np.clip(biased, -1.5, 1.5) / 0.013) * 0.013
    np.testing.assert_allclose(out, by_hand, atol=1e-12)
    assert twin.with_effect(effect_named("gyro.bias")).chain("gyro").names == chain.names
    assert parse_twin(twin_text(twin)) == twin


BIAS = entry("gyro.bias", "rad/s", bias_si_x=0.1)
WOBBLE = entry("stand.wobble", "arcsec", "acc", cosine_rad_x=5)
REFUSED: dict[str, tuple[str, str]] = {
    "no JSON": ("{", "the text"),
    "another format": (document(BIAS, format="testloom-twin/2"), "testloom-twin/1"),
    "no effects": ('{"format": "testloom-twin/1"}', "effects"),
    "an unknown key": (document(BIAS | {"amplitude": 1}), r"effects\.0\.amplitude"),
    "a value that is no number": (document(entry("gyro.bias", "rad/s", bias_si_x="1")), "bias_si_x"),  # type: ignore[arg-type]
    "an unknown effect": (document(entry("gyro.biased")), r"effects\[0\] gyro\.biased"),
    "an open triad": (document(entry("stand.wobble")), "name its sensor"),
    "an unknown sensor": (document(entry("stand.wobble", "1", "nose")), "no sensor 'nose'"),
    "an unknown parameter": (document(entry("gyro.bias", "rad/s", bias_x=0.1)), "no parameter 'bias_x'"),
    "an unknown unit": (document(entry("gyro.bias", "turns/s", bias_si_x=0.1)), "bias_si_x"),
    "a wrong unit": (document(entry("gyro.bias", "g", bias_si_x=0.1)), "give it in rad/s"),
    "half a unit": (document(entry("gyro.g_sensitivity", "deg/s", acc_xy=0.1)), "rad/s per m/s\\^2"),
    "outside its range": (
        document(entry("gyro.dead_band", "1", depth_x=1.5)),
        r"depth_x = 1\.5 1 lies out",
    ),
    "a power too many": (
        document(entry("gyro.bias_temperature", "rad/s per degC", coefficients_si_per_c_12_x=1e-6)),
        "powers 1 to 9",
    ),
    "an axis that is none": (document(WOBBLE | {"axis": "upper"}), "no axis 'upper'"),
    "an axis for a bias": (document(BIAS | {"axis": "inner"}), "no axis 'inner'"),
    "a wrong stage": (document(BIAS | {"stage": "filter"}), "acts at the stage 'transducer'"),
    "stages out of order": (
        document(entry("gyro.bandwidth", "s", time_constant_s=0.01), BIAS),
        r"'gyro\.bandwidth' \(filter\) stands before 'gyro\.bias' \(transducer\)",
    ),
    "rounding before the cut": (
        document(
            entry("gyro.quantization", "deg/s", quantum_si=0.01),
            entry("gyro.saturation", "deg/s", range_si=400),
        ),
        "acts after it",
    ),
    "one effect twice": (document(BIAS, BIAS), "there twice"),
    "one thing in two ways": (
        document(
            entry("gyro.bias_instability", "deg/h", standard_deviation_si_x=5),
            entry("gyro.flicker_noise", "deg/h", coefficient_si_x=5),
        ),
        "in two ways",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_meant_is_refused(case: str) -> None:
    text, said = REFUSED[case]
    with pytest.raises(TestloomError) as refusal:
        parse_twin(text, "unit.json")
    assert refusal.value.where.startswith("unit.json")
    assert refusal.value.remedy
    assert re.search(said, str(refusal.value)), str(refusal.value)


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TestloomError, match="no such twin file"):
        read_twin(tmp_path / "none.json")
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TestloomError, match="not UTF-8"):
        read_twin(tmp_path / "bytes.json")

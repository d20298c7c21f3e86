"""report.json: what is read back, and what is said of one that is damaged."""

import json

import numpy as np
import pytest

from gap_diagnosis.report_document import parse_report, read_report, report_text
from protocol.errors import Fault, TestloomError
from tests.gap_diagnosis.imagined_reports import document, parsed

VERDICTS = ("no_gap", "attributed", "confusable", "unattributed")


def of_the_contract() -> dict:
    """The example of the report's form, without any key that is ours."""
    return {
        "format": "testloom-gap-report/1",
        "verdict": "attributed",
        "where": [
            {
                "channel": "gyro_x",
                "kind": "deterministic",
                "regime": {"variable": "temperature", "low": 40, "high": 50, "unit": "degC"},
                "p_adjusted": 0.008,
                "excess_rms": 0.012,
                "unit": "deg/s",
            }
        ],
        "which": [
            {
                "effect": "gyro.g_sensitivity",
                "probability": 0.93,
                "channels": ["gyro_x"],
                "parameters": {"acc_y": {"value": 0.004, "standard_uncertainty": 0.0003, "unit": "deg/s/g"}},
                "confusable_with": ["gyro.even_nonlinearity"],
            }
        ],
        "sets": [{"effects": ["gyro.g_sensitivity"], "probability": 0.93}],
        "class_probability": 0.99,
        "shrinkage": {
            "held_out": ["run 2"],
            "before": 4.1,
            "after": 1.03,
            "noise_floor": 1.0,
            "unit": "1 (whitened rms)",
            "fraction_closed": 0.996,
            "ci95": [0.991, 0.998],
            "channels": {"gyro_x": {"before": 0.014, "after": 0.0006, "unit": "deg/s"}},
        },
        "unattributed": {"p": 0.4, "description": None},
        "next_test": {
            "profile": "tumble_while_rotating",
            "minutes": 6,
            "expected_bits": 1.2,
            "separates": ["gyro.g_sensitivity", "gyro.even_nonlinearity"],
        },
    }


@pytest.mark.parametrize("verdict", VERDICTS)
def test_what_is_written_is_read_back_and_keeps_what_a_later_version_adds(verdict, tmp_path):
    later = document(verdict) | {"seed": 7}
    (tmp_path / "report.json").write_text(report_text(later), encoding="utf-8")
    for path in (tmp_path, tmp_path / "report.json"):
        found = read_report(path)
        assert json.loads(found.model_dump_json(exclude_unset=True)) == json.loads(json.dumps(later))
    assert report_text(later) == report_text(dict(later))


def test_the_form_of_the_contract_is_read():
    found = parse_report(json.dumps(of_the_contract()))
    assert found.which[0].parameters["acc_y"].standard_uncertainty == 0.0003
    assert found.shrinkage is not None
    assert found.shrinkage.ci95 == (0.991, 0.998)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("format",), "testloom-gap-report/2", "testloom-gap-report/2"),
        (("verdict",), "perhaps", "verdict"),
        (("which", 0, "probability"), 1.2, r"which\.0\.probability"),
        (("which", 0, "parameters", "acc_y", "value"), "0.004", r"acc_y\.value"),
        (("which", 0, "effect"), "gyro.warm_up", "does not describe gyro.g_sensitivity"),
        (("sets",), [], "needs a first set"),
        (("sets", 0, "effects"), [], "needs a first set"),
        (("where", 0, "kind"), "odd", r"where\.0\.kind"),
        (("shrinkage", "ci95"), [0.9], "ci95"),
        (("recordings",), [{"recording_id": "a", "sha256": "abc"}], "sha256"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(place, value, said):
    broken = of_the_contract()
    inner = broken
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    with pytest.raises(TestloomError, match=said) as caught:
        parse_report(json.dumps(broken), "r.json")
    assert "r.json" in caught.value.where
    assert caught.value.fault is Fault.DATA


def test_files_that_are_no_report(tmp_path):
    cut = tmp_path / "cut.json"
    cut.write_text(report_text(document("attributed"))[:200], encoding="utf-8")
    other = tmp_path / "other.json"
    other.write_text("[1, 2]", encoding="utf-8")
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, said in (
        (cut, "not JSON"),
        (other, "format is 'None'"),
        (binary, "not UTF-8"),
        (tmp_path / "x", "no such"),
    ):
        with pytest.raises(TestloomError, match=said):
            read_report(path)


def test_a_diagnosis_that_breaks_the_form_is_our_fault():
    for broken in (
        document("attributed") | {"sets": []},
        document("attributed") | {"class_probability": float("nan")},
        document("attributed") | {"product": np.zeros(2)},
    ):
        with pytest.raises(TestloomError) as caught:
            report_text(broken)
        assert caught.value.fault is Fault.TESTLOOM


def test_sets_and_effects_are_ranked():
    assert parsed("attributed").which[0].effect == "gyro.g_sensitivity"
    swapped = document("attributed")
    swapped["which"].reverse()
    with pytest.raises(TestloomError, match="sorted"):
        report_text(swapped)

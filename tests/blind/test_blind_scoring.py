"""The scorer: the truth scores full marks, guessing fails, labels stay sealed."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.blind.case_plan import LADDER
from tests.blind.parameters import normalised_errors, si
from tests.blind.scorer import Row, _chance_calibration_error, clopper_pearson, scored
from tests.blind.verdicts import Judged, SealError, opened

EFFECTS = ("gyro.g_sensitivity", "gyro.warm_up", "acc.quadratic_nonlinearity", "stand.lever_arm")


def _label(kind: str, effects: list[str], d: float) -> dict[str, Any]:
    facts = [{"effect": name, "d_outside": d} for name in effects]
    oracle = {
        "ranking": effects or ["gyro.warm_up"],
        "class": effects,
        "sets": [effects],
        "fraction_closed": 0.97,
    }
    return {"kind": kind, "effects": effects, "d": [d for _ in effects], "facts": facts, "oracle": oracle}


def _labels() -> list[dict[str, Any]]:
    labels = [_label("null", [], 0.0) for _ in range(60)]
    labels += [_label("single", [EFFECTS[i % 4]], d) for d in LADDER for i in range(20)]
    labels += [_label("pair", [EFFECTS[i % 4], EFFECTS[(i + 1) % 4]], 12.0) for i in range(30)]
    for kind in ("out_of_catalogue", "decoy", "withheld"):
        labels += [_label(kind, ["telegraph_bias"], 20.0) for _ in range(20)]
    return labels


def _report(said: str, effects: list[str], probability: float = 1.0) -> dict[str, Any]:
    return {
        "verdict": said,
        "which": [{"effect": name, "probability": probability, "parameters": {}} for name in effects],
        "sets": [{"effects": effects, "probability": probability}],
        "shrinkage": {"fraction_closed": 0.96},
    }


def _judged(label: dict[str, Any], report: dict[str, Any]) -> Judged:
    return Judged(label, {"report": report, "cpu_s": 1.0, "rows": 30_000})


def _truthful(label: dict[str, Any]) -> dict[str, Any]:
    if label["kind"] in ("out_of_catalogue", "decoy", "withheld"):
        return _report("unattributed", [])
    return _report("attributed" if label["effects"] else "no_gap", label["effects"])


def _rows(cases: list[Judged]) -> dict[str, Row]:
    return {row.metric: row for row in scored(cases)}


def test_the_truth_scores_full_marks() -> None:
    rows = _rows([_judged(label, _truthful(label)) for label in _labels()])
    assert rows["false alarms on nulls"].value == 0
    for d in LADDER:
        assert rows[f"single, top-1, d = {d:g}"].value == 1
        assert rows[f"single, by class, d = {d:g}"].value == 1
    for metric in (
        "pair, exact set",
        "abstains, out of catalogue, d⊥ ≥ 12",
        "abstains, decoys",
        "95 % set covers",
    ):
        assert rows[metric].value == 1
    assert rows["expected calibration error"].value == 0
    assert not [row.metric for row in rows.values() if row.state == "short" and "covers" not in row.metric
                and "nulls" not in row.metric]  # fmt: skip


def test_guessing_fails() -> None:
    rng = np.random.Generator(np.random.Philox(2))
    cases = [_judged(label, _report("attributed", [str(rng.choice(EFFECTS))], 0.96)) for label in _labels()]
    rows = _rows(cases)
    for metric in (
        *(f"single, top-1, d = {d:g}" for d in LADDER),
        *("false alarms on nulls", "pair, exact set", "95 % set covers", "expected calibration error"),
        *("abstains, out of catalogue, d⊥ ≥ 12", "abstains, decoys", "attributed, all of these"),
    ):
        assert rows[metric].state == "short", metric


def test_an_engine_that_fails_is_counted() -> None:
    label = _label("single", [EFFECTS[0]], 8.0)
    rows = _rows([Judged(label, {"error": "ValueError: no", "cpu_s": 0.1, "rows": 1})])
    assert rows["engine failed"].value == 1
    assert rows["single, top-1, d = 8"].value == 0


def test_bounds_are_exact() -> None:
    """Tables of Clopper–Pearson: 0 of 10, 5 of 10, 10 of 10."""
    assert clopper_pearson(0, 10) == pytest.approx((0, 0.3085), abs=1e-4)
    assert clopper_pearson(5, 10) == pytest.approx((0.1871, 0.8129), abs=1e-4)
    assert clopper_pearson(10, 10) == pytest.approx((0.6915, 1), abs=1e-4)


@pytest.fixture
def sealed(tmp_path: Path) -> tuple[Path, Path, Path]:
    """One case with its verdict: folders of recordings, labels, verdicts."""
    out, labels, verdicts = (tmp_path / name for name in ("cases", "labels", "verdicts"))
    for folder in (out, labels, verdicts):
        folder.mkdir()
    text = json.dumps(_label("null", [], 0.0))
    (labels / "case-00001.json").write_text(text)
    seal = hashlib.sha256(text.encode()).hexdigest()
    (out / "cases.json").write_text(json.dumps({"cases": [{"case": "case-00001", "seal": seal}]}))
    (verdicts / "case-00001.json").write_text(json.dumps({"seal": seal, "report": _report("no_gap", [])}))
    return out, labels, verdicts


def test_labels_open_when_every_verdict_is_written(sealed: tuple[Path, Path, Path]) -> None:
    assert [one.said for one in opened(*sealed)] == ["no_gap"]


def test_labels_stay_sealed_without_a_verdict(sealed: tuple[Path, Path, Path]) -> None:
    (sealed[2] / "case-00001.json").unlink()
    with pytest.raises(SealError, match="no verdict"):
        opened(*sealed)


def test_labels_stay_sealed_before_an_older_verdict(sealed: tuple[Path, Path, Path]) -> None:
    os.utime(sealed[2] / "case-00001.json", ns=(1, 1))
    with pytest.raises(SealError, match="older"):
        opened(*sealed)


def test_a_changed_label_is_noticed(sealed: tuple[Path, Path, Path]) -> None:
    (sealed[1] / "case-00001.json").write_text(json.dumps(_label("single", [EFFECTS[0]], 8.0)))
    with pytest.raises(SealError, match="changed"):
        opened(*sealed)


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("deg/s/g", np.pi / 180 / 9.80665),
        ("rad/s per m/s^2", 1.0),
        ("deg/s/(degC/min)", np.pi / 180 * 60),
        ("1 per m/s^2 per m/s^2", 1.0),
        ("ppm/degC", 1e-6),
    ],
)
def test_units_of_parameters(unit: str, size: float) -> None:
    understood = si(unit)
    assert understood is not None
    assert understood[0] == pytest.approx(size)
    assert si("furlong") is None


def test_parameters_are_compared_in_any_unit() -> None:
    """0.002 deg/s/g against 1.0 and 1.5 bounds above it, given in SI."""
    label = _label("single", ["gyro.g_sensitivity"], 8.0)
    label["facts"] = [{"coefficients": [{"channels": ["gyro_x"], "values": [0.002, 0.0, 0.001]}]}]
    label["oracle"]["cramer_rao"] = [1e-4, 1e-4, 1e-4]
    si_unit = np.pi / 180 / 9.80665
    parameters = {
        f"acc_{axis}": {"value": value * si_unit, "unit": "rad/s per m/s^2"}
        for axis, value in zip("xyz", (0.0021, 0.00015, 0.001), strict=True)
    }
    report = {**_report("attributed", ["gyro.g_sensitivity"])}
    report["which"][0]["parameters"] = parameters
    assert normalised_errors(_judged(label, report)) == pytest.approx([1.0, 1.5, 0.0])


def test_probabilities_that_are_right_have_a_calibration_error_by_chance_alone():
    """One bin of n cases at p: the mean of |Σ Bernoulli − n p| / n is √(2 p (1 − p) / (π n))."""
    few, many = ([(0.75, True)] * n for n in (100, 10_000))
    for cases in (few, many):
        normal = np.sqrt(2 * 0.75 * 0.25 / np.pi / len(cases))
        assert _chance_calibration_error(cases) == pytest.approx(normal, rel=0.15)

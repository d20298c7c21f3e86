"""The quick set through the real engine: loose bounds, wide enough for forty cases."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from scipy.special import betaincinv

from tests.blind.verdicts import opened

ROOT = Path(__file__).resolve().parents[2]
ENGINE = importlib.util.find_spec("gap_diagnosis.diagnosis")
SEED = 1
DOUBT = 1e-3
"""One-sided: how seldom an engine that holds its goal may fail here."""

pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.skipif(ENGINE is None, reason="there is no gap_diagnosis.diagnosis yet: nothing to check"),
]


def _at_most(hits: int, cases: int, goal: float) -> bool:
    """Whether `hits` do not exceed what a rate of `goal` gives, up to DOUBT."""
    return hits == 0 or betaincinv(hits, cases - hits + 1, DOUBT) <= goal


def _at_least(hits: int, cases: int, goal: float) -> bool:
    return _at_most(cases - hits, cases, 1 - goal)


def test_the_quick_set_is_within_its_bounds(tmp_path: Path) -> None:
    """No more false claims than chance allows; the first name as often right as the oracle's, nearly."""
    out, labels, verdicts = (tmp_path / name for name in ("cases", "labels", "verdicts"))
    for words in (
        ("generate", "--quick", "--seed", SEED, "--out", out, "--labels", labels, "--workers", 1),
        ("diagnose", "--out", out, "--verdicts", verdicts, "--workers", 1),
    ):
        subprocess.run([sys.executable, "-m", "tests.blind", *map(str, words)], check=True, cwd=ROOT)
    cases = opened(out, labels, verdicts)
    assert len(cases) >= 40
    assert [one.verdict["error"] for one in cases if one.said == "error"] == []
    nulls = [one for one in cases if one.label["kind"] == "null"]
    assert _at_most(sum(one.said != "no_gap" for one in nulls), len(nulls), 0.065)
    foreign = [o for o in cases if o.label["kind"] in ("out_of_catalogue", "decoy", "withheld")]
    assert _at_most(sum(one.said == "attributed" for one in foreign), len(foreign), 0.05)
    singles = [one for one in cases if one.label["kind"] == "single"]
    best = sum(one.truth[0] == one.oracle["ranking"][0] for one in singles) / len(singles)
    assert _at_least(sum(one.truth[0] in one.named(1) for one in singles), len(singles), best - 0.015)

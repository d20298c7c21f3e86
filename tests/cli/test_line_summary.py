"""The summary of a run, against cases counted by hand."""

import math

import pytest

from cli.line_summary import KeptRecord, Ledger, Truth, stated_risk, summarise
from protocol.attempts import UnitIdentity
from protocol.line_views import LineStatus, UnitStatus, YieldReport
from protocol.outcomes import Disposition
from protocol.plans import Plan


def _status(dispositions: dict[str, Disposition]) -> LineStatus:
    units = tuple(
        UnitStatus(unit=UnitIdentity(serial=serial, product="gnc_module", lot="L1"), disposition=disposition)
        for serial, disposition in dispositions.items()
    )
    report = YieldReport(operations=(), stations=(), dispositions={})
    return LineStatus(
        line="t",
        at_s=0.0,
        stations=(),
        units=units,
        queue_lengths={},
        yield_report=report,
        alarms=(),
        attempts_recorded=0,
        records_set_aside=0,
        duplicates_ignored=0,
        finished=True,
    )


def test_a_record_that_only_the_station_has_is_lost() -> None:
    kept = [KeptRecord("a.1", "s1"), KeptRecord("b.1", "s1"), KeptRecord("c.1", "s2")]
    ledger = Ledger(made={"s1": 3, "s2": 1, "s3": 0}, kept=kept)
    assert ledger.lost() == 1
    assert ledger.duplicated() == 0


def test_a_record_kept_twice_is_a_duplicate_and_makes_up_for_no_loss() -> None:
    ledger = Ledger(made={"s1": 2}, kept=[KeptRecord("a.1", "s1"), KeptRecord("a.1", "s1")])
    assert ledger.duplicated() == 1
    assert ledger.lost() == 1


def test_escapes_and_false_rejects_count_gross_and_healthy_units_only() -> None:
    truths = [
        Truth("A", "gross", "dead_axis"),
        Truth("B", "gross", "open_pin"),
        Truth("C", "healthy", None),
        Truth("D", "healthy", None),
        Truth("E", "marginal", "weak_rail"),
        Truth("F", "near_limit", None),
    ]
    dispositions = {
        "A": Disposition.SHIP,
        "B": Disposition.SCRAP,
        "C": Disposition.SHIP,
        "D": Disposition.QUARANTINE,
        "E": Disposition.SHIP,
        "F": Disposition.SCRAP,
    }
    summary = summarise(_status(dispositions), truths, Ledger({}, []), [], 1.0)
    assert (summary["escapes"], summary["false_rejects"], summary["true_defective"]) == (1, 1, 3)
    assert (summary["marginal"]["escapes"], summary["marginal"]["false_rejects"]) == (1, 1)
    assert summary["dispositions"] == {"QUARANTINE": 1, "SCRAP": 2, "SHIP": 3}
    assert summary["lost"] == 0


@pytest.mark.parametrize("disposition", [Disposition.IN_PROCESS, Disposition.RETEST])
def test_a_unit_without_an_end_counts_as_lost(disposition: Disposition) -> None:
    truths = [Truth("A", "healthy", None), Truth("B", "healthy", None)]
    summary = summarise(_status({"A": disposition}), truths, Ledger({}, []), [], 1.0)
    assert summary["unfinished"] == ["A", "B"]
    assert summary["lost"] == 2


def test_the_stated_risk_is_the_normal_tail() -> None:
    plan = Plan.model_validate_json(
        """{"format": "testloom-plan/1", "name": "p", "version": "1.0.0", "product": "x", "operation": "o",
        "deadline_s": 1, "sequence": {"main": [{"step": "a", "timeout_s": 1, "measurements": [
        {"name": "m", "unit": "V", "low": -1, "high": 1, "standard_uncertainty": 0.5}]}],
        "teardown": [{"step": "z", "timeout_s": 1}]}}"""
    )
    risk = stated_risk([plan])
    tail_2 = 0.5 * math.erfc(2 / math.sqrt(2))  # half of the limits' width, 1 V, is two uncertainties
    assert risk["consumer"] == pytest.approx(1 - (1 - tail_2) ** 2)
    assert risk["producer"] == pytest.approx(0.158655**2, rel=1e-4)


def test_a_limit_open_to_one_side_is_as_wide_as_it_is_large() -> None:
    plan = Plan.model_validate_json(
        """{"format": "testloom-plan/1", "name": "p", "version": "1.0.0", "product": "x", "operation": "o",
        "deadline_s": 1, "sequence": {"main": [{"step": "a", "timeout_s": 1, "measurements": [
        {"name": "m", "unit": "V", "high": 3, "standard_uncertainty": 1.5},
        {"name": "n", "unit": "V", "low": 3}]}],
        "teardown": [{"step": "z", "timeout_s": 1}]}}"""
    )
    tail_1 = 0.158655  # half of 3 V is one uncertainty of 1.5 V
    assert stated_risk([plan])["consumer"] == pytest.approx(1 - (1 - tail_1) ** 2, rel=1e-4)

"""The summary of a run, against cases counted by hand."""

import math
from typing import Any

import pytest

from cli.line_summary import KeptRecord, Ledger, Truth, stated_risk, summarise
from protocol.attempts import UnitIdentity
from protocol.line_views import LineStatus, UnitStatus, YieldReport
from protocol.outcomes import Disposition, Outcome
from protocol.plans import Plan
from protocol.routes import Operation, Route


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


def _kept(
    fence: int,
    station: str,
    unit: str = "A",
    operation: str = "o",
    outcome: Outcome = Outcome.PASS,
    **other: Any,
) -> KeptRecord:
    values = {"attempt_id": f"{unit}.{operation}.{fence}", **other}
    return KeptRecord(
        station=station, fence=fence, serial=unit, operation=operation, outcome=outcome, **values
    )


ROUTE = Route(name="r", product="x", operations=(Operation(name="o"), Operation(name="p")))
NOTHING_KEPT = Ledger({}, {}, [])


def _supported(*kept: KeptRecord, disposition: Disposition) -> bool:
    return Ledger({}, {}, kept).supports("A", disposition, ROUTE)


def test_a_record_that_only_the_station_has_is_lost() -> None:
    kept = [_kept(1, "s1"), _kept(2, "s1"), _kept(3, "s2")]
    ledger = Ledger({"s1": 3, "s2": 1, "s3": 0}, {"s1": {1, 2, 4}, "s2": {3}}, kept)
    assert ledger.lost() == 1
    assert ledger.duplicated() == 0


def test_a_record_kept_twice_is_a_duplicate_and_makes_up_for_no_loss() -> None:
    ledger = Ledger({"s1": 2}, {}, [_kept(1, "s1"), _kept(1, "s1")])
    assert ledger.duplicated() == 1
    assert ledger.lost() == 1


def test_a_record_that_nobody_made_hides_no_loss_and_is_a_duplicate() -> None:
    swapped = Ledger({"s1": 2}, {"s1": {1, 2}}, [_kept(1, "s1"), _kept(7, "s1")])
    assert swapped.lost() == 1  # though there are as many records as were made
    surplus = Ledger({"s1": 1}, {"s1": {1}}, [_kept(1, "s1"), _kept(2, "s1"), _kept(3, "s2")])
    assert (surplus.lost(), surplus.duplicated()) == (0, 2)


def test_a_disposition_follows_from_the_records_that_count() -> None:
    fail = Outcome.FAIL
    both = [_kept(1, "s"), _kept(2, "s", operation="p")]
    ship, scrap = Disposition.SHIP, Disposition.SCRAP
    assert _supported(*both, _kept(3, "s", outcome=fail), disposition=ship)
    assert not _supported(both[0], disposition=ship)  # a record is missing
    assert not _supported(*both, _kept(3, "s"), disposition=ship)  # it passed twice
    assert not _supported(both[0], _kept(2, "s", operation="p", counted=False), disposition=ship)
    assert not _supported(both[0], _kept(2, "s", unit="B", operation="p"), disposition=ship)
    assert _supported(_kept(1, "s", outcome=fail), _kept(2, "t", outcome=fail), disposition=scrap)
    assert not _supported(_kept(1, "s", outcome=fail), disposition=scrap)
    assert _supported(disposition=Disposition.QUARANTINE)  # five lapsed leases leave no record


def test_records_set_aside_are_counted_where_they_are_kept() -> None:
    ledger = Ledger({}, {}, [_kept(1, "s"), _kept(2, "s", counted=False)])
    assert summarise(_status({}), [], ledger, ROUTE, [], 1.0)["set_aside"] == 1


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
    summary = summarise(_status(dispositions), truths, NOTHING_KEPT, ROUTE, [], 1.0)
    assert (summary["escapes"], summary["false_rejects"], summary["true_defective"]) == (1, 1, 3)
    assert (summary["marginal"]["escapes"], summary["marginal"]["false_rejects"]) == (1, 1)
    assert summary["dispositions"] == {"QUARANTINE": 1, "SCRAP": 2, "SHIP": 3}
    assert summary["lost"] == 0
    assert summary["unsupported"] == ["A", "B", "C", "E", "F"]  # nothing of them was kept


@pytest.mark.parametrize("disposition", [Disposition.IN_PROCESS, Disposition.RETEST])
def test_a_unit_without_an_end_counts_as_lost(disposition: Disposition) -> None:
    truths = [Truth("A", "healthy", None), Truth("B", "healthy", None)]
    summary = summarise(_status({"A": disposition}), truths, NOTHING_KEPT, ROUTE, [], 1.0)
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

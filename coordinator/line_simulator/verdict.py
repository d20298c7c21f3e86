"""What a finished simulation must show: the truth of the stations against the coordinator's store."""

# pyright: strict

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

from coordinator.core.yield_statistics import judge
from coordinator.line_simulator.scenario import OPERATIONS, Scenario
from protocol.coordinator_events import FACT, LeaseGranted
from protocol.errors import TestloomError
from protocol.outcomes import Disposition

FALSE_ALARMS = ("spool_gap", "spool_replaced", "unknown_lease")
"""Alarms that mean a loss; no fault that is simulated may cause one."""


class SimulationFailed(TestloomError):
    """The line did something that it must not."""


def check(scenario: Scenario, finished: bool) -> None:
    """Compare truth and store.

    Raises:
        SimulationFailed: with everything that differs.
    """
    problems = list(_problems(scenario, finished))
    if problems:
        raise SimulationFailed("; ".join(problems[:5]), where=f"seed {scenario.seed}")


def _problems(scenario: Scenario, finished: bool) -> Iterator[str]:
    if not finished:
        yield f"the line did not finish by {scenario.world.now_s:.0f} s: {_unfinished(scenario)}"
        return
    if scenario.intruder_accepted:
        yield "a second bench with an id in use was accepted"
    for alarm, count in Counter(scenario.coordinator.disk.alarms).items():
        if alarm in FALSE_ALARMS:
            yield f"{count} alarms '{alarm}'"
    yield from _records(scenario)
    yield from _dispositions(scenario)
    yield from _journal(scenario)


def _unfinished(scenario: Scenario) -> str:
    core = scenario.coordinator.core
    if core is None:
        return "the coordinator is down"
    units = {u.serial: u.state for u in core.line.units.values() if u.state != "FINISHED"}
    spools = {s.station: len(s.spool) for s in scenario.stations.values() if s.spool}
    return f"units {units}, spools {spools}"


def _records(scenario: Scenario) -> Iterator[str]:
    """0 lost, 0 recorded twice, each as it was."""
    stored = scenario.coordinator.disk.records
    made = {(summary.attempt_id, summary.fence): summary for summary in scenario.made}
    if len(made) != len(scenario.made):
        yield "a station made two records of one lease"
    for key, summary in made.items():
        kept = stored.get(key, [])
        if not kept:
            yield f"the record {key} is lost"
        elif len(kept) > 1:
            yield f"the record {key} was stored {len(kept)} times"
        elif kept[0].outcome is not summary.outcome:
            yield f"the record {key} was {summary.outcome.value}, stored as {kept[0].outcome.value}"
    for key in stored.keys() - made.keys():
        yield f"the record {key} was stored and never made"


def _dispositions(scenario: Scenario) -> Iterator[str]:
    """Dispositions follow from records of valid leases, and agree with the units' truth."""
    core = scenario.coordinator.core
    assert core is not None
    stored = scenario.coordinator.disk.records
    kept = [(s, stored.get((s.attempt_id, s.fence))) for s in scenario.made]
    valid = [summary for summary, records in kept if records and not records[0].set_aside]
    for serial, defect_at in scenario.units.items():
        unit = core.line.units[serial]
        judged = [(s.operation, judge(s.outcome, s.fault)) for s in valid if s.serial == serial]
        passed = {operation for operation, judgement in judged if judgement == "passed"}
        failed = [operation for operation, judgement in judged if judgement == "failed"]
        if unit.disposition is Disposition.SHIP and (defect_at or passed != set(OPERATIONS)):
            yield f"{serial} was shipped: defect at '{defect_at}', passed {sorted(passed)}"
        if unit.disposition is Disposition.SCRAP and failed != [defect_at] * 2:
            yield f"{serial} was scrapped: defect at '{defect_at}', failed {failed}"
        if unit.disposition is Disposition.QUARANTINE and unit.disturbed_here < 5:
            yield f"{serial} was set aside after {unit.disturbed_here} disturbed attempts"


def _journal(scenario: Scenario) -> Iterator[str]:
    """The journal alone gives the line again, and no fence was given twice."""
    core = scenario.coordinator.core
    assert core is not None
    if scenario.coordinator.replayed().line != core.line:
        yield "replaying the journal gives another line"
    facts = [FACT.validate_json(line) for line in scenario.coordinator.disk.journal]
    fences = [fact.fence for fact in facts if isinstance(fact, LeaseGranted)]
    if any(later <= earlier for earlier, later in pairwise(fences)):
        yield "fences do not grow"

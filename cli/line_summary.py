"""What a finished run comes to: dispositions, yield, and the emulator's truth beside them. Pure.

Losses are not taken from the coordinator's own counters: the stations' spools say how many records
they ever made, the database says which of them are kept.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

from protocol.line_views import LineStatus
from protocol.measurements import MeasurementSpecification
from protocol.outcomes import Disposition, Outcome
from protocol.plans import Plan
from protocol.routes import Route

REJECTED = (Disposition.SCRAP, Disposition.REWORK, Disposition.QUARANTINE)


@dataclass(frozen=True)
class Truth:
    """What a unit truly is. `category`: healthy, near_limit (healthy, but close), marginal, gross."""

    serial: str
    category: str
    defect: str | None


@dataclass(frozen=True)
class KeptRecord:
    """An attempt's record as found in the database. `counted`: not set aside."""

    attempt_id: str
    station: str
    fence: int
    serial: str
    operation: str
    outcome: Outcome
    counted: bool = True


@dataclass(frozen=True)
class Ledger:
    """What the spools say was done, and what the database kept of it.

    Attributes:
        made: by station, how many records it ever put into its spool.
        ended: by station, the fences of the leases that it began and made a record of.
        kept: the records in the database.
    """

    made: Mapping[str, int]
    ended: Mapping[str, Set[int]]
    kept: Sequence[KeptRecord]

    def lost(self) -> int:
        """Records that a station made and the database does not have.

        A station numbers its records without a gap and makes one an attempt, so that counting
        distinct attempts by station finds each loss; the fences find one that another record covers up.
        """
        kept = self._kept_by_station()
        fences = {(record.station, record.fence) for record in self.kept}
        total = 0
        for station in {*self.made, *self.ended}:
            fewer = self.made.get(station, 0) - kept[station]
            unknown = [fence for fence in self.ended.get(station, ()) if (station, fence) not in fences]
            total += max(fewer, len(unknown), 0)
        return total

    def duplicated(self) -> int:
        """Attempts that the database has more than once, and records that no station ever made."""
        kept = self._kept_by_station()
        copies = len(self.kept) - len({record.attempt_id for record in self.kept})
        return copies + sum(max(0, count - self.made.get(station, 0)) for station, count in kept.items())

    def supports(self, serial: str, disposition: Disposition, route: Route) -> bool:
        """Whether a unit's disposition follows from its records: shipped on exactly one PASS of every
        operation, scrapped on as many failures of one as the route asks for."""
        own = [record for record in self.kept if record.serial == serial and record.counted]
        passes = Counter(record.operation for record in own if record.outcome is Outcome.PASS)
        others = Counter(record.operation for record in own if record.outcome is not Outcome.PASS)
        if disposition is Disposition.SHIP:
            return passes == Counter(operation.name for operation in route.operations)
        if disposition in (Disposition.SCRAP, Disposition.REWORK):
            return any(others[o.name] >= o.max_attempts_failed for o in route.operations)
        return True  # lapsed leases leave no record: a unit may be set aside without one

    def _kept_by_station(self) -> Counter[str]:
        return Counter(station for station, _ in {(r.station, r.attempt_id) for r in self.kept})


def summarise(
    status: LineStatus,
    truths: Sequence[Truth],
    ledger: Ledger,
    route: Route,
    plans: Iterable[Plan],
    wall_s: float,
) -> dict[str, Any]:
    """The summary of a run, as `--summary` writes it.

    A unit without a final disposition counts as lost, like a record that did not arrive. A unit whose
    disposition does not follow from the records kept is `unsupported`.
    """
    dispositions = {view.unit.serial: view.disposition for view in status.units}
    finished = {Disposition.SHIP, *REJECTED}
    unfinished = [t.serial for t in truths if dispositions.get(t.serial) not in finished]

    def count(category: str, wanted: Iterable[Disposition]) -> int:
        chosen = set(wanted)
        return sum(1 for t in truths if t.category == category and dispositions.get(t.serial) in chosen)

    report = status.yield_report
    return {
        "units": len(truths),
        "attempts": len({record.attempt_id for record in ledger.kept}),
        "dispositions": dict(sorted(Counter(d.value for d in dispositions.values()).items())),
        "lost": ledger.lost() + len(unfinished),
        "duplicated": ledger.duplicated(),
        "fpy": {entry.operation: entry.fpy for entry in report.operations},
        "fpy_unit": {entry.operation: entry.fpy_unit for entry in report.operations},
        "rty": report.rty,
        "true_defective": sum(1 for t in truths if t.category in ("gross", "marginal")),
        "escapes": count("gross", [Disposition.SHIP]),
        "false_rejects": count("healthy", REJECTED),
        "marginal": {
            "units": sum(1 for t in truths if t.category == "marginal"),
            "escapes": count("marginal", [Disposition.SHIP]),
            "near_limit_units": sum(1 for t in truths if t.category == "near_limit"),
            "false_rejects": count("near_limit", REJECTED),
            "stated_risk": stated_risk(plans),
        },
        "unfinished": unfinished,
        "unsupported": sorted(s for s, d in dispositions.items() if not ledger.supports(s, d, route)),
        "set_aside": sum(not record.counted for record in ledger.kept),  # some come after the line's end
        "wall_s": round(wall_s, 3),
    }


def stated_risk(plans: Iterable[Plan]) -> dict[str, float]:
    """The largest risk that the plans' limits and stated uncertainties allow, for one unit.

    consumer: a unit whose quantity lies half a limit's width beyond the limit passes in one of its two
    attempts (where one side is open, the limit's own size counts as its width).
    producer: a unit one standard uncertainty inside a limit fails twice in a row, and is rejected.
    Both for a normal error of measurement (JCGM 106:2012, clause 7.3), each quantity by itself.
    """
    consumer = 0.0
    producer = 0.0
    for plan in plans:
        for step in plan.steps():
            for specification in step.measurements:
                width = _width(specification)
                if not specification.standard_uncertainty or width is None:
                    continue
                passes_once = _normal_tail(0.5 * width / specification.standard_uncertainty)
                consumer = max(consumer, 1 - (1 - passes_once) ** 2)
                producer = max(producer, _normal_tail(1.0) ** 2)
    return {"consumer": consumer, "producer": producer}


def _width(specification: MeasurementSpecification) -> float | None:
    low, high = specification.low, specification.high
    if low is not None and high is not None:
        return high - low
    limit = high if low is None else low
    return None if limit is None else abs(limit)


def _normal_tail(z: float) -> float:
    """P(standard normal > z)."""
    return 0.5 * math.erfc(z / math.sqrt(2))

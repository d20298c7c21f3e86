"""What a finished run comes to: dispositions, yield, and the emulator's truth beside them. Pure.

Losses are not taken from the coordinator's own counters: the stations' spools say how many records
they ever made, the database says which of them are kept.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from protocol.line_views import LineStatus
from protocol.measurements import MeasurementSpecification
from protocol.outcomes import Disposition
from protocol.plans import Plan

REJECTED = (Disposition.SCRAP, Disposition.REWORK, Disposition.QUARANTINE)


@dataclass(frozen=True)
class Truth:
    """What a unit truly is. `category`: healthy, near_limit (healthy, but close), marginal, gross."""

    serial: str
    category: str
    defect: str | None


@dataclass(frozen=True)
class KeptRecord:
    """An attempt's record as found in the database."""

    attempt_id: str
    station: str


@dataclass(frozen=True)
class Ledger:
    """Records made, by station (from the spools), and records kept (from the database)."""

    made: Mapping[str, int]
    kept: Sequence[KeptRecord]

    def lost(self) -> int:
        """Records that a station made and the database does not have.

        A station numbers its records without a gap and makes one an attempt, so that counting
        distinct attempts by station finds each loss.
        """
        kept = Counter(station for station, _ in {(r.station, r.attempt_id) for r in self.kept})
        return sum(max(0, made - kept[station]) for station, made in self.made.items())

    def duplicated(self) -> int:
        """Attempts that the database has more than once."""
        return len(self.kept) - len({record.attempt_id for record in self.kept})


def summarise(
    status: LineStatus, truths: Sequence[Truth], ledger: Ledger, plans: Iterable[Plan], wall_s: float
) -> dict[str, Any]:
    """The summary of a run, as `--summary` writes it.

    A unit without a final disposition counts as lost, like a record that did not arrive.
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
        "set_aside": status.records_set_aside,
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

"""Yield, kept incrementally: one attempt costs the same whatever came before.

Two conventions stand side by side; each counts one attempt of a unit at an operation, no retest:

- FPY as peers count it: every first attempt that is not a PASS counts against it: failed, error,
  aborted, timed out, or lost with its station.
- FPY of units: only the unit's own faults count, at the first attempt that judged the unit (PASS
  or unit fault). A station that loses power says nothing about the unit on it.

RTY, the rolled throughput yield, is the product of the operations' FPY. The final yield is shipped
units over finished units.

A unit fault is FAIL (by the unit, or by nobody's named fault), ERROR or TIMEOUT with fault 'unit'.
"""

# pyright: strict

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from protocol.errors import Fault
from protocol.line_views import OperationYield
from protocol.outcomes import Disposition, Outcome

Judgement = Literal["passed", "failed", "disturbed"]

_UNIT_FAULT_OUTCOMES = (Outcome.FAIL, Outcome.ERROR, Outcome.TIMEOUT)


def judge(outcome: Outcome | None, fault: Fault) -> Judgement:
    """What an attempt says of its unit. `outcome` None: the attempt was lost, it says nothing."""
    if outcome is Outcome.PASS:
        return "passed" if fault is Fault.NONE else "disturbed"
    if outcome is Outcome.FAIL and fault is Fault.NONE:
        return "failed"
    if fault is Fault.UNIT and outcome in _UNIT_FAULT_OUTCOMES:
        return "failed"
    return "disturbed"


@dataclass(slots=True)
class Tally:
    """Counts of one operation, or of one station at it."""

    first_attempts: int = 0
    first_passes: int = 0
    first_judged: int = 0
    first_unit_faults: int = 0
    attempts: int = 0
    passes: int = 0

    @property
    def fpy(self) -> float | None:
        """As peers count it."""
        return self.first_passes / self.first_attempts if self.first_attempts else None

    @property
    def fpy_unit(self) -> float | None:
        """Of units."""
        return 1.0 - self.first_unit_faults / self.first_judged if self.first_judged else None

    def view(self, operation: str, station: str | None) -> OperationYield:
        """As people ask for it."""
        return OperationYield(
            operation=operation,
            station=station,
            first_attempts=self.first_attempts,
            first_passes=self.first_passes,
            first_unit_faults=self.first_unit_faults,
            first_judged=self.first_judged,
            attempts=self.attempts,
            passes=self.passes,
            fpy=self.fpy,
            fpy_unit=self.fpy_unit,
        )


@dataclass(slots=True)
class YieldStatistics:
    """Tallies by operation, and by operation and station."""

    operations: dict[str, Tally] = field(default_factory=dict[str, Tally])
    stations: dict[tuple[str, str], Tally] = field(default_factory=dict[tuple[str, str], Tally])

    def add(
        self, operation: str, station: str, judgement: Judgement, first: bool, judged_before: bool
    ) -> None:
        """Count one attempt. `first`: the unit's first at this operation; `judged_before`: an
        earlier one there judged it."""
        by_operation = self.operations.get(operation)
        if by_operation is None:
            by_operation = self.operations[operation] = Tally()
        by_station = self.stations.get((operation, station))
        if by_station is None:
            by_station = self.stations[operation, station] = Tally()
        passed = judgement == "passed"
        judges_first = judgement != "disturbed" and not judged_before
        for tally in (by_operation, by_station):
            tally.attempts += 1
            if passed:
                tally.passes += 1
            if first:
                tally.first_attempts += 1
                if passed:
                    tally.first_passes += 1
            if judges_first:
                tally.first_judged += 1
                if not passed:
                    tally.first_unit_faults += 1

    def rolled(self, operations: Iterable[str]) -> tuple[float | None, float | None]:
        """RTY over these operations, (as peers count, of units); None while one has no attempt."""
        rty: float | None = 1.0
        rty_unit: float | None = 1.0
        empty = True
        for operation in operations:
            empty = False
            tally = self.operations.get(operation, Tally())
            rty = None if rty is None or tally.fpy is None else rty * tally.fpy
            rty_unit = None if rty_unit is None or tally.fpy_unit is None else rty_unit * tally.fpy_unit
        return (None, None) if empty else (rty, rty_unit)


def final_yield(dispositions: Mapping[Disposition, int]) -> float | None:
    """Shipped over finished units; None while none is finished."""
    finished = sum(dispositions.values())
    return dispositions.get(Disposition.SHIP, 0) / finished if finished else None

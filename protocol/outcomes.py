"""Outcomes of measurements and attempts, and the dispositions of units."""

from enum import StrEnum


class Outcome(StrEnum):
    """How an attempt or a step ended. Only PASS lets a unit move on."""

    PASS = "PASS"
    FAIL = "FAIL"
    ERROR = "ERROR"
    ABORTED = "ABORTED"
    TIMEOUT = "TIMEOUT"


class MeasurementOutcome(StrEnum):
    """UNSET is a measurement that was declared and never taken: it is never a PASS."""

    PASS = "PASS"
    FAIL = "FAIL"
    UNSET = "UNSET"
    ERROR = "ERROR"


class Disposition(StrEnum):
    """What becomes of a unit. RETEST: the unit is unchanged and goes to another socket."""

    IN_PROCESS = "IN_PROCESS"
    RETEST = "RETEST"
    SHIP = "SHIP"
    REWORK = "REWORK"
    QUARANTINE = "QUARANTINE"
    SCRAP = "SCRAP"

"""Words for states, outcomes, durations and fractions, in the language of the page."""

from datetime import UTC, datetime

from dashboards.intervals import CountedFraction
from dashboards.view_models import Sentence
from protocol.language import say

SOCKET_STATE_WORDS = {
    "free": "Free",
    "testing": "Testing",
    "recording": "Keeping the record",
    "passed": "Pass",
    "failed": "Fail",
    "not_judged": "Not judged",
    "silent": "Silent",
    "refused": "Refused",
}
OUTCOME_WORDS = {
    "PASS": "Pass",
    "FAIL": "Fail",
    "ERROR": "Error",
    "ABORTED": "Aborted",
    "TIMEOUT": "Time-out",
    "UNSET": "Not measured",
}
DISPOSITION_WORDS = {
    "IN_PROCESS": "In process",
    "RETEST": "Retest",
    "SHIP": "Ship",
    "REWORK": "Rework",
    "QUARANTINE": "Quarantine",
    "SCRAP": "Scrap",
}
FAULT_WORDS = {
    "none": "no fault",
    "unit": "fault of the unit",
    "fixture": "fault of the fixture",
    "station": "fault of the station",
    "stand": "fault of the stand",
    "plan": "fault of the plan",
    "data": "fault of the data",
    "operator": "fault of the operator",
    "testloom": "fault of Testloom",
}
OPERATION_WORDS = {"functional": "Functional test", "imu_calibration": "IMU calibration"}
PLACE_WORDS = {"functional": "socket boards", "imu_calibration": "turntables"}
SECTION_WORDS = {"setup": "Setup", "main": "Main", "teardown": "Teardown"}


def operation_word(operation: str, language: str) -> str:
    """The name of an operation for people; an operation not known here goes by its own name."""
    return say(OPERATION_WORDS[operation], language=language) if operation in OPERATION_WORDS else operation


def sentence_words(sentence: Sentence, language: str) -> str:
    """A sentence of the coordinator in the page's language; in English when that cannot be."""
    if not sentence.template or "language" in sentence.values:
        return sentence.text
    try:
        values = {
            name: operation_word(value, language) if name == "operation" else value
            for name, value in sentence.values.items()
        }
        return say(sentence.template, language=language, **values)
    except (KeyError, IndexError, ValueError):
        return sentence.text


def duration(seconds: float, language: str) -> str:
    """'8 s', '3 min 20 s', '2 h 05 min'."""
    whole = max(0, round(seconds))
    if whole < 60:
        return say("{seconds} s", language=language, seconds=whole)
    if whole < 3600:
        return say("{minutes} min {seconds} s", language=language, minutes=whole // 60, seconds=whole % 60)
    return say(
        "{hours} h {minutes} min", language=language, hours=whole // 3600, minutes=f"{whole % 3600 // 60:02d}"
    )


def percent(fraction: float | None) -> str:
    """One decimal, none for 100 %; an en dash when there is no fraction yet.

    A fraction below one is never rounded up to 100 %.
    """
    if fraction is None:
        return "–"
    if fraction == 1.0:
        return "100 %"
    return f"{min(fraction * 100, 99.9):.1f} %"


def interval_words(counted: CountedFraction, language: str) -> str:
    """'11 of 12 · 95 %: 64.6–98.5 %'."""
    if counted.low is None or counted.high is None:
        return say("no first attempt yet", language=language)
    return say(
        "{successes} of {trials} · 95 % interval {low} to {high}",
        language=language,
        successes=counted.successes,
        trials=counted.trials,
        low=percent(counted.low),
        high=percent(counted.high),
    )


def timestamp(seconds_since_1970: float) -> str:
    """A wall-clock time as '2026-05-04 13:20:59 UTC'; far outside the calendar: the number itself."""
    try:
        return datetime.fromtimestamp(seconds_since_1970, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"{seconds_since_1970:g} s"

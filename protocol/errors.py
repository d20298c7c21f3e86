"""Errors that a person can act on: what is wrong, where, whose fault, what to do."""

from enum import StrEnum


class Fault(StrEnum):
    """Whose fault it is. Decides who is called, and whether a unit is blamed."""

    NONE = "none"
    UNIT = "unit"
    FIXTURE = "fixture"
    STATION = "station"
    STAND = "stand"
    PLAN = "plan"
    DATA = "data"
    OPERATOR = "operator"
    TESTLOOM = "testloom"


class TestloomError(Exception):
    """An error for a person. `what` and `remedy` are English sentences.

    Attributes:
        what: what is wrong, as one sentence.
        where: file, column and row; station and socket; link and byte position.
        fault: whose fault it is.
        remedy: what to do now.
        story: what led here, oldest first, when a state machine or a link can tell.
    """

    __test__ = False  # pytest: not a test class, in spite of its name

    def __init__(
        self,
        what: str,
        *,
        where: str = "",
        fault: Fault = Fault.TESTLOOM,
        remedy: str = "",
        story: tuple[str, ...] = (),
    ) -> None:
        super().__init__(what)
        self.what = what
        self.where = where
        self.fault = fault
        self.remedy = remedy
        self.story = story

    def __str__(self) -> str:
        parts = [self.what]
        if self.where:
            parts.append(f"Where: {self.where}.")
        parts.append(f"Fault: {self.fault.value}.")
        if self.remedy:
            parts.append(f"What to do: {self.remedy}")
        return " ".join(parts)


class RecordingError(TestloomError):
    """A recording that is damaged, cut short or does not say what its columns are."""


class PlanError(TestloomError):
    """A plan that cannot be run as written."""


class LinkError(TestloomError):
    """A link to a unit, an instrument or a stand that does not do what it should."""


class LinkTimeoutError(LinkError, TimeoutError):
    """Nothing (complete) came over a link within its time-out."""


class CalibrationError(TestloomError):
    """Data that cannot carry the coefficients asked of them."""

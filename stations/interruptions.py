"""What ends a step before its time: an abort, a time-out, or a step that breaks its own declaration."""

import threading

from protocol.errors import Fault, TestloomError


class SequenceAborted(TestloomError):
    """The sequence was told to stop; the step leaves at its next wait."""


class StepTimeout(TestloomError):
    """A step (or the whole sequence) used up its bench time.

    Attributes:
        of_sequence: the plan's deadline passed, not the step's own time-out.
    """

    def __init__(self, what: str, *, where: str = "", of_sequence: bool = False) -> None:
        super().__init__(
            what,
            where=where,
            fault=Fault.UNIT,
            remedy="look at what the step waited for; or raise the time-out in the plan.",
        )
        self.of_sequence = of_sequence


class StepError(TestloomError):
    """A step does what the plan does not declare, or lacks what it needs."""


class AbortFlag:
    """Tells one running sequence to stop. It is looked at in every wait; the first reason stays."""

    def __init__(self) -> None:
        self._requested = threading.Event()
        self._reason = ""

    def request(self, reason: str) -> None:
        """Ask for the abort. Any thread may."""
        if not self._requested.is_set():
            self._reason = reason
            self._requested.set()

    @property
    def is_requested(self) -> bool:
        return self._requested.is_set()

    @property
    def reason(self) -> str:
        return self._reason

    def check(self) -> None:
        """Raises: SequenceAborted: the abort has been asked for."""
        if self._requested.is_set():
            raise SequenceAborted(
                f"The sequence was aborted: {self._reason}.",
                fault=Fault.NONE,
                remedy="run the operation again when the reason has gone.",
            )

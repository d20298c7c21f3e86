# pyright: strict
"""INIT and FETC?: an acquisition that takes its time and is evaluated at the end of its window."""

from collections.abc import Callable

from dut_emulator.instruments.scpi import Call, ScpiError, ScpiInstrument, formatted

TIME_RESOLUTION_S = 1e-9
"""Bench times are sums of doubles: a FETC? at the very end of a window is not too early."""


class AcquiringInstrument(ScpiInstrument):
    """An instrument with a trigger: INITiate begins a window, FETCh? gives its value once it is over."""

    def __init__(self, identification: str) -> None:
        super().__init__(identification)
        self._begin_s: float | None = None
        self._end_s: float | None = None
        self._value: float | None = None
        self.commands.add("INITiate[:IMMediate]", self._initiate)
        self.commands.add("FETCh?", self._fetch)
        self.commands.add("ABORt", self._abort)

    def window_s(self) -> float:
        """How long an acquisition takes: to be given by the instrument."""
        raise NotImplementedError

    def evaluate(self, begin_s: float, end_s: float) -> float:
        """The reading of a window that has just ended: to be given by the instrument."""
        raise NotImplementedError

    def next_event_s(self) -> float | None:
        """End of the window that is open, if one is."""
        return self._end_s

    def advance(self, now_s: float) -> None:
        """Evaluate a window that is over."""
        if self._end_s is not None and self._begin_s is not None and now_s >= self._end_s - TIME_RESOLUTION_S:
            begin_s, end_s = self._begin_s, self._end_s
            self._begin_s = self._end_s = None
            self._value = self.evaluate(begin_s, end_s)

    def reset(self, now_s: float) -> None:  # noqa: ARG002 - an acquisition is cut off at any time
        """Nothing acquired, no window open."""
        self.discard()

    def discard(self) -> None:
        """Throw away what is acquired or being acquired."""
        self._begin_s = self._end_s = self._value = None

    def configure(self, change: Callable[[], None]) -> Callable[[Call], None]:
        """A handler that changes the configuration and throws a running acquisition away."""

        def handler(call: Call) -> None:
            call.exactly(0)
            change()
            self.discard()

        return handler

    def _initiate(self, call: Call) -> None:
        call.exactly(0)
        if self._end_s is not None:
            raise ScpiError(-221, "acquisition is running")
        self._value = None
        self._begin_s, self._end_s = call.now_s, call.now_s + self.window_s()

    def _fetch(self, call: Call) -> str:
        call.exactly(0)
        self.advance(call.now_s)
        if self._value is None:
            raise ScpiError(-230, "acquisition is running" if self._end_s is not None else "nothing acquired")
        return formatted(self._value)

    def _abort(self, call: Call) -> None:
        call.exactly(0)
        self.discard()

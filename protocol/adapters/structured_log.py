"""Logs as JSON lines with wall-clock time in UTC, alike in every process.

A log that cannot be written never stops its process: a full disk under a station's log is the same
disk as its spool's, and the agent must live on to keep its records.
"""

import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import structlog
from structlog.typing import EventDict, WrappedLogger


class PatientStream:
    """A text stream that drops what it cannot write, and says how much when it can again."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.dropped = 0

    def write(self, text: str) -> int:
        """Write, or count it as dropped."""
        try:
            if self.dropped:
                self._stream.write(f'{{"event": "log_lines_dropped", "count": {self.dropped}}}\n')
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):
            self.dropped += 1
        else:
            self.dropped = 0
        return len(text)

    def flush(self) -> None:
        """Every write is flushed; nothing is left to do."""


def log_as_json(stream: TextIO | None = None, **names: str) -> None:
    """Log as JSON lines from now on, on every thread.

    Args:
        stream: where to; None: standard error.
        names: stand on every line, such as line='demo', station='functional-1'.
    """

    def named(logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
        del logger, method
        return {**event, **names}

    structlog.configure(
        processors=[
            named,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(ensure_ascii=False),
        ],
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.WriteLoggerFactory(file=PatientStream(stream or sys.stderr)),  # pyright: ignore[reportArgumentType]
        cache_logger_on_first_use=False,
    )


@contextmanager
def structured_log(log_file: Path | None, **names: str) -> Generator[None]:
    """Log as JSON lines for as long as the block lasts. `log_file` None: standard error."""
    stream = None if log_file is None else log_file.open("a", encoding="utf-8")
    log_as_json(stream, **names)
    try:
        yield
    finally:
        structlog.reset_defaults()
        if stream is not None:
            with suppress(OSError):
                stream.close()

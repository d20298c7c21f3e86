"""Logs as JSON lines, to stderr or a file. A log that cannot be written never stops the line."""

import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import structlog


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


@contextmanager
def structured_log(log_file: Path | None) -> Generator[None]:
    """Log as JSON lines for as long as the block lasts."""
    stream = sys.stderr if log_file is None else log_file.open("a", encoding="utf-8")
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.JSONRenderer(),
        ],
        logger_factory=structlog.WriteLoggerFactory(file=PatientStream(stream)),  # pyright: ignore[reportArgumentType]
        cache_logger_on_first_use=False,
    )
    try:
        yield
    finally:
        structlog.reset_defaults()
        if log_file is not None:
            with suppress(OSError):
                stream.close()

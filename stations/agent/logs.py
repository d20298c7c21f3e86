"""The agent's log: one JSON object a line on standard error, with wall-clock time in UTC."""

import sys

import structlog
from structlog.typing import EventDict, WrappedLogger


def configure_logs(line: str, station: str) -> None:
    """Log as JSON from now on, on every thread, each line with the line's and the station's name."""

    def named(logger: WrappedLogger, method: str, event: EventDict) -> EventDict:
        del logger, method
        return {**event, "line": line, "station": station}

    structlog.configure(
        processors=[
            named,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(ensure_ascii=False),
        ],
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,
    )

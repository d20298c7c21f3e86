"""The dashboard's log: one JSON object a line on standard error, with wall-clock time in UTC."""

import sys

import structlog
from structlog.typing import EventDict


def configure_logs(line: str) -> None:
    """Log as JSON from now on, each line with the line's name."""

    def name_process(_logger: object, _method: str, event: EventDict) -> EventDict:
        event.update(line=line, process="dashboard")
        return event

    structlog.configure(
        processors=[
            name_process,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(ensure_ascii=False),
        ],
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,
    )

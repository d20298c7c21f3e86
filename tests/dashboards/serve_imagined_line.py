"""Serve a dashboard over files instead of a coordinator: `serve_imagined_line.py FOLDER [PORT]`.

FOLDER/status.json, progress.json (a list) and unit-<serial>.json stand in for the coordinator. Without
status.json the coordinator is away. Prints the address.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import TypeAdapter

from dashboards.line_source import LineSource
from dashboards.server import run_dashboard
from protocol.adapters.zenoh_link import NoReplyError, RequestRejectedError
from protocol.line_views import LineStatus, UnitHistory
from protocol.station_messages import SocketProgress

_PROGRESS = TypeAdapter(list[SocketProgress])


class FolderSource:
    """A `LineSource` over a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._last_progress = ""

    def status(self) -> LineStatus:
        return LineStatus.model_validate_json(self._answer("status.json"))

    def unit(self, serial: str) -> UnitHistory:
        self._answer("status.json")
        try:
            return UnitHistory.model_validate_json((self._folder / f"unit-{serial}.json").read_text())
        except (OSError, ValueError):
            raise RequestRejectedError(f"No unit '{serial}' was ever ordered here.") from None

    def take_progress(self) -> list[SocketProgress]:
        file = self._folder / "progress.json"
        text = file.read_text() if file.is_file() else "[]"
        if text == self._last_progress:
            return []
        self._last_progress = text
        return _PROGRESS.validate_json(text)

    def _answer(self, name: str) -> str:
        try:
            return (self._folder / name).read_text()
        except FileNotFoundError:
            raise NoReplyError("Nobody answered.") from None


def main(folder: Path, port: int) -> None:
    @contextmanager
    def connect(_keep_trying: Callable[[], bool]) -> Iterator[LineSource]:
        yield FolderSource(folder)

    run_dashboard(
        "imagined",
        "tcp/127.0.0.1:1",
        port=port,
        on_listening=lambda url: print(url, flush=True),  # noqa: T201 - the test reads it
        connect=connect,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)

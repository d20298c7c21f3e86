"""The dashboard's copy of the line: polled, live in between, honest about its age.

One thread polls the coordinator and takes the live views; pages read snapshots. When the
coordinator or the router is away the last known data stay, with their age, and the thread goes on
asking: nothing here has to be restarted.
"""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import structlog

from dashboards.line_source import ConnectLine, LineSource
from dashboards.socket_states import LiveSocket, SocketAddress
from protocol.adapters.zenoh_link import RequestRejectedError
from protocol.errors import TestloomError
from protocol.line_views import LineStatus, UnitHistory
from protocol.station_messages import SocketProgress

POLL_PERIOD_S = 0.7
POLL_PERIOD_MAX_S = 1.5
POLL_SHARE = 3.0
"""This many times the duration of the last poll lies between two: a huge line is not hurried."""
AWAY_AFTER_S = 3.5
"""Longer than a poll that times out and the longest wait before it."""
UNIT_VALID_S = 1.0
MAX_UNITS_KEPT = 256
MAX_LIVE_SOCKETS = 4096
STOP_TIMEOUT_S = 4.0

_log = structlog.get_logger("dashboards.read_model")


@dataclass(frozen=True)
class Connection:
    """How well the coordinator can be asked.

    `connecting`: not heard of yet, and not long enough to call it away. `away_for_s`: since the
    last answer, or since the start when there was none. `reason`: what the last attempt met.
    """

    state: Literal["connecting", "live", "away"]
    away_for_s: float
    reason: str


@dataclass(frozen=True)
class Snapshot:
    """What is known of the line now. `status` None: nothing was ever heard."""

    connection: Connection
    status: LineStatus | None
    status_age_s: float
    live: dict[SocketAddress, LiveSocket]


@dataclass(frozen=True)
class UnitAnswer:
    """What is known of a unit. `unknown`: the coordinator answered that there is no such unit.

    `age_s`: since the coordinator said so; above `AWAY_AFTER_S` it could not be asked again.
    """

    history: UnitHistory | None
    unknown: str
    age_s: float


class ReadModel:
    """Follows a line. Thread-safe; `start` it, `stop` it."""

    def __init__(self, connect: ConnectLine, clock: Callable[[], float] = time.monotonic) -> None:
        self._connect = connect
        self._clock = clock
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._source: LineSource | None = None
        self._started_at_s = clock()
        self._heard_at_s: float | None = None
        self._status: LineStatus | None = None
        self._reason = ""
        self._live: dict[SocketAddress, _Seen] = {}
        self._units: OrderedDict[str, tuple[UnitHistory | None, str, float]] = OrderedDict()

    def start(self) -> None:
        """Begin to follow the line, in a thread of its own."""
        self._thread = threading.Thread(target=self._follow, name="read-model", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the source."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(STOP_TIMEOUT_S)

    def snapshot(self) -> Snapshot:
        """The line as known at this moment."""
        with self._lock:
            now_s = self._clock()
            self._take_progress(now_s)
            return Snapshot(
                connection=self._connection(now_s),
                status=self._status,
                status_age_s=0.0 if self._heard_at_s is None else now_s - self._heard_at_s,
                live={
                    key: LiveSocket(seen.view, now_s - seen.at_s, seen.notice)
                    for key, seen in self._live.items()
                },
            )

    def poll(self, source: LineSource) -> None:
        """Ask the coordinator once and keep what it says; away is a state, not an error."""
        with self._lock:
            self._source = source
        try:
            status = source.status()
        except TestloomError as error:
            self._note_failure(error)
            return
        with self._lock:
            self._status = status
            self._heard_at_s = self._clock()
            if self._reason:
                _log.info("coordinator answers")
            self._reason = ""
            self._take_progress(self._heard_at_s)

    def unit(self, serial: str) -> UnitAnswer:
        """What is known of a unit; asks the coordinator when that is older than `UNIT_VALID_S`."""
        with self._lock:
            known, source = self._units.get(serial), self._source
            if known is not None and self._clock() - known[2] < UNIT_VALID_S:
                return UnitAnswer(known[0], known[1], self._clock() - known[2])
        history, unknown = None, ""
        try:
            if source is not None:
                history = source.unit(serial)
        except RequestRejectedError as rejection:
            unknown = rejection.what
        except TestloomError as error:
            self._note_failure(error)
        with self._lock:
            now_s = self._clock()
            if history is not None or unknown:
                known = (history, unknown, now_s)
                self._units[serial] = known
                self._units.move_to_end(serial)
                if len(self._units) > MAX_UNITS_KEPT:
                    self._units.popitem(last=False)
            return (
                UnitAnswer(None, "", 0.0)
                if known is None
                else UnitAnswer(known[0], known[1], now_s - known[2])
            )

    def _follow(self) -> None:
        while not self._stopping.is_set():
            try:
                with self._connect(lambda: not self._stopping.is_set()) as source:
                    self._poll_until_stopped(source)
            except TestloomError as error:
                self._note_failure(error)
                self._stopping.wait(POLL_PERIOD_S)
            finally:
                with self._lock:
                    self._source = None

    def _poll_until_stopped(self, source: LineSource) -> None:
        while not self._stopping.is_set():
            began_s = self._clock()
            self.poll(source)
            took_s = self._clock() - began_s
            self._stopping.wait(min(max(POLL_PERIOD_S, POLL_SHARE * took_s), POLL_PERIOD_MAX_S))

    def _note_failure(self, error: TestloomError) -> None:
        with self._lock:
            if not self._reason:
                _log.warning("coordinator does not answer", what=error.what, where=error.where)
            self._reason = error.what

    def _connection(self, now_s: float) -> Connection:
        since_s = now_s - (self._started_at_s if self._heard_at_s is None else self._heard_at_s)
        if since_s > AWAY_AFTER_S:
            return Connection("away", since_s, self._reason)
        return Connection("connecting" if self._heard_at_s is None else "live", since_s, self._reason)

    def _take_progress(self, now_s: float) -> None:
        """Newest view of each socket; that a socket is idle does not wipe out its last outcome.

        A view without a unit but with a step is a notice of the station on itself: it stands
        until the next view.
        """
        if self._source is None:
            return
        for view in self._source.take_progress():
            key = (view.station, view.socket)
            before = self._live.get(key)
            if before is None:
                if len(self._live) < MAX_LIVE_SOCKETS:
                    self._live[key] = _Seen(view, now_s, _notice(view))
                continue
            idle_after_outcome = view.serial is None and before.view.outcome is not None
            said_again = view == before.view and view.outcome is not None
            if idle_after_outcome or said_again or _notice(view):
                self._live[key] = replace(before, notice=_notice(view))
            else:
                self._live[key] = _Seen(view, now_s, "")


@dataclass(frozen=True)
class _Seen:
    view: SocketProgress
    at_s: float
    notice: str


def _notice(view: SocketProgress) -> str:
    return "" if view.serial is not None or view.step is None else view.step.removeprefix("alarm: ")

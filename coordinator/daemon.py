"""The coordinator's process: Zenoh around a LineService.

Queries are only put into a bounded inbox by Zenoh's threads; one thread, the caller's, owns core
and store. Commands go to stations as queries from a small pool of threads, and what became of them
comes back through the inbox. The wall clock is read here and nowhere else in the package.
"""

import gc
import queue
import signal
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

import structlog
from pydantic import ValidationError

from coordinator.line_service import LineService, ToStation
from coordinator.requests import Request
from protocol import keys
from protocol.adapters.structured_log import structured_log
from protocol.adapters.zenoh_link import (
    IncomingQuery,
    NoReplyError,
    RequestRejectedError,
    ZenohLink,
    open_link,
)
from protocol.coordinator_events import (
    CommandUndelivered,
    Event,
    LineSettings,
    SequenceAccepted,
    SequenceRefused,
    StationTokenVanished,
)
from protocol.errors import Fault
from protocol.station_messages import COMMAND_REPLY, CommandAccepted, StartSequence

MAX_INBOX = 4_096
MAX_REQUESTS_WAITING = 3_000
"""Beyond this a request is refused as 'busy'; the rest of the inbox is for the coordinator's own."""
MAX_BATCH = 64
MAX_IDLE_S = 0.2
COMMAND_TIMEOUT_S = 1.0
COMMAND_THREADS = 16
STORE_RETRY_S = 1.0
GC_THRESHOLDS = (50_000, 20, 100)
"""The state is long-lived and nearly free of cycles: look for garbage more rarely than Python does."""

_log = structlog.get_logger("coordinator")


@dataclass(frozen=True)
class CoordinatorArguments:
    """What a coordinator needs to know. `log_file` None: stderr."""

    line: str
    router: str
    database: str
    log_file: Path | None = None
    settings: LineSettings = field(default_factory=LineSettings)


class WallClock:
    """Seconds since 1970 that go forward at the machine's own pace, whatever sets its clock."""

    def __init__(self) -> None:
        self._base_s = time.time() - time.monotonic()

    def __call__(self) -> float:
        return self._base_s + time.monotonic()


class CoordinatorDaemon:
    """One line's coordinator. `run` returns after `stop`."""

    def __init__(self, arguments: CoordinatorArguments) -> None:
        self._arguments = arguments
        self._clock = WallClock()
        self._inbox: queue.Queue[Request | Event] = queue.Queue(maxsize=MAX_INBOX)
        self._stopping = threading.Event()
        self._service = LineService(
            arguments.database, arguments.line, arguments.settings, metadata.version("testloom"), self._clock
        )
        self._retry_at_s = 0.0
        self._incarnation = time.time_ns()
        self._other_seen = threading.Event()

    def stop(self) -> None:
        """End `run` soon. May be called from a signal handler or another thread."""
        self._stopping.set()

    def run(self) -> None:
        """Serve the line until `stop`.

        Raises:
            StoreDamagedError, StoreConflictError, TestloomError: the line cannot be served.
        """
        at_start = self._service.recover()
        line = self._arguments.line
        try:
            with (
                open_link(
                    self._arguments.router,
                    give_up_after_s=float("inf"),
                    keep_trying=lambda: not self._stopping.is_set(),
                ) as link,
                _command_threads() as pool,
            ):
                for verb in keys.COORDINATOR_VERBS:
                    link.serve(keys.coordinator_queryable(line, verb), self._receiver(verb))
                link.watch_alive(keys.all_alive_keys(line), self._token_changed)
                link.declare_alive(keys.alive_key(line, keys.COORDINATOR_NAME, self._incarnation))
                _log.info("serving", router=self._arguments.router)
                gc.collect()
                gc.freeze()
                gc.set_threshold(*GC_THRESHOLDS)
                self._send(at_start, link, pool)
                while not self._stopping.is_set():
                    self._send(self._turn(), link, pool)
        except NoReplyError:
            if not self._stopping.is_set():
                raise
        finally:
            self._refuse_the_rest()
            self._service.close()
            _log.info("stopped")

    def _turn(self) -> list[ToStation]:
        if self._other_seen.is_set():
            self._other_seen.clear()
            self._service.check_sole_writer()
        items = self._next_items()
        if self._service.stood_still():
            return [*self._service.recover(), *self._service.process(items)]
        if not self._service.available and self._clock() >= self._retry_at_s:
            self._retry_at_s = self._clock() + STORE_RETRY_S
            return [*self._service.recover(), *self._service.process(items)]
        return self._service.process(items)

    def _next_items(self) -> list[Request | Event]:
        due_in_s = self._service.seconds_to_next_timer()
        wait_s = MAX_IDLE_S if due_in_s is None else min(due_in_s, MAX_IDLE_S)
        items: list[Request | Event] = []
        try:
            items.append(self._inbox.get(timeout=wait_s) if wait_s > 0 else self._inbox.get_nowait())
            while len(items) < MAX_BATCH:
                items.append(self._inbox.get_nowait())
        except queue.Empty:
            pass  # all that has arrived is taken
        return items

    # --- Zenoh's threads: hand over, nothing else ----------------------------------------------------

    def _receiver(self, verb: keys.CoordinatorVerb) -> Callable[[IncomingQuery], None]:
        def receive(query: IncomingQuery) -> None:
            try:
                if self._inbox.qsize() >= MAX_REQUESTS_WAITING:
                    raise queue.Full
                self._inbox.put_nowait(Request(verb, query))
            except queue.Full:
                query.reject("The coordinator is busy.", Fault.TESTLOOM, "try again in a moment.")

        return receive

    def _token_changed(self, key: str, alive: bool) -> None:
        name, incarnation = keys.parse_alive_key(key)
        if name == keys.COORDINATOR_NAME and alive and incarnation != self._incarnation:
            self._other_seen.set()
        if alive or name == keys.COORDINATOR_NAME:
            return
        event = StationTokenVanished(at_s=self._clock(), station=name, incarnation=incarnation)
        try:
            self._inbox.put_nowait(event)
        except queue.Full:
            _log.warning("token_change_dropped", station=name)  # the station's silence will show it

    # --- commands to stations ------------------------------------------------------------------------

    def _send(self, commands: list[ToStation], link: ZenohLink, pool: ThreadPoolExecutor) -> None:
        # At most one command per live lease is under way: the pool's own queue is bounded by sockets.
        for command in commands:
            pool.submit(self._command, command, link)

    def _command(self, command: ToStation, link: ZenohLink) -> None:
        starts = isinstance(command, StartSequence)
        station = command.lease.station if isinstance(command, StartSequence) else command.station
        fence = command.lease.fence if isinstance(command, StartSequence) else command.fence
        key = keys.station_command_key(self._arguments.line, station)
        event: Event | None = None
        try:
            payload = link.ask(key, command.model_dump_json().encode(), timeout_s=COMMAND_TIMEOUT_S)
            reply = COMMAND_REPLY.validate_json(payload)
        except (NoReplyError, RequestRejectedError, ValidationError) as error:
            _log.warning("command_undelivered", station=station, fence=fence, text=str(error))
            event = CommandUndelivered(at_s=self._clock(), fence=fence)
        else:
            if isinstance(reply, CommandAccepted):
                event = SequenceAccepted(at_s=self._clock(), fence=fence) if starts else None
            else:
                _log.warning("command_refused", station=station, fence=fence, reason=reply.reason)
                if starts:
                    event = SequenceRefused(
                        at_s=self._clock(), fence=fence, reason=reply.reason, text=reply.text
                    )
        if event is not None and not self._stopping.is_set():
            try:
                self._inbox.put(event, timeout=COMMAND_TIMEOUT_S)
            except queue.Full:
                _log.error("command_outcome_dropped", fence=fence)  # the lease will lapse

    def _refuse_the_rest(self) -> None:
        while True:
            try:
                item = self._inbox.get_nowait()
            except queue.Empty:
                return
            if isinstance(item, Request):
                item.query.reject("The coordinator is stopping.", Fault.TESTLOOM, "try again.")


@contextmanager
def _command_threads() -> Generator[ThreadPoolExecutor]:
    pool = ThreadPoolExecutor(COMMAND_THREADS, thread_name_prefix="command")
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def run_coordinator(arguments: CoordinatorArguments) -> None:
    """Run a coordinator in this process until SIGTERM or SIGINT.

    Raises:
        TestloomError: it cannot serve the line; says why and what to do.
    """
    keys.checked_name(arguments.line, "line")
    with structured_log(arguments.log_file, line=arguments.line):
        daemon = CoordinatorDaemon(arguments)

        def on_signal(_number: int, _frame: object) -> None:
            daemon.stop()

        previous = {number: signal.signal(number, on_signal) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            daemon.run()
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)

"""The agent's process: carries out what the core asks, and tells it what happened.

One thread handles the core's events, one a socket runs sequences, two ask the coordinator. Callbacks
of the link only put events into the bounded queue. The spool belongs to the events' thread.
"""

import queue
import signal
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from types import FrameType

import structlog
from pydantic import ValidationError

from protocol.adapters.structured_log import log_as_json
from protocol.adapters.zenoh_link import IncomingQuery, ZenohLink, open_link
from protocol.bench_description import BenchDescription
from protocol.errors import Fault, PlanError, TestloomError
from protocol.frozen_model import first_problem
from protocol.keys import alive_key, checked_name, station_command_key, station_live_key
from protocol.plans import Plan
from protocol.station_messages import (
    STATION_COMMAND,
    RecordsAcknowledged,
    SocketDescription,
    SocketProgress,
    StationReply,
    SubmitRecords,
)
from stations.agent import events as on
from stations.agent.bench_watch import BenchWatch, RunnerFactory, await_description
from stations.agent.caller import CoordinatorCaller
from stations.agent.core import EXIT_STOPPED, AgentCore
from stations.agent.socket_worker import SocketWorker
from stations.agent.state import AgentIdentity, SpoolContent
from stations.sequencing.runner import SequenceRunner
from stations.sequencing.step_registry import bundled_plans, load_plan
from stations.spool import Spool, SpoolError, close_interrupted

MAX_EVENTS = 1024
SIGNAL_POLL_S = 0.1
"""A signal handler only leaves a word; the events' thread looks for it this often."""
ROUTER_WAIT_S = 3600.0

_log = structlog.get_logger("stations.agent")


@dataclass(frozen=True)
class AgentSettings:
    """How an agent is started. `plans`: YAML files or folders of them, beside the bundled ones."""

    line: str
    station: str
    router: str
    bench: Path
    spool: Path
    recordings: Path
    plans: tuple[Path, ...] = ()
    make_runner: RunnerFactory = field(default=SequenceRunner, compare=False)


def run_agent(settings: AgentSettings) -> int:
    """Run a station until it is told to stop; the process's exit code. Must be on the main thread.

    Raises:
        TestloomError: the station cannot begin: no bench, no spool, a wrong plan, no router.
    """
    checked_name(settings.line, "line")
    checked_name(settings.station, "station")
    log_as_json(line=settings.line, station=settings.station)
    stop = StopSignal()
    try:
        plans = load_plans(settings.plans)  # first: a wrong plan is wrong on any bench
        bench = await_description(settings.bench, lambda: not stop.received)
        for folder in (settings.spool.parent, settings.recordings):
            _make_folder(folder)
        return _run(settings, bench, plans, stop)
    except TestloomError:
        if stop.received:  # it was told to stop while it waited for the bench or the router
            return EXIT_STOPPED
        raise


def _run(
    settings: AgentSettings, bench: BenchDescription, plans: tuple[Plan, ...], stop: "StopSignal"
) -> int:
    software_version = metadata.version("testloom")
    with ExitStack() as stack:
        spool = Spool(settings.spool, f"{settings.line}/{settings.station}")
        stack.callback(spool.close)
        for record in close_interrupted(spool, ended_at_s=time.time(), software_version=software_version):
            _log.warning("interrupted_attempt_closed", attempt=record.attempt_id, socket=record.lease.socket)
        sockets = tuple(
            SocketDescription(socket=socket.socket, operations=bench.operations) for socket in bench.sockets
        )
        identity = AgentIdentity(
            station=settings.station,
            incarnation=spool.next_incarnation(time.time_ns()),
            bench_identity=bench.bench_identity,
            sockets=sockets,
            plans=tuple(plan.reference() for plan in plans if plan.operation in bench.operations),
        )
        link = stack.enter_context(
            open_link(settings.router, give_up_after_s=ROUTER_WAIT_S, keep_trying=lambda: not stop.received)
        )
        watch = BenchWatch(settings.bench, bench, settings.recordings, settings.make_runner)
        stack.callback(watch.close)
        agent = AgentShell(settings.line, identity, link, spool, stop)
        stack.callback(agent.close)
        agent.employ(watch, plans, software_version)
        return agent.work()


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TestloomError(
            f"The folder cannot be made: {error.strerror}.",
            where=str(folder),
            fault=Fault.STATION,
            remedy="choose another folder, or correct its permissions.",
        ) from None


def load_plans(places: tuple[Path, ...]) -> tuple[Plan, ...]:
    """One plan an operation: a given one, else the bundled one that is named as its operation.

    Raises:
        PlanError: a plan cannot be used, or two of the given ones are for the same operation.
    """
    plans = {plan.operation: plan for plan in bundled_plans().values() if plan.name == plan.operation}
    given: dict[str, Path] = {}
    for place in places:
        for path in sorted(place.glob("*.yaml")) if place.is_dir() else (place,):
            plan = load_plan(path)
            if plan.operation in given:
                raise PlanError(
                    f"Two plans are given for the operation '{plan.operation}'.",
                    where=f"{given[plan.operation]} and {path}",
                    fault=Fault.PLAN,
                    remedy="give one of them: a station runs one plan an operation.",
                )
            given[plan.operation] = path
            plans[plan.operation] = plan
    return tuple(plans.values())


class StopSignal:
    """SIGTERM and SIGINT as a word that is left for the events' thread."""

    def __init__(self) -> None:
        self.received = ""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._receive)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.received = signal.Signals(number).name


class AgentShell:
    """Threads, queue and timers round the core."""

    def __init__(
        self, line: str, identity: AgentIdentity, link: ZenohLink, spool: Spool, stop: StopSignal
    ) -> None:
        self._line = line
        self._identity = identity
        self._link = link
        self._spool = spool
        self._stop = stop
        self._events: queue.Queue[on.Event] = queue.Queue(MAX_EVENTS)
        self._queries: dict[int, IncomingQuery] = {}
        self._asked = 0
        self._timers: dict[str, float] = {}
        self._workers: dict[str, SocketWorker] = {}
        self._presence = CoordinatorCaller("presence", link, line, identity.station)
        self._results = CoordinatorCaller("results", link, line, identity.station)
        fences = tuple((fence.fence, fence.socket, fence.serial) for fence in spool.fences())
        content = SpoolContent(spool.unacknowledged(), spool.next_number(), fences)
        self._core = AgentCore(identity, content)
        self._exit_code: int | None = None

    def employ(self, watch: BenchWatch, plans: tuple[Plan, ...], software_version: str) -> None:
        """Start a worker for every socket."""
        for socket in self._identity.sockets:
            self._workers[socket.socket] = SocketWorker(
                socket.socket,
                watch,
                {plan.sha256(): plan for plan in plans},
                incarnation=self._identity.incarnation,
                software_version=software_version,
                on_progress=self._publish,
                on_record=lambda record: self._put(on.SequenceEnded(record)),
            )

    def work(self) -> int:
        """Handle events until the core leaves; the exit code."""
        station = self._identity.station
        self._link.serve(station_command_key(self._line, station), self._on_query)
        self._link.declare_alive(alive_key(self._line, station, self._identity.incarnation))
        _log.info(
            "agent_started", incarnation=self._identity.incarnation, bench=self._identity.bench_identity
        )
        self._handle(on.AgentStarted())
        stop_said = False
        while self._exit_code is None:
            if self._stop.received and not stop_said:
                stop_said = True
                self._handle(on.StopRequested(self._stop.received))
                continue
            with suppress(queue.Empty):
                self._handle(self._events.get(timeout=self._idle_s()))
            self._expire_timers()
        return self._exit_code

    def close(self) -> None:
        """End every thread, as far as it lets itself be ended."""
        for worker in self._workers.values():
            worker.close()
        self._presence.close()
        self._results.close()

    # From outside, on other threads

    def _on_query(self, query: IncomingQuery) -> None:
        try:
            command = STATION_COMMAND.validate_json(query.payload)
        except ValidationError as error:
            problem = f"This is not a command to a station: {first_problem(error)}."
            query.reject(problem, Fault.TESTLOOM, "send StartSequence or AbortSequence.")
            return
        self._asked += 1  # only the link's thread counts here
        number = self._asked
        self._queries[number] = query
        try:
            self._events.put_nowait(on.CommandReceived(number, command))
        except queue.Full:
            del self._queries[number]
            query.reject("The station has too much to do.", Fault.STATION, "try again in a while.")

    def _put(self, event: on.Event) -> None:
        self._events.put(event)  # full: this thread waits for the events' thread

    def _publish(self, progress: SocketProgress) -> None:
        key = station_live_key(self._line, self._identity.station, progress.socket)
        self._link.publish(key, progress.model_dump_json().encode())

    # On the events' thread

    def _idle_s(self) -> float:
        now_s = time.monotonic()
        return max(0.0, min([SIGNAL_POLL_S, *(due_s - now_s for due_s in self._timers.values())]))

    def _expire_timers(self) -> None:
        now_s = time.monotonic()
        for name in [name for name, due_s in self._timers.items() if due_s <= now_s]:
            del self._timers[name]
            self._handle(on.TimerExpired(name))

    def _handle(self, event: on.Event) -> None:
        for command in self._core.handle(event):
            self._carry_out(command)

    def _carry_out(self, command: on.Command) -> None:
        match command:
            case on.WriteTrace() | on.SpoolRecord() | on.DropRecords():
                self._handle(self._spooling(command))
            case on.RunLease(lease):
                _log.info("sequence_starts", attempt=lease.attempt_id, serial=lease.unit.serial)
                self._workers[lease.socket].run(lease, time.time())
            case on.AbortSocket(socket, fence, why):
                _log.warning("sequence_aborted", socket=socket, fence=fence, why=why)
                self._workers[socket].abort(fence, why)
            case on.Reply(query, reply):
                self._queries.pop(query).reply(reply.model_dump_json().encode())
            case on.Register(request):
                self._presence.ask(request, self._answered(on.RegistrationAnswered))
            case on.Renew(request):
                self._presence.ask(request, self._answered(on.RenewalAnswered))
            case on.Submit(numbers):
                self._submit(numbers)
            case on.SetTimer(name, after_s):
                self._timers[name] = time.monotonic() + after_s
            case on.Publish(progress):
                self._publish(progress)
            case on.RaiseAlarm(alarm, text):
                self._raise_alarm(alarm, text)
            case on.Leave(exit_code, why):
                self._leave(exit_code, why)

    def _leave(self, exit_code: int, why: str) -> None:
        for record in self._core.unspooled:  # the log is its last resort; its trace stays in the spool
            _log.error("record_not_spooled", record=record.model_dump(mode="json"))
        waiting = len(self._core.unacknowledged)
        _log.info("agent_leaves", exit_code=exit_code, why=why, unacknowledged=waiting)
        self._exit_code = exit_code

    def _spooling(self, command: on.WriteTrace | on.SpoolRecord | on.DropRecords) -> on.Event:
        """Work on the spool, and how it went."""
        try:
            match command:
                case on.WriteTrace(lease):
                    self._spool.open_attempt(lease, time.time(), self._identity.incarnation)
                    return on.TraceWritten(lease.fence)
                case on.SpoolRecord(record):
                    number = self._spool.add(record)
                    _log.info(
                        "record_spooled", attempt=record.attempt_id, number=number, outcome=record.outcome
                    )
                    return on.RecordSpooled(record.attempt_id, number)
                case on.DropRecords(attempt_ids):
                    self._spool.drop(attempt_ids)
                    return on.RecordsDropped(attempt_ids)
        except SpoolError as error:
            match command:
                case on.WriteTrace(lease):
                    return on.TraceFailed(lease.fence, str(error))
                case on.SpoolRecord(record):
                    return on.SpoolFailed(record.attempt_id, str(error))
                case on.DropRecords():
                    _log.error("acknowledged_records_kept", why=str(error))
                    return on.DropFailed(str(error))

    def _submit(self, numbers: tuple[int, ...]) -> None:
        try:
            records = self._spool.records(numbers)
        except SpoolError as error:
            _log.error("spool_unreadable", why=str(error))
            self._handle(on.SubmissionAnswered(None))
            return
        question = SubmitRecords(
            station=self._identity.station, incarnation=self._identity.incarnation, records=records
        )

        def answered(reply: StationReply | None) -> None:
            echoed = reply.attempt_ids if isinstance(reply, RecordsAcknowledged) else None
            self._put(on.SubmissionAnswered(echoed))

        self._results.ask(question, answered)

    def _answered(
        self, event: type[on.RegistrationAnswered] | type[on.RenewalAnswered]
    ) -> Callable[[StationReply | None], None]:
        return lambda reply: self._put(event(reply))

    def _raise_alarm(self, alarm: str, text: str) -> None:
        _log.error("alarm", alarm=alarm, text=text)
        for socket in self._identity.sockets:
            self._publish(
                SocketProgress(station=self._identity.station, socket=socket.socket, step=f"alarm: {alarm}")
            )

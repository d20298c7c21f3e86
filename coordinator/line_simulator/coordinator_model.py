"""The coordinator's process, with the real core in it: inbox, batch, commit, act, crash, replay.

What it omits against daemon.py: threads and the database. A batch is handled, committed after a
while, and only then answered and acted on; a crash before that loses the batch with the process.
"""

# pyright: strict

from collections.abc import Callable
from dataclasses import dataclass, field

from coordinator.core.invariants import InvariantChecker
from coordinator.core.line_core import CoordinatorCore
from coordinator.line_simulator.world import World
from protocol.coordinator_commands import Answer, Command, Journal, KeepRecord, KeepUnit, RaiseAlarm, SetTimer
from protocol.coordinator_events import (
    FACT,
    CommandUndelivered,
    CoordinatorStarted,
    Event,
    LineSettings,
    RecordsSubmitted,
    SequenceAccepted,
    SequenceRefused,
    TimerExpired,
)
from protocol.outcomes import Outcome
from protocol.station_messages import (
    AbortSequence,
    CommandAccepted,
    CommandRefused,
    StartSequence,
    StationCommand,
)

MAX_BATCH = 16
COMMIT_S = (0.01, 0.1, 0.6)
"""A line's longest commit is one of these."""

Reply = Callable[[object], None]
ToStation = Callable[[StationCommand, Reply, Callable[[], None]], None]


@dataclass
class KeptRecord:
    """A record as the store holds it."""

    outcome: Outcome
    set_aside: bool


@dataclass
class Disk:
    """What survives the coordinator's process."""

    journal: list[bytes] = field(default_factory=list[bytes])
    records: dict[tuple[str, int], list[KeptRecord]] = field(
        default_factory=dict[tuple[str, int], list[KeptRecord]]
    )
    alarms: list[str] = field(default_factory=list[str])
    finished_at_s: dict[str, float] = field(default_factory=dict[str, float])


class CoordinatorModel:
    """The process. `acknowledge_before_commit` plants the fault of that name."""

    acknowledge_before_commit = False

    def __init__(
        self, world: World, to_station: ToStation, settings: LineSettings, check_invariants: bool
    ) -> None:
        self.disk = Disk()
        self.core: CoordinatorCore | None = None
        self.restarts = -1
        self.events_handled = 0
        self._world = world
        self._to_station = to_station
        self._settings = settings
        self._commit_s = world.random.choice(COMMIT_S)
        self._check_invariants = check_invariants
        self._checker = InvariantChecker()
        self._epoch = 0
        self._inbox: list[tuple[Event, Reply | None]] = []
        self._busy = False

    def start(self) -> None:
        """Replay the journal and take up the line."""
        self._epoch += 1
        self.restarts += 1
        self.core = self.replayed()
        self._checker = InvariantChecker()  # what was not committed never happened, fences included
        self._busy = False
        started = CoordinatorStarted(
            at_s=self._world.now_s, software_version="simulated", settings=self._settings
        )
        self.receive(started, None)

    @property
    def at_rest(self) -> bool:
        """Nothing handled waits for its commit."""
        return self.core is not None and not self._busy

    def replayed(self) -> CoordinatorCore:
        """A core that knows what the journal knows."""
        core = CoordinatorCore()
        for line in self.disk.journal:
            core.replay(FACT.validate_json(line))
        return core

    def crash(self) -> None:
        """SIGKILL: everything not committed is gone."""
        self._epoch += 1
        self.core = None
        self._inbox.clear()

    def receive(self, event: Event, reply: Reply | None) -> None:
        """An event arrives; while the process is down, nobody takes it."""
        if self.core is None:
            return
        self._inbox.append((event, reply))
        self._work_soon()

    def _work_soon(self) -> None:
        if not self._busy and self._inbox:
            self._busy = True
            self._mine(0.0, self._work)

    def _work(self) -> None:
        assert self.core is not None
        batch, self._inbox = self._inbox[:MAX_BATCH], self._inbox[MAX_BATCH:]
        done: list[tuple[Event, Reply | None, tuple[Command, ...]]] = []
        for event, reply in batch:
            timely = event.model_copy(update={"at_s": self._world.now_s})
            done.append((timely, reply, self.core.handle(timely)))
            self.events_handled += 1
            if self._check_invariants:
                self._checker.check(self.core.floor)
        if self.acknowledge_before_commit:
            for _, reply, commands in done:
                self._answer(commands, reply)
        self._mine(self._commit_s * self._world.random.random(), lambda: self._commit(done))

    def _commit(self, done: list[tuple[Event, Reply | None, tuple[Command, ...]]]) -> None:
        for event, _, commands in done:
            for command in commands:
                self._keep(event, command)
        for _, reply, commands in done:
            if not self.acknowledge_before_commit:
                self._answer(commands, reply)
            for command in commands:
                self._act(command)
        self._busy = False
        self._work_soon()

    def _keep(self, event: Event, command: Command) -> None:
        if isinstance(command, Journal):
            self.disk.journal.append(command.fact.model_dump_json().encode())
        elif isinstance(command, KeepRecord):
            assert isinstance(event, RecordsSubmitted)
            key = (command.attempt_id, command.fence)
            summary = next(s for s in event.records if (s.attempt_id, s.fence) == key)
            self.disk.records.setdefault(key, []).append(KeptRecord(summary.outcome, command.set_aside))
        elif isinstance(command, KeepUnit):
            if command.operation is None:
                self.disk.finished_at_s[command.serial] = command.at_s
        elif isinstance(command, RaiseAlarm):
            self.disk.alarms.append(command.alarm.alarm)

    def _answer(self, commands: tuple[Command, ...], reply: Reply | None) -> None:
        for command in commands:
            if isinstance(command, Answer) and reply is not None:
                reply(command.reply)

    def _act(self, command: Command) -> None:
        if isinstance(command, SetTimer):
            timer, subject = command.timer, command.subject

            def expire() -> None:
                self.receive(TimerExpired(at_s=self._world.now_s, timer=timer, subject=subject), None)

            self._mine(command.at_s - self._world.now_s, expire)
        elif isinstance(command, (StartSequence, AbortSequence)):
            self._command_station(command)

    def _command_station(self, command: StartSequence | AbortSequence) -> None:
        fence = command.lease.fence if isinstance(command, StartSequence) else command.fence
        epoch = self._epoch

        def answered(reply: object) -> None:
            if self._epoch != epoch or not isinstance(command, StartSequence):
                return
            if isinstance(reply, CommandAccepted):
                self.receive(SequenceAccepted(at_s=self._world.now_s, fence=fence), None)
            elif isinstance(reply, CommandRefused):
                self.receive(
                    SequenceRefused(
                        at_s=self._world.now_s, fence=fence, reason=reply.reason, text=reply.text
                    ),
                    None,
                )

        def unanswered() -> None:
            if self._epoch == epoch:
                self.receive(CommandUndelivered(at_s=self._world.now_s, fence=fence), None)

        self._to_station(command, answered, unanswered)

    def _mine(self, delay_s: float, action: Callable[[], None]) -> None:
        epoch = self._epoch

        def act() -> None:
            if self._epoch == epoch:
                action()

        self._world.after(delay_s, act)

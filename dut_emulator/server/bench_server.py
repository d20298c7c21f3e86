"""The shell that moves a bench's time: control requests in, bytes between links and units.

Time moves in slices of at most `MAX_SLICE_S`, one a turn of the event loop, so that links are flushed
and other connections are heard on the way. Within a slice it stops at every moment at which a unit does
something on a link that a waiting participant watches, and at the ends of the instruments' windows.
"""

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass, field

import structlog

from dut_emulator.interfaces import BenchModelError
from dut_emulator.server.bench_clock import Activity, BenchClock, InvalidTransition
from dut_emulator.server.bench_model import STAND, BenchModel, SocketModel
from dut_emulator.server.control_channel import ControlConnection
from dut_emulator.server.link_faults import FAULTS_OF_FRAMING, LinkFault
from dut_emulator.server.links import ByteLink
from dut_emulator.server.unit_store import UnitStore
from protocol.bench_control import (
    BenchRefusal,
    BenchTime,
    ControlReply,
    ControlRequest,
    Hello,
    Inject,
    Insert,
    Remove,
    Resume,
    Suspend,
    Wait,
)
from protocol.errors import TestloomError

MAX_SLICE_S = 10.0
MAX_WAIT_S = 1e6
"""Longest wait ahead: eleven days."""
MAX_STEPS_PER_SLICE = 2000
MAX_STEPS_AT_ONE_MOMENT = 100
ARRIVAL_TIMEOUT_S = 5.0
"""Wall time in which bytes that a station says it has written must arrive."""
MIN_TICK_S = 0.001
"""Shortest sleep of the wall clock in paced running."""

log = structlog.get_logger("bench")


@dataclass
class ServedLink:
    """A link with the fault it may have."""

    link: ByteLink
    fault: LinkFault

    def hand_over(self, data: bytes) -> None:
        """What leaves the bench on this link."""
        self.link.hand_over(self.fault.apply(data))


@dataclass
class _Participation:
    connection: ControlConnection
    links: set[str] = field(default_factory=set)
    arriving: Wait | None = None
    timeout: asyncio.TimerHandle | None = None


class BenchServer:
    """One bench in one event loop.

    Args:
        model: what stands on the bench.
        store: of the units.
        pace: 0 for lock-step.
    """

    def __init__(self, model: BenchModel, store: UnitStore, pace: float) -> None:
        self.model = model
        self.links: dict[str, ServedLink] = {}
        self._store = store
        self._pace = pace
        self._clock = BenchClock()
        self._participants: dict[int, _Participation] = {}
        self._loop = asyncio.get_running_loop()
        self._started_at = self._loop.time()
        self._tick: asyncio.Handle | None = None

    def present_s(self) -> float:
        """Bench time now; in paced running everything due until now is done first."""
        if self._pace:
            to_s = (self._loop.time() - self._started_at) * self._pace
            while self._clock.now_s < to_s:
                self._pass_slice(min(to_s, self._clock.now_s + MAX_SLICE_S))
        return self._clock.now_s

    def stimulated(self) -> None:
        """Something came from outside: in paced running the next moment of interest may be nearer now."""
        if self._pace:
            self._schedule()

    def bytes_arrived(self) -> None:
        """A link has received bytes: waits that were held up by them may begin."""
        for number in [n for n, one in self._participants.items() if one.arriving is not None]:
            self._begin_wait(number)
        self.stimulated()

    def request(self, connection: ControlConnection, request: ControlRequest) -> ControlReply | None:
        """Carry out a control request; None: the reply comes when time has passed."""
        self.present_s()
        try:
            reply = self._carry_out(connection, request)
        except (InvalidTransition, BenchModelError) as error:
            reply = BenchRefusal(
                what=f"{error}.", remedy="see protocol/bench_control.py for what may follow what."
            )
        except TestloomError as error:
            reply = BenchRefusal(what=error.what, remedy=error.remedy)
        self.stimulated()
        return reply

    def connection_lost(self, connection: ControlConnection) -> None:
        """A participant has gone: time does not wait for it any more."""
        participation = self._participants.pop(connection.number, None)
        self._clock.leave(connection.number)
        if participation is not None:
            if participation.timeout is not None:
                participation.timeout.cancel()
            self._pump()

    def close(self) -> None:
        """Stop the clock, keep what the units remember, free the links."""
        if self._tick is not None:
            self._tick.cancel()
        for served in self.links.values():
            served.link.close()
        self._keep_units()

    def _carry_out(self, connection: ControlConnection, request: ControlRequest) -> ControlReply | None:
        number = connection.number
        match request:
            case Hello():
                self._clock.join(number, request.participant, observer=request.observer)
                self._participants[number] = _Participation(connection)
            case Wait():
                return self._wait(number, request)
            case Suspend():
                self._clock.suspend(number)
                self._pump()
            case Resume():
                self._clock.resume(number)
            case _ if self._clock.activity(number) is None:
                raise InvalidTransition(f"'{request.op}' before 'hello'")
            case Insert():
                self._insert(request)
            case Remove():
                self._remove(request)
            case Inject():
                self._inject(request)
        return self._time()

    def _insert(self, request: Insert) -> None:
        socket = self._socket(request.socket)
        if socket.unit is not None:
            raise BenchModelError(f"socket {socket.name} holds unit {socket.serial}")
        unit = self._store.make(request.serial)
        socket.insert(unit, request.serial, self._clock.now_s)
        log.info("inserted", socket=socket.name, serial=request.serial)

    def _remove(self, request: Remove) -> None:
        removed = self._socket(request.socket).remove(self._clock.now_s)
        if removed is not None:
            unit, serial = removed
            self._store.keep(serial, unit)
            log.info("removed", socket=request.socket, serial=serial)

    def _inject(self, request: Inject) -> None:
        target = request.target
        if target == STAND and self.model.stand is not None:
            self.model.stand.inject(request.fault, self._clock.now_s)
        elif target in self.links:
            served = self.links[target]
            if request.fault not in FAULTS_OF_FRAMING[served.fault.framing]:
                raise BenchModelError(f"link {target} cannot have the fault '{request.fault}'")
            served.fault.fault = request.fault
        else:
            known = [*self.links, *([STAND] if self.model.stand is not None else [])]
            raise BenchModelError(f"there is no '{target}' to have a fault; there are {', '.join(known)}")
        log.info("fault injected", target=target, fault=request.fault)

    def _socket(self, name: str) -> SocketModel:
        socket = self.model.sockets.get(name)
        if socket is None:
            raise BenchModelError(f"there is no socket '{name}'; there are {', '.join(self.model.sockets)}")
        return socket

    def _wait(self, number: int, request: Wait) -> ControlReply | None:
        if self._clock.activity(number) is not Activity.WORKING:
            raise InvalidTransition("'wait' by a participant that is not at work")
        if request.until_s > self._clock.now_s + MAX_WAIT_S:
            raise InvalidTransition(f"nobody may wait longer than {MAX_WAIT_S:g} s at once")
        named = {*request.written, *request.wake_above}
        unknown = named - self.links.keys()
        if unknown:
            raise InvalidTransition(f"there is no link '{min(unknown)}'; there are {', '.join(self.links)}")
        participation = self._participants[number]
        participation.links |= named
        for name in named:
            self.links[name].link.poll()
        participation.arriving = request
        return self._begin_wait(number, at_once=True)

    def _begin_wait(self, number: int, *, at_once: bool = False) -> ControlReply | None:
        """Let a wait begin as soon as everything that was written has arrived."""
        participation = self._participants[number]
        request = participation.arriving
        assert request is not None
        late = self._late_links(request)
        if late:
            if at_once:
                participation.timeout = self._loop.call_later(ARRIVAL_TIMEOUT_S, self._give_up, number)
            return None
        participation.arriving = None
        if participation.timeout is not None:
            participation.timeout.cancel()
            participation.timeout = None
        overrun = self._overrun_links(participation.links)
        if overrun:
            refusal = _overrun_refusal(overrun)
            if at_once:
                return refusal
            participation.connection.reply(refusal)
            return None
        self._clock.wait(number, request.until_s, request.wake_above)
        self._pump()
        return None

    def _give_up(self, number: int) -> None:
        participation = self._participants[number]
        request, participation.arriving, participation.timeout = participation.arriving, None, None
        assert request is not None
        late = ", ".join(
            f"{name}: {self.links[name].link.received} of {request.written[name]}"
            for name in self._late_links(request)
        )
        participation.connection.reply(
            BenchRefusal(
                what=f"bytes that were written have not arrived within {ARRIVAL_TIMEOUT_S:g} s ({late}).",
                remedy="count the bytes of a link from when it was opened.",
            )
        )

    def _late_links(self, request: Wait) -> list[str]:
        """Links on which bytes are still on their way; what went down with a connection is gone."""
        return [
            name
            for name, written in request.written.items()
            if self.links[name].link.connected and self.links[name].link.received < written
        ]

    def _overrun_links(self, names: Iterable[str]) -> list[str]:
        return [name for name in names if self.links[name].link.overrun]

    def _time(self) -> BenchTime:
        return BenchTime(now_s=self._clock.now_s, pace=self._pace, handed_over=self._handed_over())

    def _handed_over(self) -> dict[str, int]:
        return {name: served.link.handed_over for name, served in self.links.items()}

    def _pump(self) -> None:
        """Let time pass while nobody works: a slice now, the next one on the loop's next turn."""
        self._answer_due()
        if self._pace:
            self._schedule()
            return
        target_s = self._clock.target_s()
        if target_s is None:
            return
        self._pass_slice(min(target_s, self._clock.now_s + MAX_SLICE_S))
        if self._tick is None and self._clock.target_s() is not None:
            self._tick = self._loop.call_soon(self._next_slice)

    def _next_slice(self) -> None:
        self._tick = None
        self._pump()

    def _schedule(self) -> None:
        """Paced running: come back at the next moment of interest."""
        if self._tick is not None:
            self._tick.cancel()
            self._tick = None
        moments = (self._clock.earliest_s(), self.model.next_event_s(self.links))
        next_s = min((moment for moment in moments if moment is not None), default=None)
        if next_s is not None:
            at = max(self._started_at + next_s / self._pace, self._loop.time() + MIN_TICK_S)
            self._tick = self._loop.call_at(at, self._ticked)

    def _ticked(self) -> None:
        self._tick = None
        self.present_s()
        self._schedule()

    def _pass_slice(self, limit_s: float) -> None:
        """Time moves to `limit_s`, or to where a watching participant is woken before."""
        at_one_moment = 0
        for _ in range(MAX_STEPS_PER_SLICE):
            now_s = self._clock.now_s
            event_s = self.model.next_event_s(self._clock.watched_links())
            to_s = limit_s if event_s is None else min(max(event_s, now_s), limit_s)
            at_one_moment = at_one_moment + 1 if to_s == now_s else 0
            if at_one_moment > MAX_STEPS_AT_ONE_MOMENT:
                to_s = limit_s
            self._advance(to_s)
            woken = self._answer_due()
            if to_s >= limit_s or (woken and not self._pace):
                return

    def _advance(self, to_s: float) -> None:
        pieces: dict[str, list[bytes]] = {}
        for link, data in self.model.advance(to_s):
            pieces.setdefault(link, []).append(data)
        self._clock.pass_time(to_s)
        for link, data in pieces.items():
            self.links[link].hand_over(b"".join(data))

    def _keep_units(self) -> None:
        for socket in self.model.sockets.values():
            if socket.unit is not None:
                self._store.keep(socket.serial, socket.unit)

    def _answer_due(self) -> bool:
        """Reply to all whose wait is over; True if there were any."""
        woken = self._clock.due(self._handed_over())
        if woken:
            reply = self._time_with_flash_kept()
            for number in woken:
                self._participants[number].connection.reply(reply)
        overrun = self._overrun_links(self.links)
        return bool(woken) or (bool(overrun) and self._refuse(overrun))

    def _time_with_flash_kept(self) -> ControlReply:
        """Before a station hears that a unit has done something, the unit's flash remembers it."""
        try:
            self._keep_units()
        except TestloomError as error:
            return BenchRefusal(what=error.what, remedy=error.remedy)
        return self._time()

    def _refuse(self, overrun: list[str]) -> bool:
        """End the waits of those who have to do with an overrun link: of all, if nobody has named it."""
        waiting = self._clock.waiting()
        concerned = [n for n in waiting if self._participants[n].links & set(overrun)]
        named = {link for one in self._participants.values() for link in one.links}
        if not named & set(overrun):
            concerned = list(waiting)
        for number in concerned:
            self._clock.wake(number)
            self._participants[number].connection.reply(_overrun_refusal(overrun))
        return bool(concerned)


def _overrun_refusal(links: list[str]) -> BenchRefusal:
    return BenchRefusal(
        what=f"nobody reads {', '.join(links)}: more bytes wait there than it keeps, the rest is lost.",
        remedy="read each link up to the count handed over after every wait, and wait in shorter pieces.",
    )

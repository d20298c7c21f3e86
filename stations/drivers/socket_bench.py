"""Everything that one socket of a bench offers, opened when first used and kept between sequences."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from protocol.bench_description import BenchDescription, SocketResources
from protocol.can_database import can_database
from protocol.errors import Fault, LinkError, TestloomError
from protocol.gnc_module import BAUD_RATE
from protocol.instruments import Multimeter, Oscilloscope
from stations.drivers.arbitration import Arbitration
from stations.drivers.can_link import CanLink, CanPort
from stations.drivers.clock import BranchClock, LockstepClock, LockstepLinks, WallClock
from stations.drivers.control_channel import ControlChannel
from stations.drivers.frame_exchange import FrameExchange
from stations.drivers.handler import EmulatedHandler, OperatorHandler, UnitHandler
from stations.drivers.multimeter import ScpiMultimeter
from stations.drivers.oscilloscope import ScpiOscilloscope
from stations.drivers.power_supply import ScpiPowerSupply, SocketSupply
from stations.drivers.scpi import ScpiSession, load_visa
from stations.drivers.serial_port import open_port, read_available
from stations.drivers.socket_board import ScpiSocketBoard
from stations.drivers.turntable import LineTurntable, TurntableSession
from stations.drivers.unit_link import GncModuleLink
from stations.interruptions import StepError

STREAM_BAUD_RATE = 921_600


def nobody_to_ask(prompt: str) -> None:
    """The default on hardware: the unit is already where it has to be, steps look at the contact."""
    del prompt


class SocketBench:
    """One socket's links, board, supply channel, stand; and the bench's shared instruments.

    Views (`unit_link`, `board` …) are made for a branch's clock and are cheap; the sessions under
    them are shared by the branches.
    """

    def __init__(
        self,
        description: BenchDescription,
        socket: str,
        arbitration: Arbitration,
        ask_operator: Callable[[str], None] = nobody_to_ask,
    ) -> None:
        self.description = description
        self.resources = _resources(description, socket)
        self._arbitration = arbitration
        self._lock = threading.RLock()
        self._links = LockstepLinks()
        self._unit_port: Any = None
        self._exchange: FrameExchange | None = None
        self._can_port: CanPort | None = None
        self._stream_port: Any = None
        self._supply = SocketSupply(ScpiPowerSupply(arbitration.power_supply), self.resources.supply_channel)
        board = self.resources.board
        self._board = None if board is None else ScpiSession(board, f"socket board {socket}")
        stand = description.stand
        self._stand = (
            TurntableSession(stand, emulated=description.control is not None)
            if stand and stand.kind == "three_axis_turntable"
            else None
        )
        self._handler_channel = (
            None
            if description.control is None
            else ControlChannel(description.control, f"{socket}.handler", observer=True)
        )
        self._handler: UnitHandler = (
            OperatorHandler(ask_operator, socket)
            if self._handler_channel is None
            else EmulatedHandler(self._handler_channel, socket)
        )
        self._clocks: list[BranchClock] = []
        self._channels: dict[int, ControlChannel] = {}

    @property
    def where(self) -> str:
        return f"bench {self.description.bench}, socket {self.resources.socket}"

    def load_libraries(self) -> None:
        """Load what is loaded once, so that the first unit is not tested more slowly than the others."""
        load_visa()
        if self.resources.can_interface is not None:
            can_database()

    def clock(self, branch: int) -> BranchClock:
        """The clock of a branch; it has not joined the bench's time yet."""
        with self._lock:
            while len(self._clocks) <= branch:
                self._clocks.append(self._new_clock(len(self._clocks)))
            return self._clocks[branch]

    def begin_sequence(self) -> None:
        """Forget what the links received before.

        Raises:
            LinkError: a link that was open is gone and cannot be opened again.
        """
        with self._lock:
            self._exchange = None
            if self._unit_port is not None:
                try:
                    read_available(self._unit_port, self.where)
                except LinkError:
                    self._close_unit_port()
            if self._can_port is not None:
                try:
                    self._can_port.discard()
                except LinkError:
                    self._close_can_port()

    def unit_link(self, clock: BranchClock) -> GncModuleLink:
        """The unit's RS-422 link. Raises LinkError: it cannot be opened."""
        with self._lock:
            link = _named(self.resources.unit_link, self.where, "link to the unit", "unit_link")
            where = f"{self.where}, RS-422 {link}"
            if self._unit_port is None:
                self._unit_port = open_port(link, baud_rate=BAUD_RATE, where=where)
                self._links.add(self._unit_port)
            if self._exchange is None:
                self._exchange = FrameExchange(self._unit_port, where)
            return GncModuleLink(self._exchange, clock)

    @property
    def unit_link_is_open(self) -> bool:
        """The unit has been spoken to in this sequence."""
        return self._exchange is not None

    def can_link(self, clock: BranchClock) -> CanLink | None:
        """The unit's CAN bus, None if the socket has none. Raises LinkError: it cannot be opened."""
        interface, channel = self.resources.can_interface, self.resources.can_channel
        if interface is None or channel is None:
            return None
        with self._lock:
            if self._can_port is None:
                self._can_port = CanPort(interface, channel, f"{self.where}, CAN {interface} {channel}")
                self._links.add(self._can_port.serial_port)
            return CanLink(self._can_port, clock)

    def supply(self, clock: BranchClock) -> SocketSupply:
        """The supply's channel of this socket."""
        del clock  # a supply answers at once
        return self._supply

    def board(self, clock: BranchClock) -> ScpiSocketBoard | None:
        """The board under the socket; None on a stand."""
        return None if self._board is None else ScpiSocketBoard(self._board, clock)

    def stand(self, clock: BranchClock) -> LineTurntable | None:
        """The motion stand. Raises LinkError: its stream cannot be opened."""
        if self._stand is None:
            return None
        with self._lock:
            if self._stream_port is None:
                url = _named(
                    self._stand.stand.stream, self._stand.where, "stream of the stand", "stand.stream"
                )
                self._stream_port = open_port(url, baud_rate=STREAM_BAUD_RATE, where=self._stand.where)
                self._links.add(self._stream_port)
            return LineTurntable(self._stand, self._stream_port, clock)

    def handler(self, clock: BranchClock) -> UnitHandler:
        """The hand that loads the socket."""
        del clock  # a hand takes no bench time
        return self._handler

    def stop_stand(self, clock: BranchClock) -> None:
        """Bring the stand to rest, without its stream. Raises LinkError."""
        if self._stand is not None:
            LineTurntable(self._stand, None, clock).stop()

    def renew_clock(self, branch: int) -> BranchClock:
        """A new clock for a branch whose thread did not come back; the old one is cut off."""
        with self._lock:
            if branch in self._channels:
                self._channels[branch].close()
            self._clocks[branch] = self._new_clock(branch)
            return self._clocks[branch]

    @contextmanager
    def multimeter(self, clock: BranchClock) -> Iterator[Multimeter]:
        """The shared multimeter, for this socket alone."""
        session = self._measuring(self._arbitration.multimeter, "multimeter")
        with self._measuring_bus(clock):
            yield ScpiMultimeter(session, clock)

    @contextmanager
    def oscilloscope(self, clock: BranchClock) -> Iterator[Oscilloscope]:
        """The shared oscilloscope, for this socket alone."""
        session = self._measuring(self._arbitration.oscilloscope, "oscilloscope")
        with self._measuring_bus(clock):
            yield ScpiOscilloscope(session, clock)

    def close(self) -> None:
        """Close every link; the next use opens it again."""
        with self._lock:
            self._close_unit_port()
            self._close_can_port()
            if self._stream_port is not None:
                self._links.remove(self._stream_port)
                self._stream_port.close()
                self._stream_port = None
            for session in (self._board, self._stand, self._handler_channel, *self._channels.values()):
                if session is not None:
                    session.close()

    @contextmanager
    def _measuring_bus(self, clock: BranchClock) -> Iterator[None]:
        board = self.board(clock)
        with self._arbitration.measuring(clock):
            try:
                yield
            finally:
                if board is not None:
                    # the safe state tries again; here nothing may hide the step's own error
                    with contextlib.suppress(LinkError):
                        board.open_all()

    def _measuring(self, session: ScpiSession | None, name: str) -> ScpiSession:
        if session is None or self._board is None:
            raise StepError(
                f"This bench has no {name} at its sockets.",
                where=self.where,
                fault=Fault.PLAN,
                remedy="run this plan on a socket-board bench, or leave the step out.",
            )
        return session

    def _new_clock(self, branch: int) -> BranchClock:
        if self.description.control is None:
            return WallClock()
        channel = ControlChannel(self.description.control, f"{self.resources.socket}.{branch}")
        self._channels[branch] = channel
        return LockstepClock(channel, self._links)

    def _close_unit_port(self) -> None:
        if self._unit_port is not None:
            self._links.remove(self._unit_port)
            self._unit_port.close()
        self._unit_port = self._exchange = None

    def _close_can_port(self) -> None:
        if self._can_port is not None:
            self._links.remove(self._can_port.serial_port)
            self._can_port.close()
        self._can_port = None


def _resources(description: BenchDescription, socket: str) -> SocketResources:
    for resources in description.sockets:
        if resources.socket == socket:
            return resources
    raise TestloomError(
        f"The bench {description.bench} has no socket '{socket}'.",
        where=f"bench {description.bench}",
        fault=Fault.OPERATOR,
        remedy=f"use one of: {', '.join(r.socket for r in description.sockets)}.",
    )


def _named(resource: str | None, where: str, what: str, key: str) -> str:
    if resource is None:
        raise LinkError(
            f"The bench's description names no {what}.",
            where=where,
            fault=Fault.STATION,
            remedy=f"add '{key}' to the description, or run this operation on a bench that has one.",
        )
    return resource

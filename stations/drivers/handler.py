"""The hand that loads a socket: the emulated bench's control channel, or a person who is asked."""

from collections.abc import Callable
from typing import Protocol

from protocol.bench_control import Insert, Remove
from protocol.language import say
from stations.drivers.control_channel import ControlChannel


class UnitHandler(Protocol):
    """Puts units into a socket and takes them out.

    Attributes:
        holds_unit: a unit is (as far as the hand knows) in the socket.
    """

    holds_unit: bool

    def insert(self, serial: str) -> None:
        """Returns when the unit is in the socket, which must be unpowered. Raises LinkError."""
        ...

    def remove(self) -> None:
        """Returns when the socket is empty. Raises LinkError."""
        ...


class EmulatedHandler:
    """Loads a socket of an emulated bench, as an observer of its clock."""

    def __init__(self, control: ControlChannel, socket: str) -> None:
        self._control = control
        self._socket = socket
        self.holds_unit = True  # until it has looked: an earlier station may have left one

    def insert(self, serial: str) -> None:
        """Insert; a unit that was left in the socket is taken out first."""
        self.remove()
        self._control.request(Insert(socket=self._socket, serial=serial))
        self.holds_unit = True

    def remove(self) -> None:
        """Remove; an empty socket is as good."""
        self._control.request(Remove(socket=self._socket))
        self.holds_unit = False


class OperatorHandler:
    """Asks a person; `ask` returns when the person has confirmed. Steps check the presence contact."""

    def __init__(self, ask: Callable[[str], None], socket: str) -> None:
        self._ask = ask
        self._socket = socket
        self.holds_unit = False

    def insert(self, serial: str) -> None:
        """Ask for the unit."""
        self._ask(say("Put unit {serial} into socket {socket}.", serial=serial, socket=self._socket))
        self.holds_unit = True

    def remove(self) -> None:
        """Ask for an empty socket."""
        self._ask(say("Take the unit out of socket {socket}.", socket=self._socket))
        self.holds_unit = False

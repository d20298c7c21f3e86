"""The hand that loads a socket: the emulated bench's control channel, or a person who is asked."""

from collections.abc import Callable
from typing import Protocol

from protocol.bench_control import Insert, Remove
from stations.drivers.control_channel import ControlChannel


class UnitHandler(Protocol):
    """Puts units into a socket and takes them out."""

    def insert(self, serial: str) -> None:
        """Returns when the unit is in the socket. Raises LinkError."""
        ...

    def remove(self) -> None:
        """Returns when the socket is empty. Raises LinkError."""
        ...


class EmulatedHandler:
    """Loads a socket of an emulated bench, as an observer of its clock."""

    def __init__(self, control: ControlChannel, socket: str) -> None:
        self._control = control
        self._socket = socket

    def insert(self, serial: str) -> None:
        self._control.request(Insert(socket=self._socket, serial=serial))

    def remove(self) -> None:
        self._control.request(Remove(socket=self._socket))


class OperatorHandler:
    """Asks a person; `ask` returns when the person has confirmed. Steps check the presence contact."""

    def __init__(self, ask: Callable[[str], None], socket: str) -> None:
        self._ask = ask
        self._socket = socket

    def insert(self, serial: str) -> None:
        self._ask(f"Put unit {serial} into socket {self._socket}.")

    def remove(self) -> None:
        self._ask(f"Take the unit out of socket {self._socket}.")

"""The unit's CAN bus through python-can: any of its interfaces, messages by the DBC."""

import contextlib
from typing import Any

import can

from protocol.can_database import BIT_RATE, CanMessage, decode_can, encode_can
from protocol.errors import Fault, LinkError
from stations.drivers.clock import BranchClock, bytes_seen

MAX_MESSAGES_AT_ONCE = 100_000


class CanPort:
    """An open bus, kept between sequences."""

    def __init__(self, interface: str, channel: str, where: str) -> None:
        """Open the bus.

        Raises:
            LinkError: it cannot be opened.
        """
        self.where = where
        options: dict[str, Any] = {"bitrate": BIT_RATE}
        if interface == "slcan":
            options |= {"sleep_after_open": 0, "timeout": 0}
        try:
            self.bus = can.Bus(interface=interface, channel=channel, **options)
        except (can.CanError, OSError, ValueError) as error:
            raise LinkError(
                f"The CAN interface {interface} on {channel} cannot be opened: {error}.",
                where=where,
                fault=Fault.STATION,
                remedy="check the adapter, its channel in the bench description, and who else has it open.",
            ) from None

    @property
    def serial_port(self) -> Any | None:
        """The serial port under an slcan bus."""
        return getattr(self.bus, "serialPortOrig", None)

    def take(self) -> can.Message | None:
        """The next data frame that is here, without waiting. Raises LinkError: the adapter is gone."""
        for _ in range(MAX_MESSAGES_AT_ONCE):
            try:
                frame = self.bus.recv(timeout=0)
            except (can.CanError, OSError, ValueError) as error:
                raise self.lost(error) from None
            if frame is None:
                # slcan ends a read at each of the adapter's own answers, with frames behind them
                if self.serial_port is not None and self.serial_port.in_waiting:
                    continue
                return None
            if not frame.is_error_frame and not frame.is_remote_frame:
                return frame
        return None

    def discard(self) -> None:
        """Forget what has come so far. Raises LinkError: the adapter is gone."""
        for _ in range(MAX_MESSAGES_AT_ONCE):
            if self.take() is None:
                return

    def lost(self, error: Exception) -> LinkError:
        """The error for an adapter that worked before: never the unit's fault."""
        return LinkError(
            f"The CAN adapter was lost: {error}.",
            where=self.where,
            fault=Fault.STATION,
            remedy="check the adapter's cable; the station opens it again.",
        )

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(can.CanError, OSError):
            self.bus.shutdown()


class CanLink:
    """The bus as one branch sees it. Only one branch at a time may read it."""

    def __init__(self, port: CanPort, clock: BranchClock) -> None:
        self._port = port
        self._clock = clock

    def send(self, name: str, signals: dict[str, float]) -> None:
        """Send a message of the DBC.

        Raises:
            LinkError: it cannot be encoded or sent.
        """
        frame = encode_can(name, signals)
        try:
            self._port.bus.send(
                can.Message(arbitration_id=frame.identifier, data=frame.data, is_extended_id=False)
            )
        except (can.CanError, OSError) as error:
            raise self._port.lost(error) from None

    def receive(self, until_s: float, name: str | None = None) -> CanMessage | None:
        """The next message (of this name), or None if none comes until a moment of bench time.

        Raises:
            LinkError: the adapter is gone, or a frame is not of the DBC.
        """
        waiting = True
        while True:
            seen = bytes_seen(self._port.serial_port)
            message = self._next(name)
            if message is not None or not waiting:
                return message
            waiting = self._wait(seen, until_s)

    def discard(self) -> None:
        """Forget what has come so far. Raises LinkError: the adapter is gone."""
        self._port.discard()

    def _wait(self, seen: int, until_s: float) -> bool:
        port = self._port.serial_port
        return self._clock.wait_for_bytes(self._port.bus if port is None else port, seen, until_s)

    def _next(self, name: str | None) -> CanMessage | None:
        for _ in range(MAX_MESSAGES_AT_ONCE):
            frame = self._port.take()
            if frame is None:
                return None
            message = decode_can(frame.arbitration_id, bytes(frame.data))
            if name is None or message.name == name:
                return message
        return None

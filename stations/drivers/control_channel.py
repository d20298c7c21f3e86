"""A connection to an emulated bench's control channel: one participant of its clock."""

import contextlib
import select
import socket
import time
from collections.abc import Callable

from pydantic import ValidationError

from protocol.bench_control import (
    CONTROL_REPLY,
    MAX_CONTROL_LINE_BYTES,
    BenchRefusal,
    BenchTime,
    ControlRequest,
    Hello,
)
from protocol.errors import Fault, LinkError, LinkTimeoutError

CONNECT_TIMEOUT_S = 2.0
REPLY_GUARD_S = 60.0
"""Wall time without any answer after which the bench counts as dead. In lock-step an answer waits for
every other participant's work, so this is far above what one of them may take."""
INTERRUPTION_POLL_S = 0.05


def _never() -> None:
    """Nothing interrupts."""


class ControlChannel:
    """One connection. Not for several threads: a branch has its own.

    An error or an interruption in mid-request closes the connection, because its answer would be
    taken for the next one's; the next request connects again, as the same participant.
    """

    def __init__(self, address: str, participant: str, *, observer: bool = False) -> None:
        self._address = address
        self._hello = Hello(participant=participant, observer=observer)
        self._socket: socket.socket | None = None
        self._received = bytearray()

    @property
    def where(self) -> str:
        return f"control channel {self._address}, participant {self._hello.participant}"

    def connect(self) -> BenchTime | None:
        """Connect if not connected; the bench's answer to the hello, None if there was nothing to do.

        Raises:
            LinkError: the bench is not there, or refuses.
        """
        if self._socket is not None:
            if not self._has_ended(self._socket):
                return None
            self.close()
        host, _, port = self._address.rpartition(":")
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise self._dead(f"The bench cannot be reached: {error}.") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received.clear()
        return self._exchange(self._hello, 0.0, _never)

    def request(
        self,
        request: ControlRequest,
        *,
        expected_wall_s: float = 0.0,
        interruption: Callable[[], None] = _never,
    ) -> BenchTime:
        """One request and its answer.

        Args:
            request: what is asked.
            expected_wall_s: wall time that the bench will need by right (a wait at its pace).
            interruption: looked at while waiting; what it raises ends the waiting.

        Raises:
            LinkError: the bench refuses, is gone, or does not answer within REPLY_GUARD_S.
        """
        self.connect()
        return self._exchange(request, expected_wall_s, interruption)

    def close(self) -> None:
        """Leave the clock."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    @staticmethod
    def _has_ended(connection: socket.socket) -> bool:
        """An idle connection that the bench has closed; nothing is ever sent to an idle one."""
        return bool(select.select([connection], [], [], 0)[0])

    def _exchange(
        self, request: ControlRequest, expected_wall_s: float, interruption: Callable[[], None]
    ) -> BenchTime:
        try:
            self._send(request.model_dump_json().encode() + b"\n")
            line = self._read_line(time.monotonic() + expected_wall_s + REPLY_GUARD_S, interruption)
            reply = CONTROL_REPLY.validate_json(line)
        except ValidationError:
            self.close()
            raise self._dead("The bench's control channel answers nonsense.") from None
        except BaseException:
            self.close()
            raise
        if isinstance(reply, BenchRefusal):
            raise LinkError(
                f"The bench refuses: {reply.what}",
                where=self.where,
                fault=Fault.STATION,
                remedy=reply.remedy or "look at the bench's log.",
            )
        return reply

    def _send(self, line: bytes) -> None:
        assert self._socket is not None
        try:
            self._socket.settimeout(REPLY_GUARD_S)
            self._socket.sendall(line)
        except OSError as error:
            raise self._dead(f"The bench's control channel broke: {error}.") from None

    def _read_line(self, guard: float, interruption: Callable[[], None]) -> bytes:
        assert self._socket is not None
        self._socket.settimeout(INTERRUPTION_POLL_S)
        while (end := self._received.find(b"\n")) < 0:
            interruption()
            if time.monotonic() > guard or len(self._received) > MAX_CONTROL_LINE_BYTES:
                raise LinkTimeoutError(
                    f"The bench has not answered for {REPLY_GUARD_S:g} s of wall time.",
                    where=self.where,
                    fault=Fault.STATION,
                    remedy="restart the bench; its log says what it was doing.",
                )
            try:
                data = self._socket.recv(MAX_CONTROL_LINE_BYTES)
            except TimeoutError:
                continue
            except OSError as error:
                raise self._dead(f"The bench's control channel broke: {error}.") from None
            if not data:
                raise self._dead("The bench closed its control channel: its process has ended.")
            self._received += data
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        return line

    def _dead(self, what: str) -> LinkError:
        return LinkError(
            what,
            where=self.where,
            fault=Fault.STATION,
            remedy="start the bench again; the station connects by itself.",
        )

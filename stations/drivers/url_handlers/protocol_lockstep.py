"""`lockstep://host:port?link=NAME`: a TCP serial port that counts its bytes both ways.

The counts tie the bytes of an emulated bench to its clock: a wait on the control channel says how
many bytes have been written, its answer says how many have been handed over, and `receive_up_to`
takes in exactly these. What a real port has and this has not: baud rate, control lines, breaks,
parity, a limited rate.
"""

import contextlib
import select
import socket
import threading
import time
from urllib.parse import parse_qs, urlsplit

from serial import SerialException
from serial.urlhandler.protocol_socket import Serial as SocketSerial

CONNECT_TIMEOUT_S = 2.0
RECEIVE_GUARD_S = 20.0
"""Wall time in which bytes that the bench says it has handed over must arrive."""
WRITE_GUARD_S = 10.0
READ_CHUNK_BYTES = 262_144


class Serial(SocketSerial):
    """The port. `link` is its name on the bench; several threads may read and write it."""

    def open(self) -> None:
        """Connect. Raises SerialException when the bench does not accept."""
        host, port = self.from_url(self.portstr or "")
        self.logger = None
        self.bytes_written = 0
        self.bytes_received = 0
        self._pending = bytearray()
        self._write_lock = threading.Lock()
        self._read_lock = threading.Lock()
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S)
        except OSError as error:
            raise SerialException(f"Could not open port {self.portstr}: {error}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        self.is_open = True

    def close(self) -> None:
        """Close at once (the base class sleeps 0.3 s)."""
        if self.is_open:
            self.is_open = False
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()

    def from_url(self, url: str) -> tuple[str, int]:
        """Host and port; the link's name is kept in `link`. Raises SerialException."""
        parts = urlsplit(url)
        names = parse_qs(parts.query).get("link", [])
        if parts.scheme != "lockstep" or not parts.hostname or not parts.port or len(names) != 1:
            raise SerialException(f"expected lockstep://<host>:<port>?link=<name>, not {url!r}")
        self.link = names[0]
        return parts.hostname, parts.port

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        with self._read_lock:
            self._take_in()
            return len(self._pending)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes; waits for the first ones up to the port's (wall) time-out."""
        deadline = None if self.timeout is None else time.monotonic() + self.timeout
        with self._read_lock:
            if len(self._pending) < size:
                self._take_in()
            while len(self._pending) < size and self._wait_readable(deadline):
                self._take_in()
            data = bytes(self._pending[:size])
            del self._pending[:size]
            return data

    def receive_up_to(self, count: int) -> None:
        """Take in bytes until `count` have been received since the port was opened.

        Raises:
            SerialException: they did not come within RECEIVE_GUARD_S, or the bench closed the port.
        """
        deadline = time.monotonic() + RECEIVE_GUARD_S
        with self._read_lock:
            while self.bytes_received < count:
                self._take_in()
                if self.bytes_received < count and not self._wait_readable(deadline):
                    raise SerialException(
                        f"{count - self.bytes_received} bytes that were handed over did not arrive"
                    )

    def write(self, data: bytes) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Write all of it. Raises SerialException."""
        with self._write_lock:
            view = memoryview(bytes(data))
            while view:
                try:
                    sent = self._socket.send(view)
                except BlockingIOError:
                    if not select.select([], [self._socket], [], WRITE_GUARD_S)[1]:
                        raise SerialException("the bench does not take bytes any more") from None
                    continue
                except OSError as error:
                    raise SerialException(f"write failed: {error}") from None
                self.bytes_written += sent
                view = view[sent:]
            return len(data)

    def reset_input_buffer(self) -> None:
        """Forget what has been received and not read."""
        with self._read_lock:
            self._take_in()
            self._pending.clear()

    def _wait_readable(self, deadline: float | None) -> bool:
        left = None if deadline is None else deadline - time.monotonic()
        if left is not None and left <= 0:
            return False
        return bool(select.select([self._socket], [], [], left)[0])

    def _take_in(self) -> None:
        """All bytes that are there now, into the buffer."""
        while True:
            try:
                data = self._socket.recv(READ_CHUNK_BYTES)
            except BlockingIOError:
                return
            except OSError as error:
                raise SerialException(f"read failed: {error}") from None
            if not data:
                raise SerialException("the bench closed the port")
            self.bytes_received += len(data)
            self._pending += data
            if len(data) < READ_CHUNK_BYTES:
                return

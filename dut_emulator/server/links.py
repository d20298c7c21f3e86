"""Byte links of a bench: a TCP port or a pty, with the bytes of each direction counted.

Counts begin at 0 when a link is opened and are 0 while it is closed. A link has one connection; a newer
one takes its place, as a station that was started again does. Bytes that leave a unit while nobody is
connected are lost and not counted.

Both directions are bounded: at most `MAX_BUFFERED_BYTES` wait for a reader that does not read, then the
link is overrun: what follows is lost, until everything has been read or the reader connects anew.
"""

import asyncio
import contextlib
import os
import socket
import tty
from collections import deque
from collections.abc import Callable

from protocol.errors import Fault, TestloomError

HOST = "127.0.0.1"
MAX_BUFFERED_BYTES = 16 * 2**20
"""Five minutes of a stand's samples at 200 Hz, in one wait, are 7 MB."""
MAX_PTY_BUFFERED_BYTES = 65_536
READ_BYTES = 65_536
MAX_READS_AT_ONCE = 64


class ByteLink:
    """One link: reads as bytes come, writes without ever blocking.

    Args:
        name: of the link, as in a control request.
        on_bytes: called with what the station has written.
        on_closed: called when a connection has ended.
    """

    max_buffered_bytes = MAX_BUFFERED_BYTES

    def __init__(
        self, name: str, on_bytes: Callable[[bytes], None], on_closed: Callable[[], None] = lambda: None
    ) -> None:
        self.name = name
        self.handed_over = 0
        self.received = 0
        self.overrun = False
        self._on_bytes = on_bytes
        self._on_closed = on_closed
        self._descriptor: int | None = None
        self._queue: deque[memoryview] = deque()
        self._buffered = 0
        self._writing = False
        self._loop = asyncio.get_running_loop()

    @property
    def resource(self) -> str:
        """What a station opens."""
        raise NotImplementedError

    @property
    def connected(self) -> bool:
        """Somebody is at the other end."""
        return self._descriptor is not None

    def poll(self) -> None:
        """Take what has arrived by now, without waiting for the loop's turn."""
        self._read()

    def hand_over(self, data: bytes) -> None:
        """Give bytes to the station; they count from now on, even while they wait to be read."""
        if not data or self._descriptor is None:
            return
        if self.overrun or self._buffered + len(data) > self.max_buffered_bytes:
            self._lose()
            return
        self.handed_over += len(data)
        self._buffered += len(data)
        self._queue.append(memoryview(data))
        if not self._writing:
            self._write()

    def close(self) -> None:
        """Free the port."""
        self._disconnect()

    def _lose(self) -> None:
        self.overrun = True

    def _attach(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._loop.add_reader(descriptor, self._read)

    def _disconnect(self) -> None:
        if self._descriptor is None:
            return
        self._loop.remove_reader(self._descriptor)
        self._loop.remove_writer(self._descriptor)
        self._writing = self.overrun = False
        self._queue.clear()
        self._buffered = 0
        self._descriptor = None
        self.handed_over = self.received = 0
        self._on_closed()

    def _read(self) -> None:
        for _ in range(MAX_READS_AT_ONCE):
            if self._descriptor is None:
                return
            try:
                data = os.read(self._descriptor, READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                data = b""  # reset by the other end: as good as closed
            if not data:
                self._disconnect()
                return
            self.received += len(data)
            self._on_bytes(data)
            if len(data) < READ_BYTES:
                return

    def _write(self) -> None:
        while self._queue and self._descriptor is not None:
            block = self._queue[0]
            try:
                sent = os.write(self._descriptor, block)
            except BlockingIOError:
                sent = 0
            except OSError:
                self._disconnect()
                return
            self._buffered -= sent
            if sent < len(block):
                self._queue[0] = block[sent:]
                break
            self._queue.popleft()
        if self._descriptor is None:
            return
        if self._queue and not self._writing:
            self._loop.add_writer(self._descriptor, self._write)
        elif not self._queue and self._writing:
            self._loop.remove_writer(self._descriptor)
        self._writing = bool(self._queue)
        self.overrun = self.overrun and self._writing


class TcpLink(ByteLink):
    """A link on a TCP port of this machine, `lockstep://127.0.0.1:PORT?link=NAME`."""

    def __init__(
        self,
        name: str,
        on_bytes: Callable[[bytes], None],
        port: int,
        on_closed: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name, on_bytes, on_closed)
        self._listener = listening_socket(port, name)
        self._listener.setblocking(False)
        self._connection: socket.socket | None = None
        self._loop.add_reader(self._listener.fileno(), self._accept)

    @property
    def resource(self) -> str:
        return f"lockstep://{HOST}:{self._listener.getsockname()[1]}?link={self.name}"

    def poll(self) -> None:
        self._accept()
        super().poll()

    def close(self) -> None:
        super().close()
        self._loop.remove_reader(self._listener.fileno())
        self._listener.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # nobody there (any more)
            return
        super().poll()  # what the former connection still held came first
        self._disconnect()
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection = connection
        self._attach(connection.fileno())

    def _disconnect(self) -> None:
        super()._disconnect()
        if self._connection is not None:
            self._connection.close()
            self._connection = None


class PtyLink(ByteLink):
    """A link on a pseudo terminal; like a UART without flow control it loses what nobody reads.

    There is no count on the station's side, so that it is of use with a running clock only.
    """

    max_buffered_bytes = MAX_PTY_BUFFERED_BYTES

    def __init__(self, name: str, on_bytes: Callable[[bytes], None]) -> None:
        super().__init__(name, on_bytes)
        # the slave is kept open: without any reader the master would report an error for ever
        master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(master, False)
        self._path = os.ttyname(self._slave)
        self._attach(master)

    @property
    def resource(self) -> str:
        return self._path

    def close(self) -> None:
        master = self._descriptor
        super().close()
        for descriptor in (master, self._slave):
            if descriptor is not None:
                with contextlib.suppress(OSError):
                    os.close(descriptor)

    def _lose(self) -> None:
        """A UART drops what comes next and recovers by itself."""


def listening_socket(port: int, purpose: str) -> socket.socket:
    """A listening TCP socket on the loopback address; port 0 takes a free one.

    Raises:
        TestloomError: the port is taken.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen()
    except (OSError, OverflowError) as error:
        listener.close()
        raise TestloomError(
            f"The bench cannot listen on port {port} of {HOST}: {error}.",
            where=f"port {port}, for {purpose}",
            fault=Fault.OPERATOR,
            remedy="stop what uses the port, choose another --port-base, or leave it out for free ports.",
        ) from None
    return listener

"""The listening ports of a bench, and what answers behind those that speak in lines."""

import asyncio
from collections.abc import Callable
from weakref import WeakSet

import structlog

from dut_emulator.instruments.scpi import MAX_LINE_BYTES, ScpiError, ScpiInstrument, Session
from dut_emulator.server.bench_server import BenchServer
from dut_emulator.server.control_channel import ControlConnection
from dut_emulator.server.line_server import LineProtocol
from dut_emulator.server.links import HOST, listening_socket

MAX_CONNECTIONS = 256
"""To the control channel, instruments and stand together."""
MAX_STAND_LINE_BYTES = 256

log = structlog.get_logger("bench")


class ListeningPorts:
    """The listening ports of a bench: consecutive ones, or free ones."""

    def __init__(self, base: int, bench: BenchServer) -> None:
        self._next = base
        self._bench = bench
        self._servers: list[asyncio.Server] = []
        self._protocols: WeakSet[LineProtocol | ControlConnection] = WeakSet()

    def next_port(self) -> int:
        """The next port to listen on; 0 for a free one."""
        port = self._next
        self._next += 1 if port else 0
        return port

    async def control(self) -> str:
        """Listen for control connections; `host:port`."""
        return await self._serve("the control channel", lambda: ControlConnection(self._bench))

    async def scpi(self, instrument: ScpiInstrument, purpose: str) -> str:
        """Listen with an instrument; its VISA resource."""
        address = await self._serve(
            purpose, lambda: LineProtocol(_ScpiSession(instrument, self._bench), MAX_LINE_BYTES)
        )
        host, port = address.split(":")
        return f"TCPIP::{host}::{port}::SOCKET"

    async def stand(self) -> str:
        """Listen with the stand's command port; `host:port`."""
        return await self._serve(
            "the stand's commands", lambda: LineProtocol(_StandSession(self._bench), MAX_STAND_LINE_BYTES)
        )

    def close(self) -> None:
        """Stop listening, end all connections."""
        for server in self._servers:
            server.close()
        for protocol in tuple(self._protocols):
            protocol.disconnect()

    async def _serve(self, purpose: str, factory: Callable[[], LineProtocol | ControlConnection]) -> str:
        def accepted() -> asyncio.Protocol:
            if len(self._protocols) >= MAX_CONNECTIONS:
                log.warning("a connection was refused", purpose=purpose, connections=MAX_CONNECTIONS)
                return _Refused()
            protocol = factory()
            self._protocols.add(protocol)
            return protocol

        listener = listening_socket(self.next_port(), purpose)
        server = await asyncio.get_running_loop().create_server(accepted, sock=listener)
        self._servers.append(server)
        return f"{HOST}:{listener.getsockname()[1]}"


class _Refused(asyncio.Protocol):
    """A connection too many: ended before a byte is read."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


class _ScpiSession:
    """A connection to an instrument, with its own error queue."""

    def __init__(self, instrument: ScpiInstrument, bench: BenchServer) -> None:
        self._instrument = instrument
        self._bench = bench
        self._session = Session()

    def line(self, text: str) -> str | None:
        answer = self._instrument.execute(text, self._session, self._bench.present_s())
        self._bench.stimulated()
        return answer

    def too_long(self) -> str | None:
        self._session.report(ScpiError(-363))
        return None


class _StandSession:
    """A connection to a stand's command port."""

    def __init__(self, bench: BenchServer) -> None:
        self._bench = bench

    def line(self, text: str) -> str | None:
        assert self._bench.model.stand is not None
        answer = self._bench.model.stand.command(text, self._bench.present_s())
        self._bench.stimulated()
        return answer

    def too_long(self) -> str | None:
        return "ERR 3 the line is too long"

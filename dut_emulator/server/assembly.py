"""Puts a bench together from its configuration: model, ports, description file; runs it until SIGTERM."""

import asyncio
import contextlib
import signal
import traceback
from collections.abc import Callable
from typing import Any
from weakref import WeakSet

import structlog

from dut_emulator.instruments.scpi import MAX_LINE_BYTES, ScpiError, ScpiInstrument, Session
from dut_emulator.server.bench_model import CAN, RS422, STAND_STREAM_LINK, BenchModel, SocketModel
from dut_emulator.server.bench_server import BenchServer, ServedLink
from dut_emulator.server.configuration import OPERATIONS_OF_KIND, BenchServerConfiguration
from dut_emulator.server.control_channel import ControlConnection
from dut_emulator.server.line_server import LineProtocol
from dut_emulator.server.link_faults import Framing, LinkFault
from dut_emulator.server.links import HOST, PtyLink, TcpLink, listening_socket
from dut_emulator.server.unit_store import UnitStore, write_atomically
from protocol.adapters.structured_log import log_as_json
from protocol.bench_description import BenchDescription, SocketResources, StandResources
from protocol.errors import Fault, TestloomError

MAX_CONNECTIONS = 256
"""To the control channel, instruments and stand together."""

log = structlog.get_logger("bench")


def run_bench(configuration: BenchServerConfiguration) -> None:
    """Serve a bench until SIGTERM or SIGINT. The description file exists while everything listens.

    Raises:
        TestloomError: a port is taken, or a directory cannot be used.
    """
    log_as_json(bench=configuration.name)
    asyncio.run(_run(configuration))


async def _run(configuration: BenchServerConfiguration) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):  # not the main thread
            loop.add_signal_handler(number, stop.set)
    await serve(configuration, stop)


async def serve(configuration: BenchServerConfiguration, stop: asyncio.Event) -> None:
    """Serve a bench in the running loop until `stop` is set. Raises as `run_bench`."""
    failures: list[dict[str, Any]] = []

    def failed(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """A fault of the emulator itself: end, so that whoever watches starts a new bench."""
        failures.append(context)
        error = context.get("exception")
        story = "".join(traceback.format_exception(error)) if error else ""
        log.error("the bench failed", message=context["message"], story=story)
        stop.set()

    asyncio.get_running_loop().set_exception_handler(failed)
    _remove_description(configuration)
    store = UnitStore(configuration.units_dir, configuration.seed)
    model = build_model(configuration)
    bench = BenchServer(model, store, configuration.pace)
    ports = _Ports(configuration.port_base)
    try:
        description = await _open_ports(configuration, bench, ports)
        _write_description(configuration, description)
        log.info("bench is up", control=description.control)
        await stop.wait()
    finally:
        _remove_description(configuration)
        ports.close()
        bench.close()
    if failures:
        raise TestloomError(
            f"The bench failed: {failures[0].get('exception') or failures[0]['message']}.",
            where=f"bench '{configuration.name}'",
            fault=Fault.TESTLOOM,
            remedy="start it again; its log has the circumstances.",
        )


def build_model(configuration: BenchServerConfiguration) -> BenchModel:
    """What stands on the bench."""
    from dut_emulator.server.surroundings import surroundings_of

    names = [str(number) for number in range(1, configuration.socket_count + 1)]
    stand, surroundings = surroundings_of(configuration)
    sockets = [SocketModel(name, surroundings) for name in names]
    seed, identity = configuration.instrument_seed, configuration.bench_identity
    return BenchModel(sockets, seed, identity, with_board=stand is None, stand=stand)


class _Ports:
    """The listening ports of a bench: consecutive ones, or free ones."""

    def __init__(self, base: int) -> None:
        self._next = base
        self._servers: list[asyncio.Server] = []
        self._protocols: WeakSet[LineProtocol | ControlConnection] = WeakSet()

    def next_port(self) -> int:
        """The next port to listen on; 0 for a free one."""
        port = self._next
        self._next += 1 if port else 0
        return port

    async def serve(self, purpose: str, factory: Callable[[], LineProtocol | ControlConnection]) -> str:
        """Listen with a protocol; `host:port`."""

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

    def close(self) -> None:
        """Stop listening, end all connections."""
        for server in self._servers:
            server.close()
        for protocol in tuple(self._protocols):
            protocol.disconnect()


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


async def _open_ports(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: _Ports
) -> BenchDescription:
    model = bench.model
    instruments = model.instruments

    async def scpi(instrument: ScpiInstrument, purpose: str) -> str:
        address = await ports.serve(
            purpose, lambda: LineProtocol(_ScpiSession(instrument, bench), MAX_LINE_BYTES)
        )
        host, port = address.split(":")
        return f"TCPIP::{host}::{port}::SOCKET"

    control = await ports.serve("the control channel", lambda: ControlConnection(bench))
    supply = await scpi(instruments.supply, "the power supply")
    multimeter = await scpi(instruments.multimeter, "the multimeter") if instruments.multimeter else None
    oscilloscope = (
        await scpi(instruments.oscilloscope, "the oscilloscope") if instruments.oscilloscope else None
    )
    stand = await _open_stand(configuration, bench, ports) if model.stand is not None else None
    sockets: list[SocketResources] = []
    for channel, socket in enumerate(model.sockets.values(), start=1):
        board = instruments.boards.get(socket.name)
        unit_link = _open_link(configuration, bench, ports, socket, RS422)
        # a stand wires a unit's power and RS-422 through its slip rings, nothing else
        can_channel = _open_link(configuration, bench, ports, socket, CAN) if board is not None else None
        sockets.append(
            SocketResources(
                socket=socket.name,
                unit_link=unit_link,
                can_interface="slcan" if can_channel else None,
                can_channel=can_channel,
                board=await scpi(board, f"the board of socket {socket.name}") if board else None,
                supply_channel=channel,
            )
        )
    return BenchDescription(
        bench=configuration.name,
        bench_identity=configuration.bench_identity,
        operations=OPERATIONS_OF_KIND[configuration.kind],
        control=control,
        pace=configuration.pace,
        sockets=tuple(sockets),
        power_supply=supply,
        multimeter=multimeter,
        oscilloscope=oscilloscope,
        stand=stand,
        site=configuration.site,
    )


async def _open_stand(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: _Ports
) -> StandResources:
    command = await ports.serve("the stand's commands", lambda: LineProtocol(_StandSession(bench), 256))
    link = TcpLink(STAND_STREAM_LINK, lambda _: None, ports.next_port())
    fault = LinkFault(Framing.STAND_STREAM, configuration.seed)
    bench.links[link.name] = ServedLink(link, fault)
    return StandResources(
        stand_id=configuration.bench_identity,
        kind="three_axis_turntable",
        command=command,
        stream=link.resource,
    )


def _open_link(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: _Ports, socket: SocketModel, kind: str
) -> str:
    """Open a link of a socket: its resource string."""
    name = f"{socket.name}.{kind}"
    receive = socket.receive_rs422 if kind == RS422 else socket.receive_can

    def on_bytes(data: bytes) -> None:
        answers = receive(data, bench.present_s())
        if answers:
            bench.links[name].hand_over(answers)
        bench.bytes_arrived()

    if configuration.serial == "pty":
        link = PtyLink(name, on_bytes)
    else:
        link = TcpLink(name, on_bytes, ports.next_port(), on_closed=socket.adapter.disconnect)
    framing = Framing.RS422 if kind == RS422 else Framing.SLCAN
    bench.links[name] = ServedLink(link, LinkFault(framing, configuration.seed))
    return link.resource


def _write_description(configuration: BenchServerConfiguration, description: BenchDescription) -> None:
    try:
        configuration.description.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(configuration.description, description.model_dump_json(indent=2) + "\n")
    except OSError as error:
        raise TestloomError(
            f"The bench's description cannot be written: {error}.",
            where=str(configuration.description),
            fault=Fault.OPERATOR,
            remedy="give --description a file in a directory that the bench may write to.",
        ) from None


def _remove_description(configuration: BenchServerConfiguration) -> None:
    """A description without a bench behind it would send stations to dead ports."""
    with contextlib.suppress(OSError):
        configuration.description.unlink(missing_ok=True)

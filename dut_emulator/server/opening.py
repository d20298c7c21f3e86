"""Opens everything that a bench offers: instruments, the stand, each socket's links."""

from collections.abc import Callable

from dut_emulator.interfaces import StandModel
from dut_emulator.server.bench_kinds import WIRING
from dut_emulator.server.bench_model import CAN, METER_LINK, RS422, STAND_STREAM_LINK, SocketModel
from dut_emulator.server.bench_server import BenchServer, ServedLink
from dut_emulator.server.configuration import BenchServerConfiguration
from dut_emulator.server.link_faults import Framing, LinkFault
from dut_emulator.server.links import ByteLink, PtyLink, TcpLink
from dut_emulator.server.listening import ListeningPorts
from protocol.bench_description import BenchDescription, SocketResources, StandResources


async def open_bench(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: ListeningPorts
) -> BenchDescription:
    """Open all ports; what a station is told of them."""
    instruments = bench.model.instruments
    control = await ports.control()
    supply = await ports.scpi(instruments.supply, "the power supply")
    multimeter = (
        await ports.scpi(instruments.multimeter, "the multimeter") if instruments.multimeter else None
    )
    oscilloscope = (
        await ports.scpi(instruments.oscilloscope, "the oscilloscope") if instruments.oscilloscope else None
    )
    counter = instruments.pulse_counter
    model = bench.model.stand
    stand = await _open_stand(configuration, bench, ports, model) if model is not None else None
    return BenchDescription(
        bench=configuration.name,
        bench_identity=configuration.bench_identity,
        operations=configuration.operations,
        product=configuration.unit_product,
        control=control,
        pace=configuration.pace,
        sockets=await _open_sockets(configuration, bench, ports),
        power_supply=supply,
        multimeter=multimeter,
        oscilloscope=oscilloscope,
        serial_multimeter=_open_serial_multimeter(configuration, bench, ports),
        pulse_counter=await ports.scpi(counter, "the pulse counter") if counter is not None else None,
        stand=stand,
        site=configuration.site,
    )


async def _open_sockets(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: ListeningPorts
) -> tuple[SocketResources, ...]:
    wired = [kind for kind, _ in WIRING[configuration.unit_product].links]
    sockets: list[SocketResources] = []
    for channel, socket in enumerate(bench.model.sockets.values(), start=1):
        board = bench.model.instruments.boards.get(socket.name)
        unit_link = _open_link(configuration, bench, ports, socket, RS422) if RS422 in wired else None
        # a stand wires a unit's power and RS-422 through its slip rings, nothing else
        can_channel = _open_link(configuration, bench, ports, socket, CAN) if board is not None else None
        sockets.append(
            SocketResources(
                socket=socket.name,
                unit_link=unit_link,
                can_interface="slcan" if can_channel else None,
                can_channel=can_channel,
                board=await ports.scpi(board, f"the board of socket {socket.name}") if board else None,
                supply_channel=channel,
            )
        )
    return tuple(sockets)


async def _open_stand(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: ListeningPorts, stand: StandModel
) -> StandResources:
    command = await ports.stand()
    link = TcpLink(STAND_STREAM_LINK, lambda _: None, ports.next_port())
    fault = LinkFault(Framing.STAND_STREAM, configuration.seed, stand.sample_bytes)
    bench.links[link.name] = ServedLink(link, fault)
    return StandResources(
        stand_id=configuration.bench_identity,
        kind=configuration.kind,
        command=command,
        stream=link.resource,
    )


def _open_serial_multimeter(
    configuration: BenchServerConfiguration, bench: BenchServer, ports: ListeningPorts
) -> str | None:
    meter = bench.model.instruments.serial_multimeter
    if meter is None:
        return None

    def on_bytes(data: bytes) -> None:
        meter.receive(data, bench.present_s())
        bench.bytes_arrived()

    return _serve(configuration, bench, ports, METER_LINK, on_bytes, Framing.UNFRAMED).resource


def _open_link(
    configuration: BenchServerConfiguration,
    bench: BenchServer,
    ports: ListeningPorts,
    socket: SocketModel,
    kind: str,
) -> str:
    """Open a link of a socket: its resource string."""
    name = f"{socket.name}.{kind}"
    receive = socket.receive_rs422 if kind == RS422 else socket.receive_can

    def on_bytes(data: bytes) -> None:
        answers = receive(data, bench.present_s())
        if answers:
            bench.links[name].hand_over(answers)
        bench.bytes_arrived()

    framing = Framing.SLCAN if kind == CAN else dict(WIRING[configuration.unit_product].links)[kind]
    link = _serve(configuration, bench, ports, name, on_bytes, framing, socket.adapter.disconnect)
    return link.resource


def _serve(
    configuration: BenchServerConfiguration,
    bench: BenchServer,
    ports: ListeningPorts,
    name: str,
    on_bytes: Callable[[bytes], None],
    framing: Framing,
    on_closed: Callable[[], None] = lambda: None,
) -> ByteLink:
    if configuration.serial == "pty":
        link: ByteLink = PtyLink(name, on_bytes)
    else:
        link = TcpLink(name, on_bytes, ports.next_port(), on_closed=on_closed)
    bench.links[name] = ServedLink(link, LinkFault(framing, configuration.seed))
    return link

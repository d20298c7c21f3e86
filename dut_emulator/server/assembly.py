"""Puts a bench together from its configuration: model, ports, description file; runs it until SIGTERM."""

import asyncio
import contextlib
import signal
import traceback
from typing import Any

import structlog

from dut_emulator.instruments.pulse_counter import PulseCounter
from dut_emulator.instruments.serial_multimeter import SerialMultimeter
from dut_emulator.products.catalogue import make_unit
from dut_emulator.server.bench_kinds import WIRING
from dut_emulator.server.bench_model import BenchModel, SocketModel
from dut_emulator.server.bench_server import BenchServer
from dut_emulator.server.configuration import BenchServerConfiguration
from dut_emulator.server.listening import ListeningPorts
from dut_emulator.server.opening import open_bench
from dut_emulator.server.unit_store import UnitStore, write_atomically
from dut_emulator.twin import Twin, read_twin
from protocol.adapters.structured_log import log_as_json
from protocol.bench_description import BenchDescription
from protocol.errors import Fault, TestloomError

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
    twin = _twin_of_units(configuration)
    store = UnitStore(configuration.units_dir, configuration.seed, configuration.unit_product, twin)
    model = build_model(configuration)
    bench = BenchServer(model, store, configuration.pace)
    ports = ListeningPorts(configuration.port_base, bench)
    try:
        description = await open_bench(configuration, bench, ports)
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
    port = stand.port if stand is not None else None
    model = BenchModel(sockets, seed, identity, with_board=stand is None, stand=port)
    match WIRING[configuration.unit_product].instrument:
        case "serial_multimeter":
            model.instruments.serial_multimeter = SerialMultimeter(sockets[0], seed, f"{identity}-DMM")
        case "pulse_counter":
            line = stand.trigger_line if stand is not None else None
            model.instruments.pulse_counter = PulseCounter(sockets[0], line, f"{identity}-PC")
        case None:
            pass
    return model


def _twin_of_units(configuration: BenchServerConfiguration) -> Twin | None:
    """What every unit here is made of; one that no unit can be made of is refused before anything listens."""
    if configuration.twin is None:
        return None
    twin, product = read_twin(configuration.twin), configuration.unit_product
    if twin.product not in ("", product):
        raise TestloomError(
            f"The twin is one of a {twin.product}, not of a {product}.",
            where=str(configuration.twin),
            fault=Fault.OPERATOR,
            remedy="give a twin of this product.",
        )
    make_unit(product, configuration.seed, "U-0001", twin=twin)
    return twin


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

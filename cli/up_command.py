"""`testloom up`: a whole line on this machine, from an order of units to verdicts and yield."""

import json
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from cli.line_layout import LineLayout
from cli.process_group import ProcessGroup
from protocol.errors import Fault, TestloomError
from protocol.language import chosen_language, say

LINE = "demo"
ROUTER_PORT = 7447
DASHBOARD_PORT = 8080
MAX_UNITS = 1000
START_TIMEOUT_S = 60.0
LINE_TIMEOUT_S = 3600.0
DRAIN_TIMEOUT_S = 10.0


def up(
    units: Annotated[int, typer.Option(min=1, max=MAX_UNITS, help=say("How many units to order."))] = 24,
    seed: Annotated[int, typer.Option(min=0, help=say("Makes the lot: the same seed, the same units."))] = 7,
    summary: Annotated[Path | None, typer.Option(help=say("Write the summary here as JSON."))] = None,
    directory: Annotated[
        Path | None, typer.Option("--dir", help=say("Keep all of the run in this folder."))
    ] = None,
    functional_stations: Annotated[int, typer.Option(min=1, max=50, help=say("Socket-board stations."))] = 4,
    sockets: Annotated[int, typer.Option(min=1, max=16, help=say("Sockets of a socket-board station."))] = 2,
    turntables: Annotated[int, typer.Option(min=1, max=20, help=say("Turntable stations."))] = 2,
    pace: Annotated[float, typer.Option(min=0.0, help=say("0: as fast as possible; 1: in real time."))] = 0.0,
    database: Annotated[
        str | None, typer.Option(help=say("Database URL; by default SQLite in the run's folder."))
    ] = None,
    dashboard: Annotated[bool, typer.Option(help=say("Serve the web page of the line."))] = True,
    dashboard_port: Annotated[int | None, typer.Option(help=say("Port of the web page."))] = None,
    stay: Annotated[bool, typer.Option(help=say("Stay up when all units are done, until Ctrl-C."))] = False,
    as_json: Annotated[bool, typer.Option("--json", help=say("Print the summary as JSON only."))] = False,
) -> None:
    run_directory = _prepared(directory)
    layout = LineLayout(
        line=LINE,
        directory=run_directory,
        seed=seed,
        functional_stations=functional_stations,
        sockets_per_station=sockets,
        turntables=turntables,
        router_endpoint=f"tcp/127.0.0.1:{_port(ROUTER_PORT)}",
        dashboard_port=(dashboard_port or _port(DASHBOARD_PORT)) if dashboard else None,
        database_url=database or f"sqlite:///{run_directory / 'coordinator.sqlite'}",
        pace=pace,
        language=chosen_language(),
    )
    with _terminated_as_interrupted():
        result = _run_line(layout, units, quiet=as_json, stay=stay)
    if summary is not None:
        summary.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")
    if as_json:
        typer.echo(json.dumps(result, ensure_ascii=False))
    if any(result[key] for key in ("lost", "duplicated", "unfinished", "unsupported")):
        raise typer.Exit(1)


up.__doc__ = say("Run a whole line on this machine: units in, verdicts and yield out.")


def _run_line(layout: LineLayout, units: int, *, quiet: bool, stay: bool) -> dict[str, Any]:
    """Start the line, order the units, watch until they are done, stop everything."""
    from cli.line_audit import audited_summary
    from cli.line_watch import LineWatch

    group = ProcessGroup(layout.directory)
    watch = LineWatch(layout, group, quiet=quiet)
    started_s = time.monotonic()
    try:
        for specification in layout.processes():
            group.start(specification)
        watch.announce()
        order = watch.order(units, START_TIMEOUT_S)
        status = watch.until_finished(LINE_TIMEOUT_S)
        wall_s = time.monotonic() - started_s
        watch.until_spools_are_empty(DRAIN_TIMEOUT_S)
        if stay:
            watch.until_interrupted()
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not leave processes behind
        group.stop()
        signal.signal(signal.SIGINT, signal.default_int_handler)
    result, truths = audited_summary(layout, status, [unit.serial for unit in order.units], wall_s)
    if not quiet:
        watch.show_result(status, result, truths)
    return result


def _prepared(directory: Path | None) -> Path:
    """The run's folder, made if it is not there; a run is never mixed into another."""
    chosen = (directory or Path("runs") / datetime.now().strftime("%Y%m%d-%H%M%S")).resolve()
    if (chosen / "processes.json").exists():
        raise TestloomError(
            f"The folder {chosen} holds a run already.",
            where=str(chosen),
            fault=Fault.OPERATOR,
            remedy="choose another folder with --dir, or move this one away.",
        )
    try:
        for name in ("logs", "spools", "benches", "recordings", "sealed/units"):
            (chosen / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TestloomError(
            f"The folder of the run cannot be made: {error.strerror}.",
            where=str(chosen),
            fault=Fault.OPERATOR,
            remedy="choose another folder with --dir.",
        ) from None
    return chosen


def _port(preferred: int) -> int:
    """The preferred port of the loopback address, or a free one when it is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", preferred))
        except OSError:
            probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM ends the run as Ctrl-C does: in order, with nothing left behind.

    SIGINT too where a script started the run in the background, which hands it down as ignored.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

"""`testloom up`: a whole line on this machine, from an order of units to verdicts and yield."""

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from cli.line_layout import LineLayout
from cli.process_group import ProcessGroup
from cli.run_claims import claimed_folder, claimed_port, demanded_port
from protocol.addresses import DASHBOARD_PORT, DEFAULT_LINE, LOOPBACK, ROUTER_PORT
from protocol.errors import Fault, TestloomError
from protocol.language import chosen_language, say
from protocol.line_views import LineStatus, OrderUnits

MAX_UNITS = 1000
START_TIMEOUT_S = 60.0
LINE_TIMEOUT_S = 3600.0
DRAIN_TIMEOUT_S = 10.0
EXIT_INTERRUPTED = 130


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
    dashboard_port: Annotated[
        int | None, typer.Option(min=1, max=65535, help=say("Port of the web page."))
    ] = None,
    stay: Annotated[bool, typer.Option(help=say("Stay up when all units are done, until Ctrl-C."))] = False,
    as_json: Annotated[bool, typer.Option("--json", help=say("Print the summary as JSON only."))] = False,
) -> None:
    _require_place_for(summary)
    run_directory = claimed_folder(directory)
    with ExitStack() as claims:
        claims.enter_context(_terminated_as_interrupted())
        layout = LineLayout(
            line=DEFAULT_LINE,
            directory=run_directory,
            seed=seed,
            functional_stations=functional_stations,
            sockets_per_station=sockets,
            turntables=turntables,
            router_endpoint=f"tcp/{LOOPBACK}:{claims.enter_context(claimed_port(ROUTER_PORT))}",
            dashboard_port=_page_port(dashboard_port, claims) if dashboard else None,
            database_url=database or f"sqlite:///{run_directory / 'coordinator.sqlite'}",
            pace=pace,
            language=chosen_language(),
        )
        try:
            result = _run_line(layout, units, quiet=as_json, stay=stay)
        except KeyboardInterrupt:
            typer.echo(say("Stopped. What was kept is in {directory}", directory=run_directory), err=True)
            raise typer.Exit(EXIT_INTERRUPTED) from None
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
            status = watch.until_interrupted(status)
    finally:
        with _undisturbed():  # a second Ctrl-C must not leave processes behind
            group.stop()
    result, truths = audited_summary(layout, status, _serials_to_judge(order, status), wall_s)
    if not quiet:
        watch.show_result(status, result, truths)
    return result


def _serials_to_judge(order: OrderUnits, status: LineStatus) -> list[str]:
    """The run's own order, and what others put on the line since and has its disposition."""
    own = [unit.serial for unit in order.units]
    later = [u.unit.serial for u in status.units if u.operation is None and u.unit.serial not in set(own)]
    return own + later


def _page_port(demanded: int | None, claims: ExitStack) -> int:
    if demanded is not None:
        return demanded_port(demanded, "--dashboard-port")
    return claims.enter_context(claimed_port(DASHBOARD_PORT))


def _require_place_for(summary: Path | None) -> None:
    """Refuse a summary that cannot be written before the line has worked for it."""
    if summary is None:
        return
    folder = summary.resolve().parent
    if summary.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise TestloomError(
            f"The summary cannot be written to {summary}.",
            where=str(summary.resolve()),
            fault=Fault.OPERATOR,
            remedy="name a file in a folder that exists and may be written.",
        )


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM, and a terminal that is closed, end the run as Ctrl-C does: in order, with nothing left behind.

    SIGINT too where a script started the run in the background, which hands it down as ignored.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    ending = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup: it shall outlive its terminal
        ending.append(signal.SIGHUP)
    with _handled(ending, interrupt):
        yield


@contextmanager
def _undisturbed() -> Iterator[None]:
    with _handled([signal.SIGTERM, signal.SIGINT, signal.SIGHUP], signal.SIG_IGN):
        yield


@contextmanager
def _handled(numbers: list[signal.Signals], handler: Any) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)

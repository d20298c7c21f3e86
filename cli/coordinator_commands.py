"""`testloom coordinator`, `order`, `status`, `unit`, `yield`: the coordinator, and questions to it."""

import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from protocol.addresses import DEFAULT_LINE, DEFAULT_ROUTER
from protocol.errors import Fault, TestloomError
from protocol.language import say

if TYPE_CHECKING:
    from cli.line_client import LineClient
    from protocol.line_views import AttemptView, LineStatus, UnitHistory
    from protocol.measurements import MeasurementSpecification

DEFAULT_DATABASE = "sqlite:///testloom-line.db"
WATCH_PERIOD_S = 0.5
MAX_ALARMS_SHOWN = 5

Line = Annotated[str, typer.Option(help=say("Name of the line."))]
Router = Annotated[str, typer.Option(help=say("Zenoh locator of the router."))]
AsJson = Annotated[bool, typer.Option("--json", help=say("Print JSON."))]


def coordinator(
    line: Line = DEFAULT_LINE,
    router: Router = DEFAULT_ROUTER,
    database: Annotated[
        str, typer.Option(help=say("Database URL: sqlite:///file or postgresql://user@host/name."))
    ] = DEFAULT_DATABASE,
    log: Annotated[
        Path | None, typer.Option(help=say("File for the log; standard error if not given."))
    ] = None,
) -> None:
    from coordinator.daemon import CoordinatorArguments, run_coordinator

    run_coordinator(CoordinatorArguments(line=line, router=router, database=database, log_file=log))


def order(
    units: Annotated[int, typer.Option(min=1, max=10_000, help=say("How many units to order."))] = 1,
    seed: Annotated[int, typer.Option(min=0, help=say("Part of the serials: GM-<seed>-<number>."))] = 7,
    serials: Annotated[
        str, typer.Option(help=say("Serials to order, with commas between; instead of --units."))
    ] = "",
    lot: Annotated[str, typer.Option(help=say("Lot of the units."))] = "L1",
    route: Annotated[str, typer.Option(help=say("Route of the units."))] = "gnc_module",
    line: Line = DEFAULT_LINE,
    router: Router = DEFAULT_ROUTER,
    as_json: AsJson = False,
) -> None:
    from protocol.attempts import UnitIdentity
    from protocol.line_views import OrderAccepted, OrderUnits
    from protocol.routes import ROUTES

    if route not in ROUTES:
        raise TestloomError(
            f"There is no route '{route}'.",
            fault=Fault.OPERATOR,
            remedy=f"choose one of: {', '.join(ROUTES)}.",
        )
    named = [serial.strip() for serial in serials.split(",") if serial.strip()]
    chosen = named or [f"GM-{seed}-{number:04d}" for number in range(1, units + 1)]
    try:
        identities = tuple(
            UnitIdentity(serial=serial, product=ROUTES[route].product, lot=lot) for serial in chosen
        )
    except ValueError:
        raise TestloomError(
            "A serial is not one.",
            where=", ".join(chosen[:5]),
            fault=Fault.OPERATOR,
            remedy="use 1 to 64 letters, digits, '_', '.' or '-', beginning with a letter or digit.",
        ) from None
    # The same order sent twice is one order.
    order_id = hashlib.sha256("\n".join((route, lot, *chosen)).encode()).hexdigest()[:16]
    with _client(line, router) as client:
        request = OrderUnits(order_id=f"order-{order_id}", route=ROUTES[route], units=identities)
        accepted = client.ask(request, OrderAccepted)
    if as_json:
        typer.echo(accepted.model_dump_json(indent=1))
        return
    typer.echo(say("{count} units are on the line.", count=accepted.accepted))
    if accepted.already_known:
        typer.echo(say("Known before: {serials}", serials=", ".join(accepted.already_known)))


def status(
    watch: Annotated[bool, typer.Option("--watch", help=say("Keep showing, until Ctrl-C."))] = False,
    line: Line = DEFAULT_LINE,
    router: Router = DEFAULT_ROUTER,
    as_json: AsJson = False,
) -> None:
    from protocol.line_views import GetLineStatus, LineStatus

    with _client(line, router) as client:
        now = client.ask(GetLineStatus(), LineStatus)
        if as_json:
            typer.echo(now.model_dump_json(indent=1))
            return
        if not watch:
            Console().print(_status_view(now))
            return
        try:
            with Live(_status_view(now), refresh_per_second=4) as live:
                while True:
                    time.sleep(WATCH_PERIOD_S)
                    try:
                        live.update(_status_view(client.ask(GetLineStatus(), LineStatus)))
                    except TestloomError as error:  # the coordinator is away: say so, look again
                        live.update(Text(say(error.what), style="bold red"))
        except KeyboardInterrupt:
            return


def unit(
    serial: Annotated[str, typer.Argument(help=say("Serial of the unit."))],
    line: Line = DEFAULT_LINE,
    router: Router = DEFAULT_ROUTER,
    as_json: AsJson = False,
) -> None:
    from protocol.line_views import GetUnit, UnitHistory

    with _client(line, router) as client:
        history = client.ask(GetUnit(serial=serial), UnitHistory)
    if as_json:
        typer.echo(history.model_dump_json(indent=1))
    else:
        Console().print(_unit_view(history))


def show_yield(
    line: Line = DEFAULT_LINE,
    router: Router = DEFAULT_ROUTER,
    as_json: AsJson = False,
) -> None:
    from cli.line_display import yield_table
    from protocol.line_views import GetYield, YieldReport

    with _client(line, router) as client:
        report = client.ask(GetYield(), YieldReport)
    if as_json:
        typer.echo(report.model_dump_json(indent=1))
    else:
        Console().print(yield_table(report))


@contextmanager
def _client(line: str, router: str) -> "Iterator[LineClient]":
    from cli.line_client import line_client

    with line_client(line, router) as client:
        yield client


def _status_view(now: "LineStatus") -> RenderableType:
    from cli.line_display import alarm_words, disposition_text, yield_table

    stations = Table(title=say("Line {line}", line=now.line), header_style="bold")
    for heading in ("Station", "State", "Socket", "Serial", "Operation", "Since"):
        stations.add_column(say(heading))
    for station in sorted(now.stations, key=lambda entry: entry.station):
        for socket in station.sockets:
            since = "" if socket.leased_since_s is None else f"{now.at_s - socket.leased_since_s:.0f} s"
            stations.add_row(
                station.station,
                Text(say(station.state), style="green" if station.state == "ready" else "bold red"),
                socket.socket,
                socket.serial or say("free"),
                socket.operation or "",
                since,
            )
    waiting = Table(title=say("Waiting"), header_style="bold")
    for heading in ("Position", "Serial", "Disposition", "Waits for"):
        waiting.add_column(say(heading), overflow="fold")
    queued = [one for one in now.units if one.queue_position is not None]
    for one in sorted(queued, key=lambda entry: (entry.operation or "", entry.queue_position or 0)):
        why = say(one.waits_for_template, **one.waits_for_values) if one.waits_for_template else one.waits_for
        waiting.add_row(str(one.queue_position), one.unit.serial, disposition_text(one.disposition), why)
    done = sum(1 for one in now.units if one.operation is None)
    parts: list[RenderableType] = [
        Text(say("{done} of {total} units", done=done, total=len(now.units))),
        stations,
    ]
    if queued:
        parts.append(waiting)
    parts.append(yield_table(now.yield_report))
    for alarm in now.alarms[-MAX_ALARMS_SHOWN:]:
        parts.append(Text(f"▲ {alarm_words(alarm)}", style="yellow"))
    return Group(*parts)


def _unit_view(history: "UnitHistory") -> RenderableType:
    from cli.line_display import disposition_text

    one = history.status
    head = Text(
        f"{one.unit.serial}  {one.unit.product}  {say('lot {lot}', lot=one.unit.lot)}  ", style="bold"
    )
    head.append_text(disposition_text(one.disposition))
    if one.waits_for:
        why = say(one.waits_for_template, **one.waits_for_values) if one.waits_for_template else one.waits_for
        head.append(f"  {why}", style="dim")
    parts: list[RenderableType] = [head]
    for view in history.attempts:
        parts.append(_attempt_view(view))
    if not history.attempts:
        parts.append(Text(say("No attempt yet."), style="dim"))
    return Group(*parts)


def _attempt_view(view: "AttemptView") -> RenderableType:
    """An attempt: its outcome and why, then each step with its measurements below it."""
    record = view.record
    passed = record.outcome.value == "PASS"
    title = Text(f"{record.attempt_id}  {record.lease.station}/{record.lease.socket}  ", style="bold")
    title.append(say(record.outcome.value), style="green" if passed else "bold red")
    if view.set_aside:
        title.append(f"  ({say('set aside: its lease was no longer valid')})", style="yellow")
    parts: list[RenderableType] = [Text(), title]
    if record.message:
        parts.append(Text(record.message))
    table = Table(header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column(say("Step, measurement"), overflow="fold")
    for heading in ("Value", "Limits", "Unit", "Outcome"):
        table.add_column(say(heading), no_wrap=True)
    for step in record.steps:
        table.add_row(Text(step.step, style="bold"), "", "", "", _outcome_text(step.outcome.value))
        for measurement in step.measurements:
            specification = measurement.specification
            table.add_row(
                f"  {specification.name}",
                "–" if measurement.value is None else _figure(measurement.value),
                _limits(specification),
                specification.unit,
                _outcome_text(measurement.outcome.value),
            )
        if step.message and step.outcome.value != "PASS" and step.message not in record.message:
            table.add_row(Text(f"  {step.message}", style="red"))
    parts.append(table)
    for recording in record.recordings:
        kept = {"samples": recording.sample_count, "path": recording.path}
        parts.append(Text(say("raw data: {samples} samples in {path}", **kept), overflow="fold"))
    return Group(*parts)


def _outcome_text(outcome: str) -> Text:
    return Text(say(outcome), style="green" if outcome == "PASS" else "bold red")


def _limits(specification: "MeasurementSpecification") -> str:
    if specification.equals is not None:
        return f"= {specification.equals}"
    low = "" if specification.low is None else _figure(specification.low)
    high = "" if specification.high is None else _figure(specification.high)
    return f"{low} … {high}" if low or high else ""


def _figure(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


coordinator.__doc__ = say("Run the coordinator of a line.")
order.__doc__ = say("Put units on the line.")
status.__doc__ = say("Show the line: stations, sockets, queue, yield, alarms.")
unit.__doc__ = say("Show a unit: its attempts, measurements against limits, recordings.")
show_yield.__doc__ = say("Show the yield by operation and by station.")

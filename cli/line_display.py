"""The line as a terminal shows it: stations and sockets, queue, yield, and the final tables."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from cli.line_summary import Truth
from protocol.language import say
from protocol.line_views import Alarm, LineStatus, SocketStatus, UnitStatus, YieldReport
from protocol.outcomes import Disposition

DISPOSITION_STYLE = {
    Disposition.SHIP: "bold green",
    Disposition.RETEST: "yellow",
    Disposition.REWORK: "magenta",
    Disposition.QUARANTINE: "bold yellow",
    Disposition.SCRAP: "bold red",
    Disposition.IN_PROCESS: "cyan",
}
MARKS = {
    Disposition.SHIP: "✔",
    Disposition.SCRAP: "✘",
    Disposition.QUARANTINE: "!",
    Disposition.REWORK: "↺",
    Disposition.RETEST: "↻",
    Disposition.IN_PROCESS: "…",
}


def disposition_text(disposition: Disposition) -> Text:
    """A disposition with a mark, so that it is read without its colour too."""
    return Text(f"{MARKS[disposition]} {say(disposition.value)}", style=DISPOSITION_STYLE[disposition])


def starting_view(line: str, elapsed_s: float, story: Sequence[str]) -> RenderableType:
    """The line before anybody answers for it."""
    head = Text(say("The line is starting, {elapsed:.0f} s …", elapsed=elapsed_s))
    parts: list[RenderableType] = [head, *(Text(f"• {words}", style="dim") for words in story[-3:])]
    return Panel(Group(*parts), title=say("Line {line}", line=line), border_style="blue")


def live_view(
    status: LineStatus, elapsed_s: float, story: Sequence[str], stations: Sequence[str]
) -> RenderableType:
    """The line at work. `stations`: all that belong to it, also those that nobody has heard of yet."""
    done = sum(1 for unit in status.units if unit.operation is None)
    total = max(1, len(status.units))
    head = Table.grid(expand=True, padding=(0, 2))
    head.add_column()
    head.add_column(ratio=1)
    head.add_column(justify="right")
    head.add_row(
        say("{done} of {total} units", done=done, total=len(status.units)),
        ProgressBar(total=total, completed=done),
        _time_left(status, elapsed_s),
    )
    parts: list[RenderableType] = [head, _stations_table(status, stations), _queue_and_yield(status)]
    parts.extend(Text(f"▲ {alarm_words(alarm)}", style="yellow") for alarm in status.alarms[-3:])
    parts.extend(Text(f"• {line}", style="dim") for line in story[-3:])
    return Panel(Group(*parts), title=say("Line {line}", line=status.line), border_style="blue")


def alarm_words(alarm: Alarm) -> str:
    """An alarm in the chosen language."""
    return say(alarm.template, **alarm.values) if alarm.template else alarm.text


def progress_line(status: LineStatus, elapsed_s: float) -> str:
    """The same in one line, for a log."""
    done = sum(1 for unit in status.units if unit.operation is None)
    busy = sum(1 for station in status.stations for socket in station.sockets if socket.serial)
    waiting = ", ".join(f"{name} {count}" for name, count in status.queue_lengths.items())
    return say(
        "{elapsed:5.1f} s  {done}/{total} units done, {busy} on sockets, waiting: {waiting}",
        elapsed=elapsed_s,
        done=done,
        total=len(status.units),
        busy=busy,
        waiting=waiting or "0",
    )


def units_table(units: Sequence[UnitStatus], truths: Mapping[str, Truth]) -> Table:
    """Every unit with what became of it and what it truly is."""
    table = Table(title=say("Units"), header_style="bold")
    for heading in ("Serial", "Disposition", "Attempts", "Truth (emulator)", "Judgement"):
        table.add_column(say(heading), overflow="fold")
    for view in sorted(units, key=lambda unit: unit.unit.serial):
        truth = truths.get(view.unit.serial)
        table.add_row(
            view.unit.serial,
            disposition_text(view.disposition),
            str(view.attempts),
            _truth_words(truth),
            _judgement(view.disposition, truth),
        )
    return table


def yield_table(report: YieldReport) -> Table:
    """First-pass yield in both conventions, by operation and by station."""
    table = Table(title=say("Yield"), header_style="bold")
    for heading in ("Operation", "Station", "First attempts", "FPY", "FPY of units"):
        justify = "left" if heading in ("Operation", "Station") else "right"
        table.add_column(say(heading), justify=justify, overflow="fold")
    for entry in (*report.operations, *report.stations):
        table.add_row(
            entry.operation,
            entry.station or say("all"),
            str(entry.first_attempts),
            _percent(entry.fpy),
            _percent(entry.fpy_unit),
        )
    table.add_section()
    table.add_row(say("RTY"), "", "", _percent(report.rty), _percent(report.rty_unit))
    table.add_row(say("shipped of finished"), "", "", _percent(report.final), "")
    return table


def summary_lines(summary: Mapping[str, Any]) -> list[Text]:
    """The figures that decide whether the run is to be trusted."""
    good = summary["lost"] == summary["duplicated"] == 0
    lines = [
        Text(
            say(
                "{attempts} attempts recorded, {lost} lost, {duplicated} duplicated",
                attempts=summary["attempts"],
                lost=summary["lost"],
                duplicated=summary["duplicated"],
            ),
            style="green" if good else "bold red",
        ),
        Text(
            say(
                "{defective} truly defective; escapes of gross defects {escapes}, "
                "false rejects of healthy units {rejects}",
                defective=summary["true_defective"],
                escapes=summary["escapes"],
                rejects=summary["false_rejects"],
            ),
            style="green" if not summary["escapes"] and not summary["false_rejects"] else "bold red",
        ),
    ]
    marginal = summary["marginal"]
    lines.append(
        Text(
            say(
                "marginal defects {units}, escaped {escapes} (stated risk of each ≤ {consumer:.2%}); "
                "healthy units near a limit {near}, rejected {rejects} (≤ {producer:.2%})",
                units=marginal["units"],
                escapes=marginal["escapes"],
                consumer=marginal["stated_risk"]["consumer"],
                near=marginal["near_limit_units"],
                rejects=marginal["false_rejects"],
                producer=marginal["stated_risk"]["producer"],
            )
        )
    )
    return lines


def _stations_table(status: LineStatus, stations: Sequence[str]) -> Table:
    table = Table(expand=True, header_style="bold", box=None)
    for heading in ("Station", "State", "Operation"):
        table.add_column(say(heading), no_wrap=True)
    table.add_column(say("Sockets"), ratio=1)
    known = {entry.station: entry for entry in status.stations}
    for name in sorted({*stations, *known}):
        entry = known.get(name)
        if entry is None:
            table.add_row(name, Text(say("starting"), style="yellow"), "", "")
            continue
        operations = sorted({operation for socket in entry.sockets for operation in socket.operations})
        style = "green" if entry.state == "ready" else "bold red"
        sockets = Columns([_socket_text(socket, status.at_s) for socket in entry.sockets], padding=(0, 3))
        table.add_row(name, Text(say(entry.state), style=style), " ".join(operations), sockets)
    return table


def _socket_text(socket: SocketStatus, now_s: float) -> Text:
    """A socket with its unit and how long it has been there; never broken over two lines."""
    if socket.serial is None:
        return Text(f"[{socket.socket}] {say('free')}", style="dim", no_wrap=True)
    since = "" if socket.leased_since_s is None else f" {max(0.0, now_s - socket.leased_since_s):.0f} s"
    return Text(f"[{socket.socket}] {socket.serial}{since}", style="cyan", no_wrap=True)


def _queue_and_yield(status: LineStatus) -> Table:
    grid = Table.grid(expand=True, padding=(0, 3))
    grid.add_column(no_wrap=True)
    grid.add_column(ratio=1)
    waiting = "   ".join(f"{name} {count}" for name, count in status.queue_lengths.items())
    counts = Counter(unit.disposition for unit in status.units)
    kinds = Text()
    for disposition, count in sorted(counts.items(), key=lambda item: list(MARKS).index(item[0])):
        kinds.append_text(disposition_text(disposition))
        kinds.append(f" {count}   ")
    yields = [
        f"{entry.operation} {_percent(entry.fpy)} ({entry.first_passes}/{entry.first_attempts})"
        for entry in status.yield_report.operations
    ]
    grid.add_row(say("Waiting"), waiting or "0")
    grid.add_row(say("Units"), kinds)
    grid.add_row(say("FPY"), "   ".join([*yields, f"RTY {_percent(status.yield_report.rty)}"]))
    return grid


def _time_left(status: LineStatus, elapsed_s: float) -> str:
    if status.expected_remaining_s is None:
        return say("{elapsed:.0f} s", elapsed=elapsed_s)
    return say(
        "{elapsed:.0f} s, about {left:.0f} s left", elapsed=elapsed_s, left=status.expected_remaining_s
    )


def _percent(fraction: float | None) -> str:
    return "–" if fraction is None else f"{fraction:.1%}"


def _truth_words(truth: Truth | None) -> str:
    if truth is None:
        return "?"
    return say(truth.category) + (f": {truth.defect}" if truth.defect else "")


def _judgement(disposition: Disposition, truth: Truth | None) -> Text:
    if truth is None or disposition in (Disposition.IN_PROCESS, Disposition.RETEST):
        return Text("–", style="dim")
    shipped = disposition is Disposition.SHIP
    defective = truth.category in ("gross", "marginal")
    if shipped and defective:
        return Text(say("escape"), style="bold red")
    if not shipped and not defective:
        return Text(say("false reject"), style="bold red")
    return Text(say("right"), style="green")

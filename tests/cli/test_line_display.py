"""What the terminal shows of a line, read as text."""

import pytest
from rich.console import Console, RenderableType

from cli.line_display import live_view
from protocol.line_views import Alarm, LineStatus, OperationYield, SocketStatus, StationStatus, YieldReport


def _text(view: RenderableType, width: int) -> str:
    console = Console(width=width, color_system=None, force_terminal=True, highlight=False)
    with console.capture() as capture:
        console.print(view)
    return capture.get()


def _status() -> LineStatus:
    sockets = tuple(
        SocketStatus(socket=str(k), operations=("functional",), serial=f"GM-8301-000{k}", leased_since_s=90.0)
        for k in (1, 2)
    )
    station = StationStatus(
        station="functional-1", state="ready", incarnation=1, sockets=sockets, last_heard_s=99.0
    )
    functional = OperationYield(
        operation="functional",
        first_attempts=2,
        first_passes=1,
        first_unit_faults=1,
        attempts=2,
        passes=1,
        fpy=0.5,
        fpy_unit=0.5,
    )
    alarm = Alarm(
        raised_at_s=95.0,
        alarm="station_silent",
        subject="functional-1",
        text="Station functional-1 is not heard of any more.",
        template="Station {station} is not heard of any more.",
        values={"station": "functional-1"},
    )
    return LineStatus(
        line="demo",
        at_s=100.0,
        stations=(station,),
        units=(),
        queue_lengths={"functional": 3},
        yield_report=YieldReport(operations=(functional,), stations=(), dispositions={}),
        alarms=(alarm,),
        attempts_recorded=2,
        records_set_aside=0,
        duplicates_ignored=0,
        finished=False,
    )


@pytest.mark.parametrize("width", [80, 120])
def test_a_socket_is_never_broken_over_two_lines(width: int) -> None:
    shown = _text(live_view(_status(), 12.0, [], ["functional-1"]), width)
    assert all(f"[{k}] GM-8301-000{k} 10 s" in shown for k in (1, 2))
    assert all(len(line) <= width for line in shown.splitlines())


def test_a_station_that_nobody_has_heard_of_is_starting() -> None:
    shown = _text(live_view(_status(), 12.0, [], ["functional-1", "turntable-1"]), 100)
    assert any("turntable-1" in line and "starting" in line for line in shown.splitlines())


def test_a_yield_shows_on_how_few_it_rests() -> None:
    assert "functional 50.0% (1/2)" in _text(live_view(_status(), 12.0, [], []), 100)


def test_the_line_is_chinese_throughout_when_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.language._chosen", ["zh"])
    shown = _text(live_view(_status(), 12.0, [], ["functional-1", "turntable-1"]), 100)
    assert "测试站 functional-1 已失去联系。" in shown
    assert not {"Station", "ready", "FPY", "Waiting", "starting"} & set(shown.replace("│", " ").split())

"""The eyes of a run: what they refuse to look at."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cli.line_layout import LineLayout
from cli.line_watch import LineWatch
from cli.process_group import ProcessGroup
from protocol.attempts import UnitIdentity
from protocol.errors import Fault, TestloomError
from protocol.frozen_model import FrozenModel
from protocol.line_views import LineStatus, OrderUnits, UnitStatus, YieldReport
from protocol.outcomes import Disposition


class _LineOfAnotherRun:
    """Answers as a coordinator does whose database has been used before."""

    def __init__(self) -> None:
        self.asked: list[FrozenModel] = []

    def ask(self, request: FrozenModel, expected: type, patience_s: float) -> FrozenModel:
        self.asked.append(request)
        unit = UnitIdentity(serial="GM-1", product="gnc_module", lot="L1")
        return LineStatus(
            line="demo",
            at_s=0.0,
            stations=(),
            units=(UnitStatus(unit=unit, disposition=Disposition.SHIP),),
            queue_lengths={},
            yield_report=YieldReport(operations=(), stations=(), dispositions={}),
            alarms=(),
            attempts_recorded=1,
            records_set_aside=0,
            duplicates_ignored=0,
            finished=True,
        )


def test_a_database_of_another_run_is_refused_and_nothing_is_ordered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout = LineLayout(
        line="demo",
        directory=tmp_path,
        seed=1,
        functional_stations=1,
        sockets_per_station=1,
        turntables=1,
        router_endpoint="tcp/127.0.0.1:1",
        dashboard_port=None,
        database_url="sqlite:///used.db",
    )
    line = _LineOfAnotherRun()

    @contextmanager
    def client(*_: object) -> Iterator[_LineOfAnotherRun]:
        yield line

    monkeypatch.setattr("cli.line_watch.line_client", client)
    watch = LineWatch(layout, ProcessGroup(tmp_path), quiet=True)
    with pytest.raises(TestloomError, match="another run") as refused:
        watch.order(1, 5.0)
    assert refused.value.fault is Fault.OPERATOR
    assert not [request for request in line.asked if isinstance(request, OrderUnits)]

"""Watching a line whose processes die, from its first moment."""

import os
import signal
from pathlib import Path

import pytest

from cli.line_layout import LineLayout
from cli.line_watch import LineWatch
from cli.process_group import ProcessGroup
from protocol.adapters.zenoh_link import IncomingQuery, open_link, open_router
from protocol.errors import Fault
from protocol.keys import coordinator_queryable
from protocol.line_views import CLIENT_REQUEST, LineStatus, OrderAccepted, OrderUnits, UnitStatus, YieldReport
from protocol.outcomes import Disposition

FINISHED = LineStatus(
    line="t",
    at_s=0.0,
    stations=(),
    units=(),
    queue_lengths={},
    yield_report=YieldReport(operations=(), stations=(), dispositions={}),
    alarms=(),
    attempts_recorded=0,
    records_set_aside=0,
    duplicates_ignored=0,
    finished=True,
)


@pytest.fixture
def layout(tmp_path: Path, free_port: int) -> LineLayout:
    return LineLayout(
        line="t",
        directory=tmp_path,
        seed=1,
        functional_stations=1,
        sockets_per_station=1,
        turntables=1,
        router_endpoint=f"tcp/127.0.0.1:{free_port}",
        dashboard_port=None,
        database_url=f"sqlite:///{tmp_path / 'coordinator.sqlite'}",
    )


def test_a_router_that_dies_before_anybody_has_reached_it_is_started_again(
    tmp_path: Path, layout: LineLayout
) -> None:
    group = ProcessGroup(tmp_path)
    watch = LineWatch(layout, group, quiet=True)
    try:
        for specification in layout.processes():
            if specification.role in ("router", "coordinator"):
                group.start(specification)
        os.kill(group.pids()["router"], signal.SIGKILL)
        assert len(watch.order(1, timeout_s=60.0).units) == 1
        assert group.restarts() == {"router": 1}
    finally:
        group.stop()


def test_a_coordinator_that_lost_its_database_is_given_the_order_again(
    tmp_path: Path, layout: LineLayout
) -> None:
    orders: list[OrderUnits] = []

    def answer(query: IncomingQuery) -> None:
        asked = CLIENT_REQUEST.validate_json(query.payload)
        if isinstance(asked, OrderUnits):
            orders.append(asked)
            reply = OrderAccepted(order_id=asked.order_id, accepted=2)
        else:  # after the first order the database is lost
            again = len(orders) > 1
            units = tuple(UnitStatus(unit=unit, disposition=Disposition.SHIP) for unit in orders[0].units)
            changes = {"finished": again, "units": units if again else ()}
            reply = FINISHED.model_copy(update=changes)
        query.reply(reply.model_dump_json().encode())

    watch = LineWatch(layout, ProcessGroup(tmp_path), quiet=True)
    with open_router(layout.router_endpoint), open_link(layout.router_endpoint) as link:
        link.serve(coordinator_queryable("t", "request"), answer)
        order = watch.order(2, 30.0)
        assert len(watch.until_finished(30.0).units) == 2
    assert orders == [order, order]


def test_a_coordinator_that_cannot_write_now_is_waited_for(
    tmp_path: Path, layout: LineLayout, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[bytes] = []

    def answer(query: IncomingQuery) -> None:
        asked.append(query.payload)
        if len(asked) < 3:
            query.reject("The database is locked by another program.", Fault.TESTLOOM, "close it.")
        else:
            query.reply(FINISHED.model_dump_json().encode())

    watch = LineWatch(layout, ProcessGroup(tmp_path), quiet=False)
    with open_router(layout.router_endpoint), open_link(layout.router_endpoint) as link:
        link.serve(coordinator_queryable("t", "request"), answer)
        assert watch.until_finished(30.0).finished
    assert capsys.readouterr().out.count("The database is locked by another program. close it.") == 1

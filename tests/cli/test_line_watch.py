"""Watching a line whose processes die, from its first moment."""

import os
import signal
from pathlib import Path

from cli.line_layout import LineLayout
from cli.line_watch import LineWatch
from cli.process_group import ProcessGroup


def test_a_router_that_dies_before_anybody_has_reached_it_is_started_again(
    tmp_path: Path, free_port: int
) -> None:
    layout = LineLayout(
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

"""A bench that comes back with other addresses gets new runners; another bench gets none."""

import json
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol.attempts import Lease
from protocol.bench_description import BenchDescription
from protocol.errors import Fault, TestloomError
from protocol.plans import Plan
from protocol.station_messages import SocketProgress
from stations.agent.bench_watch import BenchWatch, read_description
from stations.drivers.arbitration import Arbitration
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult
from stations.sequencing.safe_state import SafeState


class StandInRunner:
    def __init__(
        self, bench: BenchDescription, socket: str, arbitration: Arbitration, recordings_dir: Path
    ) -> None:
        self.bench, self.arbitration, self.closed = bench, arbitration, False

    def run(
        self, plan: Plan, lease: Lease, on_progress: Callable[[SocketProgress], None], abort: AbortFlag
    ) -> SequenceResult:
        raise NotImplementedError

    def make_safe(self) -> SafeState:
        raise NotImplementedError

    def close(self) -> None:
        self.closed = True


def describe(path: Path, *, port: int, identity: str = "FIX-1", control: str | None = None) -> None:
    path.write_text(
        json.dumps(
            {
                "bench": "bench-1",
                "bench_identity": identity,
                "operations": ["functional"],
                "control": control,
                "sockets": [{"socket": name, "unit_link": f"socket://127.0.0.1:{port}"} for name in "12"],
                "power_supply": "TCPIP::127.0.0.1::9::SOCKET",
                "site": {"latitude_deg": 34.2, "gravity_m_s2": 9.797},
            }
        )
    )


def test_runners_follow_the_description(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    describe(path, port=1)
    watch = BenchWatch(path, read_description(path), tmp_path, StandInRunner)
    first, other = watch.runner("1"), watch.runner("2")
    assert isinstance(first, StandInRunner)
    assert isinstance(other, StandInRunner)
    assert watch.runner("1") is first
    assert first.arbitration is other.arbitration

    describe(path, port=2)
    second = watch.runner("1")
    assert isinstance(second, StandInRunner)
    assert (first.closed, other.closed) == (True, False)  # socket 2 may be in mid-sequence
    assert second.bench.sockets[0].unit_link.endswith(":2")
    other_second = watch.runner("2")
    assert isinstance(other_second, StandInRunner)
    assert other_second.arbitration is second.arbitration is not first.arbitration
    watch.close()
    assert second.closed


def test_another_bench_and_no_bench_are_refused_with_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    describe(path, port=1)
    watch = BenchWatch(path, read_description(path), tmp_path, StandInRunner)
    describe(path, port=1, identity="FIX-2")
    with pytest.raises(TestloomError, match="is 'FIX-2' now") as caught:
        watch.runner("1", lambda: False)
    assert caught.value.fault is Fault.STATION
    for content in ("{", "[]", '{"bench": 1}'):
        path.write_text(content)
        with pytest.raises(TestloomError, match="not the description of a bench") as caught:
            watch.runner("1", lambda: False)
        assert str(path) in caught.value.where
    path.unlink()
    with pytest.raises(TestloomError, match="cannot be read"):
        watch.runner("1", lambda: False)


def test_a_bench_that_died_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stations.agent.bench_watch.BENCH_POLL_S", 0.001)
    path = tmp_path / "bench.json"
    with socket.create_server(("127.0.0.1", 0)) as reserved:
        dead = f"127.0.0.1:{reserved.getsockname()[1]}"
    describe(path, port=1, control=dead)
    watch = BenchWatch(path, read_description(path), tmp_path, StandInRunner)
    with pytest.raises(TestloomError, match="did not come back within 0 s") as caught:
        watch.runner("1", lambda: False)
    assert caught.value.fault is Fault.STATION

    with socket.create_server(("127.0.0.1", 0)) as alive:

        def started_again() -> bool:
            describe(path, port=2, control=f"127.0.0.1:{alive.getsockname()[1]}")
            return True

        runner = watch.runner("1", started_again)
    assert isinstance(runner, StandInRunner)
    assert runner.bench.sockets[0].unit_link.endswith(":2")

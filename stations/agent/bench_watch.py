"""The bench as its description file says now: a bench that was restarted has other addresses."""

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from pydantic import ValidationError

from protocol.attempts import Lease
from protocol.bench_description import BenchDescription
from protocol.errors import Fault, TestloomError
from protocol.frozen_model import first_problem
from protocol.plans import Plan
from protocol.station_messages import SocketProgress
from stations.drivers.arbitration import Arbitration
from stations.interruptions import AbortFlag
from stations.sequencing.runner import SequenceResult, SequenceRunner
from stations.sequencing.safe_state import SafeState

BENCH_WAIT_S = 60.0
BENCH_POLL_S = 0.1
BENCH_RETURN_S = 30.0
"""A bench that died is started again within this; a sequence waits for it rather than being lost to it."""
PROBE_TIMEOUT_S = 1.0
MAX_DESCRIPTION_BYTES = 1_000_000


class Runner(Protocol):
    """Runs sequences on one socket: `SequenceRunner`, or a stand-in in tests."""

    def run(
        self, plan: Plan, lease: Lease, on_progress: Callable[[SocketProgress], None], abort: AbortFlag
    ) -> SequenceResult: ...

    def make_safe(self) -> SafeState: ...

    def close(self) -> None: ...


RunnerFactory = Callable[[BenchDescription, str, Arbitration, Path], Runner]


def read_description(path: Path) -> BenchDescription:
    """The bench's description.

    Raises:
        TestloomError: there is no such file, or it does not describe a bench.
    """
    try:
        text = path.read_text(encoding="utf-8")
        if len(text) > MAX_DESCRIPTION_BYTES:
            raise ValueError(f"more than {MAX_DESCRIPTION_BYTES} characters")
        return BenchDescription.model_validate_json(text)
    except OSError as error:
        raise TestloomError(
            f"The description of the bench cannot be read: {error.strerror}.",
            where=str(path),
            fault=Fault.STATION,
            remedy="start the bench (`testloom bench`), or write the description of your hardware.",
        ) from None
    except ValidationError as error:
        raise _not_a_description(path, first_problem(error)) from None
    except (ValueError, UnicodeDecodeError) as error:
        raise _not_a_description(path, str(error)) from None


def is_there(description: BenchDescription) -> bool:
    """Whether the bench can be reached: an emulated one by its control channel; hardware tells by itself."""
    if description.control is None:
        return True
    host, _, port = description.control.rpartition(":")
    try:
        socket.create_connection((host, int(port)), PROBE_TIMEOUT_S).close()
    except (OSError, ValueError):
        return False
    return True


def await_description(path: Path, keep_waiting: Callable[[], bool]) -> BenchDescription:
    """The description, once a bench that is still starting has written it. Raises as above."""
    deadline = time.monotonic() + BENCH_WAIT_S
    while not path.exists() and keep_waiting() and time.monotonic() < deadline:
        time.sleep(BENCH_POLL_S)
    return read_description(path)


class BenchWatch:
    """Runners for the sockets of a bench, made anew when the bench's description has changed.

    Safe to use from the sockets' threads; the runner of a socket belongs to the socket's thread.
    """

    def __init__(
        self,
        path: Path,
        description: BenchDescription,
        recordings_dir: Path,
        make_runner: RunnerFactory = SequenceRunner,
    ) -> None:
        self._path = path
        self._identity = description.bench_identity
        self._recordings_dir = recordings_dir
        self._make_runner = make_runner
        self._lock = threading.Lock()
        self._arbitration = Arbitration(description)
        self._runners: dict[str, tuple[BenchDescription, Runner]] = {}

    def runner(self, socket: str, keep_waiting: Callable[[], bool] = lambda: True) -> Runner:
        """A runner for this socket on the bench as it is described now.

        Args:
            socket: of the bench.
            keep_waiting: looked at while a bench that is away is waited for; False: not any longer.

        Raises:
            TestloomError: the bench is away, its description cannot be read, or is that of another bench.
        """
        description = self._present_description(keep_waiting)
        if description.bench_identity != self._identity:
            raise TestloomError(
                f"The bench is '{description.bench_identity}' now; this station began on '{self._identity}'.",
                where=str(self._path),
                fault=Fault.STATION,
                remedy="restart the station, so that the line learns of the change.",
            )
        with self._lock:
            known = self._runners.get(socket)
            if known is not None and known[0] == description:
                return known[1]
            if self._arbitration.bench != description:
                self._arbitration.close()
                self._arbitration = Arbitration(description)
            if known is not None:
                known[1].close()
            runner = self._make_runner(description, socket, self._arbitration, self._recordings_dir)
            self._runners[socket] = (description, runner)
            return runner

    def _present_description(self, keep_waiting: Callable[[], bool]) -> BenchDescription:
        began = time.monotonic()
        while True:
            away: TestloomError | None = None
            try:
                description = read_description(self._path)
                if is_there(description):
                    return description
            except TestloomError as error:
                away = error
            waited_s = time.monotonic() - began
            if waited_s >= BENCH_RETURN_S or not keep_waiting():
                raise away or TestloomError(
                    f"The bench did not come back within {waited_s:.0f} s.",
                    where=str(self._path),
                    fault=Fault.STATION,
                    remedy="start the bench again; look into its log for why it ended.",
                )
            time.sleep(BENCH_POLL_S)

    def close(self) -> None:
        """Close every link."""
        with self._lock:
            for _, runner in self._runners.values():
                runner.close()
            self._runners.clear()
            self._arbitration.close()


def _not_a_description(path: Path, problem: str) -> TestloomError:
    return TestloomError(
        f"This is not the description of a bench: {problem}.",
        where=str(path),
        fault=Fault.STATION,
        remedy="correct the file, or let the bench write it again.",
    )

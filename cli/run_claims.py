"""What a run takes for itself on this machine, so that two runs stay apart: ports, a folder."""

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from protocol.addresses import LOOPBACK
from protocol.errors import Fault, TestloomError

RUNS = Path("runs")
PROCESS_TABLE = "processes.json"
MAX_RUNS_A_SECOND = 100


@contextmanager
def claimed_port(preferred: int) -> Iterator[int]:
    """`preferred` on the loopback address for the length of the block, else a free port.

    To look whether a port is free leaves a gap until the process that is to listen there does so;
    a lock closes it among runs, which would else share a router and order from each other's line.
    """
    lock = Path(tempfile.gettempdir()) / f"testloom-port-{preferred}-{os.getuid()}.lock"
    with lock.open("ab") as held:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield _any_free_port()
            return
        yield preferred if is_free(preferred) else _any_free_port()


def demanded_port(port: int, option: str) -> int:
    """A port that a person asked for.

    Raises:
        TestloomError: somebody has it.
    """
    if not is_free(port):
        raise TestloomError(
            f"The port {port} is in use.",
            where=f"{LOOPBACK}:{port}",
            fault=Fault.OPERATOR,
            remedy=f"choose another with {option}, or leave it out for a free one.",
        )
    return port


def is_free(port: int) -> bool:
    """Whether nobody listens at `port` of the loopback address."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
        return True


def claimed_folder(directory: Path | None) -> Path:
    """The run's folder, made and claimed by its table of processes; a run is never mixed into another.

    Raises:
        TestloomError: there is a run in `directory` already, or it cannot be made.
    """
    if directory is not None:
        claimed = _claim(directory.resolve())
        if claimed is None:
            raise TestloomError(
                f"The folder {directory.resolve()} holds a run already.",
                where=str(directory.resolve()),
                fault=Fault.OPERATOR,
                remedy="choose another folder with --dir, or move this one away.",
            )
        return claimed
    name = datetime.now().strftime("%Y%m%d-%H%M%S")
    for number in range(1, MAX_RUNS_A_SECOND + 1):
        claimed = _claim((RUNS / (name if number == 1 else f"{name}-{number}")).resolve())
        if claimed is not None:
            return claimed
    raise TestloomError(
        f"More than {MAX_RUNS_A_SECOND} runs began in one second.",
        where=str(RUNS.resolve()),
        fault=Fault.OPERATOR,
        remedy="choose another folder with --dir.",
    )


def _claim(chosen: Path) -> Path | None:
    """The folder with all that belongs into it, or None if it holds a run."""
    try:
        for name in ("logs", "spools", "benches", "recordings", "sealed/units"):
            (chosen / name).mkdir(parents=True, exist_ok=True)
        with (chosen / PROCESS_TABLE).open("x") as table:
            table.write("[]\n")
    except FileExistsError:
        if (chosen / PROCESS_TABLE).exists():
            return None
        raise _cannot_be_made(chosen, "a file is in its place") from None
    except OSError as error:
        raise _cannot_be_made(chosen, error.strerror or type(error).__name__) from None
    return chosen


def _cannot_be_made(chosen: Path, why: str) -> TestloomError:
    return TestloomError(
        f"The folder of the run cannot be made: {why}.",
        where=str(chosen),
        fault=Fault.OPERATOR,
        remedy="choose another folder with --dir.",
    )


def _any_free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])

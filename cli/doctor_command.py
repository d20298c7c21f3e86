"""`testloom doctor`: is this machine fit to run a line? Ports, disk, clock, permissions, libraries."""

import ctypes
import importlib.metadata
import json
import os
import resource
import shutil
import socket
import sqlite3
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.table import Table

from protocol.addresses import DASHBOARD_PORT, LOOPBACK, ROUTER_PORT
from protocol.language import say

FREE_DISK_MIN_BYTES = 2_000_000_000
FREE_DISK_FAIR_BYTES = 20_000_000_000
COMMIT_SLOW_S = 0.05
OPEN_FILES_MIN = 1024
BUILT_AT_S = 1_767_225_600.0  # 2026-01-01: a clock before this is certainly wrong
_ADJTIMEX_TIME_ERROR = 5  # TIME_ERROR of adjtimex(2): the clock is not synchronised
LIBRARIES = (
    *("eclipse-zenoh", "mcap", "nicegui", "numpy", "psycopg", "pydantic", "pyserial", "python-can"),
    *("pyvisa", "pyvisa-py", "cantools", "scipy", "sqlalchemy", "alembic", "structlog", "typer"),
)


@dataclass(frozen=True)
class Finding:
    """What one check found. `remedy` is empty when all is well."""

    check: str
    state: Literal["ok", "attention", "problem"]
    found: str
    remedy: str = ""


def doctor(
    directory: Annotated[Path, typer.Option("--dir", help=say("Where runs are to be kept."))] = Path(),
    router_port: Annotated[
        int, typer.Option(min=1, max=65535, help=say("Port of the router."))
    ] = ROUTER_PORT,
    dashboard_port: Annotated[
        int, typer.Option(min=1, max=65535, help=say("Port of the web page."))
    ] = DASHBOARD_PORT,
    as_json: Annotated[bool, typer.Option("--json", help=say("Print JSON."))] = False,
) -> None:
    checks: tuple[Callable[[], Finding], ...] = (
        _python,
        _libraries,
        lambda: _port("router", router_port, "--router-port"),
        lambda: _port("web page", dashboard_port, "--dashboard-port"),
        lambda: _disk(directory),
        lambda: _durable_commits(directory),
        _clock,
        _open_files,
        _serial_ports,
    )
    findings = [check() for check in checks]
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], ensure_ascii=False))
    else:
        _show(findings)
    if any(finding.state == "problem" for finding in findings):
        raise typer.Exit(1)


doctor.__doc__ = say("Check this machine: ports, disk, clock, permissions, libraries.")


def _python() -> Finding:
    version = ".".join(str(part) for part in sys.version_info[:3])
    if sys.version_info[:2] == (3, 11):
        return Finding(say("Python"), "ok", version)
    return Finding(say("Python"), "problem", version, say("install Python 3.11 and run `make setup`."))


def _libraries() -> Finding:
    missing: list[str] = []
    for name in LIBRARIES:
        try:
            importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    if missing:
        found = say("missing: {names}", names=", ".join(missing))
        return Finding(say("Libraries"), "problem", found, say("run `make setup`."))
    return Finding(say("Libraries"), "ok", say("{count} found", count=len(LIBRARIES)))


def _port(purpose: str, port: int, option: str) -> Finding:
    check = say("Port of the {purpose}", purpose=say(purpose))
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            return Finding(
                check,
                "attention",
                f"{port}: {error.strerror}",
                say("a line may be running already; else look for another with {option}.", option=option),
            )
    return Finding(check, "ok", say("{port} is free", port=port))


def _disk(directory: Path) -> Finding:
    check = say("Disk")
    try:
        free_bytes = shutil.disk_usage(directory).free
    except OSError as error:
        return Finding(check, "problem", f"{directory}: {error.strerror}", say("choose another --dir."))
    found = say("{free:.1f} GB free in {directory}", free=free_bytes / 1e9, directory=directory.resolve())
    if free_bytes < FREE_DISK_MIN_BYTES:
        return Finding(
            check, "problem", found, say("free some space: a spool that is full stops its station.")
        )
    if free_bytes < FREE_DISK_FAIR_BYTES:
        return Finding(check, "attention", found, say("raw data of a long run may not fit."))
    return Finding(check, "ok", found)


def _durable_commits(directory: Path) -> Finding:
    """A durable commit's time, and with it the permission to write here."""
    check = say("Durable commits")
    try:
        with tempfile.TemporaryDirectory(dir=directory) as folder:
            database = sqlite3.connect(Path(folder) / "probe.sqlite", isolation_level=None)
            database.execute("PRAGMA journal_mode = WAL")
            database.execute("PRAGMA synchronous = FULL")
            database.execute("CREATE TABLE probe (value INTEGER)")
            began_s = time.perf_counter()
            for value in range(20):
                database.execute("INSERT INTO probe VALUES (?)", (value,))
            commit_s = (time.perf_counter() - began_s) / 20
            database.close()
    except (OSError, sqlite3.Error) as error:
        return Finding(
            check, "problem", f"{directory}: {error}", say("give write permission, or choose --dir.")
        )
    found = say("{milliseconds:.2f} ms each", milliseconds=commit_s * 1e3)
    if commit_s > COMMIT_SLOW_S:
        return Finding(check, "attention", found, say("use a faster disk for spools and database."))
    return Finding(check, "ok", found)


def _clock() -> Finding:
    check = say("Clock")
    now_s = time.time()
    found = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now_s))
    if now_s < BUILT_AT_S:
        return Finding(
            check, "problem", found, say("set the clock: incarnations and records carry its time.")
        )
    if sys.platform == "linux":
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(256))
        if state == _ADJTIMEX_TIME_ERROR:
            return Finding(
                check,
                "attention",
                say("{time}, not synchronised", time=found),
                say("run an NTP client, so that records of stations can be compared."),
            )
    return Finding(check, "ok", found)


def _open_files() -> Finding:
    soft, _hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    state: Literal["ok", "attention"] = "ok" if soft >= OPEN_FILES_MIN else "attention"
    remedy = "" if state == "ok" else say("raise it with `ulimit -n {limit}`.", limit=OPEN_FILES_MIN)
    return Finding(say("Open files"), state, str(soft), remedy)


def _serial_ports() -> Finding:
    check = say("Serial ports")
    ports = sorted(Path("/dev").glob("ttyUSB*")) + sorted(Path("/dev").glob("ttyACM*"))
    if not ports:
        return Finding(check, "ok", say("none: emulated benches only"))
    closed = [str(port) for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if closed:
        return Finding(
            check, "problem", ", ".join(closed), say("add this user to the group dialout and log in again.")
        )
    return Finding(check, "ok", ", ".join(str(port) for port in ports))


def _show(findings: list[Finding]) -> None:
    table = Table(header_style="bold", title="testloom doctor")
    for heading in ("Check", "State", "Found", "What to do"):
        table.add_column(say(heading), overflow="fold")  # Chinese has no spaces to break a line at
    styles = {"ok": "green", "attention": "yellow", "problem": "bold red"}
    marks = {"ok": "✔", "attention": "!", "problem": "✘"}
    for finding in findings:
        state = f"[{styles[finding.state]}]{marks[finding.state]} {say(finding.state)}[/]"
        table.add_row(finding.check, state, finding.found, finding.remedy)
    Console().print(table)

"""A bench server in a thread, and a client of its own: plain sockets, nothing of the stations' drivers."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from dut_emulator.server.assembly import serve
from dut_emulator.server.configuration import BenchServerConfiguration
from protocol.bench_description import BenchDescription
from protocol.frames import Frame, FrameBlock, FrameParser, encode_frame

TIMEOUT_S = 20.0


@dataclass
class Link:
    """A counted TCP link."""

    connection: socket.socket
    name: str
    received: bytearray = field(default_factory=bytearray)
    written: int = 0
    parser: FrameParser = field(default_factory=FrameParser)
    parsed: int = 0

    def write(self, data: bytes) -> None:
        self.connection.sendall(data)
        self.written += len(data)

    def read_to(self, count: int) -> None:
        while len(self.received) < count:
            data = self.connection.recv(262_144)
            assert data, f"{self.name} was closed"
            self.received += data
        assert len(self.received) == count, f"{self.name}: more bytes than were handed over"

    def frames(self) -> list[Frame | FrameBlock]:
        new = bytes(self.received[self.parsed :])
        self.parsed = len(self.received)
        return self.parser.feed(new)


class Participant:
    """A control connection, with the links it looks after."""

    def __init__(self, address: str, name: str, *, observer: bool = False) -> None:
        host, port = address.split(":")
        self.connection = socket.create_connection((host, int(port)), timeout=TIMEOUT_S)
        self.file = self.connection.makefile("rb")
        self.links: dict[str, Link] = {}
        self.now_s = 0.0
        self.hello = self.ask(op="hello", participant=name, observer=observer)

    def send(self, **request: Any) -> None:
        self.connection.sendall(json.dumps(request).encode() + b"\n")

    def receive(self) -> dict[str, Any]:
        line = self.file.readline()
        assert line, "the bench closed the control channel"
        reply = json.loads(line)
        if reply["ok"]:
            assert reply["now_s"] >= self.now_s, "time went back"
            self.now_s = reply["now_s"]
            for link in self.links.values():
                link.read_to(reply["handed_over"][link.name])
        return reply

    def ask(self, **request: Any) -> dict[str, Any]:
        self.send(**request)
        return self.receive()

    def start_wait(self, until_s: float, wake_on: Link | None = None) -> None:
        written = {name: link.written for name, link in self.links.items()}
        above = {wake_on.name: len(wake_on.received)} if wake_on else {}
        self.send(op="wait", until_s=until_s, written=written, wake_above=above)

    def wait(self, until_s: float, wake_on: Link | None = None) -> dict[str, Any]:
        self.start_wait(until_s, wake_on)
        return self.receive()

    def open(self, url: str) -> Link:
        parts = urlsplit(url)
        connection = socket.create_connection((parts.hostname, parts.port), timeout=TIMEOUT_S)
        link = Link(connection, parse_qs(parts.query)["link"][0])
        self.links[link.name] = link
        return link

    def exchange(self, link: Link, type: int, payload: bytes = b"", within_s: float = 1.0) -> Frame:
        """Send a command and take the first reply to it."""
        link.write(encode_frame(type, 7, payload))
        return self.next_frame(link, within_s)

    def next_frame(self, link: Link, within_s: float) -> Frame:
        until_s = self.now_s + within_s
        while self.now_s < until_s:
            self.wait(until_s, link)
            for frame in link.frames():
                assert isinstance(frame, Frame)
                return frame
        raise AssertionError(f"nothing came on {link.name} within {within_s} s of bench time")

    def close(self) -> None:
        for link in self.links.values():
            link.connection.close()
        self.file.close()
        self.connection.close()


class LineClient:
    """One command a line, answers a line: instruments and stands without any library."""

    def __init__(self, address: str) -> None:
        parts = address.split("::") if address.startswith("TCPIP") else ["", *address.split(":")]
        self.connection = socket.create_connection((parts[1], int(parts[2])), timeout=TIMEOUT_S)
        self.file = self.connection.makefile("rb")

    def query(self, line: str) -> str:
        self.connection.sendall(line.encode() + b"\n")
        return self.file.readline().decode().rstrip("\n")

    def command(self, line: str) -> str:
        """A command, done before this returns; the oldest error."""
        self.connection.sendall(line.encode() + b"\n")
        assert self.query("*OPC?") == "1"
        return self.query("SYST:ERR?")

    def close(self) -> None:
        self.file.close()
        self.connection.close()


@dataclass
class RunningBench:
    """A bench in a thread of its own."""

    description: BenchDescription
    configuration: BenchServerConfiguration
    stop: Callable[[], None]
    closers: list[Callable[[], None]] = field(default_factory=list)

    def participant(self, name: str = "test", *, observer: bool = False) -> Participant:
        assert self.description.control is not None
        participant = Participant(self.description.control, name, observer=observer)
        self.closers.append(participant.close)
        return participant

    def instrument(self, address: str | None) -> LineClient:
        assert address is not None
        client = LineClient(address)
        self.closers.append(client.close)
        return client


BenchFactory = Callable[..., RunningBench]


@pytest.fixture
def start_bench(tmp_path: Path) -> Iterator[BenchFactory]:
    """Start benches; all are stopped at the end, and none may have died meanwhile."""
    running: list[RunningBench] = []

    def start(**options: Any) -> RunningBench:
        name = options.pop("name", f"bench-{len(running)}")
        settings = {"units_dir": tmp_path / "units", "description": tmp_path / f"{name}.json", **options}
        settings.setdefault("kind", "socket_board")
        bench = start_in_thread(BenchServerConfiguration(name=name, **settings))
        running.append(bench)
        return bench

    yield start
    for bench in running:
        for close in bench.closers:
            close()
        bench.stop()


def start_in_thread(configuration: BenchServerConfiguration) -> RunningBench:
    loops: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = []
    errors: list[BaseException] = []

    async def main() -> None:
        loop, stop = asyncio.get_running_loop(), asyncio.Event()
        loops.append((loop, stop))
        await serve(configuration, stop)

    def run() -> None:
        try:
            asyncio.run(main())
        except BaseException as error:  # noqa: BLE001 - handed to the test's thread
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    deadline = time.monotonic() + TIMEOUT_S
    while not configuration.description.exists():
        if not thread.is_alive() and errors:
            raise errors[0]
        assert time.monotonic() < deadline, "the bench does not come up"
        thread.join(0.002)
    text = configuration.description.read_text(encoding="utf-8")

    def stop() -> None:
        loop, event = loops[0]
        loop.call_soon_threadsafe(event.set)
        thread.join(TIMEOUT_S)
        assert not thread.is_alive()
        assert not errors, errors

    return RunningBench(BenchDescription.model_validate_json(text), configuration, stop)

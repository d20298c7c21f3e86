"""The shell of the control channel: JSON lines in, replies out; what is asked is done by the bench."""

import asyncio
import itertools
from typing import Protocol, cast

from pydantic import ValidationError

from protocol.bench_control import (
    CONTROL_REQUEST,
    MAX_CONTROL_LINE_BYTES,
    BenchRefusal,
    ControlReply,
    ControlRequest,
)

MAX_QUEUED_LINES = 64
"""Requests that a connection may send ahead while a wait of its is pending."""


class ControlledBench(Protocol):
    """What the control channel needs of the bench."""

    def request(self, connection: "ControlConnection", request: ControlRequest) -> ControlReply | None:
        """Carry out a request; None when the reply comes later (a wait)."""
        ...

    def connection_lost(self, connection: "ControlConnection") -> None:
        """A participant has gone."""
        ...


class ControlConnection(asyncio.Protocol):
    """One participant's connection. Requests are answered in order, one at a time."""

    _numbers = itertools.count(1)

    def __init__(self, bench: ControlledBench) -> None:
        self.number = next(self._numbers)
        self._bench = bench
        self._rest = b""
        self._lines: list[bytes] = []
        self._waiting = False
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's signature
        self._transport = None
        self._lines.clear()
        self._bench.connection_lost(self)

    def disconnect(self) -> None:
        """The bench ends."""
        if self._transport is not None:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._lines += lines
        if len(self._rest) > MAX_CONTROL_LINE_BYTES or any(len(x) > MAX_CONTROL_LINE_BYTES for x in lines):
            self._end(f"a control line is longer than {MAX_CONTROL_LINE_BYTES} bytes")
        elif len(self._lines) > MAX_QUEUED_LINES:
            self._end(f"more than {MAX_QUEUED_LINES} requests were sent without waiting for replies")
        else:
            self._work()

    def reply(self, reply: ControlReply) -> None:
        """The answer to the pending wait."""
        self._waiting = False
        self._send(reply)
        if self._lines:
            asyncio.get_running_loop().call_soon(self._work)

    def _work(self) -> None:
        while self._lines and not self._waiting:
            line = self._lines.pop(0)
            if not line.strip():
                continue
            try:
                request = CONTROL_REQUEST.validate_json(line)
            except ValidationError as error:
                self._send(_malformed(error))
                continue
            self._waiting = True
            reply = self._bench.request(self, request)
            if reply is not None:
                self._waiting = False
                self._send(reply)

    def _send(self, reply: ControlReply) -> None:
        if self._transport is not None:
            self._transport.write(reply.model_dump_json().encode() + b"\n")

    def _end(self, what: str) -> None:
        self._lines.clear()
        self._send(BenchRefusal(what=what, remedy="connect anew and send one request at a time."))
        if self._transport is not None:
            self._transport.close()


def _malformed(error: ValidationError) -> BenchRefusal:
    first = error.errors(include_url=False, include_input=False)[0]
    place = ".".join(str(part) for part in first["loc"])
    return BenchRefusal(
        what=f"this is no control request: {place + ': ' if place else ''}{first['msg']}",
        remedy="send one JSON object a line as protocol/bench_control.py describes.",
    )

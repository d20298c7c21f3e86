"""Instruments and stands on TCP, one command a line: the shell around their pure command interpreters."""

import asyncio
from typing import Protocol, cast


class LineSession(Protocol):
    """One connection's side of an interpreter."""

    def line(self, text: str) -> str | None:
        """The answer to a line, or None when there is none."""
        ...

    def too_long(self) -> str | None:
        """The answer to a line that was too long to be taken in."""
        ...


class LineProtocol(asyncio.Protocol):
    """A connection: cuts lines, asks its session, sends answers; reads no faster than answers leave."""

    def __init__(self, session: LineSession, max_line_bytes: int) -> None:
        self._session = session
        self._max_line_bytes = max_line_bytes
        self._rest = b""
        self._skipping = False
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def disconnect(self) -> None:
        """The bench ends."""
        if self._transport is not None:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        *lines, rest = (self._rest + data).split(b"\n")
        if self._skipping and lines:
            del lines[0]
            self._skipping = False
        answers = [self._answer(line) for line in lines]
        if len(rest) > self._max_line_bytes:
            if not self._skipping:
                answers.append(self._session.too_long())
            self._skipping, rest = True, b""
        self._rest = b"" if self._skipping else rest
        reply = "".join(f"{answer}\n" for answer in answers if answer is not None)
        if reply and self._transport is not None:
            self._transport.write(reply.encode("ascii", "replace"))

    def pause_writing(self) -> None:
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        if self._transport is not None:
            self._transport.resume_reading()

    def _answer(self, line: bytes) -> str | None:
        if len(line) > self._max_line_bytes:
            return self._session.too_long()
        text = line.rstrip(b"\r").decode("latin-1").strip()
        return self._session.line(text) if text else None

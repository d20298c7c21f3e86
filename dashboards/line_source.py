"""Where the read model gets its knowledge: the coordinator over Zenoh, or a stand-in in tests."""

import os
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from pydantic import ValidationError

from protocol.adapters.zenoh_link import ZenohLink, open_link
from protocol.errors import Fault, TestloomError
from protocol.keys import all_live_keys, coordinator_key
from protocol.line_views import (
    CLIENT_REPLY,
    ClientReply,
    ClientRequest,
    GetLineStatus,
    GetUnit,
    LineStatus,
    UnitHistory,
)
from protocol.station_messages import SocketProgress

STATUS_TIMEOUT_S = 1.5
UNIT_TIMEOUT_S = 2.0
MAX_PROGRESS_WAITING = 4096
"""Live views not yet taken; older ones give way (they are never relied on)."""


class LineSource(Protocol):
    """Asks the coordinator. Blocking; `unit` may be called from several threads at once."""

    def status(self) -> LineStatus:
        """The line at this moment.

        Raises:
            TestloomError: no answer, or none that can be used.
        """
        ...

    def unit(self, serial: str) -> UnitHistory:
        """A unit's history.

        Raises:
            RequestRejectedError: the coordinator does not know the serial.
            TestloomError: no answer, or none that can be used.
        """
        ...

    def take_progress(self) -> list[SocketProgress]:
        """The live views that came since the last call, oldest first."""
        ...


ConnectLine = Callable[[Callable[[], bool]], AbstractContextManager[LineSource]]
"""Opens a source; the argument says whether to keep trying."""


class ZenohLineSource:
    """The coordinator of a line, through the router."""

    def __init__(self, link: ZenohLink, line: str) -> None:
        self._link = link
        self._key = coordinator_key(line, "request", f"dashboard-{os.getpid()}")
        self._progress: deque[SocketProgress] = deque(maxlen=MAX_PROGRESS_WAITING)
        self.unreadable_live_views = 0
        link.subscribe(all_live_keys(line), self._hand_over)

    def status(self) -> LineStatus:
        reply = self._ask(GetLineStatus(), STATUS_TIMEOUT_S)
        if not isinstance(reply, LineStatus):
            raise _unusable(f"a {reply.kind} came")
        return reply

    def unit(self, serial: str) -> UnitHistory:
        reply = self._ask(GetUnit(serial=serial), UNIT_TIMEOUT_S)
        if not isinstance(reply, UnitHistory):
            raise _unusable(f"a {reply.kind} came")
        return reply

    def take_progress(self) -> list[SocketProgress]:
        # popleft is atomic; the count is taken first, so that a flood cannot hold us here.
        return [self._progress.popleft() for _ in range(len(self._progress))]

    def _ask(self, request: ClientRequest, timeout_s: float) -> ClientReply:
        reply = self._link.ask(self._key, request.model_dump_json().encode(), timeout_s)
        try:
            return CLIENT_REPLY.validate_json(reply)
        except ValidationError as error:
            raise _unusable(str(error.errors()[0]["msg"])) from None

    def _hand_over(self, _key: str, payload: bytes) -> None:
        try:
            self._progress.append(SocketProgress.model_validate_json(payload))
        except ValidationError:
            self.unreadable_live_views += 1


def zenoh_line(line: str, router_endpoint: str) -> ConnectLine:
    """How to connect to this line through this router."""

    @contextmanager
    def connect(keep_trying: Callable[[], bool]) -> Iterator[LineSource]:
        with open_link(router_endpoint, keep_trying=keep_trying) as link:
            yield ZenohLineSource(link, line)

    return connect


def _unusable(reason: str) -> TestloomError:
    return TestloomError(
        "The coordinator's answer cannot be read.",
        fault=Fault.TESTLOOM,
        remedy="see that coordinator and dashboard are of the same version of Testloom.",
        story=(reason,),
    )

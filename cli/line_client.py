"""Questions to the coordinator from the command line: one place for retry and for the words of failure."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from protocol.adapters.zenoh_link import NoReplyError, ZenohLink, open_link
from protocol.errors import Fault
from protocol.frozen_model import FrozenModel
from protocol.keys import coordinator_key
from protocol.line_views import CLIENT_REPLY

ANSWER_TIMEOUT_S = 5.0
RETRY_S = 0.2
Reply = TypeVar("Reply", bound=FrozenModel)


class LineClient:
    """Asks the coordinator of one line."""

    def __init__(self, link: ZenohLink, line: str) -> None:
        self._link = link
        self._line = line
        self._key = coordinator_key(line, "request", f"cli-{os.getpid()}")

    def ask(self, request: FrozenModel, expected: type[Reply], patience_s: float = ANSWER_TIMEOUT_S) -> Reply:
        """The coordinator's answer; asks again while nobody answers, for `patience_s`.

        Raises:
            NoReplyError: nobody answered in that time.
            RequestRejectedError: the coordinator refused, and why.
        """
        deadline_s = time.monotonic() + patience_s
        payload = request.model_dump_json().encode()
        while True:
            try:
                answer = CLIENT_REPLY.validate_json(self._link.ask(self._key, payload, ANSWER_TIMEOUT_S))
            except NoReplyError:
                if time.monotonic() >= deadline_s:
                    raise self._coordinator_silent() from None
                time.sleep(RETRY_S)
                continue
            if not isinstance(answer, expected):
                raise TypeError(f"asked for {expected.__name__}, got {type(answer).__name__}")
            return answer

    def _coordinator_silent(self) -> NoReplyError:
        return NoReplyError(
            f"The coordinator of line '{self._line}' does not answer.",
            where=self._key,
            fault=Fault.OPERATOR,
            remedy="start it with `testloom coordinator`, or correct --line and --router.",
        )


@contextmanager
def line_client(
    line: str,
    endpoint: str,
    patience_s: float = ANSWER_TIMEOUT_S,
    keep_trying: Callable[[], bool] = lambda: True,
) -> Iterator[LineClient]:
    """A client of the line for the length of a block; `keep_trying` as for `open_link`."""
    with open_link(endpoint, give_up_after_s=patience_s, keep_trying=keep_trying) as link:
        yield LineClient(link, line)

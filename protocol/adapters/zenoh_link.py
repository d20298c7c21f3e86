"""A process's link to the fabric: queries with replies, live publications, liveliness.

Why it is so, in short: a `put` that returned proves nothing, so whatever must not be lost is asked
and answered; an empty list of replies is a failure; callbacks only hand over (a plain callback left
open hangs the interpreter at exit), so sessions live in a `with` block; shared memory, multicast
scouting and gossip are off, end points are explicit.
"""

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import zenoh

from protocol.errors import Fault, TestloomError
from protocol.station_messages import RequestRejected

ASK_TIMEOUT_S = 2.0
OPEN_TIMEOUT_S = 30.0
OPEN_RETRY_S = 0.3
OPEN_ATTEMPT_TIMEOUT_MS = 1500
LIVELINESS_LEASE_MS = 1500
RECONNECT_PERIOD_MAX_MS = 500
MAX_PAYLOAD_BYTES = 16_000_000


class NoReplyError(TestloomError):
    """Nobody answered in time: the router, or the one who should answer, is away. Try again."""


class RequestRejectedError(TestloomError):
    """The other side answered that it will not do it, and why."""


class IncomingQuery:
    """A query to be answered exactly once, from any thread: `reply` or `reject`."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
        self.payload = query.payload.to_bytes() if query.payload is not None else b""

    def reply(self, payload: bytes) -> None:
        """Answer and close. A querier that has gone away is no error: it will ask again."""
        with self._query as query, suppress(zenoh.ZError):
            query.reply(self.key, payload)

    def reject(self, what: str, fault: Fault, remedy: str = "") -> None:
        """Answer with an error that says what is wrong, whose fault it is and what to do."""
        rejection = RequestRejected(what=what, fault=fault.value, remedy=remedy)
        with self._query as query, suppress(zenoh.ZError):
            query.reply_err(rejection.model_dump_json().encode())


class ZenohLink:
    """One open session. Make it with `open_link`."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._declared: list[Any] = []  # a dropped reference is an undeclared token

    def ask(self, key: str, payload: bytes, timeout_s: float = ASK_TIMEOUT_S) -> bytes:
        """The first good reply to a query.

        Raises:
            NoReplyError: no reply within `timeout_s`.
            RequestRejectedError: the other side answered with an error.
        """
        rejection: bytes | None = None
        try:
            replies = self._session.get(
                key,
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.BEST_MATCHING,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            for reply in replies:
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
                if reply.err is not None:
                    rejection = reply.err.payload.to_bytes()
        except zenoh.ZError as error:
            raise _no_reply(key, str(error)) from None
        if rejection is None:
            raise _no_reply(key, "no reply")
        raise _rejected(key, rejection)

    def serve(self, key_expression: str, on_query: Callable[[IncomingQuery], None]) -> None:
        """Answer queries. `on_query` runs on the link's thread: it hands over and returns at once."""

        def hand_over(query: zenoh.Query) -> None:
            on_query(IncomingQuery(query))

        callback = zenoh.handlers.Callback(hand_over, indirect=False)
        self._declared.append(self._session.declare_queryable(key_expression, callback, complete=True))

    def publish(self, key: str, payload: bytes) -> None:
        """A live view: may be lost, never blocks."""
        with suppress(zenoh.ZError):
            self._session.put(key, payload, congestion_control=zenoh.CongestionControl.DROP)

    def subscribe(self, key_expression: str, on_sample: Callable[[str, bytes], None]) -> None:
        """Live views. `on_sample` runs on the link's thread: it hands over and returns at once."""

        def hand_over(sample: zenoh.Sample) -> None:
            on_sample(str(sample.key_expr), sample.payload.to_bytes())

        callback = zenoh.handlers.Callback(hand_over, indirect=False)
        self._declared.append(self._session.declare_subscriber(key_expression, callback))

    def declare_alive(self, key: str) -> None:
        """Show a liveliness token until the session closes or the process dies."""
        self._declared.append(self._session.liveliness().declare_token(key))

    def watch_alive(self, key_expression: str, on_change: Callable[[str, bool], None]) -> None:
        """Tokens that are there and all changes: `on_change(key, alive)`, to be taken as a set."""

        def hand_over(sample: zenoh.Sample) -> None:
            on_change(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        callback = zenoh.handlers.Callback(hand_over, indirect=False)
        self._declared.append(
            self._session.liveliness().declare_subscriber(key_expression, callback, history=True)
        )


@contextmanager
def open_link(
    endpoint: str,
    *,
    give_up_after_s: float = OPEN_TIMEOUT_S,
    keep_trying: Callable[[], bool] = lambda: True,
) -> Iterator[ZenohLink]:
    """A link to the router at `endpoint` (such as tcp/127.0.0.1:7447); waits for the router to come.

    Args:
        endpoint: a Zenoh locator.
        give_up_after_s: how long to try; a lost router is reconnected to for ever after.
        keep_trying: looked at before each attempt; False gives up at once.

    Raises:
        NoReplyError: the router did not answer in that time.
        TestloomError: `endpoint` is no locator.
    """
    configuration = _client_configuration(endpoint)
    deadline = time.monotonic() + give_up_after_s
    while True:
        try:
            session = zenoh.open(configuration)
            break
        except zenoh.ZError as error:
            if time.monotonic() >= deadline or not keep_trying():
                raise NoReplyError(
                    f"No Zenoh router answers at {endpoint}.",
                    where=endpoint,
                    fault=Fault.TESTLOOM,
                    remedy="start it with `testloom router`, or correct --router.",
                    story=(_in_short(error),),
                ) from None
            time.sleep(OPEN_RETRY_S)
    with session:
        yield ZenohLink(session)


@contextmanager
def open_router(endpoint: str) -> Iterator[None]:
    """Run a router in this process for as long as the block lasts.

    Raises:
        TestloomError: it cannot listen at `endpoint`; most often the port is in use.
    """
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"router"')
    _insert_endpoint(configuration, "listen/endpoints", endpoint)
    configuration.insert_json5("listen/exit_on_failure", "true")
    _closed_to_the_outside(configuration)
    try:
        session = zenoh.open(configuration)
    except zenoh.ZError as error:
        raise TestloomError(
            f"The router cannot listen at {endpoint}: the port is in use, or the address is not ours.",
            where=endpoint,
            fault=Fault.OPERATOR,
            remedy="stop what uses the port, or choose another with --listen.",
            story=(_in_short(error),),
        ) from None
    with session:
        yield


def _client_configuration(endpoint: str) -> zenoh.Config:
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    _insert_endpoint(configuration, "connect/endpoints", endpoint)
    configuration.insert_json5("connect/timeout_ms", str(OPEN_ATTEMPT_TIMEOUT_MS))
    configuration.insert_json5(
        "connect/retry",
        json.dumps(
            {
                "period_init_ms": 100,
                "period_max_ms": RECONNECT_PERIOD_MAX_MS,
                "period_increase_factor": 1.5,
            }
        ),
    )
    configuration.insert_json5("transport/link/tx/lease", str(LIVELINESS_LEASE_MS))
    _closed_to_the_outside(configuration)
    return configuration


def _insert_endpoint(configuration: zenoh.Config, setting: str, endpoint: str) -> None:
    try:
        configuration.insert_json5(setting, json.dumps([endpoint]))
    except zenoh.ZError:
        raise TestloomError(
            f"'{endpoint}' is no Zenoh locator.",
            where=endpoint,
            fault=Fault.OPERATOR,
            remedy="write protocol, host and port, as in tcp/127.0.0.1:7447.",
        ) from None


def _in_short(error: zenoh.ZError) -> str:
    """Zenoh's own words, without the places in its source that it adds."""
    return re.sub(r"\s+at /\S+?\.rs:\d+\.?", "", str(error))


def _closed_to_the_outside(configuration: zenoh.Config) -> None:
    configuration.insert_json5("scouting/multicast/enabled", "false")
    configuration.insert_json5("scouting/gossip/enabled", "false")
    configuration.insert_json5("transport/shared_memory/enabled", "false")


def _no_reply(key: str, reason: str) -> NoReplyError:
    return NoReplyError(
        "Nobody answered.",
        where=key,
        fault=Fault.TESTLOOM,
        remedy="see that the router and the one who should answer are running (`testloom doctor`).",
        story=(reason,),
    )


def _rejected(key: str, payload: bytes) -> TestloomError:
    try:
        rejection = RequestRejected.model_validate_json(payload)
    except ValueError:  # Zenoh's own words, most often 'Timeout': the other side has said nothing
        return _no_reply(key, payload[:200].decode(errors="replace"))
    known = {fault.value for fault in Fault}
    fault = Fault(rejection.fault) if rejection.fault in known else Fault.TESTLOOM
    return RequestRejectedError(rejection.what, where=key, fault=fault, remedy=rejection.remedy)

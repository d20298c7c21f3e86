"""The real source over a real router on this machine: a coordinator that answers, rejects, and leaves."""

import socket
import threading

import pytest
from imagined_line import failed_then_passed, small_line

from dashboards.line_source import ZenohLineSource, zenoh_line
from protocol.adapters.zenoh_link import (
    IncomingQuery,
    NoReplyError,
    RequestRejectedError,
    open_link,
    open_router,
)
from protocol.errors import Fault, TestloomError
from protocol.keys import coordinator_queryable, station_live_key
from protocol.line_views import CLIENT_REQUEST, GetLineStatus, GetUnit, LineStatus
from protocol.station_messages import SocketProgress

pytestmark = pytest.mark.fabric

LIVE_TIMEOUT_S = 10.0
MAX_QUESTIONS = 10_000


def _free_endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


def _answer(query: IncomingQuery) -> None:
    match CLIENT_REQUEST.validate_json(query.payload):
        case GetLineStatus():
            query.reply(small_line()[0].model_dump_json().encode())
        case GetUnit(serial="GNC-0003"):
            query.reply(failed_then_passed().model_dump_json().encode())
        case GetUnit(serial="of another version"):
            query.reply(b'{"kind": "UnitHistory", "new_field": 1}')
        case GetUnit(serial=serial):
            query.reject(f"No unit '{serial}'.", Fault.OPERATOR)


def _first_status(source: ZenohLineSource) -> LineStatus:
    """A queryable is known to the asker only once its declaration has gone through the router."""
    for _ in range(MAX_QUESTIONS):
        try:
            return source.status()
        except NoReplyError:
            continue
    raise AssertionError("the coordinator never became known")


def test_status_units_and_live_views_come_through_a_router() -> None:
    endpoint = _free_endpoint()
    with open_router(endpoint), zenoh_line("imagined", endpoint)(lambda: True) as source:
        assert isinstance(source, ZenohLineSource)
        with pytest.raises(NoReplyError):
            source.status()
        with open_link(endpoint) as coordinator:
            coordinator.serve(coordinator_queryable("imagined", "request"), _answer)
            assert _first_status(source) == small_line()[0]
            assert source.unit("GNC-0003") == failed_then_passed()
            with pytest.raises(RequestRejectedError, match="No unit 'nobody'"):
                source.unit("nobody")
            with pytest.raises(TestloomError, match="cannot be read"):
                source.unit("of another version")
            view = SocketProgress(station="s", socket="a", serial="GNC-1", step="can")
            assert _received_after_publishing(coordinator, source, view) == view
        with pytest.raises(NoReplyError):
            source.status()


def _received_after_publishing(station, source: ZenohLineSource, view: SocketProgress) -> SocketProgress:
    """Live views may be lost: publish until one has come. The unreadable ones before it are counted only."""
    key = station_live_key("imagined", "s", "a")
    pause = threading.Event()
    for _ in range(int(LIVE_TIMEOUT_S / 0.02)):
        station.publish(key, b"not a view")
        station.publish(key, view.model_dump_json().encode())
        pause.wait(0.02)
        if received := source.take_progress():
            assert source.unreadable_live_views > 0
            return received[0]
    raise AssertionError("no live view came")

"""Questions over the link: a good answer, a refusal, and silence, each told apart."""

from collections.abc import Iterator

import pytest

from protocol.adapters.zenoh_link import (
    IncomingQuery,
    NoReplyError,
    RequestRejectedError,
    ZenohLink,
    open_link,
    open_router,
)
from protocol.errors import Fault

KEY = "testloom/t/coordinator/request/x"


@pytest.fixture
def links(free_port: int) -> Iterator[tuple[ZenohLink, ZenohLink]]:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with open_router(endpoint), open_link(endpoint) as asking, open_link(endpoint) as answering:
        yield asking, answering


def test_an_answer_and_a_refusal_come_through(links: tuple[ZenohLink, ZenohLink]) -> None:
    asking, answering = links

    def answer(query: IncomingQuery) -> None:
        if query.payload == b"good":
            query.reply(b"yes")
        else:
            query.reject("No such unit.", Fault.OPERATOR, "look at its label.")

    answering.serve(KEY, answer)
    assert asking.ask(KEY, b"good") == b"yes"
    with pytest.raises(RequestRejectedError, match="No such unit") as caught:
        asking.ask(KEY, b"bad")
    assert (caught.value.fault, caught.value.remedy) == (Fault.OPERATOR, "look at its label.")


def test_one_who_is_there_and_does_not_answer_has_not_refused(links: tuple[ZenohLink, ZenohLink]) -> None:
    """Zenoh says 'Timeout' in an error reply of its own, as for a process that stands still."""
    asking, answering = links
    held: list[IncomingQuery] = []
    answering.serve(KEY, held.append)
    with pytest.raises(NoReplyError):
        asking.ask(KEY, b"anybody?", timeout_s=0.3)
    assert len(held) == 1

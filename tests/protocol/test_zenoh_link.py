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
from protocol.errors import Fault, TestloomError

KEY = "testloom/t/coordinator/request/x"
PROBE = "testloom/t/coordinator/request/probe"
MAX_PROBES = 10_000


@pytest.fixture
def links(free_port: int) -> Iterator[tuple[ZenohLink, ZenohLink]]:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with open_router(endpoint), open_link(endpoint) as asking, open_link(endpoint) as answering:
        yield asking, answering


def _until_reachable(asking: ZenohLink, answering: ZenohLink) -> None:
    """A queryable is known to the asker only once its declaration has gone through the router.

    Declarations of one session travel in order: when the probe answers, those before it are known.
    """
    answering.serve(PROBE, lambda query: query.reply(b"here"))
    for _ in range(MAX_PROBES):
        try:
            assert asking.ask(PROBE, b"") == b"here"
            return
        except NoReplyError:
            continue
    raise AssertionError("the queryable never became known")


def test_an_answer_and_a_refusal_come_through(links: tuple[ZenohLink, ZenohLink]) -> None:
    asking, answering = links

    def answer(query: IncomingQuery) -> None:
        if query.payload == b"good":
            query.reply(b"yes")
        else:
            query.reject("No such unit.", Fault.OPERATOR, "look at its label.")

    answering.serve(KEY, answer)
    _until_reachable(asking, answering)
    assert asking.ask(KEY, b"good") == b"yes"
    with pytest.raises(RequestRejectedError, match="No such unit") as caught:
        asking.ask(KEY, b"bad")
    assert (caught.value.fault, caught.value.remedy) == (Fault.OPERATOR, "look at its label.")


def test_one_who_is_there_and_does_not_answer_has_not_refused(links: tuple[ZenohLink, ZenohLink]) -> None:
    """Zenoh says 'Timeout' in an error reply of its own, as for a process that stands still."""
    asking, answering = links
    held: list[IncomingQuery] = []
    answering.serve(KEY, held.append)
    _until_reachable(asking, answering)
    with pytest.raises(NoReplyError):
        asking.ask(KEY, b"anybody?", timeout_s=0.3)
    assert len(held) == 1


@pytest.mark.parametrize("word", ["banana", ""])
def test_a_word_that_is_no_locator_is_the_callers_mistake(word: str) -> None:
    with pytest.raises(TestloomError, match="is no Zenoh locator") as raised, open_link(word):
        pass
    assert raised.value.fault is Fault.OPERATOR
    with pytest.raises(TestloomError, match="is no Zenoh locator"), open_router(word):
        pass


def test_a_port_in_use_is_told_without_the_places_in_zenohs_source(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    refused = pytest.raises(TestloomError, match="cannot listen")
    with open_router(endpoint), refused as raised, open_router(endpoint):
        pass
    assert "in use" in " ".join(raised.value.story)
    assert ".rs" not in " ".join(raised.value.story)

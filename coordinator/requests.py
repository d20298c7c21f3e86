"""Requests from the fabric: what is asked, and what of it can be understood before the core sees it."""

# pyright: strict

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from pydantic import ValidationError

from protocol.errors import Fault, TestloomError
from protocol.frozen_model import first_problem
from protocol.keys import CoordinatorVerb, checked_name, sender_of
from protocol.line_views import CLIENT_REQUEST, ClientRequest
from protocol.station_messages import STATION_REQUEST, RegisterStation, StationRequest, SubmitRecords

MAX_FENCE = 2**53
"""Fences beyond this do not survive a database or a JSON reader."""


class Query(Protocol):
    """A request from the fabric, to be answered once."""

    @property
    def key(self) -> str: ...
    @property
    def payload(self) -> bytes: ...
    def reply(self, payload: bytes) -> None: ...
    def reject(self, what: str, fault: Fault, remedy: str = "") -> None: ...


@dataclass(frozen=True, slots=True)
class Request:
    """A query on one of the coordinator's verbs."""

    verb: CoordinatorVerb
    query: Query


class NotUnderstood(Exception):
    """A request that is no message, or says two things at once. The text says where, without a full stop."""


def understood(request: Request) -> ClientRequest | StationRequest:
    """The message in a request.

    Raises:
        NotUnderstood: it is none, speaks for another station, or names what cannot be stored.
    """
    query = request.query
    try:
        if request.verb == "request":
            return CLIENT_REQUEST.validate_json(query.payload)
        message = STATION_REQUEST.validate_json(query.payload)
    except ValidationError as error:
        raise NotUnderstood(first_problem(error)) from None
    if message.station != sender_of(query.key):
        raise NotUnderstood(f"{sender_of(query.key)} speaks for {message.station}")
    if isinstance(message, RegisterStation):
        _check_names(message)
        _check_fences((message.newest_fence, *(lease.fence for lease in message.held)))
    elif isinstance(message, SubmitRecords):
        _check_fences(spooled.record.lease.fence for spooled in message.records)
    return message


def _check_names(registration: RegisterStation) -> None:
    try:
        checked_name(registration.station, "station")
        for description in registration.sockets:
            checked_name(description.socket, "socket")
    except TestloomError as error:
        raise NotUnderstood(error.what.rstrip(".")) from None


def _check_fences(fences: Iterable[int]) -> None:
    for fence in fences:
        if fence > MAX_FENCE:
            raise NotUnderstood(f"no line has given out {fence} leases")

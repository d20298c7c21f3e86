# pyright: strict
"""What a socket shows, from what the coordinator and its station say of it. Pure.

First match wins:

    the station is refused                             → refused
    the station is silent                              → silent
    leased, live outcome FAIL of this unit             → failed      (bad news is shown at once)
    leased, live outcome ERROR, ABORTED, TIMEOUT       → not_judged
    leased, live outcome PASS of this unit             → recording   (a PASS counts once it is kept)
    leased                                             → testing
    not leased, a station says that it runs            → testing     (the poll is behind the live view)
    not leased, the last outcome here                  → passed, failed, not_judged
    not leased                                         → free
"""

from dataclasses import dataclass, replace
from typing import Literal

from protocol.line_views import SocketStatus
from protocol.outcomes import Outcome
from protocol.station_messages import SocketProgress

SocketState = Literal["free", "testing", "recording", "passed", "failed", "not_judged", "silent", "refused"]
SocketAddress = tuple[str, str]

LIVE_VIEW_VALID_S = 5.0
"""A running view of a socket that the coordinator calls free is believed for this long."""


@dataclass(frozen=True)
class LiveSocket:
    """The last view that a station published of a socket, and how long ago that was.

    `notice`: what the station has to say of itself since then, such as a spool that is full.
    """

    progress: SocketProgress
    age_s: float
    notice: str = ""


@dataclass(frozen=True)
class SocketView:
    """One socket as shown. `seconds`: under way, or since the outcome; None when not known."""

    socket: str
    state: SocketState
    serial: str | None = None
    operation: str | None = None
    step: str | None = None
    steps_done: int = 0
    steps_total: int = 0
    outcome: Outcome | None = None
    seconds: float | None = None
    notice: str = ""


def socket_view(
    station_state: Literal["ready", "silent", "refused"],
    socket: SocketStatus,
    live: LiveSocket | None,
    at_s: float,
) -> SocketView:
    """What one socket shows: the table at the top of this module."""
    view = _without_notice(station_state, socket, live, at_s)
    return view if live is None or not live.notice else replace(view, notice=live.notice)


def _without_notice(
    station_state: Literal["ready", "silent", "refused"],
    socket: SocketStatus,
    live: LiveSocket | None,
    at_s: float,
) -> SocketView:
    leased_for_s = None if socket.leased_since_s is None else max(0.0, at_s - socket.leased_since_s)
    if station_state != "ready":
        return SocketView(socket.socket, station_state, socket.serial, socket.operation, seconds=leased_for_s)
    if socket.serial is not None:
        if (
            live is None
            or live.progress.serial != socket.serial
            or live.progress.operation != socket.operation
        ):
            return SocketView(socket.socket, "testing", socket.serial, socket.operation, seconds=leased_for_s)
        outcome = live.progress.outcome
        if outcome is None:
            return _from_live(socket.socket, "testing", live, leased_for_s)
        state = _state_of(outcome)
        return _from_live(socket.socket, "recording" if state == "passed" else state, live, live.age_s)
    if live is None or live.progress.serial is None:
        return SocketView(socket.socket, "free")
    if live.progress.outcome is not None:
        return _from_live(socket.socket, _state_of(live.progress.outcome), live, live.age_s)
    if live.age_s <= LIVE_VIEW_VALID_S:
        return _from_live(socket.socket, "testing", live, None)
    return SocketView(socket.socket, "free")


def _state_of(outcome: Outcome) -> SocketState:
    if outcome is Outcome.PASS:
        return "passed"
    return "failed" if outcome is Outcome.FAIL else "not_judged"


def _from_live(socket: str, state: SocketState, live: LiveSocket, seconds: float | None) -> SocketView:
    progress = live.progress
    return SocketView(
        socket=socket,
        state=state,
        serial=progress.serial,
        operation=progress.operation,
        step=progress.step,
        steps_done=progress.steps_done,
        steps_total=progress.steps_total,
        outcome=progress.outcome,
        seconds=seconds,
    )

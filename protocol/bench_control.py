"""The control channel of an emulated bench: time in lock-step, and the hand that loads units.

TCP, one JSON object a line each way. A connection is one *participant* of the bench's clock: a
branch of a sequence. In lock-step (pace 0) the clock stands still while any participant is at work
and jumps to the earliest awaited moment once all of them wait. At pace p > 0 it runs at p times the
wall clock. A connection that closes leaves the clock.

Bytes travel on other connections than time does. So a `wait` says how many bytes the station has
written on each link, and the bench reads up to there before time moves; and its reply says how many
bytes each link has been handed, and the station reads up to there before it goes on. Counts begin at 0 when
a link is opened.

On hardware there is no control channel: the clock is the wall clock, and a person or a handler loads
the unit.
"""

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from protocol.frozen_model import FrozenModel

MAX_CONTROL_LINE_BYTES = 65_536


class Hello(FrozenModel):
    """First line of a connection. An observer does not hold time back; it may insert, remove, inject."""

    op: Literal["hello"] = "hello"
    participant: str
    observer: bool = False


class Insert(FrozenModel):
    """Put a unit into a socket (unpowered). The bench makes the unit from its serial number."""

    op: Literal["insert"] = "insert"
    socket: str
    serial: str


class Remove(FrozenModel):
    """Take the unit out of a socket; it loses power if it had any."""

    op: Literal["remove"] = "remove"
    socket: str


class Wait(FrozenModel):
    """Let time pass until `until_s`, or until a link of `wake_above` has been handed more bytes.

    `written`: bytes the station has written so far, by link. `wake_above`: link → count of bytes
    already seen. The reply is BenchTime.
    """

    op: Literal["wait"] = "wait"
    until_s: float
    written: dict[str, int] = Field(default_factory=dict)
    wake_above: dict[str, int] = Field(default_factory=dict)


class Suspend(FrozenModel):
    """This participant waits for something outside the bench (a shared instrument): do not wait for it."""

    op: Literal["suspend"] = "suspend"


class Resume(FrozenModel):
    """…and is back at work."""

    op: Literal["resume"] = "resume"


class Inject(FrozenModel):
    """A fault of the bench itself, for tests: it names a link or 'stand'.

    corrupt_crc: every frame's CRC is wrong · stuck: nothing comes any more · garbage: noise between
    frames · drop: every second frame is lost · none: all faults off. A stand has faults of its own,
    such as door_open; the bench refuses those that the target cannot have.
    """

    op: Literal["inject"] = "inject"
    target: str
    fault: str = Field(pattern=r"^[a-z_]{1,40}$")


class BenchTime(FrozenModel):
    """The reply to everything that succeeds: now, and bytes handed over so far, by link."""

    ok: Literal[True] = True
    now_s: float
    pace: float
    handed_over: dict[str, int] = Field(default_factory=dict)


class BenchRefusal(FrozenModel):
    """What the bench will not do, and why."""

    ok: Literal[False] = False
    what: str
    remedy: str = ""


ControlRequest = Annotated[
    Hello | Insert | Remove | Wait | Suspend | Resume | Inject, Field(discriminator="op")
]
CONTROL_REQUEST: TypeAdapter[ControlRequest] = TypeAdapter(ControlRequest)
ControlReply = BenchTime | BenchRefusal
CONTROL_REPLY: TypeAdapter[ControlReply] = TypeAdapter(ControlReply)

# pyright: strict
"""The unit's CAN interface as its DBC (`gnc_module.dbc`) says it: messages by name, signals in units.

Classic CAN 2.0A with 11-bit identifiers at 500 kbit/s. Out of scope: CAN FD and bus error counters.
"""

from collections.abc import Mapping
from enum import IntEnum
from functools import lru_cache
from importlib import resources
from typing import TYPE_CHECKING, NamedTuple

from protocol.errors import Fault, LinkError

if TYPE_CHECKING:
    from cantools.database.can import Database, Message

BIT_RATE = 500_000

GNC_STATUS = "GNC_STATUS"
GNC_RATE = "GNC_RATE"
GNC_SPECIFIC_FORCE = "GNC_SPECIFIC_FORCE"
GNC_TEST_REQUEST = "GNC_TEST_REQUEST"
GNC_TEST_ECHO = "GNC_TEST_ECHO"

PATTERN_MASK = 0xFFFF_FFFF
"""The echo's `inverted_pattern` is the request's `pattern` exclusive-or this."""


class UnitState(IntEnum):
    """Values of the signal `state` of GNC_STATUS."""

    OFF = 0
    STARTING = 1
    IDLE = 2
    SELF_TEST = 3
    STREAMING = 4
    FAULT = 5


class EchoStatus(IntEnum):
    """Values of the signal `status` of GNC_TEST_ECHO."""

    OK = 0
    NOT_READY = 1
    BUS_WARNING = 2


class CanFrame(NamedTuple):
    """A frame as it is on the bus."""

    identifier: int
    data: bytes


class CanMessage(NamedTuple):
    """A decoded frame: signals in the units of the DBC, enumerated ones as their numbers."""

    name: str
    signals: dict[str, float]


@lru_cache(maxsize=1)
def can_database() -> "Database":
    """The DBC, loaded strictly and once: overlapping or overhanging signals are refused."""
    from cantools.database import load_string
    from cantools.database.can import Database

    text = resources.files("protocol").joinpath("gnc_module.dbc").read_text(encoding="utf-8")
    database = load_string(text, database_format="dbc", strict=True)
    assert isinstance(database, Database)
    return database


def message_period_s(name: str) -> float | None:
    """How often the unit sends this message by itself; None if it does not."""
    cycle_time_ms = _message(name).cycle_time
    return cycle_time_ms / 1000 if cycle_time_ms else None


def encode_can(name: str, signals: Mapping[str, float]) -> CanFrame:
    """The frame of a message; every signal must be given, in the unit of the DBC.

    Raises:
        LinkError: the message is not known, or a signal is missing, unknown or out of its range.
    """
    from cantools.errors import Error

    message = _message(name)
    try:
        data = message.encode(dict(signals), strict=True)
    except (Error, KeyError, TypeError, ValueError) as error:
        reason = str(error).rstrip(".") or "a signal is not a number"
        raise LinkError(
            f"The CAN message {name} cannot be encoded: {reason}.",
            where=f"CAN message {name}, 0x{message.frame_id:X}",
            fault=Fault.TESTLOOM,
            remedy="give every signal of the DBC a value inside its range.",
        ) from None
    return CanFrame(message.frame_id, data)


def decode_can(identifier: int, data: bytes) -> CanMessage:
    """The message in a frame.

    Raises:
        LinkError: no message has this identifier, the length is wrong, or an enumerated signal has
            a value without a name.
    """
    database = can_database()
    try:
        message = database.get_message_by_frame_id(identifier)
    except KeyError:
        raise _undecodable(identifier, data, "the DBC has no message of this identifier") from None
    if len(data) != message.length:
        raise _undecodable(identifier, data, f"{message.name} has {message.length} bytes, not {len(data)}")
    decoded = message.decode(data, decode_choices=False)
    signals: dict[str, float] = {}
    for signal in message.signals:
        value = decoded[signal.name] if isinstance(decoded, dict) else None
        assert isinstance(value, (int, float))
        if signal.choices is not None and value not in signal.choices:
            raise _undecodable(identifier, data, f"{message.name}.{signal.name} has no value {value}")
        signals[signal.name] = value
    return CanMessage(message.name, signals)


def _message(name: str) -> "Message":
    try:
        return can_database().get_message_by_name(name)
    except KeyError:
        raise LinkError(
            f"The CAN interface has no message '{name}'.",
            where="gnc_module.dbc",
            fault=Fault.TESTLOOM,
            remedy=f"use one of: {', '.join(message.name for message in can_database().messages)}.",
        ) from None


def _undecodable(identifier: int, data: bytes, why: str) -> LinkError:
    return LinkError(
        f"A CAN frame cannot be decoded: {why}.",
        where=f"CAN identifier 0x{identifier:X}, data {data.hex(' ') or 'empty'}",
        fault=Fault.UNIT,
        remedy="check the unit's firmware version against the DBC, and the bit rate of the bus.",
    )

"""Key expressions: every key of the fabric is built here and nowhere else.

testloom/<line>/coordinator/{register,renew,submit,request}/<station or client>   queries
testloom/<line>/station/<station>/command                                         queries
testloom/<line>/station/<station>/live/<socket>                                   pub/sub
testloom/<line>/alive/<station>/<incarnation>                                     liveliness tokens
testloom/<line>/alive/coordinator/<incarnation>                                   liveliness token
"""

import re
from typing import Literal

from protocol.errors import Fault, TestloomError

CoordinatorVerb = Literal["register", "renew", "submit", "request"]
COORDINATOR_VERBS: tuple[CoordinatorVerb, ...] = ("register", "renew", "submit", "request")
COORDINATOR_NAME = "coordinator"

_CHUNK = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_NUMBER = re.compile(r"[0-9]{1,20}")


def checked_name(name: str, what: str) -> str:
    """The name itself, if it can stand in a key.

    Raises:
        TestloomError: the name is empty, too long or has a character that keys give a meaning.
    """
    if not _CHUNK.fullmatch(name):
        raise TestloomError(
            f"'{name}' cannot be the name of a {what}.",
            fault=Fault.OPERATOR,
            remedy="use 1 to 64 letters, digits, '_', '.' or '-', beginning with a letter or digit.",
        )
    return name


def coordinator_key(line: str, verb: CoordinatorVerb, sender: str) -> str:
    """Where `sender` (a station or a client) asks the coordinator."""
    return f"testloom/{checked_name(line, 'line')}/coordinator/{verb}/{checked_name(sender, 'sender')}"


def coordinator_queryable(line: str, verb: CoordinatorVerb) -> str:
    """What the coordinator listens on: one queryable for all senders of a verb."""
    return f"testloom/{checked_name(line, 'line')}/coordinator/{verb}/*"


def station_command_key(line: str, station: str) -> str:
    """Where the coordinator commands a station."""
    return f"testloom/{checked_name(line, 'line')}/station/{checked_name(station, 'station')}/command"


def station_live_key(line: str, station: str, socket: str) -> str:
    """Where a station publishes the progress of a socket."""
    prefix = f"testloom/{checked_name(line, 'line')}/station/{checked_name(station, 'station')}"
    return f"{prefix}/live/{checked_name(socket, 'socket')}"


def all_live_keys(line: str) -> str:
    """All live views of a line."""
    return f"testloom/{checked_name(line, 'line')}/station/*/live/*"


def alive_key(line: str, name: str, incarnation: int) -> str:
    """The liveliness token of a station's (or the coordinator's) process."""
    return f"testloom/{checked_name(line, 'line')}/alive/{checked_name(name, 'station')}/{incarnation}"


def all_alive_keys(line: str) -> str:
    """All liveliness tokens of a line."""
    return f"testloom/{checked_name(line, 'line')}/alive/*/*"


def parse_alive_key(key: str) -> tuple[str, int]:
    """Name and incarnation of an alive key.

    Raises:
        TestloomError: it is not an alive key.
    """
    parts = key.split("/")
    if len(parts) != 5 or parts[0] != "testloom" or parts[2] != "alive" or not _NUMBER.fullmatch(parts[4]):
        raise TestloomError(f"'{key}' is not the key of a liveliness token.", fault=Fault.TESTLOOM)
    return parts[3], int(parts[4])


def sender_of(key: str) -> str:
    """The station or client that asked on a coordinator key."""
    return key.rsplit("/", 1)[-1]

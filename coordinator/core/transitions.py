"""The states of a unit and of a lease, as tables. What is not in a table cannot happen.

**A unit** is WAITING for a socket that can run its next operation, or AT_STATION under exactly one
lease, or FINISHED with a final disposition. It never waits and is leased at once, and it never
leaves the line without a disposition. What a lease brings decides where the unit goes:

- `passed`: the operation passed; the unit waits for the next one, or ships after the last.
- `failed`: the unit is to blame; it is retested, unchanged, on another socket, until the
  operation's `max_attempts_failed` confirms the failure.
- `disturbed`: station, stand, fixture or link are to blame, or nothing is known (a lease that
  lapsed); the unit waits again at its old place, until `max_attempts_disturbed` says that it
  cannot be judged.
- `withdrawn`: the station refused the lease; nothing began, nothing is counted.

**A lease** binds one unit, one operation and one socket under one fence, a number that only grows.
It is OFFERED when granted, RUNNING once the station has taken it, ABORTING when the operation's
deadline passed before a record came. It has two deadlines: the renewal expiry, which a station
pushes on every renewal, and the operation's deadline, which nothing pushes. It ends exactly once:
CLOSED by the record of its attempt, in whatever outcome; LAPSED when a deadline passed in silence;
WITHDRAWN when the station refused it. A lease that has ended never lives again: a record that
comes for a lapsed or withdrawn one is kept, acknowledged and set aside, and moves nothing.

A record may close a lease that is still OFFERED: the station's answer to StartSequence was lost,
its work was not. A lapsed lease's unit is free at once; the old station cannot harm it, for its
fence is old: the station's later records are set aside and its renewals answered with a revocation.
"""

# pyright: strict

from collections import deque
from collections.abc import Mapping
from typing import Literal

from protocol.errors import Fault, TestloomError

UnitState = Literal["WAITING", "AT_STATION", "FINISHED"]
UnitTrigger = Literal[
    "granted", "passed", "passed_last", "failed", "confirmed", "disturbed", "unjudgeable", "withdrawn"
]

UNIT_TRANSITIONS: Mapping[tuple[UnitState, UnitTrigger], UnitState] = {
    ("WAITING", "granted"): "AT_STATION",
    ("AT_STATION", "passed"): "WAITING",
    ("AT_STATION", "passed_last"): "FINISHED",
    ("AT_STATION", "failed"): "WAITING",
    ("AT_STATION", "confirmed"): "FINISHED",
    ("AT_STATION", "disturbed"): "WAITING",
    ("AT_STATION", "unjudgeable"): "FINISHED",
    ("AT_STATION", "withdrawn"): "WAITING",
}

LeaseState = Literal["OFFERED", "RUNNING", "ABORTING", "CLOSED", "LAPSED", "WITHDRAWN"]
LeaseTrigger = Literal["accepted", "refused", "recorded", "overran", "lapsed"]

LEASE_TRANSITIONS: Mapping[tuple[LeaseState, LeaseTrigger], LeaseState] = {
    ("OFFERED", "accepted"): "RUNNING",
    ("OFFERED", "refused"): "WITHDRAWN",
    ("OFFERED", "recorded"): "CLOSED",
    ("OFFERED", "overran"): "ABORTING",
    ("OFFERED", "lapsed"): "LAPSED",
    ("RUNNING", "recorded"): "CLOSED",
    ("RUNNING", "overran"): "ABORTING",
    ("RUNNING", "lapsed"): "LAPSED",
    ("ABORTING", "recorded"): "CLOSED",
    ("ABORTING", "lapsed"): "LAPSED",
}

LIVE_LEASE_STATES: tuple[LeaseState, ...] = ("OFFERED", "RUNNING", "ABORTING")

STORY_LENGTH = 400
StoryEntry = tuple[float, str | int, str, str, str]


class InvalidTransition(TestloomError):
    """A state and a trigger that the table does not join. Carries what led there."""


class Story:
    """The last transitions of all units and leases, oldest first."""

    __slots__ = ("_entries",)

    def __init__(self) -> None:
        self._entries: deque[StoryEntry] = deque(maxlen=STORY_LENGTH)

    def of(self, subject: str | int) -> tuple[str, ...]:
        """The transitions of one unit (its serial) or lease (its fence), in words."""
        return tuple(
            f"{at_s:.3f} {subject}: {before} --{trigger}--> {after}"
            for at_s, about, before, trigger, after in self._entries
            if about == subject
        )

    def unit_step(self, serial: str, state: UnitState, trigger: UnitTrigger, at_s: float) -> UnitState:
        """The unit's next state.

        Raises:
            InvalidTransition: the table has none.
        """
        after = UNIT_TRANSITIONS.get((state, trigger))
        if after is None:
            raise self._refused("unit", serial, state, trigger)
        self._entries.append((at_s, serial, state, trigger, after))
        return after

    def lease_step(self, fence: int, state: LeaseState, trigger: LeaseTrigger, at_s: float) -> LeaseState:
        """The lease's next state.

        Raises:
            InvalidTransition: the table has none.
        """
        after = LEASE_TRANSITIONS.get((state, trigger))
        if after is None:
            raise self._refused("lease", fence, state, trigger)
        self._entries.append((at_s, fence, state, trigger, after))
        return after

    def _refused(self, what: str, subject: str | int, state: str, trigger: str) -> InvalidTransition:
        return InvalidTransition(
            f"A {what} in state {state} cannot be '{trigger}'.",
            where=f"{what} {subject}",
            fault=Fault.TESTLOOM,
            remedy="keep the journal and report it: replaying it shows the error again.",
            story=self.of(subject),
        )

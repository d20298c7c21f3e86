# pyright: strict
"""The lock-step barrier: who is at work, who waits, and when time may move.

Every participant is in one of three states:

    WORKING    at work: in lock-step, time stands
    WAITING    waits for a moment, or for bytes on a link
    SUSPENDED  waits for something outside the bench: not counted

    from \\ on   wait       moment or bytes come   suspend     resume    leave
    (none)      —          —                      —           —         —         join → WORKING
    WORKING     WAITING    —                      SUSPENDED   WORKING   gone
    WAITING     —          WORKING                —           —         gone
    SUSPENDED   —          —                      SUSPENDED   WORKING   gone

In lock-step time may move when nobody is WORKING and somebody WAITS, and then not beyond the earliest
moment that is waited for (`target_s`). What happens on the way (a unit answers) is told to the clock
(`due`), and it stops where a waiting participant asked to be woken. An observer neither
holds time back nor drives it. In paced running, time comes from outside and only `pass_time` is used.

A moment is compared exactly: the time that is passed is the very number a participant asked for.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

MAX_PARTICIPANTS = 256


class Activity(Enum):
    """What a participant does."""

    WORKING = "working"
    WAITING = "waiting"
    SUSPENDED = "suspended"


class InvalidTransition(Exception):
    """A request that the participant's state does not admit; the text says which."""


@dataclass
class _Participant:
    name: str
    observer: bool
    activity: Activity = Activity.WORKING
    until_s: float = 0.0
    wake_above: Mapping[str, int] = field(default_factory=lambda: dict[str, int]())


class BenchClock:
    """The barrier. Participants are known by a number the shell gives them."""

    def __init__(self, now_s: float = 0.0) -> None:
        self._now_s = now_s
        self._participants: dict[int, _Participant] = {}

    @property
    def now_s(self) -> float:
        """Bench time; never goes back."""
        return self._now_s

    def activity(self, participant: int) -> Activity | None:
        """What a participant does; None when it has not joined or has left."""
        known = self._participants.get(participant)
        return known.activity if known else None

    def join(self, participant: int, name: str, *, observer: bool = False) -> None:
        """A new participant, at work.

        Raises:
            InvalidTransition: it has joined already, or the bench is full.
        """
        if participant in self._participants:
            raise InvalidTransition(f"'{name}' has said hello already")
        if len(self._participants) >= MAX_PARTICIPANTS:
            raise InvalidTransition(f"the bench has its {MAX_PARTICIPANTS} participants")
        self._participants[participant] = _Participant(name, observer)

    def leave(self, participant: int) -> None:
        """Gone, whatever it did; time is held back by others only. Unknown ones are ignored."""
        self._participants.pop(participant, None)

    def wait(self, participant: int, until_s: float, wake_above: Mapping[str, int]) -> None:
        """WORKING → WAITING; a moment that has come already is due at the next `due`.

        Raises:
            InvalidTransition: it is not at work.
        """
        one = self._in("wait", participant, Activity.WORKING)
        one.activity = Activity.WAITING
        one.until_s = max(until_s, self._now_s)
        one.wake_above = dict(wake_above)

    def suspend(self, participant: int) -> None:
        """WORKING → SUSPENDED; suspended ones stay so.

        Raises:
            InvalidTransition: it waits.
        """
        one = self._in("suspend", participant, Activity.WORKING, Activity.SUSPENDED)
        one.activity = Activity.SUSPENDED

    def resume(self, participant: int) -> None:
        """SUSPENDED → WORKING; working ones stay so.

        Raises:
            InvalidTransition: it waits.
        """
        one = self._in("resume", participant, Activity.SUSPENDED, Activity.WORKING)
        one.activity = Activity.WORKING

    def wake(self, participant: int) -> None:
        """WAITING → WORKING before its moment, because the shell has to tell it something.

        Raises:
            InvalidTransition: it does not wait.
        """
        self._in("wake", participant, Activity.WAITING).activity = Activity.WORKING

    def target_s(self) -> float | None:
        """The moment that time may move to in lock-step; None while it has to stand."""
        moments: list[float] = []
        for one in self._participants.values():
            if one.observer or one.activity is Activity.SUSPENDED:
                continue
            if one.activity is Activity.WORKING:
                return None
            moments.append(one.until_s)
        return min(moments, default=None)

    def earliest_s(self) -> float | None:
        """The earliest moment that anybody waits for, observers included; None when nobody waits."""
        return min((one.until_s for one in self._waiting().values()), default=None)

    def watched_links(self) -> frozenset[str]:
        """The links whose bytes would wake somebody."""
        return frozenset(link for one in self._waiting().values() for link in one.wake_above)

    def pass_time(self, to_s: float) -> None:
        """Time moves.

        Raises:
            InvalidTransition: back.
        """
        if to_s < self._now_s:
            raise InvalidTransition(f"time cannot go back from {self._now_s} s to {to_s} s")
        self._now_s = to_s

    def due(self, handed_over: Mapping[str, int]) -> tuple[int, ...]:
        """WAITING → WORKING for all whose moment has come or whose link has been handed more bytes.

        Args:
            handed_over: bytes handed over so far, by link.

        Returns:
            Those who are at work again, in the order in which they joined.
        """
        woken = tuple(
            number
            for number, one in self._waiting().items()
            if one.until_s <= self._now_s
            or any(handed_over.get(link, 0) > seen for link, seen in one.wake_above.items())
        )
        for number in woken:
            self._participants[number].activity = Activity.WORKING
        return woken

    def waiting(self) -> tuple[int, ...]:
        """All who wait, in the order in which they joined."""
        return tuple(self._waiting())

    def _waiting(self) -> dict[int, _Participant]:
        return {n: one for n, one in self._participants.items() if one.activity is Activity.WAITING}

    def _in(self, request: str, participant: int, *allowed: Activity) -> _Participant:
        """The participant, when it is in one of these states."""
        one = self._participants.get(participant)
        if one is None:
            raise InvalidTransition(f"'{request}' before 'hello'")
        if one.activity not in allowed:
            raise InvalidTransition(f"'{request}' while '{one.name}' is {one.activity.value}")
        return one

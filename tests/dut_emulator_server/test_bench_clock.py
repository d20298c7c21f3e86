"""The lock-step barrier by itself, against a naive model, under any order of requests."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from dut_emulator.server.bench_clock import Activity, BenchClock, InvalidTransition

NAMES = st.integers(1, 5)
LINKS = st.sampled_from(["a", "b"])


class Barrier(RuleBasedStateMachine):
    """Oracle: a plain dict of what each participant said last, and the rules in words."""

    @initialize()
    def begin(self) -> None:
        self.clock = BenchClock()
        self.said: dict[int, tuple[str, float, dict[str, int]]] = {}
        self.observers: set[int] = set()
        self.handed = {"a": 0, "b": 0}
        self.last_s = 0.0

    @rule(who=NAMES, observer=st.booleans())
    def join(self, who: int, observer: bool) -> None:
        if who in self.said:
            with pytest.raises(InvalidTransition):
                self.clock.join(who, str(who))
            return
        self.clock.join(who, str(who), observer=observer)
        self.said[who] = ("works", 0.0, {})
        if observer:
            self.observers.add(who)

    @rule(who=NAMES)
    def leave(self, who: int) -> None:
        self.clock.leave(who)
        self.said.pop(who, None)
        self.observers.discard(who)

    @rule(who=NAMES, ahead_s=st.floats(-1, 5), watched=st.none() | LINKS)
    def wait(self, who: int, ahead_s: float, watched: str | None) -> None:
        above = {watched: self.handed[watched]} if watched else {}
        until_s = self.clock.now_s + ahead_s
        if self.said.get(who, ("",))[0] != "works":
            with pytest.raises(InvalidTransition):
                self.clock.wait(who, until_s, above)
            return
        self.clock.wait(who, until_s, above)
        self.said[who] = ("waits", until_s, above)

    @rule(who=NAMES, back=st.booleans())
    def suspend_or_resume(self, who: int, back: bool) -> None:
        change = self.clock.resume if back else self.clock.suspend
        if self.said.get(who, ("waits",))[0] == "waits":
            with pytest.raises(InvalidTransition):
                change(who)
            return
        change(who)
        self.said[who] = ("works" if back else "is away", 0.0, {})

    @rule(link=LINKS, count=st.integers(1, 10))
    def hand_over(self, link: str, count: int) -> None:
        self.handed[link] += count
        self.check_woken()

    @precondition(lambda self: self.clock.target_s() is not None)
    @rule(share=st.sampled_from([0.3, 1.0]))
    def let_time_pass(self, share: float) -> None:
        target_s = self.clock.target_s()
        assert target_s is not None
        now_s = self.clock.now_s
        self.clock.pass_time(target_s if share == 1.0 else now_s + share * (target_s - now_s))
        self.check_woken()
        if share == 1.0:
            assert any(said == "works" for n, (said, *_) in self.said.items() if n not in self.observers)

    def check_woken(self) -> None:
        """Whoever has a reason is woken, nobody else, and nobody twice."""
        expected = {
            who
            for who, (said, until_s, above) in self.said.items()
            if said == "waits"
            and (until_s <= self.clock.now_s or any(self.handed[k] > n for k, n in above.items()))
        }
        assert set(self.clock.due(self.handed)) == expected
        assert self.clock.due(self.handed) == ()
        for who in expected:
            self.said[who] = ("works", 0.0, {})

    @invariant()
    def time_stands_exactly_while_somebody_works(self) -> None:
        counted = [entry for who, entry in self.said.items() if who not in self.observers]
        working = any(said == "works" for said, *_ in counted)
        moments = [max(until_s, 0.0) for said, until_s, _ in counted if said == "waits"]
        target_s = self.clock.target_s()
        assert (target_s is None) == (working or not moments)
        if target_s is not None:
            assert target_s >= self.clock.now_s
            assert target_s == max(min(moments), self.clock.now_s)

    @invariant()
    def time_never_goes_back(self) -> None:
        assert self.clock.now_s >= self.last_s
        self.last_s = self.clock.now_s


Barrier.TestCase.settings = settings(max_examples=80, stateful_step_count=30, deadline=None)
TestBarrier = Barrier.TestCase


def test_two_who_wait_are_woken_one_after_the_other() -> None:
    clock = BenchClock()
    clock.join(1, "one")
    clock.join(2, "two")
    clock.wait(1, 3.0, {})
    assert clock.target_s() is None  # the other is at work
    clock.wait(2, 2.0, {})
    assert clock.target_s() == 2.0
    clock.pass_time(2.0)
    assert clock.due({}) == (2,)
    assert clock.target_s() is None
    clock.leave(2)
    assert clock.target_s() == 3.0


def test_time_cannot_go_back() -> None:
    clock = BenchClock(5.0)
    with pytest.raises(InvalidTransition, match="go back"):
        clock.pass_time(4.0)


def test_an_unknown_participant_may_nothing() -> None:
    clock = BenchClock()
    for request in (clock.suspend, clock.resume, clock.wake, lambda n: clock.wait(n, 1.0, {})):
        with pytest.raises(InvalidTransition, match="before 'hello'"):
            request(1)
    assert clock.activity(1) is None
    clock.join(1, "one")
    assert clock.activity(1) is Activity.WORKING

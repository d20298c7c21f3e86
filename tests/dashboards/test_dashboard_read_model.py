"""The read model with a stand-in for the coordinator and a clock that the test moves."""

from dataclasses import dataclass, field

import pytest
from imagined_line import failed_then_passed, small_line

from dashboards.read_model import AWAY_AFTER_S, MAX_UNITS_KEPT, UNIT_VALID_S, ReadModel
from protocol.adapters.zenoh_link import NoReplyError, RequestRejectedError
from protocol.line_views import LineStatus, UnitHistory
from protocol.outcomes import Outcome
from protocol.station_messages import SocketProgress


@dataclass
class Coordinator:
    """Answers while `here`."""

    here: bool = True
    progress: list[SocketProgress] = field(default_factory=list)
    units_asked: int = 0

    def status(self) -> LineStatus:
        self._answer()
        return small_line()[0]

    def unit(self, serial: str) -> UnitHistory:
        self._answer()
        self.units_asked += 1
        if serial != "GNC-0003":
            raise RequestRejectedError(f"No unit '{serial}'.")
        return failed_then_passed()

    def take_progress(self) -> list[SocketProgress]:
        taken, self.progress = self.progress, []
        return taken

    def _answer(self) -> None:
        if not self.here:
            raise NoReplyError("Nobody answered.")


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def _never(_keep_trying: object):
    raise AssertionError("the test polls by itself")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def model(clock: Clock) -> ReadModel:
    return ReadModel(_never, clock)


def test_away_is_said_with_its_age_and_ends_by_itself(model: ReadModel, clock: Clock) -> None:
    coordinator = Coordinator()
    assert model.snapshot().connection.state == "connecting"
    model.poll(coordinator)
    assert model.snapshot().connection.state == "live"
    coordinator.here = False
    clock.now_s += AWAY_AFTER_S - 0.1
    model.poll(coordinator)
    assert model.snapshot().connection.state == "live", "one lost poll is no outage"
    clock.now_s += 60.0
    model.poll(coordinator)
    away = model.snapshot()
    assert away.connection.state == "away"
    assert away.connection.reason == "Nobody answered."
    assert away.connection.away_for_s == away.status_age_s == pytest.approx(60.0 + AWAY_AFTER_S - 0.1)
    assert away.status == small_line()[0], "the last known data stay"
    coordinator.here = True
    model.poll(coordinator)
    back = model.snapshot()
    assert (back.connection.state, back.status_age_s, back.connection.reason) == ("live", 0.0, "")


def test_a_coordinator_that_was_never_there_is_away_too(model: ReadModel, clock: Clock) -> None:
    clock.now_s += AWAY_AFTER_S + 5
    model.poll(Coordinator(here=False))
    snapshot = model.snapshot()
    assert (snapshot.connection.state, snapshot.status) == ("away", None)
    assert snapshot.connection.away_for_s == pytest.approx(AWAY_AFTER_S + 5)


def test_the_last_outcome_outlives_idle_and_repeated_views(model: ReadModel, clock: Clock) -> None:
    coordinator = Coordinator()
    model.poll(coordinator)
    key = ("s", "a")
    failed = SocketProgress(station="s", socket="a", serial="GNC-1", operation="x", outcome=Outcome.FAIL)
    coordinator.progress = [failed]
    model.snapshot()
    clock.now_s += 10
    coordinator.progress = [failed, SocketProgress(station="s", socket="a")]
    kept = model.snapshot().live[key]
    assert kept.progress == failed
    assert kept.age_s == pytest.approx(10.0), "said again is not happened again"
    running = SocketProgress(station="s", socket="a", serial="GNC-2", operation="x", step="can")
    coordinator.progress = [running]
    assert model.snapshot().live[key].progress == running


def test_a_stations_notice_stands_beside_the_last_outcome_until_the_next_view(model: ReadModel) -> None:
    coordinator = Coordinator()
    model.poll(coordinator)
    passed = SocketProgress(station="s", socket="a", serial="GNC-1", operation="x", outcome=Outcome.PASS)
    coordinator.progress = [passed, SocketProgress(station="s", socket="a", step="alarm: spool_unwritable")]
    seen = model.snapshot().live["s", "a"]
    assert (seen.progress, seen.notice) == (passed, "spool_unwritable")
    coordinator.progress = [SocketProgress(station="s", socket="a")]
    seen = model.snapshot().live["s", "a"]
    assert (seen.progress, seen.notice) == (passed, "")


def test_units_are_asked_for_once_in_a_while_and_known_when_away(model: ReadModel, clock: Clock) -> None:
    coordinator = Coordinator()
    assert model.unit("GNC-0003").history is None, "nothing is known before the link is there"
    model.poll(coordinator)
    assert model.unit("GNC-0003").history == failed_then_passed()
    model.unit("GNC-0003")
    assert coordinator.units_asked == 1
    clock.now_s += UNIT_VALID_S + 0.1
    model.unit("GNC-0003")
    assert coordinator.units_asked == 2
    coordinator.here = False
    clock.now_s += 30
    answer = model.unit("GNC-0003")
    assert answer.history == failed_then_passed()
    assert answer.age_s == pytest.approx(30.0)


def test_an_unknown_serial_is_said_and_does_not_fill_the_memory(model: ReadModel) -> None:
    coordinator = Coordinator()
    model.poll(coordinator)
    answers = [model.unit(f"nobody-{n}") for n in range(MAX_UNITS_KEPT + 10)]
    assert answers[0].history is None
    assert answers[0].unknown == "No unit 'nobody-0'."
    asked = coordinator.units_asked
    model.unit("nobody-0")
    model.unit(f"nobody-{MAX_UNITS_KEPT + 9}")
    assert coordinator.units_asked == asked + 1, "the oldest was forgotten, the newest kept"

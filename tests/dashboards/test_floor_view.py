"""The floor's view model: states of sockets, queues, the order, and yields against published intervals."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from imagined_line import CALIBRATION, FUNCTIONAL, NOW_S, large_line, operation_yield, small_line, unit
from scipy.stats import binomtest

from dashboards.intervals import counted_fraction
from dashboards.socket_states import LIVE_VIEW_VALID_S, LiveSocket, socket_view
from dashboards.view_models import (
    MAX_QUEUE_ENTRIES_SHOWN,
    floor_view,
    natural_key,
    yield_view,
)
from protocol.line_views import Alarm, LineStatus, SocketStatus, YieldReport
from protocol.outcomes import Disposition, Outcome
from protocol.station_messages import SocketProgress

# Newcombe (1998), Statistics in Medicine 17:857, Table I, method 3 (Wilson without continuity correction).
PUBLISHED_INTERVALS = [
    (81, 263, 0.2553, 0.3662),
    (15, 148, 0.0624, 0.1605),
    (0, 20, 0.0, 0.1611),
    (1, 29, 0.0061, 0.1718),
]


@pytest.mark.parametrize(("successes", "trials", "low", "high"), PUBLISHED_INTERVALS)
def test_interval_agrees_with_published_ones(successes: int, trials: int, low: float, high: float) -> None:
    counted = counted_fraction(successes, trials)
    assert counted.low == pytest.approx(low, abs=5e-5)
    assert counted.high == pytest.approx(high, abs=5e-5)


@given(st.integers(1, 5000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_agrees_with_scipy_and_holds_the_fraction(counts: tuple[int, int]) -> None:
    successes, trials = counts
    counted = counted_fraction(successes, trials)
    reference = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert counted.low is not None
    assert counted.high is not None
    assert counted.low == pytest.approx(reference.low, abs=1e-12)
    assert counted.high == pytest.approx(reference.high, abs=1e-12)
    assert 0 <= counted.low <= successes / trials <= counted.high <= 1


def test_no_attempt_has_no_yield() -> None:
    counted = counted_fraction(0, 0)
    assert (counted.fraction, counted.low, counted.high) == (None, None, None)
    with pytest.raises(ValueError, match="cannot be"):
        counted_fraction(3, 2)


def test_yield_keeps_the_two_conventions_apart() -> None:
    """12 first attempts: 9 PASS, 2 FAIL by the unit, 1 lost with its station (it judged no unit)."""
    report = YieldReport(
        operations=(operation_yield(FUNCTIONAL, 12, 9, 2, judged=11),),
        stations=(),
        rty=0.75,
        rty_unit=9 / 11,
        final=0.9,
        dispositions={"SHIP": 9, "SCRAP": 1, "IN_PROCESS": 2},
    )
    view = yield_view(report)
    row = view.operations[0]
    assert (row.first_pass.successes, row.first_pass.trials) == (9, 12)
    assert (row.first_pass_units.successes, row.first_pass_units.trials) == (9, 11)
    assert row.first_pass.fraction == pytest.approx(0.75)
    assert row.first_pass.low == pytest.approx(0.467694, abs=1e-6)  # by hand: z² = 3.841459, n = 12
    assert row.first_pass.high == pytest.approx(0.911059, abs=1e-6)
    assert (view.final.successes, view.final.trials) == (9, 10)


def _live(outcome: Outcome | None = None, serial: str | None = "GNC-1", age_s: float = 1.0) -> LiveSocket:
    progress = SocketProgress(
        station="s",
        socket="a",
        serial=serial,
        operation=FUNCTIONAL,
        step="can",
        steps_done=2,
        steps_total=7,
        outcome=outcome,
    )
    return LiveSocket(progress, age_s)


def _socket(serial: str | None = None) -> SocketStatus:
    operation = FUNCTIONAL if serial else None
    since = NOW_S - 3 if serial else None
    return SocketStatus(
        socket="a", operations=(FUNCTIONAL,), serial=serial, operation=operation, leased_since_s=since
    )


@pytest.mark.parametrize(
    ("station", "leased", "live", "state", "step"),
    [
        ("ready", None, None, "free", None),
        ("ready", "GNC-1", None, "testing", None),
        ("ready", "GNC-1", _live(), "testing", "can"),
        ("ready", "GNC-1", _live(serial="GNC-0"), "testing", None),  # what ran here before
        ("ready", "GNC-1", _live(Outcome.PASS), "recording", "can"),  # no PASS before it is kept
        ("ready", "GNC-1", _live(Outcome.FAIL), "failed", "can"),  # bad news at once
        ("ready", "GNC-1", _live(Outcome.TIMEOUT), "not_judged", "can"),
        ("ready", None, _live(Outcome.PASS, age_s=3600), "passed", "can"),
        ("ready", None, _live(Outcome.FAIL, age_s=3600), "failed", "can"),
        ("ready", None, _live(Outcome.ERROR), "not_judged", "can"),
        ("ready", None, _live(age_s=LIVE_VIEW_VALID_S), "testing", "can"),
        (
            "ready",
            None,
            _live(age_s=LIVE_VIEW_VALID_S + 0.1),
            "free",
            None,
        ),  # a station that died in mid-step
        ("silent", "GNC-1", _live(), "silent", None),
        ("refused", None, _live(Outcome.PASS), "refused", None),
    ],
)
def test_what_a_socket_shows(station, leased, live, state, step) -> None:
    view = socket_view(station, _socket(leased), live, NOW_S)
    assert (view.state, view.step) == (state, step)
    if leased:
        assert view.serial == leased
        ended = view.outcome is not None
        assert view.seconds == pytest.approx(1.0 if ended else 3.0), "since the outcome, or since the lease"


def test_a_notice_shows_whatever_the_socket_shows() -> None:
    for station in ("ready", "silent"):
        live = LiveSocket(_live(Outcome.FAIL).progress, 1.0, "spool_unwritable")
        assert socket_view(station, _socket(), live, NOW_S).notice == "spool_unwritable"


def _line(**changes: object) -> LineStatus:
    return small_line()[0].model_copy(update=changes)


def test_queue_is_in_order_and_bounded_and_says_what_a_unit_waits_for() -> None:
    waiting = [
        unit(
            n, Disposition.IN_PROCESS, operation=FUNCTIONAL, queue_position=21 - n, waits_for="a free socket"
        )
        for n in range(1, 21)
    ]
    retest = unit(50, Disposition.RETEST, operation=CALIBRATION, queue_position=1, attempts=1)
    tested = unit(51, Disposition.IN_PROCESS, operation=FUNCTIONAL, station="s", socket="a")
    status = _line(units=(*waiting, retest, tested), queue_lengths={FUNCTIONAL: 20, CALIBRATION: 1})
    functional, calibration = floor_view(status, {}).queues
    assert [entry.position for entry in functional.entries] == list(range(1, MAX_QUEUE_ENTRIES_SHOWN + 1))
    assert functional.entries[0].serial == "GNC-0020"
    assert functional.entries[0].waits_for.text == "a free socket"
    assert functional.not_shown == 20 - MAX_QUEUE_ENTRIES_SHOWN
    assert [(entry.serial, entry.is_retest) for entry in calibration.entries] == [("GNC-0050", True)]


def test_order_parts_add_up() -> None:
    for status, _ in (small_line(), large_line()):
        order = floor_view(status, {}).order
        assert (
            order.shipped + order.fallen + order.at_stations + order.waiting
            == order.units
            == len(status.units)
        )
        assert order.done == sum(u.disposition not in ("IN_PROCESS", "RETEST") for u in status.units)


def test_stations_stand_in_natural_order_by_what_they_do() -> None:
    status, progress = large_line()
    view = floor_view(status, {(p.station, p.socket): LiveSocket(p, 1.0) for p in progress})
    assert [group.operations for group in view.groups] == [(FUNCTIONAL,), (CALIBRATION,)]
    assert [station.station for station in view.groups[0].stations] == [
        f"socket-board-{n}" for n in range(1, 43)
    ]
    assert view.density == "compact"
    assert sum(group.sockets for group in view.groups) == 42 * 2 + 8
    shown = [socket for group in view.groups for station in group.stations for socket in station.sockets]
    assert view.groups[0].sockets_at_work + view.groups[1].sockets_at_work == sum(
        s.state == "testing" for s in shown
    )


def test_alarms_are_newest_first_with_their_age() -> None:
    alarms = tuple(Alarm(raised_at_s=NOW_S - n, alarm="a", subject=str(n), text="x") for n in (9, 1, 5))
    view = floor_view(_line(alarms=alarms), {})
    assert [(alarm.subject, alarm.age_s) for alarm in view.alarms] == [("1", 1.0), ("5", 5.0), ("9", 9.0)]


@given(st.lists(st.text(max_size=8), max_size=12))
def test_natural_order_is_total(names: list[str]) -> None:
    assert sorted(names, key=natural_key) == sorted(sorted(names), key=natural_key)


def test_numbers_inside_names_are_compared_as_numbers() -> None:
    assert sorted(["st-10", "st-9", "st-1a", "a"], key=natural_key) == ["a", "st-1a", "st-9", "st-10"]

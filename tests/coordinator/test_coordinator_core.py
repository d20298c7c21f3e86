"""What the line does with units, leases and records, one case at a time. Invariants run throughout."""

from itertools import product
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordinator.core import transitions
from coordinator.core.line_core import CoordinatorCore
from coordinator.core.transitions import InvalidTransition, Story
from protocol.coordinator_events import (
    FACT,
    CommandUndelivered,
    LineSettings,
    SequenceRefused,
    StationTokenVanished,
)
from protocol.errors import Fault
from protocol.line_views import OrderAccepted
from protocol.outcomes import Disposition, Outcome
from protocol.routes import Operation, Route
from protocol.station_messages import RequestRejected, StationAccepted, StationRefused

ONE_OPERATION = Route(name="short", product="gnc_module", operations=(Operation(name="functional"),))


# --- the tables ------------------------------------------------------------------------------------


def test_what_is_not_in_a_table_cannot_happen_and_tells_its_story() -> None:
    for state, trigger in product(get_args(transitions.LeaseState), get_args(transitions.LeaseTrigger)):
        story = Story()
        story.lease_step(7, "OFFERED", "accepted", 1.0)
        if (state, trigger) in transitions.LEASE_TRANSITIONS:
            assert story.lease_step(7, state, trigger, 2.0) in get_args(transitions.LeaseState)
            continue
        with pytest.raises(InvalidTransition) as caught:
            story.lease_step(7, state, trigger, 2.0)
        assert caught.value.story == ("1.000 7: OFFERED --accepted--> RUNNING",)
        assert "lease 7" in str(caught.value)


def test_ended_leases_and_finished_units_move_no_more() -> None:
    left = {state for state, _ in transitions.LEASE_TRANSITIONS}
    assert left == set(transitions.LIVE_LEASE_STATES)
    assert all(state != "FINISHED" for state, _ in transitions.UNIT_TRANSITIONS)


# --- the route -------------------------------------------------------------------------------------


def test_a_unit_that_passes_everything_ships(line) -> None:
    line.order("GM-1")
    line.register("F1")
    line.register("T1", "imu_calibration")
    line.accept(line.newest)
    assert line.newest.attempt_id == "GM-1.functional.1"
    line.submit(line.newest)
    assert (line.newest.operation, line.newest.station) == ("imu_calibration", "T1")
    line.submit(line.newest)  # the answer to StartSequence was lost, the work was not
    assert line.unit("GM-1").disposition is Disposition.SHIP
    assert [keep.set_aside for keep in line.kept] == [False, False]


def test_a_failure_is_retested_on_another_socket_and_confirmed(line) -> None:
    line.register("F1", sockets="AB")
    line.order("GM-1", "GM-2")
    first, other = line.started
    line.submit(first, Outcome.FAIL)
    assert len(line.started) == 2, "the only free socket is the one where it failed: it waits"
    assert line.unit("GM-1").disposition is Disposition.RETEST
    line.submit(other)
    assert (line.newest.unit.serial, line.newest.socket) == ("GM-1", other.socket)
    line.submit(line.newest, Outcome.FAIL)
    assert line.unit("GM-1").disposition is Disposition.SCRAP


def test_a_retest_on_the_same_socket_needs_patience_and_that_there_is_no_other(line) -> None:
    line.register("F1")
    line.order("GM-1")
    line.submit(line.newest, Outcome.FAIL)
    line.wait(line.settings.retest_patience_s - 0.1)
    assert len(line.started) == 1
    line.wait(0.2)
    assert len(line.started) == 2
    assert line.newest.attempt_id == "GM-1.functional.2"


def test_a_retest_does_not_wait_for_a_socket_whose_station_fell_silent(line) -> None:
    line.register("F1")
    line.order("GM-1")
    line.register("F2")
    line.order("GM-2")
    line.submit(line.started[0], Outcome.FAIL)
    for _ in range(12):
        line.wait(1.0)
        line.renew("F1")
    assert "station_silent" in line.alarms
    # GM-2 was lost with F2 and is queued again, GM-1 may repeat where it failed: both use F1.
    assert line.unit("GM-1").state == "AT_STATION"


@pytest.mark.parametrize(
    ("outcome", "fault", "judged"),
    [
        (Outcome.FAIL, Fault.UNIT, "failed"),
        (Outcome.FAIL, Fault.NONE, "failed"),
        (Outcome.TIMEOUT, Fault.UNIT, "failed"),
        (Outcome.ERROR, Fault.UNIT, "failed"),
        (Outcome.ERROR, Fault.STATION, "disturbed"),
        (Outcome.FAIL, Fault.FIXTURE, "disturbed"),
        (Outcome.ABORTED, Fault.UNIT, "disturbed"),
        (Outcome.TIMEOUT, Fault.STAND, "disturbed"),
        (Outcome.PASS, Fault.STATION, "disturbed"),
    ],
)
def test_who_is_to_blame_decides_what_counts(line, outcome, fault, judged) -> None:
    line.register("F1")
    line.order("GM-1")
    line.submit(line.newest, outcome, fault)
    unit = line.unit("GM-1")
    assert (unit.failed_here, unit.disturbed_here) == ((1, 0) if judged == "failed" else (0, 1))


def test_a_unit_that_cannot_be_judged_is_set_aside(line) -> None:
    line.register("F1", sockets="AB")
    line.order("GM-1")
    for _ in range(5):
        line.submit(line.newest, Outcome.ERROR, Fault.STATION)
        line.wait(line.settings.rest_limit_s)  # a socket in trouble rests
        line.renew("F1")
    assert line.unit("GM-1").disposition is Disposition.QUARANTINE
    assert len(line.started) == 5


# --- leases ----------------------------------------------------------------------------------------


def test_a_lease_lives_while_it_is_renewed_and_lapses_in_silence(line) -> None:
    line.register("F1")
    line.order("GM-1")
    lease = line.newest
    for _ in range(30):
        line.wait(1.0)
        assert line.renew("F1", lease.fence).revoked == ()
    assert line.unit("GM-1").fence == lease.fence
    line.register("F2")
    line.wait(line.settings.lease_duration_s + 0.1)
    assert line.unit("GM-1").disturbed_here == 1
    assert line.core.line.leases == {}, "F2 was silent too: nobody gets work"
    line.renew("F2")
    assert line.newest.fence > lease.fence
    assert line.newest.station == "F2"


def test_the_record_of_a_lapsed_lease_is_kept_acknowledged_and_moves_nothing(line) -> None:
    line.register("F1")
    line.order("GM-1")
    old = line.newest
    line.wait(line.settings.lease_duration_s + 0.1)
    line.register("F2")
    new = line.newest
    assert new.unit.serial == "GM-1"
    before = line.unit("GM-1").attempts.copy()
    answer = line.submit(old, Outcome.FAIL)
    assert answer.attempt_ids == (old.attempt_id,)
    assert line.kept[-1].set_aside
    assert line.unit("GM-1").attempts == before
    assert line.unit("GM-1").fence == new.fence
    assert line.renew("F1", old.fence).revoked == (old.fence,)


def test_a_record_that_comes_again_is_acknowledged_and_not_kept_again(line) -> None:
    line.register("F1")
    line.order("GM-1")
    summary = line.summary(line.newest, Outcome.PASS, Fault.NONE)
    line.submit_again(summary)
    journal = list(line.journal)
    assert line.submit_again(summary).attempt_ids == (summary.attempt_id,)
    assert len(line.kept) == 1
    assert line.journal == journal, "nothing new: no trace in the journal"
    assert line.core.floor.presence.duplicates_ignored == 1


def test_a_restarted_station_closes_its_interrupted_lease_at_once(line) -> None:
    line.register("F1")
    line.order("GM-1")
    old = line.newest
    line.accept(old)
    line.register("F1", incarnation=2)
    line.submit(old, Outcome.ABORTED, Fault.STATION)
    assert line.newest.fence > old.fence
    assert line.unit("GM-1").state == "AT_STATION"


def test_the_deadline_of_an_operation_aborts_and_then_gives_up(line) -> None:
    route = ONE_OPERATION.model_copy(update={"operations": (Operation(name="functional", deadline_s=20.0),)})
    line.register("F1")
    line.order("GM-1", route=route)
    lease = line.newest
    line.accept(lease)
    for _ in range(21):
        line.wait(1.0)
        line.renew("F1", lease.fence)
    assert [command.fence for command in line.aborted] == [lease.fence]
    for _ in range(int(line.settings.abort_patience_s) + 1):
        line.wait(1.0)
        line.renew("F1", lease.fence)
    assert lease.fence not in line.core.line.leases
    assert line.unit("GM-1").state == "WAITING", "its socket is still held by the old sequence"
    line.renew("F1")
    assert line.unit("GM-1").state == "AT_STATION"


def test_an_undelivered_command_is_sent_again_until_it_is_taken(line) -> None:
    line.register("F1")
    line.order("GM-1")
    lease = line.newest
    for times in (2, 3):
        line.handle(CommandUndelivered(at_s=line.now_s, fence=lease.fence))
        line.wait(line.settings.resend_period_s)
        assert [one.fence for one in line.started] == [lease.fence] * times
    line.accept(lease)
    line.handle(CommandUndelivered(at_s=line.now_s, fence=lease.fence))
    line.wait(2 * line.settings.resend_period_s)
    assert len(line.started) == 3


def test_a_refusing_socket_rests_and_the_unit_goes_elsewhere(line) -> None:
    line.register("F1")
    line.order("GM-1")
    line.handle(
        SequenceRefused(at_s=line.now_s, fence=line.newest.fence, reason="unknown_plan", text="not loaded")
    )
    assert line.unit("GM-1").attempts == [], "nothing began, nothing is counted"
    assert "sequence_refused" in line.alarms
    assert len(line.started) == 1
    line.register("F2")
    assert line.newest.station == "F2"


# --- stations --------------------------------------------------------------------------------------


def test_the_newer_agent_of_a_bench_takes_over_and_the_older_is_refused(line) -> None:
    assert isinstance(line.register("F1", incarnation=10), StationAccepted)
    assert isinstance(line.register("F1", incarnation=20), StationAccepted)
    assert isinstance(line.register("F1", incarnation=10), StationRefused)
    assert line.renew("F1", 99, incarnation=10).revoked == (99,)


def test_another_bench_with_the_same_id_is_refused_with_an_alarm(line) -> None:
    line.register("F1", incarnation=10)
    answer = line.register("F1", incarnation=20, bench="another")
    assert isinstance(answer, StationRefused)
    assert "bench of F1" in answer.reason
    assert line.alarms == ["station_id_twice"]
    assert line.core.line.stations["F1"].incarnation == 10


def test_a_station_that_the_line_does_not_know_is_asked_to_register(line) -> None:
    assert line.renew("F9", 3).register_again
    line.register("F1", incarnation=1)
    assert line.renew("F1", incarnation=2).register_again


def test_a_vanished_token_requeues_nothing_and_stops_new_work(line) -> None:
    line.register("F1", sockets="AB")
    line.order("GM-1")
    line.handle(StationTokenVanished(at_s=line.now_s, station="F1", incarnation=1))
    line.order("GM-2")
    assert len(line.started) == 2, "a token alone says nothing"
    line.wait(line.settings.recheck_after_s)
    assert line.core.floor.presence.silent == {"F1"}
    assert len(line.core.line.leases) == 2
    line.renew("F1", *(lease.fence for lease in line.started))
    assert not line.core.floor.presence.silent


def test_a_token_of_a_station_that_is_heard_of_means_nothing(line) -> None:
    line.register("F1")
    line.handle(StationTokenVanished(at_s=line.now_s, station="F1", incarnation=1))
    line.wait(1.0)
    line.renew("F1")
    line.wait(line.settings.recheck_after_s)
    assert not line.core.floor.presence.silent


def test_a_gap_in_a_spool_is_an_alarm(line) -> None:
    line.register("F1", sockets="AB")
    line.order("GM-1", "GM-2")
    line.submit(line.started[0], number=1)
    assert "spool_gap" not in line.alarms
    line.submit(line.started[1], number=4)
    assert line.alarms == ["spool_gap"]
    line.register("F1", incarnation=2, spool=(0, 0, 2))
    assert line.alarms == ["spool_gap", "spool_replaced"]


def test_a_record_of_a_lease_that_was_never_given_is_kept_and_fences_go_beyond_it(line) -> None:
    line.register("F1")
    line.order("GM-1")
    foreign = line.newest.model_copy(update={"fence": 500, "attempt_id": "GM-1.functional.77"})
    assert line.submit(foreign).attempt_ids == ("GM-1.functional.77",)
    assert line.kept[-1].set_aside
    assert "unknown_lease" in line.alarms
    line.submit(line.newest, Outcome.ERROR, Fault.STATION)
    assert line.newest.fence == 501


@pytest.mark.parametrize(
    "changes",
    [
        {"attempt_id": "GM-1.functional.9"},
        {"serial": "GM-2"},
        {"station": "F2"},
        {"socket": "B"},
        {"plan_sha256": "c" * 64},
    ],
)
def test_a_record_that_has_only_the_fence_of_a_lease_does_not_end_it(line, changes) -> None:
    line.register("F1", sockets="AB")
    line.register("F2")
    line.order("GM-1", "GM-2")
    lease = line.started[0]
    foreign = line.summary(lease, Outcome.PASS, Fault.NONE).model_copy(update=changes)
    line.submit_again(foreign)
    assert line.kept[-1].set_aside
    assert line.unit("GM-1").fence == lease.fence
    assert line.unit("GM-1").attempts == []


def test_a_line_with_a_new_journal_gives_out_fences_that_no_station_has_seen(line) -> None:
    line.register("F1", newest_fence=700)
    line.order("GM-1")
    assert line.newest.fence == 701, "anything up to 700 is stale to this station"


def test_an_agent_that_was_taken_over_keeps_no_lease_alive(line) -> None:
    line.register("F1")
    line.order("GM-1")
    lease = line.newest
    line.register("F1", incarnation=2)
    line.wait(line.settings.lease_duration_s - 1.0)
    answer = line.renew("F1", lease.fence, incarnation=1)
    assert answer.revoked == (lease.fence,)
    assert answer.register_again, "its registration is then refused, and it stops"
    line.wait(1.5)
    assert "lease_lapsed" in line.alarms


def test_a_socket_that_only_disturbs_rests_ever_longer(line) -> None:
    line.register("F1")
    line.order("GM-1")
    rests = []
    for _ in range(4):
        begun = len(line.started)
        waited = 0.0
        line.submit(line.newest, Outcome.ERROR, Fault.FIXTURE)
        while len(line.started) == begun and waited < 1000:
            line.wait(1.0)
            waited += 1.0
            line.renew("F1")
        rests.append(waited)
    assert rests == [0.0, 5.0, 10.0, 20.0]


# --- orders ----------------------------------------------------------------------------------------


def test_orders_are_idempotent_and_wrong_ones_are_refused(line) -> None:
    assert line.order("GM-1", "GM-2", order_id="o1") == OrderAccepted(order_id="o1", accepted=2)
    assert line.order("GM-1", "GM-2", order_id="o1") == OrderAccepted(order_id="o1", accepted=2)
    assert line.order("GM-2", "GM-3", order_id="o2").already_known == ("GM-2",)
    assert isinstance(line.order("GM-4", "GM-4"), RequestRejected)
    renamed = ONE_OPERATION.model_copy(update={"name": "gnc_module"})
    assert "another route" in line.order("GM-5", route=renamed).what
    ships = Operation(name="functional", on_confirmed_failure=Disposition.SHIP)
    wrong = ONE_OPERATION.model_copy(update={"operations": (ships,)})
    assert "as SHIP" in line.order("GM-6", route=wrong).what
    assert set(line.core.line.units) == {"GM-1", "GM-2", "GM-3"}


# --- order of the queue ----------------------------------------------------------------------------


def test_a_retest_overtakes_only_what_became_ready_within_its_credit(new_line) -> None:
    line = new_line(LineSettings(retest_credit_s=60.0))
    line.order("OLD", route=ONE_OPERATION)
    line.wait(59.0)
    line.register("F1", sockets="A")
    line.register("F2", sockets="A", incarnation=1)
    first = line.started[0]
    assert first.unit.serial == "OLD"
    line.order("MID", "NEW", route=ONE_OPERATION)  # MID takes F2
    line.submit(first, Outcome.FAIL)  # NEW takes F1, where OLD failed
    assert [lease.unit.serial for lease in line.started] == ["OLD", "MID", "NEW"]
    line.order("LAST", route=ONE_OPERATION)
    line.submit(line.started[1])
    assert line.newest.unit.serial == "OLD"


@given(waits=st.lists(st.floats(min_value=0.0, max_value=50.0), min_size=2, max_size=12))
def test_units_are_served_in_the_order_in_which_they_became_ready(waits: list[float]) -> None:
    from coordinator.core.dispatch import Dispatcher
    from coordinator.core.line_state import Line, Socket, Unit

    dispatcher, line = Dispatcher(), Line(LineSettings())
    plan = {"functional": None}
    dispatcher.place(Socket("F1/A", "F1", "A", plan), in_service=True, free=True)  # type: ignore[arg-type]
    for arrival, ready_s in enumerate(waits, start=1):
        unit = Unit(f"U{arrival}", "gnc_module", "L", ONE_OPERATION, arrival, ready_s, 0.0)
        unit.failed_here = arrival % 2  # every other one is a retest, of another socket
        line.units[unit.serial] = unit
        dispatcher.join(unit, 10.0)
    served = []
    while (proposal := dispatcher.next_proposal(line, 0.0)) is not None:
        served.append(proposal.entry)
        dispatcher.leave(line.units[proposal.entry[2]])
    expected = sorted(
        (ready_s - 10.0 * (arrival % 2), arrival, f"U{arrival}") for arrival, ready_s in enumerate(waits, 1)
    )
    assert served == expected


# --- replay ----------------------------------------------------------------------------------------


def test_the_journal_alone_gives_the_line_again(line) -> None:
    line.register("F1", sockets="AB")
    line.register("T1", "imu_calibration")
    line.order("GM-1", "GM-2", "GM-3")
    line.submit(line.started[0], Outcome.FAIL)
    line.submit(line.started[1])
    line.renew("F1")
    line.wait(30.0)
    line.renew("T1", incarnation=1)
    again = CoordinatorCore()
    for fact in line.journal:
        again.replay(FACT.validate_json(fact.model_dump_json()))
    assert again.line == line.core.line


def test_after_a_restart_offers_are_repeated_and_running_leases_get_a_full_term(line) -> None:
    line.register("F1", sockets="AB")
    line.order("GM-1", "GM-2")
    line.accept(line.started[0])
    line.wait(9.0)
    journal = list(line.journal)
    line.core = CoordinatorCore()
    for fact in journal:
        line.core.replay(fact)
    line.timers.clear()
    line.started.clear()
    line.start()
    assert [lease.unit.serial for lease in line.started] == ["GM-2"]
    line.wait(9.5)
    assert len(line.core.line.leases) == 2
    line.wait(1.0)
    assert line.core.line.leases == {}

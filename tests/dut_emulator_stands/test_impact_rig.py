"""The impact rig: the table's motion against its equation, phases, stamps, limits, and the command port."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.stats import kstest

from dut_emulator.interfaces import BenchModelError
from dut_emulator.motion.impact_profile import (
    Impacts,
    StampsFrames,
    TableResponse,
    TakesFrames,
    since_trigger_s,
)
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.stands.catalogue import live_stand, recording_stand
from dut_emulator.stands.impact_rig.rig import ImpactRun
from protocol.bench_description import Site
from protocol.errors import TestloomError
from protocol.fog import FRAME_BYTES
from protocol.impact_rig import RECORD_DTYPE, RECORD_HEAD, stamp_of

SITE = Site(latitude_deg=39.96, gravity_m_s2=9.8013)
EARTH_UP_RAD_S = 7.292115e-5 * math.sin(math.radians(39.96))
COUNT_S = 3556.21e-6 / 32_767


def run_of(seed: int = 1, **values: float) -> ImpactRun:
    run = recording_stand("impact_rig", seed, SITE).run("impact", profile_named("impact").values(values))
    assert isinstance(run, ImpactRun)
    return run


def test_the_table_jumps_and_brakes_as_its_equation_says() -> None:
    response = TableResponse(ringing=0.0)
    jump, dry = math.radians(40.0), response.dry_rate_rad_s

    def friction(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -(state[1] + dry) / response.decay_s]

    stop_s = response.stop_s(jump)
    assert stop_s == pytest.approx(0.2 * math.log(21.0))
    times_s = np.linspace(0.0, stop_s, 50)
    solved = solve_ivp(friction, (0.0, stop_s), [0.0, jump], t_eval=times_s, rtol=1e-11, atol=1e-13).y
    jumps = np.full(50, jump)
    np.testing.assert_allclose(response.rate_rad_s(times_s, jumps), solved[1], atol=1e-9)
    np.testing.assert_allclose(response.angle_rad(times_s, jumps), solved[0], atol=1e-9)
    around = np.array([-1e-12, 0.0, stop_s * (1 + 1e-9), 10.0])
    np.testing.assert_allclose(response.rate_rad_s(around, jumps[:4]), [0.0, jump, 0.0, 0.0], rtol=1e-15)


def test_angle_is_the_integral_of_rate_with_ringing_over_several_impacts() -> None:
    impacts = Impacts(np.array([0.1, 1.3]), np.radians([40.0, 30.0]), TableResponse())
    grid_s = np.linspace(0.0, 2.5, 500_001)
    rate, angle = impacts.motion(grid_s)
    steps = np.diff(grid_s) * (rate[1:] + rate[:-1]) / 2
    # the trapezoid of a step of 40 deg/s inside 5 us is wrong by at most half of it
    np.testing.assert_allclose(angle[1:], np.cumsum(steps), atol=math.radians(40) * 5e-6)
    assert rate[grid_s == 0.1][0] == pytest.approx(math.radians(40), rel=1e-6)
    assert abs(np.ptp(rate[(grid_s > 0.1) & (grid_s < 0.105)])) > math.radians(5)  # it rings
    forgotten = Impacts(np.empty(0), np.empty(0), TableResponse())
    for time_s, jump in zip(impacts.times_s.tolist(), impacts.jumps_rad_s.tolist(), strict=True):
        forgotten = forgotten.with_impact(time_s, jump, 1)
    assert len(forgotten.times_s) == 1
    late = grid_s > 1.3
    np.testing.assert_allclose(forgotten.motion(grid_s[late])[1], angle[late], rtol=1e-12)


def test_what_acts_on_the_unit() -> None:
    run = run_of(shots=2, peak_rate_deg_s=40.0)
    hit = run.impact_times_s[1]
    acting = run.stimulus(np.array([0.0, np.nextafter(hit, 0.0), hit]))
    up = acting.channel("rate_rad_s")[:, 2]
    np.testing.assert_allclose(up[:2], EARTH_UP_RAD_S, rtol=1e-12)
    assert up[2] - EARTH_UP_RAD_S == pytest.approx(math.radians(40), rel=0.091)  # strikes: 3 %, cut at 3
    assert np.linalg.norm(acting.channel("rate_rad_s")[1]) == pytest.approx(7.292115e-5, rel=1e-12)
    np.testing.assert_array_equal(acting.channel("specific_force_m_s2"), [[0.0, 0.0, 9.8013]] * 3)
    assert acting.channel("angles_rad")[1, 0] > math.radians(5)  # where the first impact has left it


def test_random_impacts_fall_evenly_into_frames_and_triggers_follow_within_nanoseconds() -> None:
    run = run_of(seed=5, shots=20_000)
    for rate_hz in (500.0, 1500.0, 2000.0, 4000.0):
        assert kstest(run.impact_times_s * rate_hz % 1.0, "uniform").pvalue > 1e-3
    late = run.trigger_times_s - run.impact_times_s
    assert late.min() > 0.0
    assert late.max() < 80e-9
    assert 3e-9 < late.std() < 7e-9
    (events,) = run.events()
    np.testing.assert_array_equal(events.columns["t"], run.trigger_times_s)
    np.testing.assert_array_equal(events.columns["shot"], np.arange(1, 20_001))
    assert not np.array_equal(run.impact_times_s[:10], run_of(seed=6, shots=10).impact_times_s)


def test_programmed_impacts_keep_their_instants() -> None:
    run = run_of(shots=8, next_frame_us=100.0, step_us=60.0, frame_rate_hz=2000.0)
    ahead_us = 500.0 - run.impact_times_s * 1e6 % 500.0
    np.testing.assert_allclose(ahead_us, (100.0 + 60.0 * np.arange(8)) % 500.0, atol=6.1)


def test_stamps_are_the_documented_words() -> None:
    after = np.array([np.nan, 0.0, COUNT_S * 0.999, COUNT_S * 1.0001, 500e-6, 3556.2e-6, 3556.21e-6, 1.0])
    expected = [0x0000, 0x8000, 0x8000, 0x8001, 0x8000 + 4607, 0xFFFE, 0xFFFF, 0xFFFF]
    assert stamp_of(after).tolist() == expected  # 500 / 0.108530 = 4607.0
    assert pytest.approx(108.53e-9, abs=5e-12) == COUNT_S
    run = run_of(shots=3)
    trigger = run.trigger_times_s[1]
    assert isinstance(run, StampsFrames)
    received = np.array([0.0, trigger - 1e-6, trigger + 10e-6, 1.9995, 2.0])
    assert run.stamps(received).tolist() == [0, 0, 0x8000 + int(10e-6 / COUNT_S), 0xFFFF, 0]


@given(
    armed=st.lists(st.integers(0, 50), max_size=4),
    triggers=st.lists(st.integers(0, 50), max_size=4),
    at=st.integers(0, 60),
)
def test_the_first_trigger_after_the_last_arming_starts_the_timer(
    armed: list[int], triggers: list[int], at: int
) -> None:
    last = max((moment for moment in armed if moment <= at), default=None)
    starts = [moment for moment in triggers if last is not None and last <= moment <= at]
    found = since_trigger_s(
        np.array([float(at)]), np.sort(np.array(armed, float)), np.sort(np.array(triggers, float))
    )
    np.testing.assert_array_equal(found, [at - min(starts) if starts else np.nan])


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"shots": 2.5}, "2.5 shots"),
        ({"peak_rate_deg_s": 150.0}, "cannot strike for 150 deg/s"),
        ({"spacing_s": 0.5}, "not at rest for the next one 0.5 s"),
    ],
)
def test_what_the_rig_cannot_do_is_refused(values: dict[str, float], what: str) -> None:
    with pytest.raises(TestloomError, match=re.escape(what)) as refused:
        run_of(1, **values)
    assert "give" in refused.value.remedy


def test_the_spacing_that_a_refusal_names_is_enough() -> None:
    with pytest.raises(TestloomError) as refused:
        run_of(spacing_s=0.5, shots=200.0)
    (least,) = re.findall(r"[\d.]+(?= s,)", refused.value.remedy)
    run = run_of(spacing_s=float(least), shots=200.0)
    at_slots = run.stimulus(np.arange(200.0) * float(least)).channel("rate_rad_s")[:, 2]
    np.testing.assert_allclose(at_slots, EARTH_UP_RAD_S, rtol=1e-12)


def test_the_port_arms_fires_counts_and_refuses() -> None:
    stand = live_stand("impact_rig", 3, SITE, "IR-77")
    port = stand.port
    assert isinstance(stand.surroundings, TakesFrames)
    assert port.command("*IDN?", 0.0) == "Testloom,IR1,IR-77,1.0"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", port.command("CAL?", 0.0))
    assert port.command("STAT?", 0.0) == "SAFE,0,0"
    assert port.command("FIRE", 0.0).startswith("ERR 11")
    assert port.command("PEAK 20", 0.0) == "OK"
    assert port.command("PEAK 101", 0.0).startswith("ERR 12")
    assert port.command("PEAK?", 0.0) == "20"
    assert port.command("arm", 1.0) == "OK 0.500000000"
    assert port.command("STAT?", 1.4) == "COCKING,0,0"
    assert port.command("STAT?", 1.5) == "ARMED,0,0"
    assert port.command("FIRE 1.51", 1.5).startswith("ERR 12")
    word, duration = port.command("FIRE", 1.5).split()
    assert word == "OK"
    assert port.command("ARM", 1.52).startswith("ERR 10")
    assert port.command("STAT?", 1.52) == "MOVING,1,1"
    rest_s = 1.5 + float(duration)
    rates = stand.surroundings.stimulus(np.array([1.5, 1.511, rest_s])).channel("rate_rad_s")[:, 2]
    assert rates[0] == rates[2] == pytest.approx(EARTH_UP_RAD_S, rel=1e-12)
    assert rates[1] > math.radians(15)
    assert port.command("STAT?", rest_s) == "SAFE,1,1"
    assert port.command("ARM", 3.0).startswith("OK")
    assert port.command("STAT?", 3.1) == "COCKING,1,0"  # the timer is reset
    assert port.command("SAFE", 3.6) == "OK"
    assert port.command("STAT?", 3.7) == "SAFE,1,0"
    assert port.command("COUNT?", 3.7) == "1"
    low, high, least = (float(field) for field in port.command("LIM?", 3.7).split(","))
    assert (low, high) == (1.0, 100.0)
    assert 0.5 < least < 1.0
    for line, code in (
        ("FIRE soon", 2),
        ("ARM now", 2),
        ("STRE MAYBE", 2),
        ("PEAK", 2),
        ("JUMP", 1),
        ("", 1),
    ):
        assert port.command(line, 3.7).startswith(f"ERR {code} ")


def test_faults_are_seen_as_on_a_real_rig() -> None:
    stand = live_stand("impact_rig", 3, SITE, "IR-77")
    port = stand.port
    with pytest.raises(BenchModelError, match="lost_reference"):
        port.inject("lost_reference", 0.0)
    port.inject("no_trigger", 0.0)
    assert port.command("ARM", 0.0).startswith("OK")
    assert port.command("FIRE", 1.0).startswith("OK")
    assert port.command("COUNT?", 2.0) == "0"
    assert stand.surroundings.stimulus(np.array([1.011])).channel("rate_rad_s")[0, 2] > math.radians(25)
    port.inject("slider_stuck", 2.0)
    assert port.command("ARM", 2.0).startswith("OK")
    assert port.command("FIRE", 3.0).startswith("OK")
    assert port.command("STAT?", 4.0) == "SAFE,1,0"
    assert stand.surroundings.stimulus(np.array([3.011])).channel("rate_rad_s")[0, 2] < 1e-4
    port.inject("none", 4.0)
    assert port.command("ARM", 4.0).startswith("OK")
    port.inject("door_open", 5.0)
    assert port.command("STAT?", 5.0) == "FAULT,1,0"
    assert port.command("FIRE", 5.0).startswith("ERR 14")
    port.inject("none", 6.0)
    assert port.command("FIRE", 6.0).startswith("ERR 11")


def test_the_module_streams_each_frame_with_its_stamp() -> None:
    stand = live_stand("impact_rig", 3, SITE, "IR-77")
    unit_line = stand.surroundings
    assert isinstance(unit_line, TakesFrames)
    frames = np.arange(3 * FRAME_BYTES, dtype=np.uint8).reshape(3, FRAME_BYTES)
    unit_line.take_frames(frames, np.array([0.1, 0.2, 0.3]))
    assert stand.port.advance(0.3) == b""
    assert stand.port.next_event_s() is None
    assert stand.port.command("STRE ON", 0.5) == "OK"
    assert stand.port.next_event_s() == pytest.approx(0.55)
    assert stand.port.command("ARM", 0.5).startswith("OK")
    assert stand.port.command("FIRE", 1.0).startswith("OK")
    unit_line.take_frames(frames, np.array([0.4, 1.0, 1.5]))
    data = stand.port.advance(1.5)
    assert len(data) == 2 * 24  # 2 head, 12 frame, 2 stamp, 8 time; the first came before the stream
    records = np.frombuffer(data, RECORD_DTYPE)
    assert data[:2] == RECORD_HEAD == b"\xa5\x5a"
    np.testing.assert_array_equal(records["frame"], frames[1:])
    assert records["stamp"].tolist() == [0, 0xFFFF]
    assert records["received_s"].tolist() == [1.0, 1.5]
    assert stand.port.advance(1.6) == b""

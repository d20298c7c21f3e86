"""Turntables behind their command ports: what they answer, refuse, and do when something is wrong."""

import math

import numpy as np
import pytest

from dut_emulator.interfaces import BenchModelError
from dut_emulator.stands.catalogue import live_stand, recording_stand
from dut_emulator.stands.recording_stand import LiveStand
from protocol.bench_description import Site
from protocol.stand_stream import STAND_SAMPLE_DTYPE

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.797, heading_deg=30.0)
KINDS = ("three_axis_turntable", "two_axis_turntable", "thermal_turntable", "non_magnetic_turntable")


class Bench:
    """A stand and its clock."""

    def __init__(self, kind: str) -> None:
        self.live: LiveStand = live_stand(kind, 5, SITE, "S-1")
        self.now_s = 0.0

    def ask(self, line: str) -> str:
        answer = self.live.port.command(line, self.now_s)
        if answer.startswith("OK "):
            self.now_s += float(answer.split()[1])
        return answer

    def home(self) -> None:
        assert self.ask("HOME") == "OK"
        self.now_s += 10.0

    def angles(self) -> list[float]:
        return [float(text) for text in self.ask("STAT?").split(",")[1:4]]


@pytest.mark.parametrize("kind", KINDS)
def test_every_turntable_says_who_it_is_what_it_can_and_until_when_it_is_calibrated(kind: str) -> None:
    bench = Bench(kind)
    assert bench.ask("*IDN?").split(",")[2] == "S-1"
    assert bench.ask("CAL?") == recording_stand(kind, 5, SITE).identity.calibration_due
    limits = [float(text) for text in bench.ask("LIM?").split(",")]
    assert len(limits) == 6
    assert bench.ask("STAT?").startswith("NOREF,")
    assert bench.ask("MOVE 0,0,0").startswith("ERR 11")
    bench.home()
    assert bench.ask("STAT?").startswith("READY,")
    driven = [rate > 0 for rate in limits[:3]]
    for axis, drive in zip(("outer", "middle", "inner"), driven, strict=True):
        answer = bench.ask(f"ROT {axis},90,4,1")
        assert answer == "OK 4.000000000" if drive else answer.startswith("ERR 15")
    recording = recording_stand(kind, 5, SITE).effects
    assert [e for e in bench.live.surroundings.effects if e.word != "remount_misalignment"] == [
        e for e in recording if e.word != "remount_misalignment"
    ]


def test_the_two_axis_table_keeps_its_third_angle() -> None:
    bench = Bench("two_axis_turntable")
    bench.home()
    assert bench.ask("MOVE 10,0,0") == "ERR 15 the outer axis has no drive and stays at 0 deg"
    assert bench.ask("MOVE 0,-90,45").startswith("OK")
    assert bench.angles() == pytest.approx([0.0, -90.0, 45.0])
    force = bench.live.surroundings.stimulus(np.array([bench.now_s])).specific_force_m_s2
    assert force is not None
    assert force[0] == pytest.approx([9.797, 0.0, 0.0])


def test_the_non_magnetic_table_homes_with_its_axis_north_and_reaches_15_turns_a_second() -> None:
    bench = Bench("non_magnetic_turntable")
    bench.home()
    assert bench.angles() == pytest.approx([30.0, 0.0, -90.0])
    field = bench.live.surroundings.stimulus(np.array([bench.now_s])).field_t
    assert field is not None
    assert field[0, 2] == pytest.approx(27e-6)
    # 5400 °/s for 10 s between ramps of 5.4 s
    assert bench.ask(f"ROT middle,{5400 * 15.4},20.8,5.4") == "OK 20.800000000"
    assert bench.ask(f"ROT middle,{5410 * 15.4},20.8,5.4").startswith("ERR 12 peak rate 5410.0")


def test_a_drive_that_does_not_reach_its_rate_ends_short() -> None:
    bench = Bench("three_axis_turntable")
    bench.home()
    bench.live.port.inject("rate_not_reached", bench.now_s)
    began_s = bench.now_s
    assert bench.ask("ROT outer,1080,5,2.2") == "OK 5.000000000"
    assert bench.angles()[0] == pytest.approx(0.9 * 1080.0)
    rate = bench.live.surroundings.stimulus(np.array([began_s + 2.5])).rate_rad_s
    assert rate is not None
    assert np.degrees(rate[0, 2]) == pytest.approx(0.9 * 1080 / 2.8, rel=1e-4)
    bench.live.port.inject("none", bench.now_s)
    bench.ask("MOVE 0,0,0")
    bench.ask("ROT outer,1080,5,2.2")
    assert bench.angles()[0] == pytest.approx(1080.0)


def test_the_swing_of_paper_2_is_a_sine_within_the_limits() -> None:
    bench = Bench("two_axis_turntable")
    bench.home()
    bench.ask("MOVE 0,0,-80")
    began_s = bench.now_s
    assert bench.ask("SWING inner,80,200,4") == f"OK {4 * 2 * math.pi / 2.5:.9f}"
    times = np.linspace(began_s, bench.now_s, 4001)
    acting = bench.live.surroundings.stimulus(times)
    assert acting.rate_rad_s is not None
    assert acting.angles_rad is not None
    since = times - began_s
    np.testing.assert_allclose(np.degrees(acting.angles_rad[:, 2]), -80 * np.cos(2.5 * since), atol=1e-6)
    np.testing.assert_allclose(np.degrees(acting.rate_rad_s[:, 0]), 200 * np.sin(2.5 * since), atol=0.01)
    assert bench.ask("STAT?").startswith("READY,")
    assert bench.ask("SWING middle,80,200,4").startswith("ERR 12 acceleration 500.0")
    assert bench.ask("SWING inner,80,700,4").startswith("ERR 12 peak rate 700.0")
    assert bench.ask("SWING inner,80,200,1.5").startswith("ERR 15")
    assert bench.ask("SWING outer,80,200,1").startswith("ERR 15 the outer axis has no drive")


def test_a_swing_can_be_stopped_anywhere() -> None:
    bench = Bench("three_axis_turntable")
    bench.home()
    began_s = bench.now_s
    bench.ask("SWING inner,80,200,4")
    bench.now_s = began_s + math.pi / 5  # a quarter period: 80° further at 200 °/s
    assert bench.ask("STOP") == "OK"
    bench.now_s += 200 / 500
    assert bench.ask("STAT?").startswith("READY,")
    assert bench.angles()[2] == pytest.approx(80 + 200**2 / (2 * 500))


def test_a_fault_that_a_turntable_cannot_have() -> None:
    with pytest.raises(BenchModelError, match="rate_not_reached"):
        Bench("two_axis_turntable").live.port.inject("tired", 0.0)


def test_the_chamber_ramps_and_its_stream_says_so() -> None:
    bench = Bench("thermal_turntable")
    bench.home()
    assert bench.ask("STRE ON,1") == "OK"
    began_s = bench.now_s
    assert bench.ask("TEMP -37,3") == "OK 1200.000000000"  # 60 °C at 3 °C/min
    assert bench.ask("TEMP?") == "-37.00,-37"
    rows = np.frombuffer(bench.live.port.advance(bench.now_s), dtype=STAND_SAMPLE_DTYPE)
    told = np.interp(rows["time_s"], [began_s, began_s + 1200.0], [23.0, -37.0])
    np.testing.assert_allclose(rows["temperature_c"], told, atol=1e-9)
    halfway = bench.live.surroundings.stimulus(np.array([began_s + 600.0]))
    assert halfway.temperature_c[0] == pytest.approx(-7.0)
    assert bench.ask("STAT?").endswith(",-37.000000")


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("TEMP 120,3", "ERR 12 120 degC outside -60 to 100 degC"),
        ("TEMP 20,9", "ERR 12 ramp 9 degC/min above the limit of 5 degC/min"),
        ("TEMP 20,0", "ERR 15 the ramp must be above 0"),
        ("TEMP 20", "ERR 2 TEMP does not take 1 arguments"),
        ("TEMP hot,3", "ERR 2 'hot' is not a number"),
    ],
)
def test_what_the_chamber_cannot_do(line: str, answer: str) -> None:
    bench = Bench("thermal_turntable")
    assert bench.ask(line) == answer
    assert bench.ask("TEMP?") == "23.00,23"


def test_an_open_door_lets_the_room_in() -> None:
    bench = Bench("thermal_turntable")
    bench.home()
    bench.ask("TEMP 63,4")
    bench.live.port.inject("door_open", bench.now_s)
    assert bench.ask("TEMP 63,4").startswith("ERR 13")
    bench.now_s += 60.0  # 20 °C/min
    assert bench.ask("TEMP?") == "43.00,23"
    bench.live.port.inject("none", bench.now_s)
    bench.now_s += 3600.0
    assert bench.ask("TEMP?") == "43.00,43"
    assert bench.ask("TEMP 23,4") == "OK 300.000000000"


def test_a_stand_without_a_chamber_knows_no_temperature_commands() -> None:
    assert Bench("three_axis_turntable").ask("TEMP?") == "ERR 1 unknown command TEMP?"

"""The turntable over its command port and its stream."""

import math
import struct

import numpy as np
import pytest

from protocol.gnc_module import BOOT_DURATION_S, FrameType

SAMPLE_DOUBLES = 15
GRAVITY_M_S2 = 9.8013


@pytest.fixture
def table(start_bench):
    """A homed turntable bench: bench, participant, command port, stream link."""
    bench = start_bench(kind="three_axis_turntable", gravity_m_s2=GRAVITY_M_S2)
    participant = bench.participant()
    commands = bench.instrument(bench.description.stand.command)
    stream = participant.open(bench.description.stand.stream)
    assert commands.query("STAT?").startswith("NOREF,")
    assert commands.query("MOVE 0,0,0").startswith("ERR ")
    assert commands.query("HOME") == "OK"
    while commands.query("STAT?").startswith("MOVING"):
        participant.wait(participant.now_s + 0.5)
    return bench, participant, commands, stream


def do(participant, commands, line: str) -> None:
    """A motion, until it is at rest."""
    word, duration = commands.query(line).split()
    assert word == "OK"
    participant.wait(participant.now_s + float(duration))
    assert commands.query("STAT?").startswith("READY,")


def samples(stream) -> np.ndarray:
    return np.frombuffer(bytes(stream.received), "<f8").reshape(-1, SAMPLE_DOUBLES)


def test_a_turntable_bench_has_a_stand_and_no_board(table) -> None:
    bench, _, commands, _ = table
    assert bench.description.operations == ("imu_calibration",)
    assert bench.description.multimeter is bench.description.oscilloscope is None
    assert len(bench.description.sockets) == 1
    assert bench.description.sockets[0].board is None
    assert commands.query("*IDN?").startswith("Testloom,TT3,")
    assert [float(x) for x in commands.query("LIM?").split(",")] == [400, 400, 1000, 250, 250, 500]


def test_body_x_points_up_at_middle_minus_90(table) -> None:
    _, participant, commands, stream = table
    do(participant, commands, "MOVE 30,-90,0")
    assert commands.query("STRE ON,200") == "OK"
    participant.wait(participant.now_s + 1.0)
    assert commands.query("STRE OFF") == "OK"
    read = samples(stream)
    assert len(read) == 201  # both ends of the second
    np.testing.assert_allclose(np.diff(read[:, 0]), 0.005, atol=1e-9)
    np.testing.assert_allclose(read[:, 4:7], [[GRAVITY_M_S2, 0, 0]] * 201, atol=5e-4)
    np.testing.assert_allclose(np.degrees(read[:, 7:10]), [[30, -90, 0]] * 201, atol=2e-3)
    participant.wait(participant.now_s + 1.0)
    assert len(samples(stream)) == 201  # the stream is off


def test_a_turn_integrates_to_its_angle_in_one_long_wait(table) -> None:
    """1080 degrees about z with ramps of 2.2 s: the integral of the streamed rate, and nothing lost."""
    _, participant, commands, stream = table
    commands.query("STRE ON,200")
    do(participant, commands, "ROT outer,1080,5.0,2.2")
    read = samples(stream)
    assert len(read) == 1001
    integral = np.degrees(np.trapezoid(read[:, 3], read[:, 0]))
    assert integral == pytest.approx(1080.0, abs=0.01)
    assert np.degrees(np.abs(read[:, 3]).max()) == pytest.approx(1080 / 2.8, abs=0.01)


def test_five_minutes_in_one_wait_arrive_complete(table) -> None:
    _, participant, commands, stream = table
    commands.query("STRE ON,200")
    participant.wait(participant.now_s + 300.0)
    np.testing.assert_allclose(np.diff(samples(stream)[:, 0]), 0.005, atol=1e-9)
    assert len(samples(stream)) == 60_001


def test_a_watched_stream_wakes_at_its_next_sample(table) -> None:
    _, participant, commands, stream = table
    commands.query("STRE ON,100")
    begin_s = participant.now_s
    for count in range(1, 4):
        participant.wait(begin_s + 5.0, stream)
        assert len(samples(stream)) == count
        assert participant.now_s == pytest.approx(begin_s + (count - 1) / 100, abs=1e-9)


def test_what_a_turntable_refuses(table) -> None:
    bench, participant, commands, _ = table
    assert commands.query("ROT outer,1080,5.0,2.5").startswith("ERR 12 ")  # a peak of 432 deg/s
    for line in (
        "ROT outer,1080",
        "MOVE a,b,c",
        "MOVE nan,0,0",
        "STRE MAYBE",
        "STRE ON,1e9",
        "ROT up,1,1,0.1",
    ):
        assert commands.query(line).startswith("ERR "), line
    assert commands.query("DANCE").startswith("ERR 1 ")
    assert commands.query("MOVE " + "9" * 400 + ",0,0").startswith("ERR ")
    hand = bench.participant("hand", observer=True)
    assert commands.query("MOVE 90,0,0").startswith("OK ")
    assert hand.ask(op="inject", target="stand", fault="door_open")["ok"]
    assert commands.query("STAT?").startswith("FAULT,")
    assert commands.query("MOVE 0,0,0").startswith("ERR 13 ")
    assert hand.ask(op="inject", target="stand", fault="none")["ok"]
    participant.wait(participant.now_s + 2.0)
    assert commands.query("STAT?").startswith("READY,")
    assert hand.ask(op="inject", target="stand", fault="lost_reference")["ok"]
    assert commands.query("MOVE 0,0,0").startswith("ERR 11 ")
    assert "cannot have" in hand.ask(op="inject", target="stand", fault="garbage")["what"]


def test_unit_and_stand_stream_together_and_agree(table) -> None:
    """The unit's accelerometers on the turned table read the stand's specific force, to their 2 %."""
    from protocol.frames import FrameBlock
    from protocol.gnc_module import ACC_LSB_G, SAMPLE_DTYPE
    from protocol.units_of_measure import STANDARD_GRAVITY_M_S2

    bench, participant, commands, stream = table
    do(participant, commands, "MOVE 0,-90,0")
    assert participant.ask(op="insert", socket="1", serial="GNC-0001")["ok"]
    supply = bench.instrument(bench.description.power_supply)
    for command in ("VOLT 5,(@1)", "CURR 1,(@1)", "OUTP ON,(@1)"):
        assert supply.command(command) == '0,"No error"'
    link = participant.open(bench.description.sockets[0].unit_link)
    participant.wait(participant.now_s + BOOT_DURATION_S + 0.1)
    participant.exchange(link, FrameType.START_STREAM, struct.pack("<HB", 200, 0))
    commands.query("STRE ON,200")
    participant.wait(participant.now_s + 10.0)
    (block,) = (found for found in link.frames() if isinstance(found, FrameBlock))
    acc = block.payloads.view(SAMPLE_DTYPE)["acc"].reshape(-1, 3) * ACC_LSB_G * STANDARD_GRAVITY_M_S2
    expected = samples(stream)[:, 4:7].mean(axis=0)
    assert math.isclose(expected[0], GRAVITY_M_S2, rel_tol=1e-6)
    np.testing.assert_allclose(acc.mean(axis=0), expected, atol=0.6)

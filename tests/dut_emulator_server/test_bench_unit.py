"""A unit on a bench, over its real links, seen by a client that shares no code with the stations."""

import struct

import numpy as np
import pytest

from protocol.frames import FrameBlock
from protocol.gnc_module import (
    BOOT_DURATION_S,
    IDENTITY_LAYOUT,
    SAMPLE_DTYPE,
    SELF_TEST_LAYOUT,
    TEST_DURATION_S,
    FrameType,
    ReplyStatus,
    SelfTest,
)


@pytest.fixture
def powered(start_bench):
    """A bench with a booted unit in socket 1: bench, participant, its RS-422 link."""
    bench = start_bench()
    participant = bench.participant()
    supply = bench.instrument(bench.description.power_supply)
    link = participant.open(bench.description.sockets[0].unit_link)
    assert participant.ask(op="insert", socket="1", serial="GNC-0001")["ok"]
    for command in ("VOLT 5.0,(@1)", "CURR 0.8,(@1)", "OUTP ON,(@1)"):
        assert supply.command(command) == '0,"No error"'
    participant.wait(participant.now_s + BOOT_DURATION_S + 0.01)
    return bench, participant, link


def test_a_unit_boots_and_says_who_it_is(powered) -> None:
    _, participant, link = powered
    reply = participant.exchange(link, FrameType.IDENTIFY)
    assert reply.type == FrameType.IDENTIFY | 0x80
    status, serial, _, _ = IDENTITY_LAYOUT.unpack(reply.payload)
    assert status == ReplyStatus.DONE
    assert serial.rstrip(b"\0") == b"GNC-0001"


@pytest.mark.parametrize("test", [SelfTest.CPU, SelfTest.SDRAM, SelfTest.GNSS])
def test_a_self_test_takes_exactly_its_fixed_time(powered, test) -> None:
    _, participant, link = powered
    begin_s = participant.now_s
    accepted = participant.exchange(link, FrameType.SELF_TEST, SELF_TEST_LAYOUT.pack(test, 0))
    assert accepted.payload[0] == ReplyStatus.ACCEPTED
    done = participant.next_frame(link, 10.0)
    assert done.payload[0] == ReplyStatus.DONE
    assert participant.now_s - begin_s == pytest.approx(TEST_DURATION_S[test], abs=1e-3)


def test_a_stream_of_30_s_arrives_complete_and_counted(powered) -> None:
    _, participant, link = powered
    assert participant.exchange(link, FrameType.START_STREAM, struct.pack("<HB", 200, 0)).payload[0] == 0
    until_s = participant.now_s + 30.0
    before = len(link.received)
    reply = participant.wait(until_s)
    assert reply["handed_over"][link.name] == len(link.received)
    blocks = [found for found in link.frames() if isinstance(found, FrameBlock)]
    counters = np.concatenate([block.payloads.view(SAMPLE_DTYPE)["counter"].ravel() for block in blocks])
    assert len(counters) == pytest.approx(6000, abs=60)
    np.testing.assert_array_equal(counters, np.arange(len(counters)))
    assert len(link.received) - before == len(counters) * (SAMPLE_DTYPE.itemsize + 8)
    assert link.parser.statistics.dropped_bytes == 0

"""Link faults by themselves: what each does to whole frames, however many come at once."""

import numpy as np
import pytest

from dut_emulator.server.link_faults import GARBAGE_BYTES, Framing, LinkFault
from protocol.frames import FrameParser, encode_equal_frames

COUNT = 50
SAMPLE_BYTES = 64  # a satellite simulator's
STREAM = encode_equal_frames(0x20, 0, np.full((COUNT, 12), 0xEB, dtype=np.uint8))
LINES = b"t1212ABCD\r" * COUNT + b"z\r"


def faulty(framing: Framing, fault: str, data: bytes) -> bytes:
    link = LinkFault(framing, 1, SAMPLE_BYTES if framing is Framing.STAND_STREAM else 0)
    link.fault = fault
    half = len(data) // (2 * COUNT) * COUNT  # whole frames in two calls
    return link.apply(data[:half]) + link.apply(data[half:])


@pytest.mark.parametrize(
    ("fault", "frames", "crc_errors", "dropped"),
    [
        ("none", COUNT, 0, 0),
        ("corrupt_crc", 0, COUNT, 20 * COUNT),
        ("drop", COUNT // 2, 0, 0),
        ("stuck", 0, 0, 0),
    ],
)
def test_on_rs422(fault: str, frames: int, crc_errors: int, dropped: int) -> None:
    parser = FrameParser()
    parser.feed(faulty(Framing.RS422, fault, STREAM))
    parser.flush()
    statistics = parser.statistics
    assert (statistics.frames, statistics.crc_errors, statistics.dropped_bytes) == (
        frames,
        crc_errors,
        dropped,
    )


def test_garbage_between_frames_is_dropped_and_nothing_else() -> None:
    parser = FrameParser()
    parser.feed(faulty(Framing.RS422, "garbage", STREAM))
    parser.flush()
    assert parser.statistics.frames == COUNT
    assert parser.statistics.dropped_bytes == COUNT * GARBAGE_BYTES


def test_on_can_the_adapters_own_answers_stay() -> None:
    assert faulty(Framing.SLCAN, "corrupt_crc", LINES) == b"z\r"
    assert faulty(Framing.SLCAN, "stuck", LINES) == b""
    lines = faulty(Framing.SLCAN, "garbage", LINES).split(b"\r")[:-1]
    assert [line for line in lines if not line.startswith(b"?")] == LINES.split(b"\r")[:-1]


def test_of_a_stands_stream_whole_samples_are_lost() -> None:
    stream = b"".join(bytes([number]) * SAMPLE_BYTES for number in range(COUNT))
    assert faulty(Framing.STAND_STREAM, "drop", stream) == b"".join(
        bytes([number]) * SAMPLE_BYTES for number in range(0, COUNT, 2)
    )

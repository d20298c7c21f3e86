"""The FOG's frames and commands: layout by hand, CRC by the bit, any cut, any damage."""

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.errors import LinkError
from protocol.fog import (
    FRAME_BYTES,
    FRAME_TRANSMISSION_S,
    Command,
    FogCommandParser,
    FogFrameParser,
    encode_command,
    make_frames,
)


def crc_by_the_bit(data: bytes) -> int:
    """CRC-16/CCITT-FALSE as its definition has it."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (register >> 15) ^ (byte >> bit & 1)
            register = (register << 1 & 0xFFFF) ^ (0x1021 if feedback else 0)
    return register


def frames_of(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return make_frames(
        np.arange(count).astype(np.uint8),
        rng.integers(0, 8, count).astype(np.uint8),
        rng.integers(-(2**31), 2**31, count).astype(np.int32),
        rng.integers(-6000, 9000, count).astype(np.int16),
    )


def in_pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[start:end] for start, end in pairwise(places)]


def test_a_frame_is_the_documented_bytes() -> None:
    assert crc_by_the_bit(b"123456789") == 0x29B1
    frame = make_frames(
        np.array([7], np.uint8), np.array([2], np.uint8), np.array([-8_000_000], np.int32),
        np.array([-3999], np.int16),
    ).tobytes()  # fmt: skip
    body = bytes([7, 2]) + struct.pack("<ih", -8_000_000, -3999)
    assert frame == b"\xc5\x5c" + body + struct.pack("<H", crc_by_the_bit(body))
    assert len(frame) == FRAME_BYTES == 12
    assert pytest.approx(12 * 10 / 921_600, rel=1e-12) == FRAME_TRANSMISSION_S
    command = encode_command(Command.BROADCAST, 4000)
    assert command == b"\xc5\xa3\x01\xa0\x0f" + struct.pack("<H", crc_by_the_bit(b"\x01\xa0\x0f"))
    with pytest.raises(LinkError, match="65536"):
        encode_command(Command.BROADCAST, 65536)


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(0, 40),
    garbage=st.lists(st.tuples(st.integers(0, 40), st.binary(max_size=30)), max_size=4),
    cuts=st.lists(st.integers(0, 2000), max_size=12),
)
def test_frames_come_back_from_any_pieces_between_any_garbage(
    count: int, garbage: list[tuple[int, bytes]], cuts: list[int]
) -> None:
    frames = frames_of(count)
    pieces = [frame.tobytes() for frame in frames]
    # a sync in the garbage may lead on to good bytes, but never to a good CRC by the hand of this test
    noise = [(place, junk.replace(b"\xc5", b"\xc4")) for place, junk in garbage]
    for place, junk in sorted(noise, key=lambda one: -one[0]):
        pieces.insert(min(place, count), junk + b"\xc5\x5c")
    data = b"".join(pieces)
    parser, whole = FogFrameParser(), FogFrameParser()
    found = np.concatenate([parser.feed(piece) for piece in in_pieces(data, cuts)])
    np.testing.assert_array_equal(found, whole.feed(data))
    np.testing.assert_array_equal(found, frames)


@pytest.mark.parametrize("damaged", [0, 1, 5, 11])
def test_a_damaged_frame_is_lost_and_no_other(damaged: int) -> None:
    frames = frames_of(5000, seed=3)
    data = bytearray(frames.tobytes())
    for number in (0, 17, 2500, 4999):
        data[number * FRAME_BYTES + damaged] ^= 0x40
    parser = FogFrameParser()
    found = parser.feed(bytes(data))
    np.testing.assert_array_equal(found, np.delete(frames, [0, 17, 2500, 4999]))
    parser.feed(b"\x00" * 24)
    assert parser.dropped_bytes == 4 * FRAME_BYTES + 24


@settings(max_examples=40, deadline=None)
@given(
    sent=st.lists(st.tuples(st.sampled_from(Command), st.integers(0, 65535)), max_size=6),
    cuts=st.lists(st.integers(0, 60), max_size=6),
)
def test_commands_come_back_from_any_pieces(sent: list[tuple[Command, int]], cuts: list[int]) -> None:
    data = b"\xc5".join([b"", *(encode_command(*one) for one in sent)])
    parser = FogCommandParser()
    found = [frame for piece in in_pieces(data, cuts) for frame in parser.feed(piece)]
    assert [(frame.command, frame.argument) for frame in found] == sent

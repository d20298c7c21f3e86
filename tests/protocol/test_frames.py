"""The frame parser against a naive scanner of its own, with any bytes cut in any way."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from protocol.errors import LinkError
from protocol.frames import (
    MAX_FRAME_BYTES,
    MAX_PAYLOAD_BYTES,
    MIN_BLOCK_FRAMES,
    SYNC,
    Frame,
    FrameBlock,
    FrameParser,
    crc16,
    crc16_of_rows,
    encode_equal_frames,
    encode_frame,
)


def crc_bit_by_bit(data: bytes) -> int:
    """CRC-16/CCITT-FALSE by its definition: one bit of the message at a time."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (register >> 15 & 1) ^ (byte >> bit & 1)
            register = (register << 1 & 0xFFFF) ^ (0x1021 if feedback else 0)
    return register


def scan(data: bytes) -> tuple[list[Frame], int]:
    """All frames of a finished input, and the bytes that belong to none: the slow, obvious way."""
    found, dropped, at = [], 0, 0
    while at < len(data):
        length = int.from_bytes(data[at + 4 : at + 6], "little")
        end = at + 8 + length
        whole = data[at : at + 2] == SYNC and at + 8 <= len(data) and length <= MAX_PAYLOAD_BYTES
        if whole and end <= len(data):
            sent = int.from_bytes(data[end - 2 : end], "little")
            if sent == crc_bit_by_bit(data[at + 2 : end - 2]):
                found.append(Frame(data[at + 2], data[at + 3], data[at + 6 : end - 2]))
                at = end
                continue
        at, dropped = at + 1, dropped + 1
    return found, dropped


def singles(found: list[Frame | FrameBlock]) -> list[Frame]:
    """Blocks taken apart."""
    return [frame for item in found for frame in (item.frames() if isinstance(item, FrameBlock) else (item,))]


def parse(data: bytes, cuts: list[int] | None = None) -> tuple[list[Frame], FrameParser]:
    """Everything found when the data come in pieces cut at these places and then the line is silent."""
    parser = FrameParser()
    places = sorted({min(cut, len(data)) for cut in cuts or []})
    found: list[Frame | FrameBlock] = []
    for start, stop in zip([0, *places], [*places, len(data)], strict=True):
        found += parser.feed(data[start:stop])
        assert parser.pending_bytes < MAX_FRAME_BYTES
    return singles(found + parser.flush()), parser


FRAMES = st.builds(
    Frame, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=12) | st.just(SYNC * 3 + b"\x01\x02")
)
RUNS = st.builds(
    lambda kind, first, count, length, seed: encode_equal_frames(
        kind, first, np.random.default_rng(seed).integers(0, 256, (count, length), dtype=np.uint8)
    ),
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(1, 3 * MIN_BLOCK_FRAMES),
    st.integers(0, 9),
    st.integers(0, 2**32),
)
# false headers, half sync patterns and frames cut short, besides plain noise
GARBAGE = st.one_of(
    st.binary(max_size=20),
    st.sampled_from(
        [SYNC, SYNC[:1], SYNC[:1] + SYNC, SYNC + b"\0\0\x05\0", SYNC + b"\0\0\xff\x03", SYNC + b"\0" * 8]
    ),
    FRAMES.map(lambda frame: encode_frame(*frame)[:-1]),
)
WIRE = st.lists(FRAMES.map(lambda frame: encode_frame(*frame)) | RUNS | GARBAGE, max_size=12).map(b"".join)


@pytest.mark.parametrize("crc", [crc16, crc_bit_by_bit])
def test_crc_check_value(crc):
    assert crc(b"123456789") == 0x29B1
    assert crc_bit_by_bit(b"") == 0xFFFF


@given(st.integers(0, 5), st.integers(0, 40), st.integers(0, 2**32))
def test_crc_of_rows_equals_bit_by_bit(count, length, seed):
    rows = np.random.default_rng(seed).integers(0, 256, (count, length), dtype=np.uint8)
    assert crc16_of_rows(rows).tolist() == [crc_bit_by_bit(row.tobytes()) for row in rows]


def test_frame_layout_is_the_documented_one():
    assert encode_frame(0x02, 0x11, b"\xaa\xbb\xcc") == bytes.fromhex("eb90 02 11 0300 aabbcc") + (
        crc_bit_by_bit(bytes.fromhex("02 11 0300 aabbcc")).to_bytes(2, "little")
    )


def test_equal_frames_are_single_frames_in_a_row():
    payloads = np.random.default_rng(5).integers(0, 256, (600, 7), dtype=np.uint8)
    one_by_one = b"".join(
        encode_frame(9, (250 + i) % 256, payload.tobytes()) for i, payload in enumerate(payloads)
    )
    assert encode_equal_frames(9, 250, payloads) == one_by_one


@example(encode_equal_frames(1, 0, np.zeros((MIN_BLOCK_FRAMES - 1, 3), np.uint8)), [])
@example(encode_equal_frames(1, 0, np.zeros((MIN_BLOCK_FRAMES, 3), np.uint8)) + b"\xeb", [])
@example(encode_equal_frames(1, 0, np.zeros((300, 3), np.uint8))[:-1] + b"x" + encode_frame(1, 0, b"abc"), [])
@given(WIRE, st.lists(st.integers(0, 600), max_size=30))
def test_any_bytes_in_any_pieces_give_what_a_naive_scan_finds(data, cuts):
    found, parser = parse(data, cuts)
    expected, dropped = scan(data)
    assert found == expected
    statistics = parser.statistics
    assert (statistics.frames, statistics.dropped_bytes) == (len(expected), dropped)
    assert statistics == parse(data)[1].statistics
    assert statistics == parse(data, list(range(len(data))))[1].statistics


@given(st.lists(FRAMES, max_size=10), st.data())
def test_garbage_between_frames_loses_none(frames, data):
    noise = st.binary(max_size=30).map(lambda noise: noise.replace(SYNC[:1], b""))
    wire, dropped, gaps = b"", 0, 0
    for frame in frames:
        between = data.draw(noise)
        wire += between + encode_frame(*frame)
        dropped, gaps = dropped + len(between), gaps + bool(between)
    found, parser = parse(wire)
    assert found == frames
    statistics = parser.statistics
    assert (statistics.dropped_bytes, statistics.resynchronisations) == (dropped, gaps)
    assert statistics.crc_errors == 0


@given(st.integers(0, 40), st.integers(0, 10**6), st.integers(1, 255))
def test_a_damaged_frame_is_counted_and_never_returned(count, place, flip):
    payloads = np.random.default_rng(count).integers(0, 0xEB, (count + 1, 6), dtype=np.uint8)
    wire = bytearray(encode_equal_frames(4, 0, payloads))
    size = len(wire) // (count + 1)
    hit = place % len(wire)
    wire[hit] ^= flip
    found, parser = parse(bytes(wire))
    good = [Frame(4, i % 256, payload.tobytes()) for i, payload in enumerate(payloads) if i != hit // size]
    assert found == good
    assert parser.statistics.dropped_bytes == size
    in_length_or_sync = hit % size in (0, 1, 4, 5)
    assert in_length_or_sync or parser.statistics.crc_errors >= 1


def test_long_runs_come_as_blocks_in_order_with_single_frames():
    payloads = np.random.default_rng(2).integers(0, 256, (9000, 10), dtype=np.uint8)
    wire = (
        encode_frame(1, 0, b"hello")
        + encode_equal_frames(0x20, 7, payloads[:5000])
        + encode_frame(2, 1, SYNC * 4)
        + encode_equal_frames(0x20, 9, payloads[5000:])
    )
    first, run, between, rest = FrameParser().feed(wire)
    assert first == Frame(1, 0, b"hello")
    assert between == Frame(2, 1, SYNC * 4)
    assert isinstance(run, FrameBlock)
    assert isinstance(rest, FrameBlock)
    np.testing.assert_array_equal(np.concatenate([run.payloads, rest.payloads]), payloads)
    assert run.sequences.tolist() == [(7 + i) % 256 for i in range(5000)]
    assert run.payloads.view("<i2").shape == (5000, 5)


def test_a_lying_length_holds_back_one_frame_at_most():
    good = encode_frame(3, 3, b"good")
    liar = SYNC + b"\x01\x01" + MAX_PAYLOAD_BYTES.to_bytes(2, "little")
    parser = FrameParser()
    assert parser.feed(liar + good) == []
    found = [frame for _ in range(MAX_FRAME_BYTES // len(good)) for frame in singles(parser.feed(good))]
    assert found
    assert parser.statistics.crc_errors == 1

    silent = FrameParser()
    assert silent.feed(liar + good) == []
    assert silent.flush() == [Frame(3, 3, b"good")]
    assert silent.pending_bytes == 0
    assert silent.feed(good) == [Frame(3, 3, b"good")]


def test_an_impossible_length_is_given_up_at_once():
    impossible = SYNC + b"\x01\x01" + (MAX_PAYLOAD_BYTES + 1).to_bytes(2, "little")
    assert FrameParser().feed(impossible + encode_frame(3, 3, b"")) == [Frame(3, 3, b"")]


@pytest.mark.parametrize(
    ("kind", "sequence", "payload"), [(256, 0, b""), (0, -1, b""), (0, 0, bytes(MAX_PAYLOAD_BYTES + 1))]
)
def test_what_no_frame_can_carry_is_refused(kind, sequence, payload):
    with pytest.raises(LinkError, match="cannot be sent"):
        encode_frame(kind, sequence, payload)
    with pytest.raises(LinkError, match="cannot be sent"):
        encode_equal_frames(kind, sequence, np.frombuffer(payload, np.uint8).reshape(1, -1))

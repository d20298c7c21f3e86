# pyright: strict
"""The unit's RS-422 frame: encoding, and a parser that finds its way back after garbage.

    0xEB 0x90 | type u8 | sequence u8 | length u16 | payload (length bytes) | CRC u16

All numbers little endian. The CRC is CRC-16/CCITT-FALSE (polynomial 0x1021, initial value 0xFFFF,
not reflected; check value 0x29B1) over type, sequence, length and payload.

The parser takes a candidate at each sync pattern. A candidate whose length is impossible or whose
CRC is wrong is given up one byte at a time, so that a frame hidden behind false sync bytes is still
found; bytes inside an accepted frame are never looked at again, so that a sync pattern in a payload
confuses nothing. What it finds depends on the bytes only, never on how they were cut into pieces.
"""

import binascii
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, LinkError

SYNC = b"\xeb\x90"
HEADER_BYTES = 6
CRC_BYTES = 2
MAX_PAYLOAD_BYTES = 1024
MAX_FRAME_BYTES = HEADER_BYTES + MAX_PAYLOAD_BYTES + CRC_BYTES

MIN_BLOCK_FRAMES = 8
"""Shorter runs of equal frames come as single frames: numpy would cost more than it saves."""
MAX_WINDOW_FRAMES = 4096
"""A run is checked in windows that grow up to this: they stay in the processor's cache."""
_FIRST_WINDOW_FRAMES = 128

_CRC_INITIAL = 0xFFFF
_CRC_POLYNOMIAL = 0x1021


class Frame(NamedTuple):
    """One frame."""

    type: int
    sequence: int
    payload: bytes


@dataclass(frozen=True)
class FrameBlock:
    """A run of frames of one type and one length, as arrays.

    Attributes:
        type: the frames' type.
        sequences: shape (n,), uint8.
        payloads: shape (n, k), uint8, contiguous: `payloads.view("<i2")` gives the numbers.
    """

    type: int
    sequences: NDArray[np.uint8]
    payloads: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.sequences)

    def frames(self) -> Iterator[Frame]:
        """The same frames one by one."""
        for sequence, payload in zip(self.sequences.tolist(), self.payloads, strict=True):
            yield Frame(self.type, sequence, payload.tobytes())


@dataclass(frozen=True)
class FrameStatistics:
    """What a parser has seen since it was made.

    Attributes:
        frames: accepted frames.
        dropped_bytes: bytes that belong to no accepted frame.
        crc_errors: candidates that were complete and had a wrong CRC (a false sync in garbage too).
        resynchronisations: frames that were found only after dropping bytes.
    """

    frames: int = 0
    dropped_bytes: int = 0
    crc_errors: int = 0
    resynchronisations: int = 0


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE of some bytes."""
    return binascii.crc_hqx(data, _CRC_INITIAL)


def crc16_of_rows(rows: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """CRC-16/CCITT-FALSE of each row: (n, m) uint8 → (n,) uint16.

    Vectorised over the rows, two bytes at a time: after 16 bits have been shifted in, a 16-bit CRC
    depends on nothing but (register xor these bits), so that one table of 2^16 entries is enough.
    """
    pairs = rows.shape[1] // 2
    words = rows[:, : 2 * pairs].view("<u2") if pairs else rows[:, :0].astype("<u2")
    register = np.full(len(rows), _CRC_INITIAL, dtype=np.uint16)  # the same in either byte order
    for position in range(pairs):
        np.bitwise_xor(register, words[:, position], out=register)
        register = _SWAPPED_PAIR_TABLE[register]
    register = register.byteswap()
    if rows.shape[1] % 2:
        register = (register << np.uint16(8)) ^ _BYTE_TABLE[(register >> np.uint16(8)) ^ rows[:, -1]]
    return register


def encode_frame(type: int, sequence: int, payload: bytes) -> bytes:
    """One frame on the wire.

    Raises:
        LinkError: type or sequence is no byte, or the payload is too long.
    """
    _check_encodable(type, sequence, len(payload))
    body = bytes((type, sequence)) + len(payload).to_bytes(2, "little") + payload
    return SYNC + body + crc16(body).to_bytes(2, "little")


def encode_equal_frames(type: int, first_sequence: int, payloads: NDArray[np.uint8]) -> bytes:
    """Frames with payloads of equal length, (n, k) uint8, one after the other on the wire.

    The sequence counts up from `first_sequence`, modulo 256.

    Raises:
        LinkError: type or sequence is no byte, or the payloads are too long.
    """
    count, length = payloads.shape
    _check_encodable(type, first_sequence, length)
    frames = np.empty((count, HEADER_BYTES + length + CRC_BYTES), dtype=np.uint8)
    frames[:, 0], frames[:, 1], frames[:, 2] = SYNC[0], SYNC[1], type
    frames[:, 3] = (first_sequence + np.arange(count)) % 256
    frames[:, 4], frames[:, 5] = length % 256, length // 256
    frames[:, HEADER_BYTES:-CRC_BYTES] = payloads
    for start in range(0, count, MAX_WINDOW_FRAMES):
        window = frames[start : start + MAX_WINDOW_FRAMES]
        crc = crc16_of_rows(window[:, 2:-CRC_BYTES])
        window[:, -2], window[:, -1] = crc & 0xFF, crc >> 8
    return frames.tobytes()


class FrameParser:
    """Finds frames in a stream of bytes that arrives in pieces of any size.

    Keeps at most one incomplete frame (`MAX_FRAME_BYTES`) between calls.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._frames = 0
        self._dropped_bytes = 0
        self._crc_errors = 0
        self._resynchronisations = 0
        self._out_of_step = False

    @property
    def statistics(self) -> FrameStatistics:
        """What has been seen so far."""
        return FrameStatistics(self._frames, self._dropped_bytes, self._crc_errors, self._resynchronisations)

    @property
    def pending_bytes(self) -> int:
        """Bytes kept because they may be the beginning of a frame."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Frame | FrameBlock]:
        """The frames that these bytes complete, in their order; long runs of equal ones as blocks."""
        return self._parse(self._rest + data, more_may_come=True)

    def flush(self) -> list[Frame | FrameBlock]:
        """Give up waiting for the end of an incomplete frame: what stood behind its false header.

        To be called when the line has been silent for longer than a frame takes: a damaged length
        field would else hold back up to `MAX_PAYLOAD_BYTES` of good frames.
        """
        return self._parse(self._rest, more_may_come=False)

    def _parse(self, data: bytes, *, more_may_come: bool) -> list[Frame | FrameBlock]:
        found: list[Frame | FrameBlock] = []
        end = len(data)
        at = 0
        while at < end:
            start = data.find(SYNC, at)
            if start < 0:
                # the last byte may be the first half of a sync pattern
                start = end - 1 if more_may_come and data[-1] == SYNC[0] else end
                self._drop(start - at)
                at = start
                break
            self._drop(start - at)
            at = start
            size = _frame_size(data, at)
            if size is not None and at + size <= end:
                at += self._take(data, at, size, found)
            elif size is not None and more_may_come:
                break
            else:
                self._drop(1)
                at += 1
        self._rest = data[at:]
        return found

    def _take(self, data: bytes, at: int, size: int, found: list[Frame | FrameBlock]) -> int:
        """Accept the complete candidate at `at`, or a whole run beginning there; the bytes used up."""
        if not _crc_is_right(data, at, size):
            self._crc_errors += 1
            self._drop(1)
            return 1
        run = _run_length(data, at, size)
        if run:
            rows = np.frombuffer(data, np.uint8, run * size, at).reshape(run, size)
            payloads = np.ascontiguousarray(rows[:, HEADER_BYTES:-CRC_BYTES])
            found.append(FrameBlock(data[at + 2], rows[:, 3].copy(), payloads))
            self._accept(run)
            return run * size
        found.append(Frame(data[at + 2], data[at + 3], data[at + HEADER_BYTES : at + size - CRC_BYTES]))
        self._accept(1)
        return size

    def _accept(self, frames: int) -> None:
        self._frames += frames
        self._resynchronisations += self._out_of_step
        self._out_of_step = False

    def _drop(self, count: int) -> None:
        if count:
            self._dropped_bytes += count
            self._out_of_step = True


def _frame_size(data: bytes, at: int) -> int | None:
    """Size of the candidate at `at`, the least possible while its header is incomplete; None: impossible."""
    if len(data) - at < HEADER_BYTES:
        return HEADER_BYTES + CRC_BYTES
    length = data[at + 4] | data[at + 5] << 8
    return HEADER_BYTES + length + CRC_BYTES if length <= MAX_PAYLOAD_BYTES else None


def _crc_is_right(data: bytes, at: int, size: int) -> bool:
    end = at + size
    return crc16(data[at + 2 : end - 2]) == data[end - 2] | data[end - 1] << 8


def _run_length(data: bytes, at: int, size: int) -> int:
    """How many good frames with the header (type, length) of the one at `at`, which is good, are in a row.

    0 if they are too few for a block, which a look at the first ones tells: a window of numpy costs as
    much as many single frames, and a line on which every other frame is damaged must not stall.
    """
    last = at + (MIN_BLOCK_FRAMES - 1) * size
    if last + size > len(data) or not _same_header(data, at, last):
        return 0
    for place in range(at + size, last + size, size):
        if not _same_header(data, at, place) or not _crc_is_right(data, place, size):
            return 0
    available = (len(data) - at) // size
    good, window = 0, _FIRST_WINDOW_FRAMES
    while good < available:
        count = min(window, available - good)
        rows = np.frombuffer(data, np.uint8, count * size, at + good * size).reshape(count, size)
        bad = _bad_rows(rows, np.frombuffer(data, np.uint8, HEADER_BYTES, at))
        if bad.any():
            return good + int(bad.argmax())
        good += count
        window = min(8 * window, MAX_WINDOW_FRAMES)
    return good


def _same_header(data: bytes, one: int, other: int) -> bool:
    """Same sync, type and length; the sequence is free."""
    return (
        data[one : one + 3] == data[other : other + 3]
        and data[one + 4 : one + 6] == data[other + 4 : other + 6]
    )


def _bad_rows(rows: NDArray[np.uint8], header: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Which rows, (n, size), have another header or a wrong CRC: shape (n,)."""
    bad = np.zeros(len(rows), dtype=np.bool_)
    for column in (0, 1, 2, 4, 5):
        bad |= rows[:, column] != header[column]
    sent: NDArray[Any] = rows[:, -2] | rows[:, -1].astype(np.uint16) << np.uint16(8)
    return bad | (sent != crc16_of_rows(rows[:, 2:-CRC_BYTES]))


def _check_encodable(type: int, sequence: int, length: int) -> None:
    if not (0 <= type <= 255 and 0 <= sequence <= 255 and length <= MAX_PAYLOAD_BYTES):
        raise LinkError(
            f"A frame of type {type}, sequence {sequence} and {length} payload bytes cannot be sent.",
            where="RS-422 frame encoder",
            fault=Fault.TESTLOOM,
            remedy=f"use bytes for type and sequence and at most {MAX_PAYLOAD_BYTES} payload bytes.",
        )


def _byte_table() -> NDArray[np.uint16]:
    """Register after one byte, by (high byte of the register xor the byte)."""
    table = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        table = (table << 1 ^ np.where(table & 0x8000, _CRC_POLYNOMIAL, 0)) & 0xFFFF
    return table.astype(np.uint16)


def _swapped_pair_table(one: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Register after two bytes, by (register xor both); index and entry with their bytes swapped.

    Swapped, because the bytes of a frame read as little-endian words have the first byte low.
    """
    word = np.arange(65536, dtype=np.uint16)
    first = one[word >> 8]
    both = (first << np.uint16(8)) ^ one[(word & 0xFF) ^ (first >> 8)]
    return both[word.byteswap()].byteswap()


_BYTE_TABLE = _byte_table()
_SWAPPED_PAIR_TABLE = _swapped_pair_table(_BYTE_TABLE)

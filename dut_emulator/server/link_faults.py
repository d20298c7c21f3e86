# pyright: strict
"""Faults of a link, applied to what leaves it: for tests of stations, switched over the control channel."""

from enum import Enum

import numpy as np

from protocol.frames import CRC_BYTES, HEADER_BYTES

GARBAGE_BYTES = 12


class Framing(Enum):
    """How a link's bytes fall into frames."""

    RS422 = "rs422"
    SLCAN = "slcan"
    UNFRAMED = "unframed"
    STAND_STREAM = "stand_stream"


FAULTS_OF_FRAMING = {
    Framing.RS422: frozenset({"none", "corrupt_crc", "stuck", "garbage", "drop"}),
    Framing.SLCAN: frozenset({"none", "corrupt_crc", "stuck", "garbage", "drop"}),
    # a protocol of the product's own: where its frames end is not the link's matter
    Framing.UNFRAMED: frozenset({"none", "stuck"}),
    # doubles without sync or CRC: nothing in them can be found wrong
    Framing.STAND_STREAM: frozenset({"none", "stuck", "drop"}),
}


class LinkFault:
    """What a link does to its bytes.

    corrupt_crc: RS-422: the last byte of every frame is inverted; CAN: the adapter finds every frame's
    CRC wrong and reports none. garbage: `GARBAGE_BYTES` random bytes before every frame. drop: every
    second frame is lost. stuck: nothing comes any more. `sample_bytes`: a sample of a stand's stream.
    """

    def __init__(self, framing: Framing, seed: int, sample_bytes: int = 0) -> None:
        assert (framing is Framing.STAND_STREAM) == (sample_bytes > 0)
        self.framing = framing
        self._sample_bytes = sample_bytes
        self.fault = "none"
        self._rng = np.random.default_rng(seed)
        self._count = 0

    def apply(self, data: bytes) -> bytes:
        """What arrives of whole frames that were sent."""
        match self.fault:
            case "none":
                return data
            case "stuck":
                return b""
            case _:
                return b"".join(
                    self._frame(frame) for frame in split_frames(data, self.framing, self._sample_bytes)
                )

    def _frame(self, frame: bytes) -> bytes:
        self._count += 1
        match self.fault:
            case "drop":
                return frame if self._count % 2 else b""
            case "garbage":
                return self._garbage() + frame
            case _ if self.framing is Framing.SLCAN:
                return b"" if frame[:1] in (b"t", b"T") else frame
            case _:
                return frame[:-1] + bytes((frame[-1] ^ 0xFF,))

    def _garbage(self) -> bytes:
        noise = self._rng.integers(0, 256, GARBAGE_BYTES, dtype=np.uint8).tobytes()
        # an adapter's text stays text: a line that is no command
        return b"?" + noise.hex().upper().encode() + b"\r" if self.framing is Framing.SLCAN else noise


def split_frames(data: bytes, framing: Framing, sample_bytes: int = 0) -> list[bytes]:
    """Cut whole frames apart. `sample_bytes`: as `LinkFault`'s."""
    if framing is Framing.SLCAN:
        return [line + b"\r" for line in data.split(b"\r")[:-1]]
    frames: list[bytes] = []
    at = 0
    while at < len(data):
        size = sample_bytes
        if framing is Framing.RS422:
            size = HEADER_BYTES + int.from_bytes(data[at + 4 : at + 6], "little") + CRC_BYTES
        frames.append(data[at : at + size])
        at += size
    return frames

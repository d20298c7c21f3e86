# pyright: strict
"""What a fibre-optic gyro (`fog`, paper 3) says on its RS-422 link: frames, commands, product constants.

    unit → host   C5 5C | counter u8 | status u8 | rate s32 | temperature s16 | CRC u16     12 bytes
    host → unit   C5 A3 | command u8 | argument u16 | CRC u16                                7 bytes

Little endian. The CRC is CRC-16/CCITT-FALSE over what stands between sync and CRC. The digital output Q is
`rate`, in counts: Q = 2000 + 20,000 · rate in °/s about the input axis, body z. At 2 kHz its noise is
σ = 200 (paper 3, figure 1: 2000 and 200), an angle random walk of 0.0134 °/√h. Temperature in 0.01 °C.

The unit begins in broadcast: one frame each period. In query mode it is silent until it is asked.
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from protocol.errors import Fault, LinkError
from protocol.frames import crc16, crc16_of_rows

BAUD_RATE = 921_600
BITS_PER_BYTE = 10
"""On the line: start, eight, stop."""
FRAME_RATES_HZ = (10, 4000)
"""Least and greatest; any whole number between. Below 500 Hz for tests of minutes and hours."""
DEFAULT_FRAME_RATE_HZ = 2000

ZERO_RATE_COUNTS = 2000
COUNTS_PER_DEG_S = 20_000
RANGE_DEG_S = 400.0
NOISE_COUNTS_AT_2_KHZ = 200.0
TEMPERATURE_LSB_C = 0.01

FRAME_SYNC = b"\xc5\x5c"
FRAME_DTYPE = np.dtype(
    [
        ("sync", "u1", (2,)),
        ("counter", "u1"),
        ("status", "u1"),
        ("rate", "<i4"),
        ("temperature", "<i2"),
        ("crc", "<u2"),
    ]
)
FRAME_BYTES = FRAME_DTYPE.itemsize
FRAME_TRANSMISSION_S = FRAME_BYTES * BITS_PER_BYTE / BAUD_RATE
"""From the first byte's start bit to the last byte's stop bit: 130.2 µs."""

COMMAND_SYNC = b"\xc5\xa3"
COMMAND_BYTES = 7

MAX_WINDOW_FRAMES = 4096
_FIRST_WINDOW_FRAMES = 16

FrameArray = NDArray[np.void]


class FrameStatus(IntFlag):
    """Bits of a frame's status."""

    QUERY_MODE = 1
    SATURATED = 2
    COMMAND_REFUSED = 4  # the last command had an argument that cannot be


class Command(IntEnum):
    """What a host may tell the unit."""

    BROADCAST = 1  # argument: frame rate in Hz
    QUERY_MODE = 2
    QUERY = 3  # answered with one frame; only in query mode


@dataclass(frozen=True)
class CommandFrame:
    """One command. `argument`: 0 to 65535."""

    command: int
    argument: int


def make_frames(
    counters: NDArray[np.uint8],
    statuses: NDArray[np.uint8],
    rates: NDArray[np.int32],
    temperatures: NDArray[np.int16],
) -> FrameArray:
    """Frames with their CRCs, (n,) of `FRAME_DTYPE`; `.tobytes()` is what goes over the line."""
    frames = np.empty(len(counters), dtype=FRAME_DTYPE)
    frames["sync"] = np.frombuffer(FRAME_SYNC, np.uint8)
    frames["counter"], frames["status"] = counters, statuses
    frames["rate"], frames["temperature"] = rates, temperatures
    frames["crc"] = _crcs(frames)
    return frames


def encode_command(command: Command, argument: int = 0) -> bytes:
    """A command on the line.

    Raises:
        LinkError: the argument is no 16-bit number.
    """
    if not 0 <= argument <= 0xFFFF:
        raise LinkError(
            f"The argument {argument} of the command {command.name} cannot be sent.",
            where="FOG command",
            fault=Fault.TESTLOOM,
            remedy="give 0 to 65535.",
        )
    body = bytes((command,)) + argument.to_bytes(2, "little")
    return COMMAND_SYNC + body + crc16(body).to_bytes(2, "little")


class FogFrameParser:
    """Finds a unit's frames in bytes that arrive in pieces of any size; what it finds depends on bytes only.

    A candidate whose CRC is wrong is given up one byte at a time, so that a frame behind a false sync is
    found. Keeps less than one frame between calls. `dropped_bytes`: those that belong to no frame.
    """

    def __init__(self) -> None:
        self._rest = b""
        self.dropped_bytes = 0

    def feed(self, data: bytes) -> FrameArray:
        """The frames that these bytes complete: (n,) of `FRAME_DTYPE`."""
        data = self._rest + data
        found: list[FrameArray] = []
        at, used = 0, 0
        while at + FRAME_BYTES <= len(data):
            start = data.find(FRAME_SYNC, at)
            if start < 0 or start + FRAME_BYTES > len(data):
                break
            frames = _good_run(data, start)
            if len(frames):
                found.append(frames)
                self.dropped_bytes += start - used
                at = used = start + len(frames) * FRAME_BYTES
            else:
                at = start + 1
        start = data.find(FRAME_SYNC, at)
        if start < 0:  # the last byte may be the first half of a sync
            start = len(data) - (1 if data[max(at, 0) :].endswith(FRAME_SYNC[:1]) else 0)
        self.dropped_bytes += start - used
        self._rest = data[start:]
        return np.concatenate(found) if found else np.empty(0, dtype=FRAME_DTYPE)


class FogCommandParser:
    """Finds a host's commands in bytes that arrive in pieces of any size."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[CommandFrame]:
        """The commands that these bytes complete, in their order."""
        data = self._rest + data
        found: list[CommandFrame] = []
        at = 0
        while (start := data.find(COMMAND_SYNC, at)) >= 0 and start + COMMAND_BYTES <= len(data):
            end = start + COMMAND_BYTES
            body = data[start + 2 : end - 2]
            if crc16(body) == int.from_bytes(data[end - 2 : end], "little"):
                found.append(CommandFrame(body[0], int.from_bytes(body[1:], "little")))
                at = end
            else:
                at = start + 1
        if start < 0:
            start = len(data) - (1 if data[at:].endswith(COMMAND_SYNC[:1]) else 0)
        self._rest = data[start:]
        return found


def _good_run(data: bytes, start: int) -> FrameArray:
    """The frames from `start` on, up to the first that is none."""
    available = (len(data) - start) // FRAME_BYTES
    good, window = 0, _FIRST_WINDOW_FRAMES
    sync = np.frombuffer(FRAME_SYNC, np.uint8)
    frames = np.frombuffer(data, FRAME_DTYPE, available, start)
    while good < available:
        part = frames[good : good + window]
        bad = (part["sync"] != sync).any(axis=1) | (part["crc"] != _crcs(part))
        if bad.any():
            good += int(bad.argmax())
            break
        good += len(part)
        window = min(8 * window, MAX_WINDOW_FRAMES)
    return frames[:good].copy()


def _crcs(frames: FrameArray) -> NDArray[np.uint16]:
    rows = np.ascontiguousarray(frames).view(np.uint8).reshape(-1, FRAME_BYTES)
    return crc16_of_rows(rows[:, len(FRAME_SYNC) : -2])

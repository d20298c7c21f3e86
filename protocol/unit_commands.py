# pyright: strict
"""What the commands of all units with the frames of `protocol/frames.py` have in common.

A reply's type is its command's with bit 7 set, its sequence is the command's, its first byte a `ReplyStatus`.
"""

import struct
from enum import IntEnum

REPLY_BIT = 0x80


class ReplyStatus(IntEnum):
    """First byte of every reply."""

    DONE = 0
    ACCEPTED = 1
    BUSY = 2
    UNKNOWN = 3
    INVALID = 4
    FLASH_ERROR = 5


IDENTITY_LAYOUT = struct.Struct("<B32s16s16s")
"""Reply to IDENTIFY: status, serial, firmware version, hardware revision (ASCII, zero padded)."""
START_STREAM_LAYOUT = struct.Struct("<HB")
"""Rate in Hz, flags (bit 0: compensated)."""
COEFFICIENTS_LAYOUT = struct.Struct("<B9d3d")
"""WRITE_COEFFICIENTS: sensor, K row by row (dimensionless), bias b (rad/s or m/s²), of u = K (y − b).
The reply to READ_COEFFICIENTS is the status byte followed by the same."""

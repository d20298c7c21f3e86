# pyright: strict
"""UBX: a receiver's binary frames, and NAV-PVT, its position, velocity and time.

    0xB5 0x62 | class | id | length u16 | payload | CK_A CK_B        little endian

The checksum is the 8-bit Fletcher sum of class to payload (RFC 1145). Source of frame and layout: u-blox 8 /
u-blox M8 receiver description, UBX-13003221, sections 32.2, 32.4 and 32.17.15.

Out of scope: configuration messages and all navigation messages but this one.
"""

import math
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from protocol.errors import Fault, LinkError

SYNC = b"\xb5\x62"
HEAD = struct.Struct("<2sBBH")
CHECKSUM_BYTES = 2
MAX_PAYLOAD_BYTES = 1024
"""A longer length is taken for noise: no message of these receivers has more."""

NAV_PVT = (0x01, 0x07)
NAV_PVT_LAYOUT = struct.Struct("<IH5BBIi4B4i2I5i2IHH4sihH")
_DATE_TIME_RESOLVED = 0x07
_FIX_OK = 0x01
_DEG_1E7, _DEG_1E5 = math.radians(1e-7), math.radians(1e-5)


class UbxFrame(NamedTuple):
    """A frame with a right checksum. `kind`: class and id."""

    kind: tuple[int, int]
    payload: bytes


@dataclass(frozen=True)
class NavPvt:
    """Position, velocity, time. `fix_type`: 0 none, 2 two-, 3 three-dimensional. Heights: ellipsoid and sea.

    Accuracies are the receiver's own 1σ. UTC is whole seconds plus `nanosecond`, which may be negative.
    """

    time_of_week_ms: int
    year: int
    month: int
    day: int
    hour: int
    minute: int
    second: int
    nanosecond: int
    fix_type: int
    satellites_used: int
    longitude_rad: float
    latitude_rad: float
    height_m: float
    height_above_sea_m: float
    horizontal_accuracy_m: float
    vertical_accuracy_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    velocity_down_m_s: float
    speed_accuracy_m_s: float
    position_dop: float
    time_accuracy_s: float = 0.0

    @property
    def ground_speed_m_s(self) -> float:
        """Horizontal speed."""
        return math.hypot(self.velocity_north_m_s, self.velocity_east_m_s)

    @property
    def heading_of_motion_rad(self) -> float:
        """East of north, 0 to 2π."""
        return math.atan2(self.velocity_east_m_s, self.velocity_north_m_s) % (2 * math.pi)


def checksum(data: bytes) -> bytes:
    """CK_A, CK_B: the 8-bit Fletcher sums of class to payload."""
    values = np.frombuffer(data, np.uint8).astype(np.uint64)
    weights = np.arange(len(values), 0, -1, dtype=np.uint64)
    return bytes((int(values.sum()) & 0xFF, int((values * weights).sum()) & 0xFF))


def encode_ubx(frame: UbxFrame) -> bytes:
    """The frame as it is on the wire.

    Raises:
        LinkError: the payload is longer than `MAX_PAYLOAD_BYTES`.
    """
    if len(frame.payload) > MAX_PAYLOAD_BYTES:
        raise LinkError(
            f"A UBX payload cannot have {len(frame.payload)} bytes.",
            where=f"UBX class 0x{frame.kind[0]:02X} id 0x{frame.kind[1]:02X}",
            fault=Fault.TESTLOOM,
            remedy=f"give at most {MAX_PAYLOAD_BYTES}.",
        )
    head = HEAD.pack(SYNC, *frame.kind, len(frame.payload))
    return head + frame.payload + checksum(head[2:] + frame.payload)


def nav_pvt_frame(fix: NavPvt) -> UbxFrame:
    """The message NAV-PVT. Raises LinkError for a value that its field cannot hold."""
    heading = round(fix.heading_of_motion_rad / _DEG_1E5)
    try:
        payload = NAV_PVT_LAYOUT.pack(
            fix.time_of_week_ms,
            fix.year,
            *(fix.month, fix.day, fix.hour, fix.minute, fix.second),
            _DATE_TIME_RESOLVED,
            round(fix.time_accuracy_s * 1e9),
            fix.nanosecond,
            *(fix.fix_type, _FIX_OK if fix.fix_type else 0, 0, fix.satellites_used),
            round(fix.longitude_rad / _DEG_1E7),
            round(fix.latitude_rad / _DEG_1E7),
            *(round(height * 1e3) for height in (fix.height_m, fix.height_above_sea_m)),
            *(round(sigma * 1e3) for sigma in (fix.horizontal_accuracy_m, fix.vertical_accuracy_m)),
            round(fix.velocity_north_m_s * 1e3),
            round(fix.velocity_east_m_s * 1e3),
            round(fix.velocity_down_m_s * 1e3),
            round(fix.ground_speed_m_s * 1e3),
            heading,
            round(fix.speed_accuracy_m_s * 1e3),
            0,
            round(fix.position_dop * 100),
            *(0, bytes(4), 0, 0, 0),
        )
    except (struct.error, OverflowError, ValueError) as error:
        raise LinkError(
            f"A fix cannot be said in NAV-PVT: {error}.",
            where="UBX NAV-PVT",
            fault=Fault.TESTLOOM,
            remedy="give finite values inside the fields' ranges.",
        ) from None
    return UbxFrame(NAV_PVT, payload)


def decode_nav_pvt(frame: UbxFrame) -> NavPvt:
    """The fix in a NAV-PVT frame.

    Raises:
        LinkError: it is another message, or has another length.
    """
    if frame.kind != NAV_PVT or len(frame.payload) != NAV_PVT_LAYOUT.size:
        raise LinkError(
            f"This is no NAV-PVT of {NAV_PVT_LAYOUT.size} bytes, but class 0x{frame.kind[0]:02X}, "
            f"id 0x{frame.kind[1]:02X} with {len(frame.payload)} bytes.",
            where="UBX NAV-PVT",
            fault=Fault.UNIT,
            remedy="check the receiver's protocol version (18 or later).",
        )
    v = NAV_PVT_LAYOUT.unpack(frame.payload)
    return NavPvt(
        **dict(
            zip(("time_of_week_ms", "year", "month", "day", "hour", "minute", "second"), v[:7], strict=True)
        ),
        time_accuracy_s=v[8] * 1e-9,
        nanosecond=v[9],
        fix_type=v[10],
        satellites_used=v[13],
        longitude_rad=v[14] * _DEG_1E7,
        latitude_rad=v[15] * _DEG_1E7,
        height_m=v[16] * 1e-3,
        height_above_sea_m=v[17] * 1e-3,
        horizontal_accuracy_m=v[18] * 1e-3,
        vertical_accuracy_m=v[19] * 1e-3,
        velocity_north_m_s=v[20] * 1e-3,
        velocity_east_m_s=v[21] * 1e-3,
        velocity_down_m_s=v[22] * 1e-3,
        speed_accuracy_m_s=v[25] * 1e-3,
        position_dop=v[27] * 1e-2,
    )

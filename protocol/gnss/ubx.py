# pyright: strict
"""UBX NAV-PVT: a receiver's position, velocity and time, as it is on the wire.

The frame is pyubx2's. The payload is packed here: pyubx2 1.4 cuts a scaled value off instead of rounding it,
by up to a unit of the field (of latitude: 11 mm). Source of the layout: u-blox 8 / u-blox M8 receiver
description, UBX-13003221, section 32.17.15.

Out of scope: other messages, and reading, which is a client's (`pyubx2.UBXReader`).
"""

import math
import struct
from dataclasses import dataclass

from pyubx2 import GET, UBXMessage  # pyright: ignore[reportMissingTypeStubs]

from protocol.errors import Fault, LinkError

NAV_PVT_LAYOUT = struct.Struct("<IH5BBIi4B4i2I5i2IHH4sihH")
_DATE_TIME_RESOLVED = 0x07
_FIX_OK = 0x01
_DEG_1E7, _DEG_1E5 = math.radians(1e-7), math.radians(1e-5)


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


def nav_pvt_bytes(fix: NavPvt) -> bytes:
    """The frame NAV-PVT. Raises LinkError for a value that its field cannot hold."""
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
    message = UBXMessage("NAV", "NAV-PVT", GET, payload=payload)
    return message.serialize()

# pyright: strict
"""The impact rig's time stamp and what its acquisition module streams (paper 3, section 2.4).

The stamp is two bytes c1 c2, the 16-bit number c2c1: bit 15 is set once the trigger has come, bits 0 to 14
count since the trigger. The full count 32,767 stands for 3556.21 µs, so one count is 108.53 ns (eqs (23),
(37)); a counter is read, so a stamp is rounded down, and it stays at 0xffff when its time is over. Before
the trigger a stamp is 0.
"""

import numpy as np
from numpy.typing import NDArray

from protocol.fog import FRAME_BYTES

STAMP_FLAG = 0x8000
STAMP_MAX_COUNT = 0x7FFF
STAMP_FULL_SCALE_S = 3556.21e-6
STAMP_RESOLUTION_S = STAMP_FULL_SCALE_S / STAMP_MAX_COUNT

RECORD_HEAD = b"\xa5\x5a"
RECORD_DTYPE = np.dtype(
    [
        ("head", "u1", (2,)),
        ("frame", "u1", (FRAME_BYTES,)),
        ("stamp", "<u2"),
        ("received_s", "<f8"),
    ]
)
"""What the module sends for each frame of the unit: head, the frame as it came, the stamp, and when its last
byte had come by the module's own clock (the bench's), which programmed instants are given in."""


def stamp_of(since_trigger_s: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Stamps of events so long after the trigger, (n,); NaN: there was none."""
    triggered = ~np.isnan(since_trigger_s)
    # a guard of 1e-9 of a count: a time that is a whole number of counts shall have that count
    count = np.floor(np.where(triggered, since_trigger_s, 0.0) / STAMP_RESOLUTION_S + 1e-9)
    count = np.clip(count, 0, STAMP_MAX_COUNT).astype(np.uint16)
    return np.where(triggered, count | np.uint16(STAMP_FLAG), np.uint16(0))


def make_records(
    frames: NDArray[np.uint8], stamps: NDArray[np.uint16], received_s: NDArray[np.float64]
) -> bytes:
    """Records of frames (n, `FRAME_BYTES`) one after the other."""
    records = np.empty(len(frames), dtype=RECORD_DTYPE)
    records["head"] = np.frombuffer(RECORD_HEAD, np.uint8)
    records["frame"], records["stamp"], records["received_s"] = frames, stamps, received_s
    return records.tobytes()

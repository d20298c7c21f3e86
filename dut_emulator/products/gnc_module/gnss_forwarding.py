# pyright: strict
"""The receiver's epochs handed through on RS-422, each as the payload of one frame.

Epochs lie on whole periods of the satellites' time, not of the unit's crystal. A receiver that nobody asked
for yet has run since power-on all the same: what it has tracked until then is made up for at 1 Hz.
"""

import math

import numpy as np

from dut_emulator.motion.satellite_profiles import SignalSource
from dut_emulator.products.gnc_module import self_tests
from dut_emulator.products.gnc_module.gnss_messages import epoch_bytes, nav_pvt_of
from dut_emulator.products.gnc_module.gnss_receiver import INNER_RATE_HZ
from dut_emulator.products.gnc_module.hardware import Hardware
from protocol.frames import encode_frame
from protocol.gnc_module import FORWARD_GNSS_LAYOUT, GNSS_RATES_HZ, FrameType, GnssProtocol
from protocol.gnss.ubx import NavPvt

ALL_PROTOCOLS = GnssProtocol.UBX | GnssProtocol.NMEA


class GnssForwarding:
    """From one order to the next."""

    def __init__(self, hardware: Hardware, rate_hz: int, protocols: int, now_s: float) -> None:
        self._receiver, self._protocols = hardware.receiver, protocols
        self._every = INNER_RATE_HZ // rate_hz
        now = math.floor(now_s * INNER_RATE_HZ + 1e-6)
        self._make_up(now)
        self._next = (max(now, self._receiver.seen) // self._every + 1) * self._every
        self._sequence = 0

    @staticmethod
    def ordered(payload: bytes) -> tuple[int, int] | None:
        """Rate and protocols of an order; None if it is none."""
        if len(payload) != FORWARD_GNSS_LAYOUT.size:
            return None
        rate_hz, protocols = FORWARD_GNSS_LAYOUT.unpack(payload)
        sound = rate_hz == 0 or (rate_hz in GNSS_RATES_HZ and 0 < protocols <= ALL_PROTOCOLS)
        return (rate_hz, protocols) if sound else None

    @property
    def next_epoch_s(self) -> float:
        """When the next is due."""
        return self._next / INNER_RATE_HZ

    def last_fix(self) -> NavPvt:
        """Of the last epoch so far."""
        assert self._receiver.last is not None, "power-on comes before every order"
        return nav_pvt_of(self._receiver.last, len(self._receiver.last.time_s) - 1)

    def epoch(self) -> bytes:
        """The frame of the epoch that is due."""
        fixes = self._receiver.fixes(np.array([self._next]))
        self._next += self._every
        payload = epoch_bytes(fixes, 0, self._protocols)
        frame = encode_frame(int(FrameType.GNSS_DATA), self._sequence % 256, payload)
        self._sequence += 1
        return frame

    def _make_up(self, now: int) -> None:
        """Whole seconds that have passed unseen, and now."""
        first = self._receiver.seen // INNER_RATE_HZ + 1
        missed = np.arange(first * INNER_RATE_HZ, now, INNER_RATE_HZ)
        self._receiver.fixes(np.append(missed, now) if now > self._receiver.seen else missed)


def gnss_self_test(hardware: Hardware, forwarding: GnssForwarding | None, now_s: float) -> bytes:
    """Under a satellite simulator what the receiver has found; a board repeats the roof to a warm one."""
    if not isinstance(hardware.surroundings, SignalSource):
        return self_tests.gnss_values(hardware.truth, hardware.rng)
    return self_tests.gnss_values_of((forwarding or GnssForwarding(hardware, 1, 0, now_s)).last_fix())

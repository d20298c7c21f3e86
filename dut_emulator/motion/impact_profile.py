# pyright: strict
"""Impacts that set a free table turning, exactly, and who stamps the frames that report them.

A slider hits an arm of a table that is free to turn about the vertical (paper 3, section 2.3). The hit is
over in less than a nanosecond: the rate jumps by p at t = 0. Then

    ω(t) = (p + c) e^(−t/τ) − c + r p e^(−t/τ_r) sin Ωt     until  t_stop = τ ln(1 + p / c),  then 0

The bearing brakes with a part in proportion to the rate (1 / τ) and a dry part (c / τ), which brings the
table to rest for good; the struck arm rings at Ω and dies away within some milliseconds.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dut_emulator.motion.profile import ProfileKind, ProfileParameter

FloatArray = NDArray[np.float64]

RANDOM_INSTANT = -1.0
"""`next_frame_us` of impacts that come when they come."""

KINDS: tuple[ProfileKind, ...] = (
    ProfileKind(
        "impact",
        "pure lag: the time from a jump of the rate to the first frame that shows it",
        (
            ProfileParameter("shots", 31, "1", 1, 20_000, "how many impacts; a whole number"),
            ProfileParameter("peak_rate_deg_s", 40.0, "deg/s", 1.0, 200.0, "rate right after an impact"),
            ProfileParameter("spacing_s", 1.0, "s", 0.05, 60.0, "from one impact to the next, rest included"),
            ProfileParameter(
                "next_frame_us",
                RANDOM_INSTANT,
                "us",
                RANDOM_INSTANT,
                2000.0,
                "programmed impacts: when the next frame follows the first one; -1: random instants",
            ),
            ProfileParameter(
                "step_us", 0.0, "us", -2000.0, 2000.0, "programmed impacts: how much later it does each time"
            ),
            ProfileParameter(
                "frame_rate_hz",
                2000.0,
                "Hz",
                500.0,
                4000.0,
                "frame rate that programmed impacts are timed for",
            ),
        ),
    ),
)


@dataclass(frozen=True)
class TableResponse:
    """How the free table answers a hit.

    Attributes:
        decay_s: τ.
        dry_rate_rad_s: c.
        ringing: r, of the jump.
        ringing_decay_s: τ_r.
        ringing_rad_s: Ω.
    """

    decay_s: float = 0.2
    dry_rate_rad_s: float = math.radians(2.0)
    ringing: float = 0.15
    ringing_decay_s: float = 4e-3
    ringing_rad_s: float = 2 * math.pi * 180.0

    def stop_s(self, jump_rad_s: float) -> float:
        """Time from the hit to rest."""
        return self.decay_s * math.log1p(abs(jump_rad_s) / self.dry_rate_rad_s)

    def rate_rad_s(self, since_s: FloatArray, jump_rad_s: FloatArray) -> FloatArray:
        """(n,) ω so long after hits with these jumps > 0; 0 before the hit and after the stop."""
        since = np.maximum(since_s, 0.0)
        dry = self.dry_rate_rad_s
        rate = np.maximum((jump_rad_s + dry) * np.exp(-since / self.decay_s) - dry, 0.0)
        ring = np.exp(-since / self.ringing_decay_s) * np.sin(self.ringing_rad_s * since)
        moving = (since_s >= 0.0) & (rate > 0.0)
        return np.where(moving, rate + self.ringing * jump_rad_s * ring, 0.0)

    def angle_rad(self, since_s: FloatArray, jump_rad_s: FloatArray) -> FloatArray:
        """(n,) how far the table has turned since the hit."""
        dry, tau, tau_r, omega = self.dry_rate_rad_s, self.decay_s, self.ringing_decay_s, self.ringing_rad_s
        since = np.clip(since_s, 0.0, tau * np.log1p(jump_rad_s / dry))
        turned = -(jump_rad_s + dry) * tau * np.expm1(-since / tau) - dry * since
        phase = omega * since
        ringing = omega - np.exp(-since / tau_r) * (omega * np.cos(phase) + np.sin(phase) / tau_r)
        return turned + self.ringing * jump_rad_s * ringing / (omega**2 + tau_r**-2)


@dataclass(frozen=True)
class Impacts:
    """Hits of a table that has come to rest before each of them.

    Attributes:
        times_s: (k,) ascending.
        jumps_rad_s: (k,) of the rate, > 0.
        response: of the table.
        turned_before_rad: how far hits that are no longer listed have turned the table.
    """

    times_s: FloatArray
    jumps_rad_s: FloatArray
    response: TableResponse
    turned_before_rad: float = 0.0

    def motion(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rate (rad/s) and angle (rad) at these times, each (n,)."""
        if len(self.times_s) == 0:
            return np.zeros(len(times_s)), np.full(len(times_s), self.turned_before_rad)
        latest = np.searchsorted(self.times_s, times_s, side="right") - 1
        hit = latest >= 0
        index = np.maximum(latest, 0)
        since, jumps = times_s - self.times_s[index], self.jumps_rad_s[index]
        before = self.turned_before_rad + np.concatenate([[0.0], np.cumsum(self._turns_rad())])
        rate = self.response.rate_rad_s(since, jumps)
        angle = before[index] + self.response.angle_rad(since, jumps)
        return np.where(hit, rate, 0.0), np.where(hit, angle, self.turned_before_rad)

    def with_impact(self, time_s: float, jump_rad_s: float, kept: int) -> "Impacts":
        """One hit more; of all, the latest `kept` stay listed."""
        times = np.append(self.times_s, time_s)
        gone = max(len(times) - kept, 0)
        return Impacts(
            times[gone:],
            np.append(self.jumps_rad_s, jump_rad_s)[gone:],
            self.response,
            self.turned_before_rad + float(self._turns_rad()[:gone].sum()),
        )

    def _turns_rad(self) -> FloatArray:
        """(k,) how far each hit turns the table until it rests."""
        return self.response.angle_rad(np.full(len(self.times_s), np.inf), self.jumps_rad_s)


@runtime_checkable
class StampsFrames(Protocol):
    """A run whose stand stamps every frame of the unit that it receives."""

    @property
    def frame_rate_hz(self) -> float:
        """What it has told the unit to send."""
        ...

    def stamps(self, received_s: FloatArray) -> NDArray[np.uint16]:
        """Stamps, as `protocol.impact_rig` has them, of frames whose last bytes came then, (n,)."""
        ...


@runtime_checkable
class TakesFrames(Protocol):
    """Surroundings that a unit's serial line goes through: they see its frames as they come."""

    def take_frames(self, frames: NDArray[np.uint8], received_s: FloatArray) -> None:
        """Frames (n, bytes), and when the last byte of each had come (n,)."""
        ...


def since_trigger_s(received_s: FloatArray, armed_s: FloatArray, triggers_s: FloatArray) -> FloatArray:
    """(n,) time since the trigger, NaN where the timer was armed after the last one, or there was none.

    The first trigger after arming starts the timer; further ones until the next arming change nothing.

    Args:
        received_s: (n,).
        armed_s: (a,) ascending.
        triggers_s: (k,) ascending.
    """
    if len(armed_s) == 0 or len(triggers_s) == 0:
        return np.full(len(received_s), np.nan)
    arming = np.searchsorted(armed_s, received_s, side="right") - 1
    armed = armed_s[np.maximum(arming, 0)]
    first = np.searchsorted(triggers_s, armed, side="left")
    trigger = triggers_s[np.minimum(first, len(triggers_s) - 1)]
    started = (arming >= 0) & (first < len(triggers_s)) & (trigger <= received_s)
    return np.where(started, received_s - trigger, np.nan)

# pyright: strict
"""What a satellite simulator plays, and what of its signals reaches a receiver's antenna.

The unit itself does not move: signals tell it where it would be. Its track is in local axes east, north, up;
the body's x axis points forward, y left, z up. `satellite_trajectory` is rest, straight north with constant
acceleration, straight at speed, then a circle to the right about a centre in the east: all in closed form.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dut_emulator.motion.profile import ProfileKind, ProfileParameter

FloatArray = NDArray[np.float64]

NOMINAL_POWER_DBM = -130.0
"""At an antenna of 0 dBi under the open sky (IS-GPS-200, 6.3.1: −128.5 dBm at least, for a GPS L1 signal)."""
OFF_DBM = -math.inf
_ELEVATIONS_DEG = (62, 18, 40, 15, 71, 29, 52, 24, 35, 12, 46, 57, 20, 66, 27, 33)
_GOLDEN_ANGLE_DEG = 180 * (3 - math.sqrt(5))
MAX_SATELLITES = len(_ELEVATIONS_DEG)

_POWER = ProfileParameter("power_dbm", NOMINAL_POWER_DBM, "1", -170.0, -110.0, "of each signal, in dBm")
_SATELLITES = ProfileParameter("satellites", 12.0, "1", 0.0, float(MAX_SATELLITES), "signals switched on")

KINDS: tuple[ProfileKind, ...] = (
    ProfileKind(
        "satellite_static",
        "time to first fix, satellites used, errors of position and pulse of a receiver at rest",
        (
            ProfileParameter("duration_s", 120.0, "s", 10.0, 86_400.0, "from the signals' start"),
            _SATELLITES,
            _POWER,
        ),
    ),
    ProfileKind(
        "satellite_trajectory",
        "latency, clock steps, lever arm: a receiver that accelerates, drives straight and then circles",
        (
            ProfileParameter("rest_s", 60.0, "s", 0.0, 3600.0, "at rest, to find the satellites"),
            ProfileParameter("acceleration_m_s2", 2.0, "m/s^2", 0.01, 100.0, "up to the speed"),
            ProfileParameter("speed_m_s", 30.0, "m/s", 0.1, 500.0, "of straight and circle"),
            ProfileParameter("straight_s", 20.0, "s", 0.0, 3600.0, "at that speed before the circle"),
            ProfileParameter("radius_m", 200.0, "m", 1.0, 1e5, "of the circle"),
            ProfileParameter("turns", 1.0, "1", 0.0, 100.0, "of the circle"),
            _SATELLITES,
            _POWER,
        ),
    ),
)


@dataclass(frozen=True)
class SatelliteSignals:
    """What reaches the antenna at n moments from s satellites.

    Attributes:
        power_dbm: (n, s); −inf is none.
        line_of_sight: (s, 3) unit vectors to the satellites, east, north, up.
        reference_error_s: (n,) how late the time is that the signals carry.
    """

    power_dbm: FloatArray
    line_of_sight: FloatArray
    reference_error_s: FloatArray


@runtime_checkable
class SignalSource(Protocol):
    """A run, or surroundings, that say what a receiver hears. Without it there is the open sky."""

    def signals(self, times_s: FloatArray) -> SatelliteSignals:
        """At these moments (n,), non-decreasing."""
        ...


def lines_of_sight(count: int) -> FloatArray:
    """(count, 3) of the first satellites of a sky whose every beginning is well spread."""
    elevation = np.radians(np.array(_ELEVATIONS_DEG[:count], dtype=np.float64))
    azimuth = np.radians(_GOLDEN_ANGLE_DEG * np.arange(count))
    level = np.cos(elevation)
    return np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=1)


def open_sky(times_s: FloatArray) -> SatelliteSignals:
    """Twelve satellites at nominal power, at all times."""
    power = np.full((len(times_s), 12), NOMINAL_POWER_DBM)
    return SatelliteSignals(power, lines_of_sight(12), np.zeros(len(times_s)))


@dataclass(frozen=True)
class Track:
    """A way in closed form. All at rest if `speed_m_s` is 0."""

    rest_s: float = 0.0
    acceleration_m_s2: float = 1.0
    speed_m_s: float = 0.0
    straight_s: float = 0.0
    radius_m: float = 1.0
    turns: float = 0.0

    @property
    def circle_from_s(self) -> float:
        """When the circle begins."""
        return self.rest_s + self.speed_m_s / self.acceleration_m_s2 + self.straight_s

    @property
    def duration_s(self) -> float:
        """To the end of the circle; later it goes on."""
        circle_s = 2 * math.pi * self.radius_m * self.turns / self.speed_m_s if self.speed_m_s else 0.0
        return self.circle_from_s + circle_s

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position (n, 3), velocity (n, 3) in local axes, and heading (n,) east of north in rad."""
        position, velocity = np.zeros((len(times_s), 3)), np.zeros((len(times_s), 3))
        ramp_s = self.speed_m_s / self.acceleration_m_s2
        ramp = np.clip(times_s - self.rest_s, 0.0, ramp_s)
        cruise = np.clip(times_s - self.rest_s - ramp_s, 0.0, self.straight_s)
        heading = np.maximum(times_s - self.circle_from_s, 0.0) * (self.speed_m_s / self.radius_m)
        speed = self.acceleration_m_s2 * ramp
        position[:, 0] = self.radius_m * (1 - np.cos(heading))
        position[:, 1] = speed * ramp / 2 + self.speed_m_s * cruise + self.radius_m * np.sin(heading)
        velocity[:, 0], velocity[:, 1] = speed * np.sin(heading), speed * np.cos(heading)
        return position, velocity, heading


def dcm_local_from_body(heading_rad: FloatArray) -> FloatArray:
    """(n, 3, 3) of a level body whose x axis points along the heading."""
    sine, cosine = np.sin(heading_rad), np.cos(heading_rad)
    dcm = np.zeros((len(heading_rad), 3, 3))
    dcm[:, 0, 0], dcm[:, 1, 0] = sine, cosine
    dcm[:, 0, 1], dcm[:, 1, 1] = -cosine, sine
    dcm[:, 2, 2] = 1.0
    return dcm

# pyright: strict
"""The pieces that an axis' motion is made of, exact in closed form: angle, rate, acceleration in degrees.

A piece begins at its own τ = 0. `peaks` bound |rate| and |acceleration| over the whole piece: exactly for
`Constant`, by the full circle for `Sine`, by the envelope for `Sweep`.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from dut_emulator.motion.axis_motion import FloatArray, Trapezoid

_TAPER_CYCLES = 4.0
_ENVELOPE_POINTS = 2000

Motion = tuple[FloatArray, FloatArray, FloatArray]


class Piece(Protocol):
    """See the module."""

    @property
    def duration_s(self) -> float:
        """How long it lasts."""
        ...

    def at(self, elapsed_s: FloatArray) -> Motion:
        """Angle (deg), rate (deg/s) and acceleration (deg/s²) at τ, (n,) each."""
        ...

    @property
    def peaks(self) -> tuple[float, float]:
        """Bounds of |rate| and |acceleration|."""
        ...


@dataclass(frozen=True)
class Constant:
    """Constant acceleration: θ = angle + rate τ + acceleration τ² / 2. Rest and cruise are special cases."""

    duration_s: float
    angle_deg: float
    rate_deg_s: float = 0.0
    acceleration_deg_s2: float = 0.0

    def at(self, elapsed_s: FloatArray) -> Motion:
        """See `Piece`."""
        acceleration = np.full(len(elapsed_s), self.acceleration_deg_s2)
        if not self.acceleration_deg_s2:
            rate = np.full(len(elapsed_s), self.rate_deg_s)
            return self.angle_deg + self.rate_deg_s * elapsed_s, rate, acceleration
        gained = self.acceleration_deg_s2 * elapsed_s
        return (
            self.angle_deg + (self.rate_deg_s + gained / 2) * elapsed_s,
            self.rate_deg_s + gained,
            acceleration,
        )

    @property
    def peaks(self) -> tuple[float, float]:
        """See `Piece`."""
        last = self.rate_deg_s + self.acceleration_deg_s2 * self.duration_s
        return max(abs(self.rate_deg_s), abs(last)), abs(self.acceleration_deg_s2)


@dataclass(frozen=True)
class Sine:
    """Whole periods of θ = centre − amplitude cos ωτ: begins and ends at rest, at one turning point."""

    cycles: int
    centre_deg: float
    amplitude_deg: float
    angular_frequency_rad_s: float

    @property
    def duration_s(self) -> float:
        """See `Piece`."""
        return self.cycles * 2 * math.pi / self.angular_frequency_rad_s

    def at(self, elapsed_s: FloatArray) -> Motion:
        """See `Piece`."""
        omega, phase = self.angular_frequency_rad_s, self.angular_frequency_rad_s * elapsed_s
        wave = self.amplitude_deg * np.cos(phase)
        return self.centre_deg - wave, self.amplitude_deg * omega * np.sin(phase), omega**2 * wave

    @property
    def peaks(self) -> tuple[float, float]:
        """See `Piece`."""
        rate = abs(self.amplitude_deg) * self.angular_frequency_rad_s
        return rate, rate * self.angular_frequency_rad_s


@dataclass(frozen=True)
class Sweep:
    """A sine whose frequency rises: θ = centre + w(τ) A(ω) sin φ(τ), φ̇ = ω(τ) from ω_low to ω_high.

    A = R / (ω √(1 + (ωR / α)²)): a rate of amplitude R while the frequency is low, an acceleration of
    amplitude α when it is high, without a corner between. The window w = sin²(π τ / 2 T) over the first
    period, and back over the last four, begins and ends the sweep at rest at the centre.
    """

    duration_s: float
    centre_deg: float
    low_hz: float
    high_hz: float
    peak_rate_deg_s: float
    peak_acceleration_deg_s2: float
    logarithmic: bool = True

    def phase_rad(self, elapsed_s: FloatArray) -> FloatArray:
        """φ(τ), the integral of ω."""
        if self.logarithmic:
            growth = self._growth_per_s
            return 2 * np.pi * self.low_hz / growth * np.expm1(growth * elapsed_s)
        slope = (self.high_hz - self.low_hz) / self.duration_s
        return 2 * np.pi * (self.low_hz + slope * elapsed_s / 2) * elapsed_s

    def at(self, elapsed_s: FloatArray) -> Motion:
        """See `Piece`."""
        phase = self.phase_rad(elapsed_s)
        sine, cosine = np.sin(phase), np.cos(phase)
        omega, chirp, _ = self._frequency(elapsed_s)
        a, a1, a2 = self._amplitude(elapsed_s)
        return (
            self.centre_deg + a * sine,
            a1 * sine + a * omega * cosine,
            (a2 - a * omega**2) * sine + (2 * a1 * omega + a * chirp) * cosine,
        )

    @property
    def peaks(self) -> tuple[float, float]:
        """See `Piece`."""
        return self._peaks

    @cached_property
    def _peaks(self) -> tuple[float, float]:
        rise_s, fall_s = self._tapers_s
        inside = np.linspace(0.0, 1.0, _ENVELOPE_POINTS, endpoint=False)  # the window bends at its ends
        between_s = self.duration_s - rise_s - fall_s
        times_s = np.concatenate(
            [rise_s * inside, rise_s + between_s * inside, self.duration_s - fall_s * inside[::-1]]
        )
        omega, chirp, _ = self._frequency(times_s)
        a, a1, a2 = self._amplitude(times_s)
        rate = np.hypot(a1, a * omega)
        acceleration = np.hypot(a2 - a * omega**2, 2 * a1 * omega + a * chirp)
        return float(rate.max()), float(acceleration.max())

    @property
    def _growth_per_s(self) -> float:
        return math.log(self.high_hz / self.low_hz) / self.duration_s

    @property
    def _tapers_s(self) -> tuple[float, float]:
        """How long the window opens and closes."""
        longest_s = self.duration_s / 4
        return min(1 / self.low_hz, longest_s), min(_TAPER_CYCLES / self.high_hz, longest_s)

    def _frequency(self, elapsed_s: FloatArray) -> Motion:
        """ω in rad/s and its first two derivatives."""
        low = 2 * np.pi * self.low_hz
        if self.logarithmic:
            growth = self._growth_per_s
            omega = low * np.exp(growth * elapsed_s)
            return omega, growth * omega, growth**2 * omega
        slope = 2 * np.pi * (self.high_hz - self.low_hz) / self.duration_s
        return low + slope * elapsed_s, np.full(len(elapsed_s), slope), np.zeros(len(elapsed_s))

    def _amplitude(self, elapsed_s: FloatArray) -> Motion:
        """a = w A in degrees and its first two derivatives."""
        omega, chirp, chirp_change = self._frequency(elapsed_s)
        square = (omega * self.peak_rate_deg_s / self.peak_acceleration_deg_s2) ** 2
        amplitude = self.peak_rate_deg_s / (omega * np.sqrt(1 + square))
        share = (1 + 2 * square) / (1 + square)
        slope = -share / omega  # of ln A over ω
        bend = share / omega**2 - 2 * square / (omega * (1 + square)) ** 2
        first = amplitude * slope * chirp
        second = amplitude * ((slope**2 + bend) * chirp**2 + slope * chirp_change)
        w, w1, w2 = self._window(elapsed_s)
        return w * amplitude, w1 * amplitude + w * first, w2 * amplitude + 2 * w1 * first + w * second

    def _window(self, elapsed_s: FloatArray) -> Motion:
        """w and its first two derivatives."""
        rise_s, fall_s = self._tapers_s
        left_s = self.duration_s - elapsed_s
        falling = left_s < fall_s
        length_s = np.where(falling, fall_s, rise_s)
        place = np.clip(np.where(falling, left_s, elapsed_s) / length_s, 0.0, 1.0)
        speed = np.where(falling, -1.0, 1.0) * np.pi / length_s
        inside = place < 1.0
        angle = np.pi * place
        return (
            (1 - np.cos(angle)) / 2,
            np.where(inside, speed * np.sin(angle) / 2, 0.0),
            np.where(inside, speed**2 * np.cos(angle) / 2, 0.0),
        )


def turn_pieces(trapezoid: Trapezoid, start_deg: float) -> tuple[Constant, ...]:
    """A turn from rest to rest: ramp, cruise, ramp."""
    peak, ramp_s = trapezoid.peak_rate, trapezoid.ramp_s
    cruise_s = max(trapezoid.duration_s - 2 * ramp_s, 0.0)
    cruising_deg = start_deg + peak * ramp_s / 2
    return (
        Constant(ramp_s, start_deg, 0.0, trapezoid.acceleration),
        Constant(cruise_s, cruising_deg, peak),
        Constant(ramp_s, cruising_deg + peak * cruise_s, peak, -trapezoid.acceleration),
    )


def staircase_pieces(
    levels_deg_s: tuple[float, ...], dwell_s: float, acceleration_deg_s2: float, start_deg: float
) -> tuple[Constant, ...]:
    """From rest through these rates, each kept for `dwell_s`; between them ramps. The last should be 0."""
    pieces: list[Constant] = []
    angle, rate = start_deg, 0.0
    for level in levels_deg_s:
        step = level - rate
        if step:
            ramp_s = abs(step) / acceleration_deg_s2
            pieces.append(Constant(ramp_s, angle, rate, math.copysign(acceleration_deg_s2, step)))
            angle += (rate + level) / 2 * ramp_s
        pieces.append(Constant(dwell_s, angle, level))
        angle, rate = angle + level * dwell_s, level
    return tuple(pieces)

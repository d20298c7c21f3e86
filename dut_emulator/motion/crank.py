# pyright: strict
"""A crank that drives a slide to and fro, and the flywheel that evens its speed. Pure functions of an angle.

    x(θ) = r cos θ + √(b² − r² sin²θ) − b = r (cos θ − λ sin²θ / (1 + s)),   s = √(1 − λ² sin²θ),   λ = r / b

is a slider-crank with a rod of length b; with λ = 0 it is a scotch yoke, a pure sinusoid (paper 5, eq (1)).
θ = 0 is the outer dead centre.

Kinetic energy goes between the slide, a counter-slide whose crank pin is a quarter turn ahead, and the
flywheel (paper 5, eq (2), (3)); a drive that gives back just what friction takes leaves the sum as it is:

    ½ θ̇² I(θ) = E,   I(θ) = J + m x'(θ)² + m_c x'(θ + π/2)²

With the even phase ψ = 2π t / T of a turn that takes T, dψ/dθ = √I(θ) / mean √I. √I is smooth and periodic,
so ψ(θ) is a Fourier series, and so is its inverse θ(ψ): the inverse is solved by Newton's method on a grid
once, and its series is right to 1e-13 rad everywhere between. For a yoke with m = m_c nothing is left of it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

GRID = 512
"""Points of a turn: up to the 256th harmonic; λ = 0.3 needs some 30."""
NEGLIGIBLE_RAD = 1e-15
_NEWTON_STEPS = 30
_BISECTIONS = 60


@dataclass(frozen=True)
class Crank:
    """Geometry. `ratio`: λ = r / b, below 1; 0 for a scotch yoke."""

    radius_m: float
    ratio: float = 0.0

    def position(self, angle_rad: FloatArray) -> FloatArray:
        """x(θ) in m: ± r at the dead centres."""
        sine = np.sin(angle_rad)
        return self.radius_m * (np.cos(angle_rad) - self.ratio * sine**2 / (1.0 + self._rod(sine)))

    def slope(self, angle_rad: FloatArray) -> FloatArray:
        """x'(θ) in m per rad."""
        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        return -self.radius_m * sine * (1.0 + self.ratio * cosine / self._rod(sine))

    def curvature(self, angle_rad: FloatArray) -> FloatArray:
        """x''(θ) in m per rad²."""
        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        rod = self._rod(sine)
        bend = (cosine**2 - sine**2) / rod + (self.ratio * sine * cosine) ** 2 / rod**3
        return -self.radius_m * (cosine + self.ratio * bend)

    def force_free_angle_rad(self) -> float:
        """θ in (0, π) where an even turn does not accelerate the slide; at 2π − θ neither. π/2 for a yoke.

        The two passes share their position, since x is even in θ.
        """
        low, high = 0.0, math.pi
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if float(self.curvature(np.array([middle]))[0]) < 0.0:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def _rod(self, sine: FloatArray) -> FloatArray:
        return np.sqrt(1.0 - (self.ratio * sine) ** 2)


@dataclass(frozen=True)
class Flywheel:
    """What turns and what goes to and fro with it; see the module. Masses in kg, J in kg m²."""

    crank: Crank
    inertia_kg_m2: float
    slide_kg: float
    counter_slide_kg: float

    def inertia_at(self, angle_rad: FloatArray) -> FloatArray:
        """I(θ) in kg m²."""
        ahead = angle_rad + 0.5 * math.pi
        return (
            self.inertia_kg_m2
            + self.slide_kg * self.crank.slope(angle_rad) ** 2
            + self.counter_slide_kg * self.crank.slope(ahead) ** 2
        )

    def inertia_slope_at(self, angle_rad: FloatArray) -> FloatArray:
        """I'(θ) in kg m² per rad."""
        ahead = angle_rad + 0.5 * math.pi
        own = self.slide_kg * self.crank.slope(angle_rad) * self.crank.curvature(angle_rad)
        counter = self.counter_slide_kg * self.crank.slope(ahead) * self.crank.curvature(ahead)
        return 2.0 * (own + counter)

    def kinetic_energy_j(self, mean_speed_rad_s: float) -> float:
        """E of a turn that takes 2π / mean speed: ½ (mean speed · mean √I)²."""
        mean_root = float(np.sqrt(self.inertia_at(_grid())).mean())
        return 0.5 * (mean_speed_rad_s * mean_root) ** 2


@dataclass(frozen=True)
class SlideState:
    """Crank and slide at n instants; SI."""

    angle_rad: FloatArray
    speed_rad_s: FloatArray
    position_m: FloatArray
    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray


class CrankTurn:
    """How the crank turns with its flywheel, by the even phase ψ: θ(0) = 0, θ(ψ + 2π) = θ(ψ) + 2π."""

    def __init__(self, flywheel: Flywheel) -> None:
        self._flywheel = flywheel
        roots = np.fft.rfft(np.sqrt(flywheel.inertia_at(_grid())))[: GRID // 2] / GRID
        self._mean_root = float(roots[0].real)
        orders = np.arange(1, len(roots))
        self._phase_terms = _significant(2.0 * roots[1:] / (self._mean_root * 1j * orders))
        lead = np.fft.rfft(self._solved(_grid()) - _grid())[: GRID // 2] / GRID
        self._angle_terms = _significant(2.0 * lead[1:])

    def phase(self, angle_rad: FloatArray) -> FloatArray:
        """ψ(θ)."""
        return angle_rad + _series(self._phase_terms, angle_rad)

    def at(self, phase: FloatArray, rate: FloatArray, acceleration: FloatArray) -> SlideState:
        """Crank and slide where ψ, ψ̇ (rad/s) and ψ̈ (rad/s²) are these, each (n,)."""
        flywheel, crank = self._flywheel, self._flywheel.crank
        angle = phase + _series(self._angle_terms, phase)
        inertia = flywheel.inertia_at(angle)
        per_phase = self._mean_root / np.sqrt(inertia)
        speed = rate * per_phase
        angular = acceleration * per_phase - speed**2 * flywheel.inertia_slope_at(angle) / (2.0 * inertia)
        slope = crank.slope(angle)
        return SlideState(
            angle_rad=angle,
            speed_rad_s=speed,
            position_m=crank.position(angle),
            velocity_m_s=slope * speed,
            acceleration_m_s2=crank.curvature(angle) * speed**2 + slope * angular,
        )

    @property
    def speed_ripple(self) -> float:
        """(largest − least speed) / mean speed."""
        per_phase = self._mean_root / np.sqrt(self._flywheel.inertia_at(_grid()))
        return float(np.ptp(per_phase))

    def _solved(self, phases: FloatArray) -> FloatArray:
        """θ of these ψ by Newton's method."""
        angles = phases.copy()
        for _ in range(_NEWTON_STEPS):
            slope = np.sqrt(self._flywheel.inertia_at(angles)) / self._mean_root
            step = (self.phase(angles) - phases) / slope
            angles -= step
            if float(np.abs(step).max()) < NEGLIGIBLE_RAD:
                break
        return angles


def _grid() -> FloatArray:
    return np.arange(GRID, dtype=np.float64) * (2.0 * math.pi / GRID)


def _significant(terms: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Without the tail that is rounding only."""
    large = np.flatnonzero(np.abs(terms) > NEGLIGIBLE_RAD)
    return terms[: int(large[-1]) + 1] if len(large) else terms[:0]


def _series(terms: NDArray[np.complex128], at_rad: FloatArray) -> FloatArray:
    """Re Σ c_k (e^{ik at} − 1) for k = 1 …, by Horner's scheme: 0 at 0."""
    if len(terms) == 0:
        return np.zeros_like(at_rad)
    wave = np.exp(1j * at_rad)
    total: NDArray[np.complex128] = np.full(at_rad.shape, terms[-1], dtype=np.complex128)
    for term in terms[-2::-1]:
        total = total * wave + term
    return np.real(total * wave) - float(np.real(terms).sum())

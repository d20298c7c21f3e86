# pyright: strict
"""The way of a vehicle or an aircraft: speed, climb angle, rate of turn as functions of time; what follows.

Local axes are east, north, up, fixed to the Earth at the start. Body axes are x forward, y left, z up. Yaw ψ
is clockwise from north, pitch nose up, roll right side down:

    velocity   V (sin ψ cos γ, cos ψ cos γ, sin γ)
    attitude   heading ψ, climb γ, bank φ about the velocity, incidence α about body y

V, γ, ψ̇ and what is given of α are sums of steps of a polynomial of degree 9 (four continuous derivatives).
Hence force and rate have two continuous derivatives, and all of them are exact (`series`). The velocity's
integral has no closed form: it is a Chebyshev series on fixed pieces of time, exact to rounding (1e-9 m), and
like everything here a function of time alone.

Left out: the Earth's curvature. Up is parallel to itself all along the way, which is wrong by 0.16 mrad per
km, and so there is no transport rate (1e-5 rad/s at 60 m/s). Earth rate and Coriolis force are in.
"""

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from dut_emulator.gimbal_geometry import EARTH_RATE_RAD_S
from dut_emulator.motion.gravity import height_coefficients
from dut_emulator.motion.series import angle_of, antiderivative, derivative, product, sine_cosine

FloatArray = NDArray[np.float64]

QUANTITIES = ("speed", "climb", "turn", "incidence")
ORDER = 3
"""Of the series of speed and angles."""
_STEP = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
_STEP_DERIVATIVES = [_STEP.deriv(k) if k else _STEP for k in range(ORDER + 1)]
_STEP_INTEGRAL = _STEP.integ()
STEEPEST = 630 / 256
"""Largest slope of the step from 0 to 1 in unit time."""
_DEGREE = 24
_LONGEST_PIECE_S = 4.0
_NODES = np.cos(np.pi * (np.arange(_DEGREE + 1)[::-1] + 0.5) / (_DEGREE + 1))
_INTEGRAL: FloatArray = np.asarray(
    chebyshev.chebint(np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE)), lbnd=-1), dtype=np.float64
)
"""(degree + 2, degree + 1): values at the nodes → Chebyshev coefficients of the integral from −1."""


@dataclass(frozen=True)
class Step:
    """From `begin_s` on the value changes by `amount` within `duration_s` > 0."""

    begin_s: float
    duration_s: float
    amount: float


@dataclass(frozen=True)
class Steps:
    """A value that goes from one level to the next, smoothly."""

    start: float = 0.0
    steps: tuple[Step, ...] = ()

    def series(self, times_s: FloatArray) -> FloatArray:
        """(ORDER + 1, n) at non-decreasing times."""
        result = np.zeros((ORDER + 1, len(times_s)))
        result[0] = self.start
        for step in self.steps:
            begin, end = np.searchsorted(times_s, (step.begin_s, step.begin_s + step.duration_s))
            result[0, end:] += step.amount
            if begin < end:
                share = (times_s[begin:end] - step.begin_s) / step.duration_s
                factor = step.amount
                for k, polynomial in enumerate(_STEP_DERIVATIVES):
                    result[k, begin:end] += factor * polynomial(share)
                    factor /= step.duration_s * (k + 1)
        return result

    def integral(self, times_s: FloatArray) -> FloatArray:
        """(n,) from time 0."""
        result = self.start * times_s
        for step in self.steps:
            passed = np.maximum((times_s - step.begin_s) / step.duration_s, 0.0)
            inside = _STEP_INTEGRAL(np.minimum(passed, 1.0)) + np.maximum(passed - 1.0, 0.0)
            result += step.amount * step.duration_s * inside
        return result

    def level_after(self, now_s: float) -> float:
        """Where the steps that have begun lead to."""
        return self.start + sum(step.amount for step in self.steps if step.begin_s < now_s)

    def ended(self, now_s: float, duration_s: float) -> "Steps":
        """The same until now; steps that have begun go on, none begins, and one more leads to zero."""
        begun = tuple(step for step in self.steps if step.begin_s < now_s)
        level = self.level_after(now_s)
        return Steps(self.start, (*begun, Step(now_s, duration_s, -level)) if level else begun)


@dataclass(frozen=True)
class Suspension:
    """How a car leans, in rad per m/s²: outwards in a turn, nose up as it accelerates."""

    roll_per_m_s2: float
    pitch_per_m_s2: float


@dataclass(frozen=True)
class Motion:
    """Of the centre, at n moments. Vectors are (n, 3), in body axes unless the name says local.

    Attributes:
        euler_rad: roll, pitch, yaw of the body.
        rate_rad_s: of the body relative to the Earth.
        angular_acceleration_rad_s2: its derivative.
        specific_force_m_s2: gravity and Coriolis force included.
    """

    position_local_m: FloatArray
    velocity_local_m_s: FloatArray
    dcm_local_from_body: FloatArray
    euler_rad: FloatArray
    rate_rad_s: FloatArray
    angular_acceleration_rad_s2: FloatArray
    specific_force_m_s2: FloatArray
    earth_rate_rad_s: FloatArray


@dataclass(frozen=True)
class Path:
    """Speed V (m/s), climb γ (rad), turn rate ψ̇ (rad/s), incidence α (rad), from `heading_rad` on.

    Without a suspension the turns are coordinated: the bank is such that no force acts along body y, as in
    tan φ = V ψ̇ / g for a steady level turn (with Coriolis force and pull-up counted in).
    """

    speed: Steps
    climb: Steps
    turn: Steps
    incidence: Steps = field(default_factory=Steps)
    heading_rad: float = 0.0
    latitude_deg: float = 0.0
    gravity_m_s2: float = 9.80665
    suspension: Suspension | None = None

    def motion(self, times_s: FloatArray) -> Motion:
        """Everything at non-decreasing times (n,)."""
        speed, climb, turn = (steps.series(times_s) for steps in (self.speed, self.climb, self.turn))
        heading = antiderivative(turn, self.heading_rad + self.turn.integral(times_s))[: ORDER + 1]
        (sine_h, cosine_h), (sine_c, cosine_c) = sine_cosine(heading), sine_cosine(climb)
        position = self.position_local_m(times_s)
        earth_north, earth_up = self._earth_rate_north_up()
        earth_left = earth_north * sine_h
        earth_normal = -earth_north * product(cosine_h, sine_c) + earth_up * cosine_c
        gravity = self._gravity(position[:, 2], product(speed, sine_c))
        left = product(speed, 2.0 * earth_normal - product(cosine_c, turn))[:ORDER]
        normal = (
            product(speed, derivative(climb) - 2.0 * earth_left[:ORDER]) + product(gravity, cosine_c)[:ORDER]
        )
        forward = derivative(speed)[0] + gravity[0] * sine_c[0]
        bank, incidence = self._lean(speed, product(speed, turn), left, normal, times_s)
        axes = _Axes(sine_h, cosine_h, sine_c, cosine_c, *sine_cosine(bank), *sine_cosine(incidence))
        rate = axes.body_rate(turn, climb, bank, incidence)
        dcm = axes.dcm_local_from_body()
        earth = np.array([0.0, earth_north, earth_up])
        return Motion(
            position_local_m=position,
            velocity_local_m_s=_velocity(speed[0], sine_h[0], cosine_h[0], sine_c[0], cosine_c[0]),
            dcm_local_from_body=dcm,
            euler_rad=euler_angles_rad(dcm),
            rate_rad_s=rate[0],
            angular_acceleration_rad_s2=rate[1],
            specific_force_m_s2=axes.into_body(forward, left[0], normal[0]),
            earth_rate_rad_s=np.einsum("nij,i->nj", dcm, earth),
        )

    def position_local_m(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) east, north, up of the start, at non-decreasing times."""
        knots, starts, coefficients = self._pieces
        inside = np.clip(times_s, knots[0], knots[-1])
        piece = np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, len(knots) - 2)
        result = np.empty((len(times_s), 3))
        first = 0
        while first < len(times_s):
            here = int(piece[first])
            last = int(np.searchsorted(piece, here, side="right"))
            low, high = knots[here : here + 2]
            share = (2.0 * inside[first:last] - low - high) / (high - low)
            way: FloatArray = np.asarray(chebyshev.chebval(share, coefficients[here]), dtype=np.float64)
            result[first:last] = starts[here] + way.T
            first = last
        beyond = times_s - inside
        return result + self._steady_way(inside, beyond) if beyond.any() else result

    def ended(self, now_s: float, duration_s: float) -> "Path":
        """The same way until now, then to rest, straight and level."""
        steps = {name: getattr(self, name).ended(now_s, duration_s) for name in QUANTITIES}
        return dataclasses.replace(self, **steps)

    def end_s(self) -> float:
        """When the last step ends."""
        every = [step for name in QUANTITIES for step in getattr(self, name).steps]
        return max((step.begin_s + step.duration_s for step in every), default=0.0)

    def _steady_way(self, times_s: FloatArray, passed_s: FloatArray) -> FloatArray:
        """(n, 3) of a time in which nothing changes: a chord of the circle, or straight on."""
        half = self.turn.level_after(np.inf) * passed_s / 2.0
        sine, cosine = np.sin(half), np.cos(half)
        east, north, up = self._velocity_local_m_s(times_s).T
        level = np.stack([cosine * east + sine * north, cosine * north - sine * east]) * np.sinc(half / np.pi)
        return np.stack([*level, up], axis=1) * passed_s[:, np.newaxis]

    @cached_property
    def _pieces(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Knots (k + 1,), positions at k pieces' starts (k, 3), Chebyshev coefficients (k, degree + 2, 3)."""
        ends = {0.0, self.end_s() + _LONGEST_PIECE_S}
        for step in (*self.speed.steps, *self.climb.steps, *self.turn.steps):
            ends |= {step.begin_s, step.begin_s + step.duration_s}
        parts: list[FloatArray] = [
            np.linspace(low, high, 1 + int(np.ceil((high - low) / _LONGEST_PIECE_S)))[:-1]
            for low, high in pairwise(sorted(ends))
        ]
        knots = np.concatenate([*parts, np.array([max(ends)])])
        half = np.diff(knots)[:, np.newaxis] / 2.0
        times = knots[:-1, np.newaxis] + half * (1.0 + _NODES)
        velocity = self._velocity_local_m_s(times.ravel()).reshape(*times.shape, 3)
        coefficients: FloatArray = np.einsum("dm,kmi->kdi", _INTEGRAL, velocity) * half[:, :, np.newaxis]
        ways: FloatArray = coefficients.sum(axis=1)  # every Chebyshev polynomial is 1 at its piece's end
        starts = np.concatenate([np.zeros((1, 3)), np.cumsum(ways, axis=0)[:-1]])
        return knots, starts, coefficients

    def _velocity_local_m_s(self, times_s: FloatArray) -> FloatArray:
        speed, climb = self.speed.series(times_s)[0], self.climb.series(times_s)[0]
        heading = self.heading_rad + self.turn.integral(times_s)
        return _velocity(speed, np.sin(heading), np.cos(heading), np.sin(climb), np.cos(climb))

    def _earth_rate_north_up(self) -> tuple[float, float]:
        latitude = np.radians(self.latitude_deg)
        return EARTH_RATE_RAD_S * float(np.cos(latitude)), EARTH_RATE_RAD_S * float(np.sin(latitude))

    def _gravity(self, height_m: FloatArray, climbing: FloatArray) -> FloatArray:
        """Series of gravity: that of the site at the start's height."""
        height = antiderivative(climbing, height_m)[: ORDER + 1]
        first, second = height_coefficients(self.latitude_deg)
        series = self.gravity_m_s2 * (first * height + second * product(height, height))
        series[0] += self.gravity_m_s2
        return series

    def _lean(
        self,
        speed: FloatArray,
        turning: FloatArray,
        left: FloatArray,
        normal: FloatArray,
        times_s: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Bank and incidence, to second order."""
        incidence = self.incidence.series(times_s)[:ORDER]
        if self.suspension is None:
            return angle_of(-left, normal), incidence
        squat = self.suspension.pitch_per_m_s2 * derivative(speed)
        return -self.suspension.roll_per_m_s2 * turning[:ORDER], incidence + squat


@dataclass(frozen=True)
class _Axes:
    """Body axes as rotations by heading, climb, bank and incidence: series of their sines and cosines."""

    sine_h: FloatArray
    cosine_h: FloatArray
    sine_c: FloatArray
    cosine_c: FloatArray
    sine_b: FloatArray
    cosine_b: FloatArray
    sine_i: FloatArray
    cosine_i: FloatArray

    def body_rate(
        self, turn: FloatArray, climb: FloatArray, bank: FloatArray, incidence: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rate and its derivative, (n, 3) each; each angle turns in the axes that it carries."""
        forward = derivative(bank) - product(turn, self.sine_c)[:2]
        left, normal = -derivative(climb), -product(turn, self.cosine_c)
        banked_left = product(self.cosine_b, left)[:2] + product(self.sine_b, normal)[:2]
        banked_normal = product(self.cosine_b, normal)[:2] - product(self.sine_b, left)[:2]
        x = product(self.cosine_i, forward) + product(self.sine_i, banked_normal)
        y = banked_left - derivative(incidence)
        z = product(self.cosine_i, banked_normal) - product(self.sine_i, forward)
        rate = np.stack([x, y, z], axis=2)
        return rate[0], rate[1]

    def into_body(self, forward: FloatArray, left: FloatArray, normal: FloatArray) -> FloatArray:
        """(n, 3) of a vector given along and across the velocity, before the bank."""
        sine_b, cosine_b, sine_i, cosine_i = (
            self.sine_b[0],
            self.cosine_b[0],
            self.sine_i[0],
            self.cosine_i[0],
        )
        banked_left = cosine_b * left + sine_b * normal
        banked_normal = cosine_b * normal - sine_b * left
        x = cosine_i * forward + sine_i * banked_normal
        return np.stack([x, banked_left, cosine_i * banked_normal - sine_i * forward], axis=1)

    def dcm_local_from_body(self) -> FloatArray:
        """(n, 3, 3): columns are the body axes, rows east, north, up."""
        sine_h, cosine_h, sine_c, cosine_c = (
            self.sine_h[0],
            self.cosine_h[0],
            self.sine_c[0],
            self.cosine_c[0],
        )
        rows = [
            self.into_body(sine_h * cosine_c, -cosine_h, -sine_h * sine_c),
            self.into_body(cosine_h * cosine_c, sine_h, -cosine_h * sine_c),
            self.into_body(sine_c, np.zeros_like(sine_c), cosine_c),
        ]
        return np.stack(rows, axis=1)


def euler_angles_rad(dcm_local_from_body: FloatArray) -> FloatArray:
    """(n, 3, 3) → (n, 3): roll, pitch, yaw."""
    forward, up = dcm_local_from_body[:, :, 0], dcm_local_from_body[:, 2]
    pitch = np.arcsin(np.clip(forward[:, 2], -1.0, 1.0))
    yaw = np.arctan2(forward[:, 0], forward[:, 1])
    return np.stack([np.arctan2(up[:, 1], up[:, 2]), pitch, yaw], axis=1)


def _velocity(
    speed: FloatArray, sine_h: FloatArray, cosine_h: FloatArray, sine_c: FloatArray, cosine_c: FloatArray
) -> FloatArray:
    return np.stack([speed * sine_h * cosine_c, speed * cosine_h * cosine_c, speed * sine_c], axis=1)

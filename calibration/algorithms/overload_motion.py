"""Half-cycles T, V, S from the grating of a sinusoidal overload rig (paper 5, 4.2).

The paper differentiates the grating. Twice over, that turns a micrometre into noise of the size of the
acceleration. A rig that runs steadily moves periodically, whatever its crank: its position is

    x(t) = x_0 + sum_k p_k cos(k w t) + q_k sin(k w t),   k = 1 … harmonics

fitted with w by Gauss-Newton, and differentiated in closed form. Half-cycles are cut where the
acceleration changes sign. A rig that does not run steadily leaves a residual, and is refused.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.sinusoidal_overload import HalfCycles, refused
from protocol.errors import Fault

HARMONICS = 6
"""What a crank with r/b up to 0.3 has above is below 1e-6 of the first."""
MIN_CYCLES_SEEN = 3
MIN_SAMPLES_PER_CYCLE = 4 * HARMONICS
MAX_ITERATIONS = 20
MAX_RESIDUAL = 1e-3
"""Largest rms residual relative to the amplitude: more is no steady motion."""
GRID = 4096
"""Points of one cycle between which the acceleration's sign changes are looked for."""


@dataclass(frozen=True)
class OverloadMotion:
    """A steady motion and its half-cycles.

    Attributes:
        half_cycles: m whole cycles.
        cut_s: instants between halves, shape (2 m + 1,); the first half has A > 0.
        angular_frequency_rad_s: w.
        amplitude_m: half of the stroke.
        peak_m_s2: largest acceleration, either way.
        residual_rms_m: of the fit.
        relative_uncertainty: bound on the relative standard uncertainty of V and S's root from the
            grating's noise; combine it with the grating's own length error (`u_grating`).
        terms_m: of the position: constant, cosines, sines of the phase since `start_s`.
        start_s: where the phase is zero.
    """

    half_cycles: HalfCycles
    cut_s: FloatArray
    angular_frequency_rad_s: float
    amplitude_m: float
    peak_m_s2: float
    residual_rms_m: float
    relative_uncertainty: float
    terms_m: FloatArray
    start_s: float

    def slide(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position about its mean (m), speed (m/s), acceleration (m/s^2), shapes (n,)."""
        frequency = self.angular_frequency_rad_s
        basis = _basis(frequency * (time_s - self.start_s))
        centred = np.concatenate([[0.0], self.terms_m[1:]])
        speed = _derivative(centred) * frequency
        return basis @ centred, basis @ speed, basis @ (_derivative(speed) * frequency)


def half_cycles_from_grating(time_s: FloatArray, position_m: FloatArray) -> OverloadMotion:
    """Fit the motion and cut it.

    Args:
        time_s: shape (n,), ascending; need not be even.
        position_m: shape (n,), positive along the accelerometer's axis.

    Raises:
        CalibrationError: missing samples, too few cycles or samples, or a motion that is not steady.
    """
    time_s, position_m = np.asarray(time_s, dtype=np.float64), np.asarray(position_m, dtype=np.float64)
    if time_s.shape != position_m.shape or not np.isfinite(np.r_[time_s, position_m]).all():
        raise refused("The grating's times and positions do not fit, or some are missing.", Fault.DATA)
    if len(time_s) < 2 or (np.diff(time_s) <= 0).any():
        raise refused("The grating's time does not run forward.", Fault.DATA)
    start_s = float(time_s[0])
    elapsed = time_s - start_s
    frequency, cycles = _first_guess(elapsed, position_m)
    if cycles < MIN_CYCLES_SEEN or len(time_s) < MIN_SAMPLES_PER_CYCLE * cycles:
        raise refused(
            f"{len(time_s)} samples of {cycles} cycles: a motion takes {MIN_CYCLES_SEEN} cycles and "
            f"{MIN_SAMPLES_PER_CYCLE} samples of each.",
            Fault.PLAN,
        )
    frequency, terms, residual_rms = _fit(elapsed, position_m, frequency)
    amplitude = float(np.hypot(terms[1], terms[1 + HARMONICS]))
    if residual_rms > MAX_RESIDUAL * amplitude:
        raise refused(
            f"The motion is not steady: {residual_rms:.3g} m rms are left of {amplitude:.3g} m.", Fault.STAND
        )
    orders = np.arange(1, HARMONICS + 1)
    per_term = residual_rms * math.sqrt(2.0 / len(time_s))
    return _cut(
        terms,
        frequency,
        start_s,
        float(elapsed[-1]),
        residual_rms,
        per_term * float(np.sqrt((orders**4).sum())) / amplitude,
    )


def pulses_of_halves(cut_s: FloatArray, time_s: FloatArray, count: FloatArray) -> FloatArray:
    """Pulses of each half, shape (m, 2, ...), from running counts (n, ...) at times (n,).

    A count between two readings is taken as straight; read the counters fast against a half-cycle.

    Raises:
        CalibrationError: counters that were not read over all of the halves.
    """
    if cut_s[0] < time_s[0] or cut_s[-1] > time_s[-1] or not np.isfinite(count).all():
        raise refused("The counters were not read over all of the half-cycles.", Fault.DATA)
    columns = count.reshape(len(time_s), -1)
    at_cuts = np.column_stack([np.interp(cut_s, time_s, column) for column in columns.T])
    return np.diff(at_cuts, axis=0).reshape(-1, 2, *count.shape[1:])


def _first_guess(elapsed_s: FloatArray, position_m: FloatArray) -> tuple[float, int]:
    """w from the rising passes through the middle, and how many whole cycles they span."""
    centred = position_m - 0.5 * float(position_m.max() + position_m.min())
    before = np.flatnonzero((centred[:-1] < 0) & (centred[1:] >= 0))
    if len(before) < 2:
        return 0.0, 0
    part = -centred[before] / (centred[before + 1] - centred[before])
    passes = elapsed_s[before] + part * (elapsed_s[before + 1] - elapsed_s[before])
    return 2.0 * math.pi * (len(passes) - 1) / float(passes[-1] - passes[0]), len(passes) - 1


def _basis(phase: FloatArray) -> FloatArray:
    """1, cos(k phase), sin(k phase), shape (n, 1 + 2 harmonics)."""
    turned = np.outer(phase, np.arange(1, HARMONICS + 1))
    return np.hstack([np.ones((len(phase), 1)), np.cos(turned), np.sin(turned)])


def _derivative(terms: FloatArray) -> FloatArray:
    """Terms of dx/dphase."""
    orders = np.arange(1, HARMONICS + 1)
    cos, sin = terms[1 : 1 + HARMONICS], terms[1 + HARMONICS :]
    return np.concatenate([[0.0], orders * sin, -orders * cos])


def _fit(elapsed_s: FloatArray, position_m: FloatArray, frequency: float) -> tuple[float, FloatArray, float]:
    """Gauss-Newton in w and the terms together."""
    for _ in range(MAX_ITERATIONS):
        basis = _basis(frequency * elapsed_s)
        terms = np.asarray(np.linalg.lstsq(basis, position_m, rcond=None)[0], dtype=np.float64)
        along = (basis @ _derivative(terms)) * elapsed_s
        step = float(np.linalg.lstsq(np.column_stack([basis, along]), position_m, rcond=None)[0][-1])
        frequency += step
        if abs(step) <= 1e-13 * frequency:
            break
    basis = _basis(frequency * elapsed_s)
    terms = np.asarray(np.linalg.lstsq(basis, position_m, rcond=None)[0], dtype=np.float64)
    residual = position_m - basis @ terms
    freedom = len(position_m) - 2 * HARMONICS - 2
    return frequency, terms, math.sqrt(float(residual @ residual) / freedom)


def _cut(
    terms: FloatArray,
    frequency: float,
    start_s: float,
    span_s: float,
    residual_rms: float,
    relative: float,
) -> OverloadMotion:
    """Cut at the acceleration's sign changes, and integrate each half: V in closed form, S by quadrature."""
    speed_terms = _derivative(terms) * frequency
    force_terms = _derivative(speed_terms) * frequency
    grid = np.linspace(0.0, 2.0 * math.pi, GRID + 1)
    force = _basis(grid) @ force_terms
    rising, falling = (
        np.flatnonzero((sign * force[:-1] < 0) & (sign * force[1:] >= 0)) for sign in (1.0, -1.0)
    )
    if len(rising) != 1 or len(falling) != 1:
        raise refused("The acceleration changes its sign more than twice in a cycle.", Fault.STAND)
    up, down = (_root(grid, force, force_terms, int(place[0])) for place in (rising, falling))
    down += 2.0 * math.pi * (down < up)
    cycles = int((frequency * span_s - up) // (2.0 * math.pi))
    edges = np.array([up, down, up + 2.0 * math.pi])
    speed = np.abs(np.diff(_basis(edges) @ speed_terms))
    squared = np.empty(2)
    nodes, weights = np.polynomial.legendre.leggauss(8 * HARMONICS)
    for half in range(2):
        width = 0.5 * (edges[half + 1] - edges[half])
        phase = edges[half] + width * (nodes + 1.0)
        squared[half] = width * float(weights @ (_basis(phase) @ force_terms) ** 2) / frequency
    duration = np.diff(edges) / frequency
    every = np.ones((cycles, 1))
    wave = _basis(grid) @ terms
    starts = up + 2.0 * math.pi * np.arange(cycles + 1)
    cuts = np.sort(np.concatenate([starts, starts[:-1] + (down - up)]))
    return OverloadMotion(
        half_cycles=HalfCycles(every * duration, every * speed, every * squared),
        cut_s=np.asarray(start_s + cuts / frequency, dtype=np.float64),
        angular_frequency_rad_s=frequency,
        amplitude_m=0.5 * float(np.ptp(wave)),
        peak_m_s2=float(np.abs(force).max()),
        residual_rms_m=residual_rms,
        relative_uncertainty=relative,
        terms_m=terms,
        start_s=start_s,
    )


def _root(grid: FloatArray, force: FloatArray, force_terms: FloatArray, place: int) -> float:
    """Phase of a sign change after `grid[place]`: a chord, then two Newton steps."""
    low, high = float(force[place]), float(force[place + 1])
    phase = float(grid[place] + (grid[place + 1] - grid[place]) * -low / (high - low))
    for _ in range(2):
        at = _basis(np.array([phase]))
        phase -= float((at @ force_terms)[0] / (at @ _derivative(force_terms))[0])
    return phase

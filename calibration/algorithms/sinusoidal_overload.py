"""Scale-factor asymmetry and odd quadratic non-linearity from a sinusoidal overload rig (paper 5).

    dN/dt = K_1 (1 + K_a sgn A) (K_0 + A + K_2 A|A| + K_2e A^2)      eq (4); K_2e is even, known, usually 0

Over the half of a cycle with A > 0 (duration T+, integral V+ of A, integral S+ of A^2), and over
the other (T-, and magnitudes V-, S-):

    N+ = K_1 (1 + K_a) (K_0 T+ + V+ + (K_2 + K_2e) S+)
    N- = K_1 (1 - K_a) (K_0 T- - V- - (K_2 - K_2e) S-)

Two equations, two unknowns, solved exactly from the *measured* T, V, S: a slider-crank is no
sinusoid, and its halves differ (r/b = 0.2: S+ to S- as 0.72 to 1). The printed forms, eq (9) and (11),
drop K_a K_2 and K_0 K_a and take both halves as alike; they stand beside (`printed_forms`).

The half-cycles are cut where the *acceleration* changes sign, which is where the speed peaks.
A is specific force along the axis in m/s^2 (a speed from a grating is in m/s: nothing is divided by
g); K_0 includes the part of gravity that lies along the axis. K_2 is in s^2/m.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.uncertainty_budget import t_inflation
from protocol.errors import CalibrationError, Fault

MIN_CYCLES = 4
"""Cycles whose scatter carries a standard uncertainty."""
MAX_ASYMMETRY = 0.1
"""|K_a| beyond this is no small error of an accelerometer: pulses or halves are mixed up."""
CORRELATION_SIGMAS = 2.5
"""A lag-1 correlation of the cycles beyond this many of its standard deviations counts."""
MAX_CORRELATION = 0.98
_CLOSURE = 0.05
"""Largest |V+ - V-| / (V+ + V-) of a rig that comes back to where it started."""


@dataclass(frozen=True)
class HalfCycles:
    """What the grating tells of each cycle; column 0 the half with A > 0, column 1 that with A < 0.

    Attributes:
        duration_s: T, shape (m, 2).
        speed_change_m_s: V, magnitude of the integral of A, shape (m, 2).
        squared_m2_s3: S, integral of A^2, shape (m, 2).

    Raises:
        CalibrationError: shapes that do not fit, values that are not positive, or halves whose speed
            changes differ so much that the rig did not move in cycles.
    """

    duration_s: FloatArray
    speed_change_m_s: FloatArray
    squared_m2_s3: FloatArray

    def __post_init__(self) -> None:
        cycles = len(self.duration_s)
        for name in ("duration_s", "speed_change_m_s", "squared_m2_s3"):
            values = np.array(getattr(self, name), dtype=np.float64)  # a copy of our own
            if values.shape != (cycles, 2) or cycles == 0:
                raise refused(
                    f"The half-cycles' {name} has shape {values.shape}, not (cycles, 2).", Fault.DATA
                )
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise refused(f"The half-cycles' {name} holds values that are not positive.", Fault.DATA)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        change = self.speed_change_m_s
        if (np.abs(change[:, 0] - change[:, 1]) > _CLOSURE * change.sum(axis=1)).any():
            raise refused("The speed changes of two halves do not close a cycle.", Fault.STAND)

    def total(self) -> "HalfCycles":
        """All cycles as one: the model is linear in T, V and S, so sums obey it too. Shape (1, 2)."""
        sums = (self.duration_s, self.speed_change_m_s, self.squared_m2_s3)
        return HalfCycles(*(values.sum(axis=0, keepdims=True) for values in sums))

    def as_if_sinusoidal(self, amplitude_m: float) -> "HalfCycles":
        """The same cycles with T and S of a pure sinusoid of this amplitude of position; V as measured."""
        period = self.duration_s.sum(axis=1, keepdims=True)
        peak = amplitude_m * (2.0 * math.pi / period) ** 2
        both = np.ones((1, 2))
        return HalfCycles(0.5 * period * both, self.speed_change_m_s, 0.25 * peak**2 * period * both)


@dataclass(frozen=True)
class KnownAccelerometer:
    """What other tests told of the accelerometer, and of the rig's grating.

    Attributes:
        scale_factor_pulse_s_m: K_1, pulses per (m/s).
        bias_m_s2: K_0, including gravity along the axis.
        even_quadratic_s2_m: K_2e.
        u_scale_factor: relative, of K_1.
        u_bias_m_s2, u_even_quadratic_s2_m: standard uncertainties.
        u_grating: relative standard uncertainty of the grating's length; A, V scale with it.
    """

    scale_factor_pulse_s_m: float
    bias_m_s2: float
    u_scale_factor: float
    u_bias_m_s2: float
    u_grating: float
    even_quadratic_s2_m: float = 0.0
    u_even_quadratic_s2_m: float = 0.0

    def __post_init__(self) -> None:
        values = tuple(vars(self).values())
        uncertainties = (self.u_scale_factor, self.u_bias_m_s2, self.u_grating, self.u_even_quadratic_s2_m)
        if not all(math.isfinite(value) for value in values) or min(uncertainties) < 0:
            raise refused("What is known of the accelerometer is not finite or negative.", Fault.DATA)
        if self.scale_factor_pulse_s_m <= 0:
            raise refused("The scale factor K_1 is not positive.", Fault.DATA)


@dataclass(frozen=True)
class Sensitivity:
    """How the two coefficients move with one known quantity, per unit of it.

    Attributes:
        quantity, unit: what moves.
        standard_uncertainty: of the quantity, in `unit`.
        asymmetry: dK_a per unit.
        odd_quadratic_s2_m: dK_2 per unit.
    """

    quantity: str
    unit: str
    standard_uncertainty: float
    asymmetry: float
    odd_quadratic_s2_m: float


@dataclass(frozen=True)
class OverloadResult:
    """K_a and K_2 at one overload, and how far they can be trusted.

    Attributes:
        asymmetry: K_a (1).
        odd_quadratic_nonlinearity_s2_m: K_2, s^2/m.
        covariance: of (K_a, K_2), shape (2, 2): scatter of the cycles or one pulse of counting, whichever
            is larger, plus what is known only so far of K_0, K_1, K_2e and the grating.
        random_covariance: the first part alone, shape (2, 2): what a comparison of overloads on one
            day sees.
        sensitivities: of the known quantities. Their shapes over overload (K_0 into K_a and K_1 into
            K_2 as 1/A, an even term into K_a as A) are those of the trends that paper 5 reports.
        printed: (K_a, K_2) by eq (9) and (11).
        sinusoid_shift: change of (K_a, K_2) had the halves been taken as sinusoidal; None without a stroke.
        half_ratio: S+ / S-: 1 for a sinusoid.
        cycles: how many.
        correlation: of neighbouring cycles' (K_a, K_2), shape (2,), where it is significant, else 0. A bias
            that wanders does that; the scatter is then widened by (1 + r) / (1 - r), as for an AR(1) series.
    """

    asymmetry: float
    odd_quadratic_nonlinearity_s2_m: float
    covariance: FloatArray
    random_covariance: FloatArray
    sensitivities: tuple[Sensitivity, ...]
    printed: tuple[float, float]
    sinusoid_shift: tuple[float, float] | None
    half_ratio: float
    cycles: int
    correlation: FloatArray

    @property
    def standard_uncertainty(self) -> FloatArray:
        """u(K_a) (1), u(K_2) (s^2/m), shape (2,)."""
        return np.sqrt(np.diag(self.covariance))


def joint_solve(motion: HalfCycles, pulses: FloatArray, known: KnownAccelerometer) -> FloatArray:
    """(K_a, K_2) of each cycle, shape (m, 2): the exact solution of both equations.

    With p = K_0 T+ + V+ + K_2e S+, q = K_0 T- - V- + K_2e S-, n = N / K_1 and rho = S-/S+, putting K_2
    of the first equation into the second leaves c K_a^2 - b K_a + e = 0 with c = q + rho p,
    b = rho n+ - n-, e = rho n+ + n- - c; the root that stays small is 2 e / (b + sqrt(b^2 - 4 c e)).

    Args:
        motion: m cycles.
        pulses: N+ and N-, signed, shape (m, 2).

    Raises:
        CalibrationError: pulses that no small asymmetry explains.
    """
    if pulses.shape != motion.duration_s.shape or not np.isfinite(pulses).all():
        raise refused(f"The pulses have shape {pulses.shape}, or some are missing.", Fault.DATA)
    (t_plus, t_minus), (v_plus, v_minus) = motion.duration_s.T, motion.speed_change_m_s.T
    s_plus, s_minus = motion.squared_m2_s3.T
    n_plus, n_minus = pulses.T / known.scale_factor_pulse_s_m
    p = known.bias_m_s2 * t_plus + v_plus + known.even_quadratic_s2_m * s_plus
    q = known.bias_m_s2 * t_minus - v_minus + known.even_quadratic_s2_m * s_minus
    rho = s_minus / s_plus
    c, b = q + rho * p, rho * n_plus - n_minus
    e = rho * n_plus + n_minus - c
    inside = b**2 - 4.0 * c * e
    if (inside <= 0).any() or (b <= 0).any():
        raise refused(
            "The pulses do not fit the motion: their signs, or the halves, are mixed up.", Fault.DATA
        )
    asymmetry = 2.0 * e / (b + np.sqrt(inside))
    if (np.abs(asymmetry) > MAX_ASYMMETRY).any():
        raise refused(
            f"An asymmetry of {float(np.abs(asymmetry).max()):.2g} is none of an accelerometer: see that "
            "K_1, K_0 and the counters belong to this axis.",
            Fault.DATA,
        )
    quadratic = (n_plus / (1.0 + asymmetry) - p) / s_plus
    share = float(np.abs(quadratic * s_plus / v_plus).max())
    if share > MAX_ASYMMETRY:
        raise refused(
            f"A quadratic part of {share:.2g} of the acceleration is none of an accelerometer: see the units "
            "of position and scale factor.",
            Fault.DATA,
        )
    return np.column_stack([asymmetry, quadratic])


def printed_forms(motion: HalfCycles, pulses: FloatArray, known: KnownAccelerometer) -> tuple[float, float]:
    """Paper 5, eq (9) and (11): (K_a, K_2) with K_a K_2 and K_0 K_a neglected, from sums over all cycles."""
    n_plus, n_minus = pulses.sum(axis=0) / known.scale_factor_pulse_s_m
    speed = 0.5 * float(motion.speed_change_m_s.sum())
    asymmetry = (n_plus + n_minus - known.bias_m_s2 * float(motion.duration_s.sum())) / (2.0 * speed)
    quadratic = (n_plus - n_minus - 2.0 * speed) / float(motion.squared_m2_s3.sum())
    return float(asymmetry), float(quadratic)


def calibrate_overload(
    motion: HalfCycles, pulses: FloatArray, known: KnownAccelerometer, amplitude_m: float | None = None
) -> OverloadResult:
    """K_a and K_2 of an axis from m cycles at one overload, with covariance and sensitivities.

    Args:
        motion, known: see there.
        pulses: N+ and N-, signed, shape (m, 2), counted without a break.
        amplitude_m: half of the measured stroke; to say what a sinusoid would have given.

    Raises:
        CalibrationError: fewer than `MIN_CYCLES` cycles, or pulses that do not fit the motion.
    """
    pulses = np.asarray(pulses, dtype=np.float64)
    each = joint_solve(motion, pulses, known)
    cycles = len(each)
    if cycles < MIN_CYCLES:
        raise refused(f"{cycles} cycles carry no standard uncertainty; {MIN_CYCLES} do.", Fault.PLAN)
    total, counted = motion.total(), pulses.sum(axis=0, keepdims=True)
    estimate = joint_solve(total, counted, known)[0]
    jacobian = _jacobian(total, estimate, known)
    per_pulse = np.asarray(np.linalg.inv(jacobian), dtype=np.float64) / known.scale_factor_pulse_s_m
    random = _random_covariance(each, per_pulse)
    sensitivities = _sensitivities(total, counted[0], estimate, known, jacobian)
    covariance = random.copy()
    for known_one in sensitivities:
        effect = (
            np.array([known_one.asymmetry, known_one.odd_quadratic_s2_m]) * known_one.standard_uncertainty
        )
        covariance += np.outer(effect, effect)
    shift = None
    if amplitude_m is not None:
        sinusoidal = joint_solve(motion.as_if_sinusoidal(amplitude_m).total(), counted, known)[0] - estimate
        shift = (float(sinusoidal[0]), float(sinusoidal[1]))
    squared = total.squared_m2_s3[0]
    return OverloadResult(
        asymmetry=float(estimate[0]),
        odd_quadratic_nonlinearity_s2_m=float(estimate[1]),
        covariance=covariance,
        random_covariance=random,
        sensitivities=sensitivities,
        printed=printed_forms(motion, pulses, known),
        sinusoid_shift=shift,
        half_ratio=float(squared[0] / squared[1]),
        cycles=cycles,
        correlation=_correlation(each),
    )


def _jacobian(total: HalfCycles, estimate: FloatArray, known: KnownAccelerometer) -> FloatArray:
    """d(n+, n-) / d(K_a, K_2), shape (2, 2)."""
    a, k = estimate
    t, v, s = total.duration_s[0], total.speed_change_m_s[0], total.squared_m2_s3[0]
    sign = np.array([1.0, -1.0])
    level = known.bias_m_s2 * t + sign * v + (sign * k + known.even_quadratic_s2_m) * s
    return np.column_stack([sign * level, (1.0 + sign * a) * sign * s])


def _sensitivities(
    total: HalfCycles,
    counted: FloatArray,
    estimate: FloatArray,
    known: KnownAccelerometer,
    jacobian: FloatArray,
) -> tuple[Sensitivity, ...]:
    """How (K_a, K_2) move so that n stays as measured: -J^-1 dn/d(known)."""
    a, k = estimate
    t, v, s = total.duration_s[0], total.speed_change_m_s[0], total.squared_m2_s3[0]
    sign = np.array([1.0, -1.0])
    gain = 1.0 + sign * a
    n = counted / known.scale_factor_pulse_s_m
    stretched = sign * v + 2.0 * (sign * k + known.even_quadratic_s2_m) * s
    rows = (
        ("bias K_0", "m/s^2", known.u_bias_m_s2, gain * t),
        ("scale factor K_1", "1", known.u_scale_factor, n),
        ("even quadratic K_2e", "s^2/m", known.u_even_quadratic_s2_m, gain * s),
        ("length of the grating", "1", known.u_grating, gain * stretched),
    )
    moved = [(name, unit, u, -np.linalg.solve(jacobian, effect)) for name, unit, u, effect in rows]
    return tuple(Sensitivity(name, unit, u, float(d[0]), float(d[1])) for name, unit, u, d in moved)


def _random_covariance(each: FloatArray, per_pulse: FloatArray) -> FloatArray:
    """Scatter of the cycles' mean (t-inflated), never below what counting whole pulses leaves.

    Each boundary between two halves cuts a pulse: it errs by e, uniform over one pulse, and the halves
    share it with opposite signs. Over m cycles counted without a break the errors of N+ and N-
    have variance 2m/12 each and covariance -(2m - 1)/12: the sum keeps one pulse, the difference does not.
    """
    cycles = len(each)
    shared = -(2.0 * cycles - 1.0)
    counting = np.array([[2.0 * cycles, shared], [shared, 2.0 * cycles]]) / 12.0
    quantised = per_pulse @ counting @ per_pulse.T
    scatter = np.cov(each, rowvar=False) / cycles * t_inflation(cycles - 1) ** 2
    correlation = _correlation(each)
    slow = np.sqrt((1.0 + correlation) / (1.0 - correlation))
    scatter = scatter * np.outer(slow, slow)
    seen, least = np.diag(scatter), np.diag(quantised)
    if not (seen > 0).all():
        return quantised
    widen = np.sqrt(np.maximum(least / seen, 1.0))
    return np.asarray(scatter * np.outer(widen, widen), dtype=np.float64)


def _correlation(each: FloatArray) -> FloatArray:
    """Lag-1 correlation of each coefficient over the cycles, by von Neumann's ratio, shape (2,)."""
    deviation = ((each - each.mean(axis=0)) ** 2).sum(axis=0)
    steps = (np.diff(each, axis=0) ** 2).sum(axis=0)
    ratio = np.divide(steps, deviation, out=np.full(2, 2.0), where=deviation > 0)
    correlation = np.minimum(1.0 - 0.5 * ratio, MAX_CORRELATION)
    significant = correlation > CORRELATION_SIGMAS / math.sqrt(len(each))
    return np.where(significant, correlation, 0.0)


def refused(what: str, fault: Fault) -> CalibrationError:
    """The error of this method and its sibling for gyros."""
    remedies = {
        Fault.DATA: "look at the recording, and at what is taken as known of the unit.",
        Fault.STAND: "look at the rig's grating and where its half-cycles were cut.",
        Fault.PLAN: "let the rig run for more cycles, or along the missing direction.",
    }
    return CalibrationError(what, where="sinusoidal overload", fault=fault, remedy=remedies[fault])

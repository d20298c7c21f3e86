"""A gyro's response to motion from *when* its pulses come, not from how many lie in a half-cycle.

A gyro with a slow rate puts out a few pulses in a half-cycle. Sums over halves then err by parts of a pulse
at every cut; pulses that step with the cycles err alike in all of them, and no number of cycles helps, nor
does their scatter show it. When a pulse comes, however, the integral behind its counter is a whole number,
known as closely as the pulse's instant. With the rate (in pulses)

    r(t) = b + s A(t) + d/dt sum_k g_k (x/X)^k + n(t)

g the slide's own rotation, which goes with its position x (X: half of the stroke), and n noise of standard
deviation v, the counters hold the integrals of r where it is positive and of -r where it is negative; mean

    R+ = r Phi(r/v) + v phi(r/v),     R- = R+ - r

Between two ticks of a counter the integral grows by their number: that is fitted for b, s, g and v by
weighted Gauss-Newton over all increments of both counters. What noise (angle random walk) leaves of them
grows as the root of the time in which the counter is active. A rotation that goes with the position has
another sign forth than back; A has not: whatever of it no g_k takes up does not pass for a response.

The covariance is that of the increments' scores summed over whole cycles (a 'sandwich' clustered by cycle),
so that neighbouring increments may depend on each other; and never below that of independent ones.
"""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr  # pyright: ignore[reportMissingTypeStubs,reportUnknownVariableType]

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.uncertainty_budget import t_inflation

GUIDE_POWERS = 4
"""Of the position, that the slide's rotation is made of."""
MAX_ITERATIONS = 60
MAX_HALVINGS = 12
"""Of a step that makes the fit worse."""
CONVERGED = 1e-3
"""Largest step of s that counts as none, in standard uncertainties."""
INCREMENTS_PER_NUMBER = 4
"""So many for each number that is fitted."""
MIN_CYCLES = 4
MAX_RESIDUAL_PULSES = 0.7
"""Increments that scatter more tell no instants: noise of pulses, or another motion than this."""
_LEAST_NOISE = 1e-3
"""Of the rate's own size: no corner has to be sharper."""
_TOLD = 1e-9
"""Relative size of an eigenvalue below which a combination is not told by the data."""


@dataclass(frozen=True)
class PulseCounters:
    """Two counters of one gyro, and the motion at the instants when they are read.

    Attributes:
        period_s: between readings, even.
        positive, negative: running counts, shape (n,).
        cycle: which cycle of the motion a reading is in, shape (n,).
    """

    period_s: float
    positive: FloatArray
    negative: FloatArray
    cycle: NDArray[np.intp]


@dataclass(frozen=True)
class SlideMotion:
    """The slide at the readings and half-way between them, shapes (2 n - 1,): A, speed, and x / X.

    Attributes:
        acceleration_m_s2: A.
        speed_m_s: dx/dt.
        position: x / X, about -1 to 1.
        half_stroke_m: X.
    """

    acceleration_m_s2: FloatArray
    speed_m_s: FloatArray
    position: FloatArray
    half_stroke_m: float

    def regressors(self) -> FloatArray:
        """What b, s, g_1 … are multiplied with in the rate, shape (2 + GUIDE_POWERS, 2 n - 1)."""
        turning = [
            k * self.position ** (k - 1) * self.speed_m_s / self.half_stroke_m
            for k in range(1, GUIDE_POWERS + 1)
        ]
        return np.vstack([np.ones_like(self.position), self.acceleration_m_s2, *turning])


@dataclass(frozen=True)
class TimedResponse:
    """What the pulses' instants tell.

    Attributes:
        rate_pulse_s: b.
        response_pulse_s_m: s, pulses per m/s.
        response_variance: of s.
        response_per_delay: ds/dtau, pulses per m/s and s: a gyro that is read tau late sees part of the
            slide's turning with the sign and shape of A. Nothing in the data tells the two apart.
        guide_pulses: g, shape (GUIDE_POWERS,).
        increments: how many there were between pulses.
        residual_pulses: their rms.
    """

    rate_pulse_s: float
    response_pulse_s_m: float
    response_variance: float
    response_per_delay: float
    guide_pulses: FloatArray
    increments: int
    residual_pulses: float


@dataclass(frozen=True)
class _Train:
    """The ticks of one counter: `sign` +1 or -1, ticking readings (k,), counts at them (k,)."""

    sign: float
    reading: NDArray[np.intp]
    count: FloatArray


@dataclass(frozen=True)
class _Linearised:
    """Of k increments: counted less modelled, derivatives (k, p), time of activity, what steps leave."""

    residual: FloatArray
    jacobian: FloatArray
    active_s: FloatArray
    timing: FloatArray

    @property
    def noise_density(self) -> float:
        """Variance by second of activity that is left beside the steps of reading."""
        squares = float(self.residual @ self.residual)
        return max(squares - float(self.timing @ self.timing), 1e-3 * squares) / float(self.active_s.sum())

    def variance(self, density: float) -> FloatArray:
        """Of each increment."""
        return density * self.active_s + self.timing**2

    def misfit(self, density: float) -> float:
        """-2 log of the normal likelihood, but for a constant."""
        variance = self.variance(density)
        return float((np.log(variance) + self.residual**2 / variance).sum())


def response_by_pulse_times(counters: PulseCounters, motion: SlideMotion) -> TimedResponse | None:
    """Fit b, s, g and v.

    Returns:
        None where too few pulses came, in too few cycles, or the fit does not settle.
    """
    trains = [_train(counters.positive, 1.0), _train(counters.negative, -1.0)]
    trains = [train for train in trains if len(train.reading) >= 2]
    number = sum(len(train.reading) - 1 for train in trains)
    regressors = motion.regressors()
    unknown = len(regressors) + 1
    if number < INCREMENTS_PER_NUMBER * unknown:
        return None
    size = np.append(np.sqrt((regressors**2).mean(axis=1)), 1.0)
    values = _first_guess(counters, regressors)
    scale = float(np.sqrt(np.mean((values @ regressors) ** 2))) + 1.0 / (
        counters.period_s * len(counters.cycle)
    )
    values = np.append(values, 0.1 * scale)
    at = _linearised(counters, trains, regressors, values)
    for _ in range(MAX_ITERATIONS):
        density = at.noise_density
        weight = 1.0 / at.variance(density)
        scaled = at.jacobian / size
        inverse = np.linalg.pinv(scaled.T @ (weight[:, None] * scaled), rcond=_TOLD, hermitian=True)
        step = inverse @ (scaled.T @ (weight * at.residual)) / size
        inverse = inverse / np.outer(size, size)
        settled = abs(step[1]) <= CONVERGED * math.sqrt(inverse[1, 1])
        for shorter in range(MAX_HALVINGS):
            trial = values + step / 2**shorter
            trial[-1] = np.clip(trial[-1], max(0.5 * values[-1], _LEAST_NOISE * scale), 2.0 * values[-1])
            there = _linearised(counters, trains, regressors, trial)
            if there.misfit(density) <= at.misfit(density):
                break
        else:
            settled, trial, there = True, values, at
        values, at = trial, there
        if settled:
            break
    else:
        return None
    rms = math.sqrt(float(np.mean(at.residual**2)))
    told = float((scaled.T @ (weight[:, None] * scaled) * np.outer(size, size) @ inverse)[1, 1])
    if rms > MAX_RESIDUAL_PULSES or abs(told - 1.0) > 1e-3:
        return None
    cycle = np.concatenate([counters.cycle[train.reading[1:]] for train in trains])
    variance = _clustered_variance(inverse, at.jacobian, weight, at.residual, cycle)
    if variance is None:
        return None
    late = np.gradient(values[2:-1] @ regressors[2:], 0.5 * counters.period_s)
    per_delay = np.linalg.lstsq((regressors / size[:-1, None]).T, -late, rcond=None)[0][1] / size[1]
    return TimedResponse(
        rate_pulse_s=float(values[0]),
        response_pulse_s_m=float(values[1]),
        response_variance=variance,
        response_per_delay=float(per_delay),
        guide_pulses=values[2:-1],
        increments=number,
        residual_pulses=rms,
    )


def _first_guess(counters: PulseCounters, regressors: FloatArray) -> FloatArray:
    """b, s, g by least squares from the counts at each reading: a staircase, but a linear problem."""
    integrals = _running_simpson(regressors, counters.period_s)
    basis = np.vstack([integrals, np.ones(integrals.shape[1])])
    size = np.sqrt((basis**2).mean(axis=1))
    net = counters.positive - counters.negative
    solved = np.asarray(np.linalg.lstsq((basis / size[:, None]).T, net, rcond=None)[0], dtype=np.float64)
    return (solved / size)[:-1]


def _train(count: FloatArray, sign: float) -> _Train:
    ticking = np.flatnonzero(np.diff(count) > 0) + 1
    return _Train(sign, ticking, count[ticking])


def _linearised(
    counters: PulseCounters, trains: list[_Train], regressors: FloatArray, values: FloatArray
) -> _Linearised:
    noise = float(values[-1])
    rate = values[:-1] @ regressors
    parts: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []
    for train in trains:
        own = train.sign * rate / noise
        share = np.asarray(ndtr(own), dtype=np.float64)
        corner = np.exp(-0.5 * own**2) / math.sqrt(2.0 * math.pi)
        mean = noise * (own * share + corner)
        rows = np.vstack([mean, train.sign * share * regressors, corner, share])
        grown = np.diff(_running_simpson(rows, counters.period_s)[:, train.reading], axis=1)
        # within the reading that shows a pulse the integral has passed the whole number by at most this
        beyond = np.minimum(mean[2 * train.reading] * counters.period_s, 1.0)
        parts.append(
            (
                np.diff(train.count + 0.5 * beyond) - grown[0],
                grown[1:-1].T,
                np.maximum(grown[-1], 1e-3 * counters.period_s),
                np.sqrt((beyond[1:] ** 2 + beyond[:-1] ** 2) / 12.0),
            )
        )
    return _Linearised(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _running_simpson(rows: FloatArray, period_s: float) -> FloatArray:
    """Integrals of rows (k, 2 n - 1) up to each reading, shape (k, n)."""
    panels = (rows[:, :-1:2] + 4.0 * rows[:, 1::2] + rows[:, 2::2]) * (period_s / 6.0)
    return np.concatenate([np.zeros((len(rows), 1)), np.cumsum(panels, axis=1)], axis=1)


def _clustered_variance(
    inverse: FloatArray,
    jacobian: FloatArray,
    weight: FloatArray,
    residual: FloatArray,
    cycle: NDArray[np.intp],
) -> float | None:
    """Of s; None where the pulses lie in too few cycles."""
    _, cluster = np.unique(cycle, return_inverse=True)
    clusters = int(cluster.max()) + 1
    if clusters < MIN_CYCLES:
        return None
    scores = weight * residual * (jacobian @ inverse[1])
    summed = np.bincount(cluster, weights=scores, minlength=clusters)
    clustered = float(summed @ summed) * clusters / (clusters - 1.0)
    independent = float(inverse[1, 1]) * float(weight @ residual**2) / (len(residual) - jacobian.shape[1])
    return max(clustered * t_inflation(clusters - 1) ** 2, independent)

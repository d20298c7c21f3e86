# pyright: strict
"""Timing against the stand: delay, drift and jitter of the unit's samples, and a clock that was set.

    delay, drift   `delay_fit`: regression on ∂ŷ/∂t, by every triad that moves
    jitter         `jitter_fit`, with the prediction taken anew at the instants that the delay tells
    a jump         two delays, one before and one behind a moment, where a drift explains much less

Jitter is a frame's: a triad that shows it where another tells that there is none must be the more certain.

A delay and a filter's lag look alike in all but fast motion; both are offered to the engine as effects.
Nothing is said of a delay where the clocks' epochs were joined by the motion itself, of a drift where motion
lasts less than `LEAST_DRIFT_S` or the delay wanders in a curve, and of jitter where the stand's rows do not
come twice as often as the samples: what they leave between them is no jitter.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.alignment import constant_delay, triad_of
from gap_diagnosis.delay_fit import DelayFit, Triad, fitted_delay
from gap_diagnosis.jitter_fit import JitterFit, fitted_jitter
from gap_diagnosis.observation import Observation, TimingFinding

LEAST_LOG_RATIO = 12.0
LEAST_DRIFT_S = 30.0
STRAIGHT = 3.0
"""A drift is a straight line: its curvature is below so many of its own standard uncertainties."""
LARGEST_USEFUL_UNCERTAINTY_S = 0.05
JITTER_LOG_RATIO, LONE_JITTER_LOG_RATIO = 20.0, 60.0
STAND_PERIODS = 0.51
SHARED_JITTER = 0.4
"""Of the variance: so much of it another triad must show that could."""
LEAST_JITTER_PERIODS, LONE_JITTER_PERIODS, LARGEST_JITTER_PERIODS = 0.01, 0.5, 1.0
JUMP_LOG_RATIO = 30.0
JUMP_PERIODS = 1.0
JUMP_OVER_DRIFT = 1.1
"""Of what is gained: a line explains three quarters of a step, and a step as much of a line."""
JUMP_BLOCKS = 100


@dataclass(frozen=True)
class ClockJump:
    """The unit's clock was set: `step_s` forward at `at_s`, on the time of the observation."""

    at_s: float
    step_s: float
    log_likelihood_ratio: float


@dataclass(frozen=True)
class StandTiming:
    """What comparing with the stand tells."""

    findings: tuple[TimingFinding, ...]
    jump: ClockJump | None


def timing_against_stand(
    observation: Observation,
    stand_period_s: float,
    is_aligned: bool,
    about_s: float,
    again: Callable[[float], Observation],
) -> StandTiming:
    """Delay, drift and jitter of each triad.

    Args:
        observation: of single samples.
        stand_period_s: of the stand's rows.
        is_aligned: the clocks were joined by the motion: no delay is claimed.
        about_s: the delay, as far as it is known.
        again: the observation with the unit's clock moved by so much more.
    """
    findings: list[TimingFinding] = []
    jump: ClockJump | None = None
    jitters: dict[SensorName, JitterFit] = {}
    for sensor in observation.outputs:
        if sensor == "temperature":
            continue
        triad = triad_of(observation, sensor)
        fit = constant_delay(triad, about_s)
        if fit is None or fit.standard_uncertainties[0] > LARGEST_USEFUL_UNCERTAINTY_S:
            continue
        jump = jump or clock_jump(fit, triad)
        drift = _drift(sensor, fit, triad, observation.stimulus.power_on_s)
        if drift:
            findings += drift[1:] if is_aligned else drift
        elif not is_aligned:
            findings += _delay(sensor, float(fit.values[0]), float(fit.standard_uncertainties[0]))
        if stand_period_s <= STAND_PERIODS * observation.sample_period_s:
            jitter = _jitter(sensor, fit, triad, drift is not None, again)
            jitters |= {sensor: jitter} if jitter is not None else {}
    for sensor in jitters:
        findings += _jitter_findings(sensor, jitters, observation.sample_period_s)
    return StandTiming(tuple(one for one in findings if one.log_likelihood_ratio > 0), jump)


def _delay(sensor: SensorName, delay_s: float, uncertainty_s: float) -> list[TimingFinding]:
    ratio = 0.5 * (delay_s / uncertainty_s) ** 2
    if ratio < LEAST_LOG_RATIO:
        return []
    way = "later" if delay_s > 0 else "earlier"
    said = f"The {sensor} shows the motion {abs(delay_s) * 1e3:.3f} ms {way} than the stand."
    return [_finding("link.fixed_delay", sensor, "delay_s", delay_s, uncertainty_s, "s", ratio, said)]


def _drift(sensor: SensorName, fit: DelayFit, triad: Triad, power_on_s: float) -> list[TimingFinding] | None:
    """A delay (possibly none) and a drift, in that order; None where no drift can be claimed."""
    if fit.moved_for_s < LEAST_DRIFT_S or 0.5 * _drift_gain(*_blocks(fit)) < LEAST_LOG_RATIO / 2:
        return None
    middle_s = float(np.mean(triad.time_s))
    middle, constant = triad.time_s - middle_s, np.ones(len(triad.time_s))
    centred = fitted_delay(triad, [constant, middle], fit)
    if centred is None or not _is_certain(centred, 1):
        return None
    curved = fitted_delay(triad, [constant, middle, middle**2], centred)
    if curved is None or abs(curved.values[2]) > STRAIGHT * curved.standard_uncertainties[2]:
        return None
    rate, since_s = float(centred.values[1]), middle_s - power_on_s  # from the middle back to power-on
    back = np.array([[1.0, -since_s], [0.0, 1.0]])
    delay_s = float(centred.values[0]) - rate * since_s
    delay_u, rate_u = np.sqrt(np.diag(back @ centred.covariance @ back.T)).tolist()
    ratio = 0.5 * (rate / rate_u) ** 2
    delayed = _delay(sensor, delay_s, delay_u) or [
        _finding("link.fixed_delay", sensor, "delay_s", delay_s, delay_u, "s", 0.0, "")
    ]
    said = (
        f"The unit's clock runs {'fast' if rate > 0 else 'slow'} by {abs(rate) * 1e6:.2f} ppm of the stand's."
    )
    return [*delayed, _finding("link.clock_drift", sensor, "relative_rate", rate, rate_u, "1", ratio, said)]


def _is_certain(fit: DelayFit, index: int) -> bool:
    return 0.5 * (fit.values[index] / fit.standard_uncertainties[index]) ** 2 > LEAST_LOG_RATIO


def _jitter(
    sensor: SensorName, fit: DelayFit, triad: Triad, drifts: bool, again: Callable[[float], Observation]
) -> JitterFit | None:
    """If it looks like jitter, once more on the prediction at the right instants."""
    first = fitted_jitter(fit.raw, fit.slope, triad.piece)
    if first is None or first.log_likelihood_ratio < LEAST_LOG_RATIO or drifts:
        return first
    triad = triad_of(again(-float(fit.values[0])), sensor)
    refined = constant_delay(triad)
    return refined and fitted_jitter(refined.raw, refined.slope, triad.piece)


def _jitter_findings(
    sensor: SensorName, jitters: Mapping[SensorName, JitterFit], period_s: float
) -> list[TimingFinding]:
    """σ of the samples' times, if it is certain."""
    fit = jitters[sensor]
    if fit.variance_s2 <= 0:
        return []
    denied = any(
        other.uncertainty_s2 < 0.25 * fit.variance_s2 and other.variance_s2 < SHARED_JITTER * fit.variance_s2
        for other in jitters.values()
    )
    deviation_s = math.sqrt(fit.variance_s2)
    if fit.log_likelihood_ratio < (LONE_JITTER_LOG_RATIO if denied else JITTER_LOG_RATIO):
        return []
    largest = LONE_JITTER_PERIODS if denied else LARGEST_JITTER_PERIODS
    if not LEAST_JITTER_PERIODS < deviation_s / period_s < largest:
        return []
    said = f"The {sensor}'s samples were taken {deviation_s * 1e3:.3f} ms (rms) beside their stamps."
    uncertainty_s = 0.5 * fit.uncertainty_s2 / deviation_s
    ratio = fit.log_likelihood_ratio
    name = "link.timestamp_jitter"
    return [_finding(name, sensor, "deviation_s", deviation_s, uncertainty_s, "s", ratio, said)]


def _finding(
    effect: str,
    sensor: SensorName,
    parameter: str,
    value: float,
    uncertainty: float,
    unit: str,
    ratio: float,
    said: str,
) -> TimingFinding:
    return TimingFinding(effect, (sensor,), parameter, value, uncertainty, unit, ratio, said)


def _blocks(fit: DelayFit) -> tuple[FloatArray, FloatArray]:
    """(`JUMP_BLOCKS`,) score of a delay and what tells of it, in blocks of as many rows."""
    rows = np.isfinite(fit.left).any(axis=1)
    e, x = np.nan_to_num(fit.left[rows]), np.nan_to_num(fit.patterns[rows][:, :, 0])
    number = np.arange(len(e)) * JUMP_BLOCKS // max(len(e), 1)
    score = np.bincount(number, weights=(x * e).sum(axis=1), minlength=JUMP_BLOCKS)
    telling = np.bincount(number, weights=(x * x).sum(axis=1), minlength=JUMP_BLOCKS)
    return score.astype(np.float64), telling.astype(np.float64)


def clock_jump(fit: DelayFit, triad: Triad) -> ClockJump | None:
    """Two delays instead of one, where that explains much more than a drift does."""
    score, telling = _blocks(fit)
    if fit.rows < 10 * JUMP_BLOCKS or telling.sum() <= 0:
        return None
    before_i, before_s = np.cumsum(telling)[:-1], np.cumsum(score)[:-1]
    after_i, after_s = telling.sum() - before_i, score.sum() - before_s
    good = np.minimum(before_i, after_i) > 0.05 * telling.sum()
    if not good.any():
        return None
    before_i, after_i = np.where(good, before_i, np.inf), np.where(good, after_i, np.inf)
    gains = before_s**2 / before_i + after_s**2 / after_i - score.sum() ** 2 / telling.sum()
    best = int(np.argmax(gains))
    step_s = float(after_s[best] / after_i[best] - before_s[best] / before_i[best])
    ratio = 0.5 * float(gains[best]) / _excess(score, telling, best)
    is_far = abs(step_s) > JUMP_PERIODS * triad.period_s
    if ratio < JUMP_LOG_RATIO or not is_far or gains[best] < JUMP_OVER_DRIFT * _drift_gain(score, telling):
        return None
    time_s = triad.time_s[np.isfinite(fit.left).any(axis=1)]
    at_row = math.ceil((best + 1) * len(time_s) / JUMP_BLOCKS)
    return ClockJump(float(time_s[min(at_row, len(time_s) - 1)]), step_s, ratio)


def _drift_gain(score: FloatArray, telling: FloatArray) -> float:
    """What a straight line gains over a constant."""
    place = np.arange(len(score)) - float((np.arange(len(score)) * telling).sum() / telling.sum())
    return float((place * score).sum() ** 2 / max(float((place**2 * telling).sum()), 1e-300))


def _excess(score: FloatArray, telling: FloatArray, split: int) -> float:
    """How far the blocks scatter beyond their noise about two delays; 1 at least."""
    chi2 = 0.0
    for part in (slice(0, split + 1), slice(split + 1, None)):
        s, i = score[part], telling[part]
        there = i > 0
        delay = s.sum() / max(float(i.sum()), 1e-300)
        chi2 += float((((s - delay * i)[there] ** 2) / i[there]).sum())
    return max(1.0, chi2 / max(len(score) - 2, 1))

# pyright: strict
"""References that are no test stands: optical motion capture, another sensor on the same body.

Their errors follow the motion and come in bursts, ten times the unit's noise. So

    noise     is white of the largest density that the residual has in any octave: rather too much.
              Neighbours' differences show the unit's noise alone: such a reference is smooth between rows.
    effects   that follow the motion in size (a nonlinearity, a coupling) cannot be told from the reference's
              own errors and are not offered. What such a reference cannot imitate is a field that begins and
              ends while the unit turns.
    a delay   is what the timing stage finds, whose uncertainty holds for bursts. A unit cannot be early: that
              would be the reference's.
    a claim   about the unit's noise is not made.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.candidates import Trial
from gap_diagnosis.holes import stretches
from gap_diagnosis.observation import Observation, SetAside, TimingFinding

WORDS = ("optical", "motion_capture", "second_gyro")
"""In `stand.kind` of recordings whose reference is no test stand."""
CLAIMABLE = frozenset({"mag.hard_iron"})
DELAY = "link.fixed_delay"
DELAY_LOG_RATIO = 60.0
"""A delay counts from this log likelihood ratio on: eleven standard uncertainties."""
SAID = "reference noise in bursts: the stand's report errs by more than the unit's noise where the unit moves"
WINDOWS_S = (8.0, 4.0, 2.0, 1.0)
LEAST_WINDOWS = 8
LEAST_LINES = 2
LEAST_FREQUENCY_HZ = 0.25


def is_reference(observation: Observation) -> bool:
    """Whether something other than a stand's encoders tells the motion."""
    rates = observation.stimulus.rate_rad_s
    return any(word in observation.stand_kind for word in WORDS) and rates is not None and bool(rates.any())


def claimable(trials: Sequence[Trial], observations: Sequence[Observation]) -> list[Trial]:
    """The trials that such references can carry; all, where every recording is a test stand's."""
    if not any(is_reference(one) for one in observations):
        return list(trials)
    return [trial for trial in trials if trial.name in CLAIMABLE]


def delays_beside(observations: Sequence[Observation], without: frozenset[str]) -> tuple[TimingFinding, ...]:
    """How late a unit is against such a reference: the clearest finding, the gyro's where it has one."""
    found = [
        finding
        for one in observations
        if is_reference(one) and DELAY not in without
        for finding in one.timing
        if finding.effect == DELAY and finding.value > 0 and finding.log_likelihood_ratio > DELAY_LOG_RATIO
    ]
    found.sort(key=lambda finding: ("gyro" not in finding.sensors, -finding.log_likelihood_ratio))
    return tuple(found[:1])


def reference_noted(observation: Observation) -> Observation:
    """The observation, with a word on such a reference among what is not used."""
    if not is_reference(observation):
        return observation
    note = SetAside("reference", 0, SAID)
    return dataclasses.replace(observation, set_aside=(*observation.set_aside, note))


def reference_density(residual: FloatArray, piece: NDArray[np.int64], period_s: float) -> float:
    """Largest density of any octave, SI per √Hz; 0 where no stretch is long enough.

    residual (n,) with bias and matrix taken off, piece (n,) as in `Observation`.
    """
    for window_s in WINDOWS_S:
        size = max(16, round(window_s / period_s))
        power, count = _spectrum(residual, piece, size)
        if count < LEAST_WINDOWS:
            continue
        first = max(1, round(LEAST_FREQUENCY_HZ * window_s))
        largest = 0.0
        while first + LEAST_LINES <= len(power):
            last = max(2 * first, first + LEAST_LINES)
            largest = max(largest, float(power[first:last].mean()))
            first = last
        return float(np.sqrt(largest * period_s))
    return 0.0


def _spectrum(residual: FloatArray, piece: NDArray[np.int64], size: int) -> tuple[FloatArray, int]:
    """(size / 2 + 1,) power such that white noise of deviation s has s² at every line; windows used."""
    taper = np.hanning(size)
    total, count = np.zeros(size // 2 + 1), 0
    for first, last in stretches(piece):
        for begin in range(first, last - size + 1, size // 2):
            part = residual[begin : begin + size]
            total += np.abs(np.fft.rfft((part - part.mean()) * taper)) ** 2
            count += 1
    return total / (float(taper @ taper) * max(count, 1)), count

"""The first frame that shows an impact: paper 3's 5 sigma rule, and what it does to the lag.

A frame shows the impact when its output leaves the rest's mean by five standard deviations. Until the
response has risen so far the impact is there but not seen: that time is part of the measured lag and
depends on how hard the impact was. A frame on the rise may be missed or taken early by noise.

The rest before the impact gives mean and standard deviation; white noise is assumed between frames.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calibration.algorithms.allan_variance import FloatArray
from protocol.errors import CalibrationError, Fault

THRESHOLD_SIGMAS = 5.0
MIN_REST_FRAMES = 30
"""Fewer frames of rest do not tell sigma to 13 %."""
MIN_MARGIN = 4.0
"""A peak below this many thresholds is too weak an impact: noise may hide its rise for a frame or more."""
NOISE_SIGMAS = 3.5
"""What noise may hide of a response."""
STEP_PART = 0.7
"""Least part of the peak that the step itself has: the rest is ringing of what was struck."""


@dataclass(frozen=True)
class ImpactDetection:
    """Which frame shows the impact.

    Attributes:
        frame: index of the first frame beyond the threshold.
        rest_mean, rest_deviation: of the frames before the impact, unit of the output.
        threshold: distance from the mean that counts, unit of the output.
        peak: largest distance from the mean, unit of the output.
        early_probability: that noise alone passed the threshold in a searched frame before this one.
        late_probability: that noise would hide a response as large as this frame's below the threshold,
            and the same impact be detected a frame later.
    """

    frame: int
    rest_mean: float
    rest_deviation: float
    threshold: float
    peak: float
    early_probability: float
    late_probability: float


def detect_impact(
    outputs: FloatArray, impact_frame: int, threshold_sigmas: float = THRESHOLD_SIGMAS
) -> ImpactDetection:
    """The first frame from `impact_frame` on that leaves the rest by the threshold.

    Args:
        outputs: one output a frame, shape (n,), any unit.
        impact_frame: index of the first frame after the trigger; those before are the rest.
        threshold_sigmas: of the rest's standard deviation.

    Raises:
        CalibrationError: too short or stuck a rest, missing frames, no response, or one too weak.
    """
    samples = np.asarray(outputs, dtype=np.float64)
    if samples.ndim != 1 or not np.isfinite(samples).all():
        raise _refused("The frames around the impact are not all there.", "look at the link", Fault.DATA)
    if impact_frame < MIN_REST_FRAMES or impact_frame >= len(samples):
        raise _refused(
            f"{max(impact_frame, 0)} frames of rest before the impact, {MIN_REST_FRAMES} are needed.",
            "start recording earlier",
            Fault.PLAN,
        )
    rest = samples[:impact_frame]
    mean, deviation = float(rest.mean()), float(rest.std(ddof=1))
    if deviation == 0.0:
        raise _refused(
            "The output does not move at rest: no noise, no threshold.", "look for a stuck output", Fault.UNIT
        )
    distance = np.abs(samples[impact_frame:] - mean)
    threshold = threshold_sigmas * deviation
    beyond = np.flatnonzero(distance >= threshold)
    peak = float(distance.max())
    if len(beyond) == 0 or peak < MIN_MARGIN * threshold:
        raise _refused(
            f"The response peaks at {peak / deviation:.1f} standard deviations of the rest; "
            f"{MIN_MARGIN * threshold_sigmas:g} are needed.",
            "strike harder, or look whether the gyro was struck at all",
            Fault.STAND,
        )
    first = int(beyond[0])
    return ImpactDetection(
        impact_frame + first,
        mean,
        deviation,
        threshold,
        peak,
        false_alarm_probability(first, threshold_sigmas),
        float(ndtr((threshold - distance[first]) / deviation)),
    )


def false_alarm_probability(frames: int, threshold_sigmas: float = THRESHOLD_SIGMAS) -> float:
    """That noise alone passes the threshold in any of so many frames: 5.7e-7 a frame at 5 sigma."""
    return -math.expm1(frames * math.log1p(-2.0 * float(ndtr(-threshold_sigmas))))


def detection_delay_s(
    step: float, rest_deviation: float, time_constant_s: float, threshold_sigmas: float = THRESHOLD_SIGMAS
) -> float:
    """How much later than the impact's arrival the rule can see it, s: part of a lag measured so.

    The response is a step through one pole: step (1 - exp(-t / tau)) reaches k sigma at
    -tau ln(1 - k sigma / step). Paper 3's gyro (sigma 200, threshold 1000) has 0.105 tau for a step of
    10,000 and 0.69 tau for one of 2,000: compare lags at like impacts only.

    Args:
        step: output of the impact's rate, in the unit of `rest_deviation`.
        rest_deviation: sigma.
        time_constant_s: tau of the gyro's band limit, s.
        threshold_sigmas: k.

    Raises:
        CalibrationError: the step does not reach the threshold.
    """
    if not abs(step) > threshold_sigmas * rest_deviation >= 0.0 or time_constant_s < 0.0:
        raise _refused(
            f"A step of {step:g} does not pass {threshold_sigmas:g} deviations of {rest_deviation:g}.",
            "strike harder",
            Fault.STAND,
        )
    return -time_constant_s * math.log1p(-threshold_sigmas * rest_deviation / abs(step))


def latest_detection_s(peak_sigmas: float, time_constant_s: float) -> float:
    """The most that passes from the impact's arrival until the rule sees it, s.

    Args:
        peak_sigmas: of the weakest impact used, in standard deviations of the rest.
        time_constant_s: of the gyro's band limit.

    Raises:
        CalibrationError: an impact that noise can hide.
    """
    return detection_delay_s(STEP_PART * peak_sigmas, 1.0, time_constant_s, THRESHOLD_SIGMAS + NOISE_SIGMAS)


def _refused(what: str, remedy: str, fault: Fault) -> CalibrationError:
    return CalibrationError(what, where="impact detection", fault=fault, remedy=remedy + ".")

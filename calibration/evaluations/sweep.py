"""Profile 'sweep': gain, delay, lag and bandwidth of the gyros, from a sine of rising frequency."""

# pyright: strict
import math
from dataclasses import dataclass

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.frequency_response import (
    DelayAndLag,
    FrequencyResponse,
    delay_and_lag,
    frequency_response,
)
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.channels import channels_in_si
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refuse_unjoined,
    refused,
    stream_with,
)
from calibration.records.inertial_contents import response_content
from calibration.sensor_knowledge import sensor_range
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

CRYSTAL_DOUBT = 20e-6
"""Standard uncertainty of a unit's clock rate where the sweep does not tell it better."""
MAX_CLOCK_RATE = 3e-4
CLOCK_STEPS = (2e-5, 2e-6)
MOVING_RAD_S = 1e-5
REST_S = 0.5
LEAST_SWEEP_S = 5.0
UNLIKELY_CHI_SQUARE = 2.0
"""Of the model per degree of freedom: above it the unit has another dynamics."""


def evaluate_sweep(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """Each axis that was swept and has a gyro.

    Raises:
        CalibrationError: clocks that no trigger joins, no sweep, or none that can be evaluated.
    """
    (recording,) = recordings
    refuse_unjoined(recording)
    sweeps, not_used = _sweeps(recording)
    clock, errors = _clock(sweeps)
    found: list[tuple[str, FrequencyResponse, DelayAndLag]] = []
    for sweep in sweeps:
        if sweep.letter in errors:
            not_used.append(
                NotUsed(f"sweep about {sweep.letter}", len(sweep.time_s), errors[sweep.letter].what)
            )
            continue
        response = sweep.response(clock.rate)
        found.append(
            (
                sweep.letter,
                response,
                delay_and_lag(response, clock_standard_uncertainty_s=sweep.apart_s(clock)),
            )
        )
        not_used += response.not_used
    if not found:
        raise (
            next(iter(errors.values()))
            if errors
            else refused(recording, "No axis that has a gyro is swept alone.", "sweep at least 5 s about one")
        )
    result = SensorResult("gyro", response_content(found), recordings, _beside(found, clock))
    return method_evaluation(recordings, [result], _sentences(found, clock), not_used)


@dataclass(frozen=True)
class _Clock:
    """By how much the unit's clock is fast against the stand's, relative; how well that is known."""

    rate: float
    standard_uncertainty: float
    seen: bool


@dataclass(frozen=True)
class _Sweep:
    """One axis's sweep, with some rest on both sides."""

    letter: str
    time_s: FloatArray
    output: FloatArray
    stand_s: FloatArray
    rate_rad_s: FloatArray
    limit: float | None
    where: str

    def response(self, clock_rate: float) -> FrequencyResponse:
        """H with the unit's times set right by its clock's rate."""
        return frequency_response(
            self.time_s * (1.0 - clock_rate),
            self.output,
            self.stand_s,
            self.rate_rad_s,
            range_limit=self.limit,
            where=self.where,
        )

    def chi_square(self, clock_rate: float) -> tuple[float, int]:
        """Of delay and lag, and its degrees of freedom."""
        response = self.response(clock_rate)
        freedom = 2 * len(response.frequency_hz) - 3
        return delay_and_lag(response).chi_square_ratio * freedom, freedom

    def apart_s(self, clock: _Clock) -> float:
        """What the clocks may still be apart at the end."""
        return clock.standard_uncertainty * float(self.time_s[-1])


def _sweeps(recording: Recording) -> tuple[list[_Sweep], list[NotUsed]]:
    """Of each axis that was swept alone and has a gyro."""
    time_s = stream_with(recording, "dut").time_s()
    letters, output = channels_in_si(recording, "gyro")
    stand = stream_with(recording, "stand", "rate_x", "rate_y", "rate_z")
    stand_s, rates = stand.time_s(), stand.si("rate_x", "rate_y", "rate_z")
    limit = sensor_range(recording, "gyro")
    sweeps: list[_Sweep] = []
    not_used: list[NotUsed] = []
    for axis, (begin_s, end_s) in _swept(stand_s, rates).items():
        letter = "xyz"[axis]
        mine, acted = ((t >= begin_s) & (t <= end_s) for t in (time_s, stand_s))
        if letter not in letters:
            not_used.append(NotUsed(f"sweep about {letter}", int(mine.sum()), say("no gyro along this axis")))
            continue
        where = f"recording {recording.recording_id}, sweep about {letter}"
        sampled = output[mine, letters.index(letter)]
        sweeps.append(_Sweep(letter, time_s[mine], sampled, stand_s[acted], rates[acted, axis], limit, where))
    return sweeps, not_used


def _clock(sweeps: list[_Sweep]) -> tuple[_Clock, dict[str, CalibrationError]]:
    """The unit's clock rate from the sweeps themselves; by letter, why a sweep cannot be evaluated.

    A clock that runs fast delays late frequencies more than early ones, which no delay and no lag does:
    chi-square is a parabola in its rate.
    """
    errors: dict[str, CalibrationError] = {}
    usable: list[_Sweep] = []
    for sweep in sweeps:
        try:
            sweep.response(0.0)
            usable.append(sweep)
        except CalibrationError as error:
            errors[sweep.letter] = error
    rate, curvature, ratio = 0.0, 0.0, 1.0
    for step in CLOCK_STEPS if usable else ():
        told = [[sweep.chi_square(rate + k * step) for sweep in usable] for k in (-1, 0, 1)]
        low, middle, high = (sum(chi_square for chi_square, _ in row) for row in told)
        curvature = (low - 2.0 * middle + high) / step**2
        ratio = max(middle / sum(freedom for _, freedom in told[1]), 1.0)
        if curvature <= 0.0:
            break
        rate -= (high - low) / (2.0 * step) / curvature
    doubt = math.sqrt(2.0 * ratio / curvature) if curvature > 0.0 else math.inf
    if doubt < CRYSTAL_DOUBT and abs(rate) < MAX_CLOCK_RATE:
        return _Clock(rate, doubt, True), errors
    return _Clock(0.0, CRYSTAL_DOUBT, False), errors


def _sentences(found: list[tuple[str, FrequencyResponse, DelayAndLag]], clock: _Clock) -> list[str]:
    ppm, doubt = f"{clock.rate * 1e6:.2f}", f"{clock.standard_uncertainty * 1e6:.2g}"
    sentences = [
        say(
            "clocks joined by the trigger; the unit's runs {ppm} ± {doubt} ppm fast by the sweeps, taken out",
            ppm=ppm,
            doubt=doubt,
        )
        if clock.seen
        else say("clocks joined by the trigger; the unit's crystal is taken as good to {ppm} ppm", ppm=doubt)
    ]
    for letter, _, told in found:
        sentences.append(say("axis {axis}: {words}", axis=letter, words=told.words))
        if told.bandwidth_hz is None:
            above = f"{told.bandwidth_above_hz:.3g}"
            sentences.append(
                say("axis {axis}: the bandwidth is above {hz} Hz (97.5 %)", axis=letter, hz=above)
            )
        if told.chi_square_ratio > UNLIKELY_CHI_SQUARE:
            sentences.append(
                say(
                    "axis {axis}: a delay and one lag do not describe this unit (chi-square {ratio} per "
                    "degree of freedom); the uncertainties are widened by it",
                    axis=letter,
                    ratio=f"{told.chi_square_ratio:.3g}",
                )
            )
    return sentences


def _beside(found: list[tuple[str, FrequencyResponse, DelayAndLag]], clock: _Clock) -> tuple[Beside, ...]:
    words = say("rate of the unit's clock against the stand's")
    figures = [Beside(words, clock.rate if clock.seen else None, "1")]
    for letter, response, told in found:
        chi_square = say("chi-square of delay and lag {axis} per degree of freedom", axis=letter)
        figures.append(Beside(chi_square, told.chi_square_ratio, "1"))
        highest = say("highest frequency told {axis}", axis=letter)
        figures.append(Beside(highest, float(response.frequency_hz.max()), "Hz"))
    return tuple(figures)


def _swept(time_s: FloatArray, rates: FloatArray) -> dict[int, tuple[float, float]]:
    """Axis → begin and end of its longest motion alone, with some rest on both sides."""
    found: dict[int, tuple[float, float]] = {}
    moving = np.abs(rates) > MOVING_RAD_S
    for axis in range(3):
        alone = np.flatnonzero(moving[:, axis] & ~np.delete(moving, axis, axis=1).any(axis=1))
        if len(alone) == 0:
            continue
        parts = np.split(alone, np.flatnonzero(np.diff(time_s[alone]) > REST_S) + 1)
        longest = max(parts, key=len)
        begin_s, end_s = float(time_s[longest[0]]), float(time_s[longest[-1]])
        if end_s - begin_s >= LEAST_SWEEP_S:
            found[axis] = (begin_s - REST_S, end_s + REST_S)
    return found

# pyright: strict
"""From a recording to what the diagnosis sees of it: everything in SI, on the unit's instants.

    unit_rows          the unit's samples, an empty row for each lost frame
    unit_outputs       counts, volts and pulses to SI
    stand_at_unit      the stand's report at those instants, never across a hole
    prediction         M u + b behind the believed pole, the Earth's rate added where it is believed
    doubtful_samples   what is saturated or frozen is set aside
    lattice            the quantum that the values have
    timing, frames     what the sample times and the order of the frames show by themselves
    clipping, held_values, steps    stops inside the range, channels that repeat themselves, jumps

Out of scope: GNSS fixes (a stream of their own) and poses that nothing in the recording tells.
"""

import dataclasses
import math

import numpy as np

from gap_diagnosis.alignment import coarse_alignment, constant_delay, triad_of
from gap_diagnosis.clipping import clipped
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.frames import (
    counter_wrap,
    duplicates,
    frame_loss,
    repeated_frames,
    stamp_jumps,
    without_duplicates,
)
from gap_diagnosis.held_values import held_channels
from gap_diagnosis.holes import median_period_s
from gap_diagnosis.observation import Observation, Oddity, SetAside, TimingFinding
from gap_diagnosis.plausibility import refuse_mistakes
from gap_diagnosis.steps import steps_in
from gap_diagnosis.timing import LEAST_LOG_RATIO, StandTiming, timing_against_stand
from gap_diagnosis.unit_and_stand import UnitSide, observed_at, unit_side
from protocol.errors import Fault
from protocol.recordings import Recording

ALIGNMENT_ROUNDS = 6
SAME_RATE = 1e-3
ALIGNED_SHARE = 0.05
"""Of the standard uncertainty: nearer is not worth another round."""


def observe(recording: Recording) -> Observation:
    """One recording, ready to be diagnosed.

    Raises:
        TestloomError: it cannot carry a diagnosis: too short, units that do not fit, the stand's report
            missing although the unit moved, no common time.
    """
    unit = unit_side(recording)
    coarse = coarse_alignment(recording, unit.rows.time_s[unit.rows.row_of_sample], unit.triads)
    is_aligned, added_s = coarse.added_s is not None, coarse.added_s or 0.0
    observation = observed_at(unit, added_s)
    uncertainty_s = 0.0
    if is_aligned:
        observation, uncertainty_s = _finely_aligned(unit, observation)
    refuse_mistakes(observed_at(unit, added_s - coarse.about_s) if coarse.about_s else observation)
    notes = list(observation.set_aside)
    if is_aligned:
        moved = f"{observation.aligned_by_s:.7f} s (± {uncertainty_s:.2g} s)"
        why = f"the unit's is moved by {moved} onto the stand's by the motion: nothing is said of a delay"
        notes.insert(0, SetAside("clock", 0, why))
    observation, timing, said = _frames(unit, observation)
    notes += said
    timing += unit.lattices
    oddities = [*observation.oddities, *steps_in(observation)]
    against = _against_stand(unit, observation, is_aligned, coarse.about_s)
    if against is not None:
        timing += against.findings
    for note in (stamp_jumps(unit.rows, recording.stream("dut").time_s()), _other_period(unit)):
        notes += [] if note is None else [note]
    return dataclasses.replace(
        observation, timing=tuple(timing), set_aside=tuple(notes), oddities=tuple(oddities)
    )


def _other_period(unit: UnitSide) -> SetAside | None:
    """The samples come at another rate than the test says; no drift, which needs two clocks."""
    stated = unit.recording.test.get("rate_hz")
    if isinstance(stated, bool) or not isinstance(stated, int | float) or stated <= 0:
        return None
    ratio = 1.0 / (stated * unit.rows.period_s)
    if abs(ratio - 1.0) < SAME_RATE:
        return None
    why = f"by the stamps {1.0 / unit.rows.period_s:.6g} Hz, by the test {stated:g} Hz; the stamps are used"
    return SetAside("sample rate", 0, why)


def _finely_aligned(unit: UnitSide, observation: Observation) -> tuple[Observation, float]:
    """The unit's clock moved until no triad sees a delay, and the standard uncertainty of that."""
    uncertainty_s = math.inf
    for _ in range(ALIGNMENT_ROUNDS):
        fits = [
            fit
            for sensor in observation.outputs
            if sensor != "temperature" and (fit := constant_delay(triad_of(observation, sensor))) is not None
        ]
        if not fits:
            break
        weight = np.array([1.0 / float(fit.covariance[0, 0]) for fit in fits])
        late_s = float((weight * [float(fit.values[0]) for fit in fits]).sum() / weight.sum())
        uncertainty_s = float(weight.sum() ** -0.5)
        observation = observed_at(unit, observation.aligned_by_s - late_s)
        if abs(late_s) < ALIGNED_SHARE * uncertainty_s:
            break
    return observation, uncertainty_s


def _frames(
    unit: UnitSide, observation: Observation
) -> tuple[Observation, list[TimingFinding], list[SetAside]]:
    """What the frames show; copies, wrapped, held and stopped values are missing values from here on."""
    found, notes = list(frame_loss(unit.rows, unit.triads)), list[SetAside]()
    again, twice = repeated_frames(unit.rows)
    if twice is not None:
        found.append(twice)
        notes.append(SetAside("frames", int(again.sum()), "frames that were sent twice"))
    oddities: list[Oddity] = []
    outputs = dict(observation.outputs)
    for sensor, output in observation.outputs.items():
        if sensor == "temperature" or unit.triads[sensor].are_means:
            continue
        output, wraps = counter_wrap(sensor, output)
        found += wraps
        notes += [SetAside(sensor, 0, wrap.description) for wrap in wraps]
        if twice is not None:
            values = np.where(again[:, np.newaxis], np.nan, output.values_si)
            output = dataclasses.replace(output, values_si=values)
        copies = duplicates(sensor, output)
        if copies is not None and copies.log_likelihood_ratio > LEAST_LOG_RATIO:
            output, count = without_duplicates(output)
            found.append(copies)
            notes.append(SetAside(sensor, count, "frames that repeat the one before"))
        output, held, of_held = held_channels(sensor, output)
        output, stop, one_sided, of_stops = clipped(
            sensor, output, unit.rows.spread(unit.triads[sensor].values_si)
        )
        found += [] if stop is None else [stop]
        oddities += [*held, *one_sided]
        notes += [*of_held, *of_stops]
        outputs[sensor] = output
    return dataclasses.replace(observation, outputs=outputs, oddities=tuple(oddities)), found, notes


def _against_stand(
    unit: UnitSide, observation: Observation, is_aligned: bool, about_s: float
) -> StandTiming | None:
    """Delay, drift, jitter.

    Raises:
        DiagnosisError: the unit's clock was set while it recorded.
    """
    stand = unit.recording.streams.get("stand")
    if stand is None:
        return None
    added_s = observation.aligned_by_s
    timing = timing_against_stand(
        observation,
        median_period_s(stand.time_s()),
        is_aligned,
        about_s,
        lambda more_s: _frames(unit, observed_at(unit, added_s + more_s))[0],
    )
    if timing.jump is not None:
        raise DiagnosisError(
            f"A clock jumps by {timing.jump.step_s:.4g} s at {timing.jump.at_s:.2f} s: before and behind it, "
            "unit and stand are apart by different times.",
            where=f"recording {unit.recording.recording_id}, streams dut and stand, time",
            fault=Fault.DATA,
            remedy="split the recording there, or record with clocks that are not set meanwhile.",
        )
    return timing

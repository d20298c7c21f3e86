"""Profiles 'flight' and 'vehicle_run': errors of roll and pitch against a reference on board (paper 2, 4.2).

The unit's own attitude is evaluated where it sends one: that is what a customer gets. What our strapdown
algorithm makes of its gyros and accelerometers is evaluated beside it, or alone. Phases are the recording's
where clocks are joined and it has them, else what the unit's own rates and forces show.
"""

# pyright: strict
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.algorithms.attitude_angles import roll_pitch_yaw_rad
from calibration.algorithms.attitude_error_figures import OVERALL, figures_by_phase, wrapped_rad
from calibration.algorithms.attitude_uncertainty import gates_of_run, roll_pitch_uncertainty_rad
from calibration.algorithms.coefficients import FloatArray
from calibration.algorithms.flight_phases import flight_phases, initial_rest_samples
from calibration.algorithms.screening import NotUsed
from calibration.algorithms.strapdown_attitude import (
    CorrectionSettings,
    StrapdownAttitude,
    align_at_rest,
    strapdown_attitude,
)
from calibration.evaluations.attitude_sources import (
    OURS,
    OWN,
    OWN_ANGLES,
    InertialSamples,
    error_sources,
    has_inertial,
    has_own_attitude,
    inertial_samples,
)
from calibration.evaluations.method_evaluation import (
    Beside,
    MethodEvaluation,
    SensorResult,
    method_evaluation,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.records.attitude_contents import attitude_content, curves_table
from calibration.site_gravity import gravity
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.mems_ahrs import SampleFlag
from protocol.recordings import Recording, Stream

PHASE_NAMES = (
    "rest",
    "take_off",
    "climb",
    "cruise",
    "turn",
    "circling",
    "pitch_manoeuvre",
    "descent",
    "landing",
    "accelerate",
    "straight",
    "slalom",
    "hill",
    "stop",
)
"""What the numbers of a recording's stream 'phases' mean."""
STEADY = ("cruise", "straight")
MAX_REFERENCE_HOLE_S = 0.1
MIN_USED_PART = 0.5
U_REFERENCE_RAD, U_MOUNTING_RAD = math.radians(0.01), 1e-3
"""Standard uncertainties of the reference's roll and pitch, and of how the unit sits beside it: stated."""
SETTINGS = CorrectionSettings()
PAPER_ROLL_DEG, PAPER_PITCH_DEG, PAPER_STEADY_DEG = 2.3, 2.5, 1.0
SHIFT_STEPS = 4


@dataclass(frozen=True)
class _Reference:
    """Roll and pitch (m, 2), rad, and where they may be interpolated."""

    time_s: FloatArray
    angles_rad: FloatArray

    def at(self, time_s: FloatArray) -> FloatArray:
        """(n, 2); not a number in holes and beyond the ends."""
        found = np.column_stack([np.interp(time_s, self.time_s, self.angles_rad[:, k]) for k in (0, 1)])
        after = np.searchsorted(self.time_s, time_s)
        inside = (after > 0) & (after < len(self.time_s))
        later, earlier = (
            self.time_s[after.clip(max=len(self.time_s) - 1)],
            self.time_s[(after - 1).clip(min=0)],
        )
        on_sample = np.isclose(later, time_s, rtol=0.0, atol=1e-9)
        known = on_sample | (inside & (later - earlier <= MAX_REFERENCE_HOLE_S))
        return np.where(known[:, None], found, np.nan)


@dataclass(frozen=True)
class _Ours:
    """Our attitude from the raw output, what the unit does by it, and how well it is known (n, 2)."""

    run: StrapdownAttitude
    states: NDArray[np.str_]
    uncertainty_rad: FloatArray
    inertial: InertialSamples


def evaluate_flight(recordings: tuple[Recording, ...]) -> MethodEvaluation:
    """1 sigma of roll and pitch, overall and by phase.

    Raises:
        CalibrationError: no reference, a unit with neither attitude nor gyros and accelerometers, no phases
            and nothing to tell them from, most of the reference missing.
    """
    (recording,) = recordings
    dut = stream_with(recording, "dut")
    reference = _reference(recording)
    not_used: list[NotUsed] = []
    ours = _ours(recording, dut, not_used, needed=not has_own_attitude(dut))
    phase, phase_words = _phases(recording, dut, ours)
    assumptions = [
        say("1 sigma: root mean square of the error about zero, the mounting's part included"),
        say(
            "reference {reference}°, mounting of the unit {mounting}° (standard uncertainties, stated)",
            reference=f"{math.degrees(U_REFERENCE_RAD):.2g}",
            mounting=f"{math.degrees(U_MOUNTING_RAD):.2g}",
        ),
        phase_words,
    ]
    attitudes: list[tuple[str, FloatArray]] = []
    if has_own_attitude(dut):
        attitudes.append((OWN, dut.si(*OWN_ANGLES)[:, :2]))
        assumptions.append(say("attitude: what the unit sends as roll and pitch"))
    if ours is not None:
        attitudes.append((OURS, roll_pitch_yaw_rad(ours.run.quaternion)[:, :2]))
        assumptions += [_words_of_ours(), ours.inertial.sentence]
    results = [
        result
        for sensor, angles in attitudes
        if (result := _sensor_result(sensor, recordings, dut, angles, reference, phase, ours, not_used))
    ]
    if recording.test.get("triggered") is False:
        assumptions.append(
            say("no trigger joins the clocks: their offset and the unit's lag are taken out together")
        )
    return method_evaluation(recordings, results, assumptions, not_used)


def _sensor_result(
    sensor: str,
    recordings: tuple[Recording, ...],
    dut: Stream,
    angles: FloatArray,
    reference: _Reference,
    phase: NDArray[np.str_],
    ours: _Ours | None,
    not_used: list[NotUsed],
) -> SensorResult | None:
    """Of one attitude (n, 2); None where the unit never levelled its own, and ours is there instead."""
    (recording,) = recordings
    triggered = recording.test.get("triggered") is not False
    shift_s = 0.0 if triggered else _shift_s(dut.time_s(), angles, reference)
    error = wrapped_rad(angles - reference.at(dut.time_s() - shift_s))
    usable = np.asarray(np.isfinite(error).all(axis=1), dtype=np.bool_)
    _note_missing(recording, sensor, usable, not_used)
    if sensor == OWN:
        usable &= _aligned(recording, dut, not_used)
        if not usable.any():
            if ours is not None:
                return None
            raise refused(
                recording,
                "The unit never said that it was aligned, and ours cannot be had from its output.",
                "leave it at rest before it moves, and calibrate its accelerometers",
            )
    result = _result(sensor, recordings, dut.time_s(), error, phase, usable, ours)
    if triggered:
        return result
    words = say("lag and clock offset together, taken out of the errors")
    return replace(result, beside=(*result.beside, Beside(words, shift_s, "s")))


def _words_of_ours() -> str:
    return say(
        "strapdown attitude: ours from gyros and accelerometers, corrected with {tilt} s (bias {bias} s) "
        "while the gates are open",
        tilt=f"{SETTINGS.tilt_time_constant_s:g}",
        bias=f"{SETTINGS.bias_time_constant_s:g}",
    )


def _reference(recording: Recording) -> _Reference:
    stand = stream_with(recording, "stand", "roll", "pitch")
    angles = stand.si("roll", "pitch")
    kept = np.isfinite(angles).all(axis=1)
    if kept.sum() < 2:
        raise refused(
            recording, "The reference was lost all the time.", "look at its satellites", "stream stand"
        )
    return _Reference(stand.time_s()[kept], np.unwrap(angles[kept], axis=0))


def _ours(recording: Recording, dut: Stream, not_used: list[NotUsed], needed: bool) -> _Ours | None:
    """None where it cannot be had, and need not: why is noted."""
    try:
        if not has_inertial(dut):
            raise refused(
                recording,
                "The unit sends neither roll, pitch and yaw nor its gyros and accelerometers.",
                "record one of them",
                "stream dut",
            )
        return _our_attitude(recording, dut)
    except CalibrationError as error:
        if needed:
            raise
        not_used.append(NotUsed(say("gyros and accelerometers"), len(dut), error.what))
        return None


def _our_attitude(recording: Recording, dut: Stream) -> _Ours:
    inertial = inertial_samples(recording, dut)
    lost = int(inertial.broken.sum())
    if lost:
        raise refused(
            recording,
            f"{lost} samples of gyros or accelerometers are missing, saturated or after a hole: no "
            "attitude can be integrated across them.",
            "look at the unit's link, and choose a wider range",
            "stream dut",
        )
    period_s = sample_period_s(recording, dut)
    rest = initial_rest_samples(inertial.rate_rad_s, inertial.force_m_s2, period_s)
    rate, force = inertial.rate_rad_s, inertial.force_m_s2
    block_s = SETTINGS.block_s
    alignment = align_at_rest(rate[:rest], force[:rest], period_s, block_s)
    magnitude = gravity(recording).magnitude_m_s2
    gates = gates_of_run(alignment, magnitude)
    run = strapdown_attitude(rate, force, period_s, alignment, gates.bounds, SETTINGS)
    states = flight_phases(run.quaternion, rate - alignment.bias_rad_s, force, period_s)
    by_block = roll_pitch_uncertainty_rad(run, alignment, error_sources(recording), SETTINGS, magnitude)
    uncertainty = np.repeat(by_block, run.block_samples, axis=0)[: len(rate)]
    return _Ours(run, states, uncertainty, inertial)


def _phases(recording: Recording, dut: Stream, ours: _Ours | None) -> tuple[NDArray[np.str_], str]:
    """(n,) names and where they are from."""
    joined = recording.test.get("triggered") is not False
    if joined and "phases" in recording.streams and len(recording.streams["phases"]):
        stream = stream_with(recording, "phases", "phase")
        numbers = np.asarray(stream.columns["phase"], dtype=np.int64)
        if numbers.min() < 0 or numbers.max() >= len(PHASE_NAMES):
            raise refused(
                recording,
                f"The stream 'phases' has the number {int(numbers.max())} of {len(PHASE_NAMES)} phases.",
                f"number them from 0 in this order: {', '.join(PHASE_NAMES)}",
                "stream phases",
            )
        index = np.searchsorted(stream.time_s(), dut.time_s() + 1e-9, side="right") - 1
        names = np.where(index < 0, "before", np.array(PHASE_NAMES)[numbers[index.clip(min=0)]])
        return names, say("phases as the recording has them")
    if ours is None:
        raise refused(
            recording,
            "The recording has no phases, and no gyros and accelerometers that would tell them.",
            "record the stream 'phases', or gyro_x … acc_z",
        )
    return ours.states, say("phases from the unit's own rates and forces")


def _shift_s(time_s: FloatArray, angles_rad: FloatArray, reference: _Reference) -> float:
    """How far the unit's angles lie behind the reference's stamps: least squares on what changes fast."""
    shift_s = 0.0
    for _ in range(SHIFT_STEPS):
        there = reference.at(time_s - shift_s)
        error = wrapped_rad(angles_rad - there)
        turning = np.gradient(there, axis=0) / np.gradient(time_s)[:, None]
        known = np.isfinite(error).all(axis=1) & np.isfinite(turning).all(axis=1)
        slow = max(3, round(5.0 / float(np.median(np.diff(time_s)))))
        fast = error[known] - _running_mean(error[known], slow)
        rate = turning[known] - _running_mean(turning[known], slow)
        shift_s -= float(np.sum(fast * rate) / max(float(np.sum(rate**2)), 1e-12))
    return shift_s


def _running_mean(values: FloatArray, size: int) -> FloatArray:
    total = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0)
    index = np.arange(len(values))
    first, last = (index - size // 2).clip(min=0), (index + size // 2 + 1).clip(max=len(values))
    return (total[last] - total[first]) / (last - first)[:, None]


def _aligned(recording: Recording, dut: Stream, not_used: list[NotUsed]) -> NDArray[np.bool_]:
    """(n,) whether the unit says that its attitude has been levelled, where its product says so."""
    if recording.unit.get("product") != "mems_ahrs" or "flags" not in dut.columns:
        return np.ones(len(dut), dtype=np.bool_)
    aligned = (np.asarray(dut.columns["flags"], dtype=np.int64) & int(SampleFlag.ALIGNED)) != 0
    if not aligned.any():
        not_used.append(NotUsed(OWN, len(dut), say("the unit never said that it was aligned")))
    elif not aligned.all():
        why = say("before the unit says that it is aligned")
        not_used.append(NotUsed(OWN, int((~aligned).sum()), why))
    return np.asarray(aligned, dtype=np.bool_)


def _note_missing(
    recording: Recording, sensor: str, usable: NDArray[np.bool_], not_used: list[NotUsed]
) -> None:
    lost = int((~usable).sum())
    if lost > (1.0 - MIN_USED_PART) * len(usable):
        raise refused(
            recording,
            f"{lost} of {len(usable)} samples of the attitude or of its reference are missing.",
            "record again",
        )
    if lost:
        why = say("the unit or the reference sent nothing there")
        not_used.append(NotUsed(sensor, lost, why))


def _result(
    sensor: str,
    recordings: tuple[Recording, ...],
    time_s: FloatArray,
    error: FloatArray,
    phase: NDArray[np.str_],
    usable: NDArray[np.bool_],
    ours: _Ours | None,
) -> SensorResult:
    of_reference = math.hypot(U_REFERENCE_RAD, U_MOUNTING_RAD)
    roll, pitch = (figures_by_phase(error[:, k], phase, usable) for k in (0, 1))
    both = (("roll angle", roll), ("pitch angle", pitch))
    numbers = np.array([PHASE_NAMES.index(name) if name in PHASE_NAMES else -1 for name in phase.tolist()])
    curves = {
        "time": ("s", time_s[usable] - time_s[usable][0]),
        "roll_error": ("rad", error[usable, 0]),
        "pitch_error": ("rad", error[usable, 1]),
        "phase_number": ("1", numbers[usable].astype(np.float64)),
    }
    beside = [
        Beside(say("roll in flight, paper 2 (1 sigma)"), PAPER_ROLL_DEG, "deg"),
        Beside(say("pitch in flight, paper 2 (1 sigma)"), PAPER_PITCH_DEG, "deg"),
        Beside(say("when steady, paper 2: at most (1 sigma)"), PAPER_STEADY_DEG, "deg"),
        *(
            Beside(
                say("here {angle}, all phases", angle=say(word)), math.degrees(figures[OVERALL].sigma), "deg"
            )
            for word, figures in both
        ),
        *(
            Beside(say("here {angle}, steady", angle=say(word)), math.degrees(figures[steady].sigma), "deg")
            for word, figures in both
            for steady in STEADY
            if steady in figures
        ),
    ]
    if sensor == OURS and ours is not None:
        curves |= {
            f"u_{name}_error": ("rad", ours.uncertainty_rad[usable, k])
            for k, name in enumerate(("roll", "pitch"))
        }
        stated = np.abs(error[usable]) <= 2.0 * np.hypot(ours.uncertainty_rad[usable], of_reference)
        beside += [
            Beside(
                say("part of the errors within twice their stated uncertainty"), float(stated.mean()), "1"
            ),
            Beside(say("part of the time with open gates"), float(ours.run.gates_open.mean()), "1"),
        ]
    content = attitude_content(
        roll,
        pitch,
        of_reference,
        {name: number for number, name in enumerate(PHASE_NAMES)},
        (curves_table("errors_over_time", curves),),
        computed_here=sensor == OURS,
    )
    return SensorResult(sensor, content, recordings, tuple(beside))

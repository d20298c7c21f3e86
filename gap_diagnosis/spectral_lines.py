# pyright: strict
"""Spectral lines in what the motion does not explain: tones that last, of one frequency in all recordings.

Of each channel, what bias, matrix and the prediction's slope leave is taken; its periodogram over the local
background (medians of ever wider bands, interpolated) is, without a line, a unit exponential. Sums over
recordings, and over the axes of a triad, are gamma distributed, F distributed for the background's own
uncertainty; p is family-wise over all frequencies, channels and triads. With amplitude A in n samples of
deviation σ, the sum grows by d² / 2 = n A² / (4 σ²).

What the motion leaves has lines too. A line counts only if
    it is none of the excitation's     no predicted output, square or modulus of one, and no gimbal's wave has
                                       a line there
    it lasts                           its amplitude and phase are alike in six parts of each recording
    it does not wander                 no other line of its axis within 0.1 Hz
    it is not the sensor's own rate    its frames do not repeat themselves by a clock (`renewal`)

Found lines are fitted (own phases in each recording) and taken off, the clearest first.
"""

import dataclasses
import math
from collections.abc import Collection, Sequence

import numpy as np

from dut_emulator.effects.effect import SI_UNIT
from gap_diagnosis.line_residuals import LineResiduals, line_residuals
from gap_diagnosis.line_search import Line, LineSearch
from gap_diagnosis.observation import AXES, Observation, SetAside, TimingFinding
from gap_diagnosis.renewal import renewal_words, renews_by_itself

MAX_ROWS_TOGETHER = 2_000_000
SAME_RATE = 1e-5
WANDERING_HZ = 0.1
MAINS_HZ, MAINS_TOLERANCE_HZ = (50.0, 60.0), 0.05


def without_lines(observations: Sequence[Observation]) -> tuple[list[Observation], list[Line]]:
    """The observations (single samples, one sampling period) with lines taken off, and the lines.

    Each observation gets the findings; see `finding_of`.
    """
    period_s = observations[0].sample_period_s
    parts = [line_residuals(one) for one in observations]
    rate_hz = 1.0 / period_s
    expected_hz = [abs(f - rate_hz * round(f / rate_hz)) for f in MAINS_HZ]
    search = LineSearch([part for part in parts if part is not None], period_s, expected_hz)
    lines = list(search.lines())
    sensors = {line.sensor for line in lines}
    wandering = {sensor for sensor in sensors if _wanders(lines, sensor, len(observations))}
    merged = [
        line
        for line in _merged(lines)
        if line.sensor not in wandering and not _is_of_renewal(line, observations)
    ]
    alone = [
        not any(other.sensor != line.sensor and _same_frequency(other, line) for other in merged)
        for line in merged
    ]
    findings = [finding_of(line, period_s, mag_alone) for line, mag_alone in zip(merged, alone, strict=True)]
    return [
        one if part is None else _with(_unnamed_noted(one, lines, wandering), part, findings, merged)
        for one, part in zip(observations, parts, strict=True)
    ], lines


def _is_of_renewal(line: Line, observations: Sequence[Observation]) -> bool:
    return any(renews_by_itself(one, line.sensor) for one in observations)


def _wanders(lines: Sequence[Line], sensor: str, recordings: int) -> bool:
    """Lines so near to each other on one axis are one source without a fixed frequency.

    As many as there are recordings may be one tone, by as many clocks.
    """
    mine = [line for line in lines if line.sensor == sensor]
    return any(
        sum(
            abs(one.frequency_hz - other.frequency_hz) < WANDERING_HZ
            and bool(set(one.axes) & set(other.axes))
            for other in mine
            if other is one or not _same_frequency(one, other)
        )
        > recordings
        for one in mine
    )


def _unnamed_noted(one: Observation, lines: Sequence[Line], wandering: Collection[str]) -> Observation:
    """With a word on each sensor whose lines are those of its own rate, or wander."""
    notes: list[SetAside] = []
    outputs = dict(one.outputs)
    for sensor in sorted({line.sensor for line in lines}):
        if renews_by_itself(one, sensor):
            notes.append(SetAside(sensor, 0, renewal_words(one, sensor)))
        elif sensor in wandering:
            notes.append(SetAside(sensor, 0, _wandering_words([x for x in lines if x.sensor == sensor])))
            if sensor in outputs:
                noise = dataclasses.replace(outputs[sensor].noise, white_si_per_sqrt_hz=None)
                outputs[sensor] = dataclasses.replace(outputs[sensor], noise=noise)
    return dataclasses.replace(one, outputs=outputs, set_aside=(*one.set_aside, *notes))


def _wandering_words(lines: Sequence[Line]) -> str:
    at = ", ".join(f"{frequency:.4g}" for frequency in sorted({round(one.frequency_hz, 1) for one in lines}))
    return (
        f"lines about {at} Hz that wander are taken off: no tone of one frequency, so none is named, "
        "and white noise is not claimed beside them"
    )


def lines_taken_off(observations: Sequence[Observation]) -> list[Observation]:
    """The observations with findings of lines, and without these; searched together as far as that fits.

    Those of one sampling rate belong together, up to `MAX_ROWS_TOGETHER`.
    """
    groups: list[list[int]] = []
    for number, one in enumerate(observations):
        for group in groups:
            first = observations[group[0]]
            rows = sum(len(observations[index]) for index in group) + len(one)
            if rows <= MAX_ROWS_TOGETHER and _same_rate(first, one):
                group.append(number)
                break
        else:
            groups.append([number])
    found = list(observations)
    for group in groups:
        cleaned, _ = without_lines([observations[index] for index in group])
        for number, one in zip(group, cleaned, strict=True):
            found[number] = one
    return found


def _same_rate(one: Observation, other: Observation) -> bool:
    return abs(one.sample_period_s / other.sample_period_s - 1.0) < SAME_RATE


def _with(
    one: Observation, part: LineResiduals, findings: Sequence[TimingFinding], lines: Sequence[Line]
) -> Observation:
    """Without its lines, and with their findings: amplitudes as the recording's own clock has the phase."""
    outputs = dict(one.outputs)
    for (sensor, axis), tone in part.removed.items():
        values = outputs[sensor].values_si.copy()
        values[:, axis] -= tone
        outputs[sensor] = dataclasses.replace(outputs[sensor], values_si=values)
    own = tuple(
        dataclasses.replace(finding, more=_waves(part, line, finding.value))
        for finding, line in zip(findings, lines, strict=True)
        if any((line.sensor, axis) in part.removed for axis in line.axes)
    )
    notes = (SetAside("spectral line", 0, finding.description.rstrip(".")) for finding in own)
    return dataclasses.replace(
        one, outputs=outputs, timing=(*one.timing, *own), set_aside=(*one.set_aside, *notes)
    )


def _waves(part: LineResiduals, line: Line, true_hz: float) -> tuple[tuple[str, float, float, str], ...]:
    """Cosine and sine of the true frequency, of each axis, as the catalogue has them."""
    phase = 2.0 * np.pi * true_hz * part.time_s
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    found: list[tuple[str, float, float, str]] = []
    for axis in line.axes:
        tone = part.removed.get((line.sensor, axis))
        if tone is None:
            continue
        cosine, sine = np.linalg.lstsq(waves, tone, rcond=None)[0].tolist()
        uncertainty, unit = line.amplitude_uncertainty_si[axis], SI_UNIT[line.sensor]
        found.append((f"cosine_si_{AXES[axis]}", cosine, uncertainty, unit))
        found.append((f"sine_si_{AXES[axis]}", sine, uncertainty, unit))
    return tuple(found)


def _same_frequency(one: Line, other: Line) -> bool:
    apart = abs(one.frequency_hz - other.frequency_hz)
    return apart < 5.0 * math.hypot(one.frequency_uncertainty_hz, other.frequency_uncertainty_hz)


def _merged(lines: Sequence[Line]) -> list[Line]:
    """One line for each sensor and frequency, axes found apart joined."""
    found: list[Line] = []
    for line in sorted(lines, key=lambda one: -one.log_ratio):
        same = next(
            (
                n
                for n, other in enumerate(found)
                if other.sensor == line.sensor and _same_frequency(other, line)
            ),
            None,
        )
        if same is None:
            found.append(line)
            continue
        other = found[same]
        found[same] = dataclasses.replace(
            other,
            axes=tuple(sorted({*other.axes, *line.axes})),
            amplitude_si=tuple(map(max, other.amplitude_si, line.amplitude_si)),  # pyright: ignore[reportArgumentType]
            amplitude_uncertainty_si=tuple(
                map(max, other.amplitude_uncertainty_si, line.amplitude_uncertainty_si)
            ),  # pyright: ignore[reportArgumentType]
        )
    return found


def finding_of(line: Line, period_s: float, is_alone: bool) -> TimingFinding:
    """The line by the catalogue's name: mains in a magnetometer alone, else 'link.aliasing'.

    Samples of one rate do not tell a tone from one that folded down: the lowest frequency beyond half the
    sampling rate is given, and the description says what else it may be.
    """
    channels = ", ".join(f"{line.sensor}_{AXES[axis]}" for axis in line.axes)
    rate_hz = 1.0 / period_s
    seen = line.frequency_hz
    tolerance = MAINS_TOLERANCE_HZ + 3.0 * line.frequency_uncertainty_hz
    mains = [f for f in MAINS_HZ if abs(abs(f - rate_hz * round(f / rate_hz)) - seen) < tolerance]
    unit = SI_UNIT[line.sensor]
    size = max(line.amplitude_si)
    said = f"A line at {seen:.5g} Hz on {channels}, of {size:.3g} {unit}"
    if line.sensor == "mag" and mains and is_alone:
        fold = mains[0] - rate_hz * round(mains[0] / rate_hz)
        name, true_hz = "mag.mains_interference", mains[0] + math.copysign(seen - abs(fold), fold or 1.0)
        said += f": the mains' {mains[0]:.0f} Hz."
    else:
        name, true_hz = "link.aliasing", rate_hz - seen
        others = ", ".join(f"{f:.5g}" for f in (rate_hz - seen, rate_hz + seen, 2.0 * rate_hz - seen))
        said += (
            f": a tone there, or one that folds there from {others} Hz …; samples of one rate do not tell."
        )
    return TimingFinding(
        name,
        (line.sensor,),
        "frequency_hz",
        true_hz,
        line.frequency_uncertainty_hz,
        "Hz",
        line.log_ratio,
        said,
        channels=tuple(f"{line.sensor}_{AXES[axis]}" for axis in line.axes),
    )

# pyright: strict
"""What the counter, the stamps and the order of the frames show: losses, copies, words that wrap round."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import SI_UNIT, FloatArray, SensorName
from gap_diagnosis.doubtful_samples import runs_of
from gap_diagnosis.observation import AXES, SensorOutput, SetAside, TimingFinding
from gap_diagnosis.unit_outputs import UnitTriad
from gap_diagnosis.unit_rows import MAX_LOST_IN_A_ROW, UnitRows

PER_FRAME = 10.0
"""Log likelihood ratio of one frame that is not there: links lose one in 20,000 without anyone's minding."""
LEAST_PAIRS = 100
MOVED_QUANTA = 3.0
LARGEST_CHANCE = 0.5
"""With more equal frames than this by chance a copy cannot be told."""
LEAST_WRAPPED = 3
MAX_LOG_RATIO = 1e6
LEAST_SLOWER = 0.05
PATTERN_DISTANCES, PATTERN = 20, 0.2
"""Total variation between the distances of repeats and random ones."""
UNKNOWN_CHANCE = 2e-3
"""Of equal frames, where no quantum is believed."""

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def frame_loss(rows: UnitRows, triads: dict[SensorName, UnitTriad]) -> tuple[TimingFinding, ...]:
    """Frames that the counter or the stamps miss, and rows without values."""
    if rows.lost:
        sent = rows.lost + len(rows.row_of_sample)
        how = "the counter skips them" if rows.counter is not None else "the stamps leave room for them"
        return (_loss(rows.lost, sent, (), f"{rows.lost} of {sent} frames are lost: {how}."),)
    findings: list[TimingFinding] = []
    for sensor, triad in triads.items():
        there = ~np.isnan(triad.values_si).all(axis=0)
        values = triad.values_si[1:, there] if triad.are_means else triad.values_si[:, there]
        empty: BoolArray = np.isnan(values).sum(axis=1) == values.shape[1]
        if not there.any() or not empty.any():
            continue
        first, length = runs_of(empty[1:] == empty[:-1])
        single = length[empty[first]]
        single = single[single <= MAX_LOST_IN_A_ROW]  # a longer one is a hole
        if len(single):
            lost, sent = int(single.sum()), len(empty)
            said = f"{lost} of {sent} frames of the {sensor} have no values, in {len(single)} places."
            findings.append(_loss(lost, sent, (sensor,), said))
    return tuple(findings)


def repeated_frames(rows: UnitRows) -> tuple[BoolArray, TimingFinding | None]:
    """Rows whose frame has the number of the one before, (n,); what the counter says of them."""
    again: BoolArray = np.zeros(len(rows.time_s), dtype=bool)
    if rows.counter is None:
        return again, None
    again[rows.row_of_sample[1:][np.diff(rows.counter) == 0]] = True
    count, sent = int(again.sum()), len(rows.row_of_sample)
    if not count:
        return again, None
    said = f"{count} of {sent} frames have the number of the one before: they were sent twice."
    return again, _share("link.duplicate_frames", count, sent, (), count * PER_FRAME, said)


def _loss(lost: int, sent: int, sensors: tuple[SensorName, ...], said: str) -> TimingFinding:
    return _share("link.frame_loss", lost, sent, sensors, lost * PER_FRAME, said)


def _share(
    effect: str, count: float, of: int, sensors: tuple[SensorName, ...], ratio: float, said: str
) -> TimingFinding:
    share = count / of
    uncertainty = math.sqrt(max(share * (1.0 - share), 1.0 / of) / of)
    return TimingFinding(
        effect, sensors, "probability", share, uncertainty, "1", min(ratio, MAX_LOG_RATIO), said
    )


def duplicates(sensor: SensorName, output: SensorOutput) -> TimingFinding | None:
    """Frames that repeat the one before oftener than the quantum makes them.

    Of a share A of equal frames, c are so by chance, and A = p + (1 − p) c. c is the product over the axes of
    what their steps of one and two quanta tell of steps of none: of a normal step, P0 = P1^(4/3) / P2^(1/3).
    Frames are looked at where the prediction moves, if it does: c is a bound there. Repeats at even distances
    are a sensor that is slower than its frames, not a link's copies.
    """
    steps, moves, known = _steps(output)
    if not len(steps):
        return None
    chance = _chance(steps[known], output.quantum_si)
    if moves.sum() >= LEAST_PAIRS:
        known = moves
    number = int(known.sum())
    if number < LEAST_PAIRS or chance > LARGEST_CHANCE:
        return None
    repeats = np.flatnonzero(known & (steps == 0.0).all(axis=1))
    equal, expected = len(repeats), chance * number
    found = (equal / number - chance) / (1.0 - chance)
    unknown = UNKNOWN_CHANCE if output.quantum_si <= 0 else 1e-5  # the chance is estimated
    several = _chance_at_most(steps[known])  # a channel that stands still repeats itself
    allowed = 1.5 * expected + 3.0 * math.sqrt(expected) + (unknown + 1.5 * several) * number
    everywhere = np.flatnonzero((steps == 0.0).all(axis=1))
    if found <= 0 or equal <= allowed or is_slower(everywhere, equal / number):
        return None
    ratio = equal * math.log(equal / allowed) - (equal - allowed)
    said = (
        f"{equal} of {number} frames of the {sensor} repeat the one before; by chance it were {expected:.1f}."
    )
    return _share("link.duplicate_frames", found * number, number, (sensor,), ratio, said)


def without_duplicates(output: SensorOutput) -> tuple[SensorOutput, int]:
    """The triad with repeated frames as missing, and how many: what they should have brought is lost."""
    steps, _, known = _steps(output)
    again = np.concatenate([[False], known & (steps == 0.0).all(axis=1)])
    values = np.where(again[:, np.newaxis], np.nan, output.values_si)
    return dataclasses.replace(output, values_si=values), int(again.sum())


def _steps(output: SensorOutput) -> tuple[FloatArray, BoolArray, BoolArray]:
    """(n − 1, k) steps of the axes there are; where the prediction moves clearly; where they are known."""
    there = ~np.isnan(output.values_si).all(axis=0)
    steps = np.diff(output.values_si[:, there], axis=0)
    known: BoolArray = np.isfinite(steps).sum(axis=1) == max(steps.shape[1], 1)
    change = np.abs(np.diff(output.predicted_si[:, there], axis=0))
    seen: BoolArray = known & (np.isfinite(change).sum(axis=1) == change.shape[1])
    if not seen.any() or not steps.shape[1]:
        return steps, np.zeros(len(steps), dtype=bool), known
    largest = np.where(seen[:, np.newaxis], change, 0.0).max(axis=1)
    # without a quantum: the quarter that moves most, so that what a rest repeats does not count
    least = (
        MOVED_QUANTA * output.quantum_si if output.quantum_si > 0 else float(np.quantile(largest[seen], 0.75))
    )
    return steps, seen & (largest > least), known


def is_slower(repeats: IntArray, share: float) -> bool:
    """Random repeats have geometric distances, P(d) = p (1 − p)^(d − 1); a slower sensor's show a pattern."""
    if len(repeats) < LEAST_PAIRS or share < LEAST_SLOWER:
        return False
    distance = np.diff(repeats)
    own = 1.0 / float(np.mean(distance))
    ways = np.arange(1, PATTERN_DISTANCES + 1)
    seen = np.bincount(np.minimum(distance, PATTERN_DISTANCES + 1), minlength=PATTERN_DISTANCES + 2)
    random = own * (1.0 - own) ** (ways - 1)
    return float(np.abs(seen[1:-1] / len(distance) - random).sum()) / 2.0 > PATTERN


def _chance_at_most(steps: FloatArray) -> float:
    """Of several axes that have nothing to do with each other; 0 for one, which no copy is told from."""
    if steps.shape[1] < 2 or not len(steps):
        return 0.0
    return math.prod(np.count_nonzero(axis == 0.0) / len(axis) for axis in steps.T)


def _chance(steps: FloatArray, quantum_si: float) -> float:
    """That all axes repeat themselves by their quantum."""
    if quantum_si <= 0 or not len(steps):
        return 0.0
    chance = 1.0
    for axis in range(steps.shape[1]):
        size = np.abs(np.rint(steps[:, axis] / quantum_si))
        share = np.bincount(np.minimum(size, 3.0).astype(np.int64), minlength=4) / len(size)
        none, one, two = float(share[0]), 0.5 * float(share[1]), 0.5 * float(share[2])
        smooth = one ** (4.0 / 3.0) / two ** (1.0 / 3.0) if one > 0 and two > 0 else none
        chance *= min(smooth, 1.0)
    return chance


def counter_wrap(sensor: SensorName, output: SensorOutput) -> tuple[SensorOutput, tuple[TimingFinding, ...]]:
    """Values that come out at the other end of their word, off by whole multiples of 2 M.

    Returns:
        the triad with those as missing; a finding for each axis.
    """
    findings: list[TimingFinding] = []
    kept = output.values_si
    for axis, name in enumerate(AXES):
        values, predicted = kept[:, axis], output.predicted_si[:, axis]
        known = np.isfinite(values) & np.isfinite(predicted)
        if known.sum() < LEAST_PAIRS:
            continue
        end, off = float(np.abs(values[known]).max()), np.abs(values - predicted)
        if end <= 0:
            continue
        turns = np.rint(np.where(known, off, 0.0) / (2.0 * end))
        wrapped = turns > 0
        straight = known & ~wrapped
        if wrapped.sum() < LEAST_WRAPPED or straight.sum() < LEAST_PAIRS or np.ptp(predicted[straight]) == 0:
            continue
        slope, offset = np.polyfit(predicted[straight], values[straight], 1)
        off = np.abs(values - (slope * predicted + offset))[wrapped] / (2.0 * turns[wrapped])
        half = float(np.median(off))
        spread = 1.4826 * float(np.median(np.abs(off - half)))
        if not 0.5 < slope < 2.0 or spread > 0.03 * half or half < 0.99 * end:
            continue  # the axis itself is turned, or this is no word's end
        kept = np.where(wrapped[:, np.newaxis] & (np.arange(3) == axis), np.nan, kept)
        said = f"{int(wrapped.sum())} values of {sensor}_{name} come out at the other end of their word."
        uncertainty = math.hypot(1.25 * spread / math.sqrt(len(off)), output.quantum_si)
        ratio = min(len(off) * PER_FRAME, MAX_LOG_RATIO)
        unit = SI_UNIT[sensor]
        findings.append(
            TimingFinding(
                "link.counter_wrap", (sensor,), "half_span_si", half, uncertainty, unit, ratio, said
            )
        )
    return dataclasses.replace(output, values_si=kept), tuple(findings)


def stamp_jumps(rows: UnitRows, sample_s: FloatArray) -> SetAside | None:
    """Stamps that jump while the counter goes on: the clock was set, or the unit paused."""
    if rows.counter is None:
        return None
    expected = np.diff(rows.counter) * rows.period_s
    off = np.diff(sample_s) - expected
    jumps = np.abs(off) > 2.0 * rows.period_s
    if not jumps.any() or jumps.mean() > 0.01:
        return None
    at = int(np.argmax(np.abs(off)))
    why = (
        f"the stamps jump while the counter goes on, most by {off[at]:.4g} s at {sample_s[at + 1]:.3f} s: "
        "the unit's clock was set, or it paused"
    )
    return SetAside("clock", int(jumps.sum()), why)

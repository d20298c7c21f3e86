# pyright: strict
"""What a set of effects gains on data that it was not fitted to, and how far it closes the gap there.

Held out is a recording; with a single one, contiguous stretches of it ('within run'). The nuisances are
recalibrated on the held-out part, as a user would do; the effects are not.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import ChannelDesign, Design
from gap_diagnosis.evidence import STEPS_OF_DATA, Terms, log_sum_exp, profile
from gap_diagnosis.fitting import JointFit, joint_terms, level_weights, systems_with
from gap_diagnosis.noise_model import knots_for
from gap_diagnosis.observation import Channel
from gap_diagnosis.prepared import ChannelNoise, Prepared
from gap_diagnosis.whitened import RecordingMoments, moments

PARTS_OF_A_RUN = 5
BOOTSTRAPS = 400
GAIN_SIGMAS = 2.0


@dataclass(frozen=True)
class Fold:
    """One held-out part: what the model gains there.

    Attributes:
        label: recording, or part of it.
        gain: 2 ln of the likelihoods with and without, at the amplitudes of the other parts.
        signal: variance of `gain` over 4: aᵀ G a of the held-out part.
        by_cause: (causes,) what each effect adds to `gain` when it comes last.
        cause_signal: (causes,) its aᵀ G a.
        best_gain: what amplitudes fitted to this part itself would gain, less their number.
        rows: of the part, all channels.
    """

    label: str
    gain: float
    signal: float
    by_cause: FloatArray
    cause_signal: FloatArray
    best_gain: float
    rows: int


@dataclass(frozen=True)
class HeldOut:
    """All parts, each held out once."""

    folds: tuple[Fold, ...]
    within_run: bool

    def gains(self, cause: int) -> bool:
        """Whether an effect gains more than chance: by more than two standard errors."""
        gain = sum(float(fold.by_cause[cause]) for fold in self.folds)
        variance = 4.0 * sum(float(fold.cause_signal[cause]) for fold in self.folds)
        return gain > GAIN_SIGMAS * math.sqrt(max(variance, 1e-300))


def hold_out(fit: JointFit, noisy: frozenset[Channel]) -> HeldOut:
    """Each recording, or each stretch of a single one, against the amplitudes of the others."""
    prepared = fit.prepared
    recordings = sorted({i for by in prepared.moments.values() for i in by})
    within = len(recordings) == 1
    labels = {i: prepared.observations[i].recording_id for i in recordings}
    if within:
        prepared, labels = _in_parts(prepared, PARTS_OF_A_RUN)
        recordings = sorted(labels)
    folds: list[Fold] = []
    for out in recordings:
        training = systems_with(prepared, noisy, [i for i in recordings if i != out])
        testing = systems_with(prepared, noisy, [out])
        places, terms = joint_terms(training, prepared.design, fit.causes)
        tested = joint_terms(testing, prepared.design, fit.causes)[1]
        if not terms or not tested:
            continue
        _, amplitude = profile(terms, STEPS_OF_DATA)
        causes = np.array([number for number, _, _ in places])
        rows = sum(by[out].rows for by in prepared.moments.values() if out in by)
        folds.append(_fold(labels[out], tested, amplitude[0, 0], causes, len(fit.causes), rows))
    return HeldOut(tuple(folds), within)


def _fold(
    label: str, tested: Sequence[Terms], amplitude: FloatArray, causes: FloatArray, count: int, rows: int
) -> Fold:
    gain = _gain(tested, amplitude)
    by_cause = np.zeros(count)
    cause_signal = np.zeros(count)
    for number in range(count):
        without = np.where(causes == number, 0.0, amplitude)
        by_cause[number] = gain - _gain(tested, without)
        cause_signal[number] = _signal(tested, amplitude - without)
    own, _ = profile(tested, STEPS_OF_DATA)
    return Fold(
        label,
        gain,
        _signal(tested, amplitude),
        by_cause,
        cause_signal,
        float(own[0, 0]) - len(amplitude),
        rows,
    )


def _gain(terms: Sequence[Terms], amplitude: FloatArray) -> float:
    total = 0.0
    for term in terms:
        linear = amplitude @ term.cross[0, :, :, 0].T
        square = np.einsum("k,hkl,l->h", amplitude, term.gram[0], amplitude)
        weighted = term.log_weighted[:, 0]
        total += float(log_sum_exp(weighted + linear - 0.5 * square, 0) - log_sum_exp(weighted, 0))
    return 2.0 * total


def _signal(terms: Sequence[Terms], amplitude: FloatArray) -> float:
    return sum(
        float(amplitude @ np.tensordot(level_weights(term, amplitude), term.gram[0], 1) @ amplitude)
        for term in terms
    )


def _in_parts(prepared: Prepared, count: int) -> tuple[Prepared, dict[int, str]]:
    """Each channel's rows cut into contiguous stretches that count as recordings of one mount."""
    rng = np.random.default_rng(0)
    channels: dict[Channel, ChannelDesign] = {}
    statistics: dict[Channel, dict[int, RecordingMoments]] = {}
    noises: dict[Channel, ChannelNoise] = {}
    (recording,) = {i for by in prepared.moments.values() for i in by}
    one = prepared.observations[recording]
    for channel, design in prepared.design.channels.items():
        noise = prepared.noise[channel]
        use, matrix = design.rows[recording], design.matrices[recording]
        residual = one.outputs[channel.sensor].residual_si[use, channel.axis]
        time_s = one.stimulus.time_s[use]
        cuts = np.linspace(0, len(residual), count + 1).astype(np.int64)
        split = {k: slice(int(a), int(b)) for k, (a, b) in enumerate(itertools.pairwise(cuts)) if b - a > 8}
        shape = noise.knots[recording].shape
        knots = {k: knots_for(time_s[s], shape) for k, s in split.items()}
        white = dict.fromkeys(split, noise.white_si[recording])
        nothing = np.zeros(0)
        statistics[channel] = {
            k: moments(matrix[s], residual[s], knots[k], white[k], nothing, rng) for k, s in split.items()
        }
        channels[channel] = ChannelDesign(
            channel, {k: matrix[s] for k, s in split.items()}, {}, design.scales
        )
        noises[channel] = ChannelNoise(
            white, noise.belief, noise.log_white_ratio, noise.levels, knots, nothing, nothing
        )
    design = Design(prepared.design.trials, channels, prepared.design.blocks)
    labels = {k: f"{one.recording_id}, part {k + 1} of {count}" for k in range(count)}
    return Prepared((one,) * count, design, noises, statistics), labels


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap shrinks on held-out data, in units of the noise.

    Attributes:
        before, after: whitened rms of the residual, 1 is noise alone.
        fraction_closed: 1 − (after² − 1) / (before² − 1).
        interval_95: of the fraction, from a bootstrap over the held-out parts and their noise.
    """

    before: float
    after: float
    fraction_closed: float
    interval_95: tuple[float, float]


def shrinkage_of(held: HeldOut, unexplained: float) -> Shrinkage:
    """From the folds, and from what the set leaves unexplained over all rows (Q above its expectation).

    The gap before is what amplitudes of the part's own would gain, and what is left beside.
    """
    gain = np.array([fold.gain for fold in held.folds])
    best = np.array([fold.best_gain for fold in held.folds])
    rows = sum(fold.rows for fold in held.folds)
    left = max(unexplained, 0.0)

    def fraction(gained: FloatArray, reachable: FloatArray) -> float:
        whole = max(float(np.sum(np.maximum(reachable, gained))) + left, 1e-9)
        return float(np.sum(gained)) / whole

    rng = np.random.default_rng(0)
    signal = np.array([fold.signal for fold in held.folds])
    found: list[float] = []
    for _ in range(BOOTSTRAPS):
        pick = rng.integers(0, len(gain), len(gain)) if len(gain) > 1 else np.zeros(1, dtype=np.int64)
        shaken = gain[pick] + 2.0 * np.sqrt(np.maximum(signal[pick], 0.0)) * rng.standard_normal(len(pick))
        found.append(fraction(shaken, best[pick]))
    low, high = np.quantile(found, (0.025, 0.975))
    whole = float(np.sum(np.maximum(best, gain))) + left
    closed = fraction(gain, best)
    before, after = 1.0 + whole / rows, 1.0 + (whole - float(np.sum(gain))) / rows
    return Shrinkage(
        math.sqrt(max(before, 0.0)), math.sqrt(max(after, 0.0)), closed, (float(low), float(min(high, 1.0)))
    )

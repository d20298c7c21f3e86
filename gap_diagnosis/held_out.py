# pyright: strict
"""What a set of effects gains on data that it was not fitted to, and how far it closes the gap there.

Held out is a recording. With a single one, or where only one shows the effect, it is every second of
contiguous stretches of a run ('within run'). The nuisances are
recalibrated on the held-out part, as a user would do; the effects are not.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.design import ChannelDesign, Design
from gap_diagnosis.evidence import STEPS_OF_DATA, Terms, log_sum_exp, profile
from gap_diagnosis.fitting import JointFit, joint_terms, level_weights, systems_with
from gap_diagnosis.noise_model import Knots, knots_for
from gap_diagnosis.observation import Channel
from gap_diagnosis.prepared import ChannelNoise, Prepared
from gap_diagnosis.whitened import NullNoise, RecordingMoments, moments

STRETCHES = 24
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

    def sigmas(self, cause: int) -> float:
        """How clearly the held-out parts show an effect at the amplitudes of the others.

        Without the effect the gain 2 aᵀc − aᵀGa has the mean −aᵀGa and the deviation 2 √(aᵀGa).
        """
        signal = sum(float(fold.cause_signal[cause]) for fold in self.folds)
        gain = sum(float(fold.by_cause[cause]) for fold in self.folds)
        return (gain + signal) / (2.0 * math.sqrt(signal)) if signal > 0.0 else 0.0

    def gains(self, cause: int) -> bool:
        """Whether an effect gains more than chance: by more than two standard errors."""
        return self.sigmas(cause) > GAIN_SIGMAS


def hold_out(fit: JointFit, noisy: Mapping[Channel, tuple[int, ...]]) -> HeldOut:
    """Each recording against the others' amplitudes; stretches of one where only one shows an effect."""
    recordings = sorted({i for by in fit.prepared.moments.values() for i in by})
    if len(recordings) > 1:
        labels = {i: fit.prepared.observations[i].recording_id for i in recordings}
        held = HeldOut(_folds(fit, fit.prepared, labels, noisy), within_run=False)
        if all(held.gains(number) for number in range(len(fit.causes))):
            return held
    parted, labels = _in_stretches(fit.prepared)
    within = HeldOut(_folds(fit, parted, labels, noisy), within_run=True)
    return within


def _folds(
    fit: JointFit, prepared: Prepared, labels: Mapping[int, str], noisy: Mapping[Channel, tuple[int, ...]]
) -> tuple[Fold, ...]:
    groups: dict[str, list[int]] = {}
    for index, label in labels.items():
        groups.setdefault(label, []).append(index)
    folds: list[Fold] = []
    for label, out in groups.items():
        training = systems_with(prepared, noisy, [i for i in labels if i not in out])
        testing = systems_with(prepared, noisy, out)
        places, terms = joint_terms(training, prepared.design, fit.causes)
        tested = joint_terms(testing, prepared.design, fit.causes)[1]
        if not terms or not tested:
            continue
        _, amplitude = profile(terms, STEPS_OF_DATA)
        causes = np.array([number for number, _, _ in places])
        rows = sum(by[i].rows for by in prepared.moments.values() for i in out if i in by)
        folds.append(_fold(label, tested, amplitude[0, 0], causes, len(fit.causes), rows))
    return tuple(folds)


def _fold(
    label: str, tested: Sequence[Terms], amplitude: FloatArray, causes: FloatArray, count: int, rows: int
) -> Fold:
    gain = gain_at(tested, amplitude)
    by_cause = np.zeros(count)
    cause_signal = np.zeros(count)
    for number in range(count):
        without = np.where(causes == number, 0.0, amplitude)
        by_cause[number] = gain - gain_at(tested, without)
        cause_signal[number] = signal_at(tested, amplitude - without)
    own, _ = profile(tested, STEPS_OF_DATA)
    return Fold(
        label,
        gain,
        signal_at(tested, amplitude),
        by_cause,
        cause_signal,
        float(own[0, 0]) - len(amplitude),
        rows,
    )


def gain_at(terms: Sequence[Terms], amplitude: FloatArray) -> float:
    """2 ln of the likelihoods with these amplitudes and without."""
    total = 0.0
    for term in terms:
        linear = amplitude @ term.cross[0, :, :, 0].T
        square = np.einsum("k,hkl,l->h", amplitude, term.gram[0], amplitude)
        weighted = term.log_weighted[:, 0]
        total += float(log_sum_exp(weighted + linear - 0.5 * square, 0) - log_sum_exp(weighted, 0))
    return 2.0 * total


def signal_at(terms: Sequence[Terms], amplitude: FloatArray) -> float:
    """aᵀ G a, the square of the whitened signal-to-noise ratio."""
    return sum(
        float(amplitude @ np.tensordot(level_weights(term, amplitude), term.gram[0], 1) @ amplitude)
        for term in terms
    )


def _in_stretches(prepared: Prepared) -> tuple[Prepared, dict[int, str]]:
    """Every recording as two: its odd and its even stretches. Each has a bias of its own."""
    rng = np.random.default_rng(0)
    nothing = np.zeros(0)
    channels: dict[Channel, ChannelDesign] = {}
    statistics: dict[Channel, dict[int, RecordingMoments]] = {}
    noises: dict[Channel, ChannelNoise] = {}
    for channel, design in prepared.design.channels.items():
        noise = prepared.noise[channel]
        matrices: dict[int, FloatArray] = {}
        knots: dict[int, Knots] = {}
        white: dict[int, float] = {}
        statistics[channel] = {}
        for recording, matrix in design.matrices.items():
            one, use = prepared.observations[recording], design.rows[recording]
            residual = one.outputs[channel.sensor].residual_si[use, channel.axis]
            time_s = one.stimulus.time_s[use]
            stretch = np.arange(len(residual)) * STRETCHES // len(residual)
            for half in (0, 1):
                index, mine = 2 * recording + half, stretch % 2 == half
                matrices[index], white[index] = matrix[mine], noise.white_si[recording]
                knots[index] = knots_for(time_s[mine], noise.knots[recording].shapes)
                statistics[channel][index] = moments(
                    matrix[mine], residual[mine], knots[index], white[index], NullNoise(nothing), rng
                )
        channels[channel] = ChannelDesign(channel, matrices, {}, design.scales)
        noises[channel] = dataclasses.replace(
            noise, white_si=white, knots=knots, nulls=NullNoise(nothing), null_log_white_ratios=nothing
        )
    twice = tuple(one for one in prepared.observations for _ in range(2))
    labels = {index: say_half(index % 2) for by in statistics.values() for index in by}
    design = Design(prepared.design.trials, channels, prepared.design.blocks)
    return Prepared(twice, design, noises, statistics), labels


def say_half(half: int) -> str:
    """Name of a half in the report."""
    return ("odd stretches of each run", "even stretches of each run")[half]


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

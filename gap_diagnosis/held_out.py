# pyright: strict
"""What a set of effects gains on data that it was not fitted to, and how far it closes the gap there.

Held out is a recording. With a single one, or where only one shows the effect, it is every second of
contiguous stretches of a run ('within run'). Bias and matrix are recalibrated, as a user would do; the
effects are not.

Stretches of one run share its slow noise: what an effect explains of it in one half would be gained again
in the other. So a half counts given the other one,

    ln p(y₂ | y₁, a) = ln p(y₁, y₂ | a) − ln p(y₁ | a):    G₂|₁ = G − G₁,    c₂|₁ = c − c₁

at each level of the noise, and what that adds is independent of what `a` was fitted to.
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
from gap_diagnosis.noise_model import Knots
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
    """All parts, each held out once.

    Attributes:
        folds: one for each part.
        within_run: whether parts are stretches of the same runs.
        freedom: (causes,) amplitudes of each; empty where none was fitted.
    """

    folds: tuple[Fold, ...]
    within_run: bool
    freedom: tuple[int, ...] = ()

    def sigmas(self, cause: int) -> float:
        """How clearly the held-out parts show an effect at the amplitudes of the others.

        Without the effect the gain 2 aᵀc − aᵀGa has the mean −aᵀGa and the deviation 2 √(aᵀGa). Two parts
        that are held out in turn tell partly the same: with k amplitudes the variance of their sum is
        2k/(k + 1) times as large.
        """
        k = self.freedom[cause] if self.freedom else 1
        signal = sum(float(fold.cause_signal[cause]) for fold in self.folds)
        gain = sum(float(fold.by_cause[cause]) for fold in self.folds)
        return (gain + signal) / (2.0 * math.sqrt(signal * 2 * k / (k + 1))) if signal > 0.0 else 0.0

    def gains(self, cause: int) -> bool:
        """Whether an effect gains more than chance: by more than two standard errors."""
        return self.sigmas(cause) > GAIN_SIGMAS


def hold_out(fit: JointFit, noisy: Mapping[Channel, tuple[int, ...]]) -> HeldOut:
    """Each recording against the others' amplitudes; stretches of one where only one shows an effect."""
    recordings = sorted({i for by in fit.prepared.moments.values() for i in by})
    numbers = [number for number, _, _ in fit.places]
    freedom = tuple(max(numbers.count(number), 1) for number in range(len(fit.causes)))
    if len(recordings) > 1:
        labels = {i: fit.prepared.observations[i].recording_id for i in recordings}
        held = HeldOut(_folds(fit, fit.prepared, labels, noisy), within_run=False, freedom=freedom)
        if all(held.gains(number) for number in range(len(fit.causes))):
            return held
    parted, labels = _in_stretches(fit.prepared)
    whole = joint_terms(systems_with(fit.prepared, noisy), fit.prepared.design, fit.causes)[1]
    return HeldOut(_folds(fit, parted, labels, noisy, whole), within_run=True, freedom=freedom)


def _folds(
    fit: JointFit,
    prepared: Prepared,
    labels: Mapping[int, str],
    noisy: Mapping[Channel, tuple[int, ...]],
    whole: Sequence[Terms] | None = None,
) -> tuple[Fold, ...]:
    """`whole`: all parts together, where they are not independent."""
    groups: dict[str, list[int]] = {}
    for index, label in labels.items():
        groups.setdefault(label, []).append(index)
    folds: list[Fold] = []
    for label, out in groups.items():
        training = systems_with(prepared, noisy, [i for i in labels if i not in out])
        places, terms = joint_terms(training, prepared.design, fit.causes)
        if not terms:
            continue
        _, amplitude = profile(terms, STEPS_OF_DATA)
        if whole is None:
            tested = joint_terms(systems_with(prepared, noisy, out), prepared.design, fit.causes)[1]
        else:
            tested = _given(whole, terms, amplitude[0, 0])
        if not tested:
            continue
        causes = np.array([number for number, _, _ in places])
        rows = sum(by[i].rows for by in prepared.moments.values() for i in out if i in by)
        folds.append(_fold(label, tested, amplitude[0, 0], causes, len(fit.causes), rows))
    return tuple(folds)


def _given(whole: Sequence[Terms], known: Sequence[Terms], amplitude: FloatArray) -> list[Terms]:
    """What the rest of the rows says once some are known, the levels weighed as these say at `amplitude`."""
    return [
        Terms(
            every.gram - some.gram,
            every.cross - some.cross,
            every.log_weighted + _gain_of_levels(some, amplitude)[:, np.newaxis],
        )
        for every, some in zip(whole, known, strict=True)
    ]


def _gain_of_levels(term: Terms, amplitude: FloatArray) -> FloatArray:
    """(h,) ln of the likelihoods with these amplitudes and without, at each level."""
    linear = amplitude @ term.cross[0, :, :, 0].T
    return linear - 0.5 * np.einsum("k,hkl,l->h", amplitude, term.gram[0], amplitude)


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
        weighted = term.log_weighted[:, 0]
        gained = weighted + _gain_of_levels(term, amplitude)
        total += float(log_sum_exp(gained, 0) - log_sum_exp(weighted, 0))
    return 2.0 * total


def signal_at(terms: Sequence[Terms], amplitude: FloatArray) -> float:
    """aᵀ G a, the square of the whitened signal-to-noise ratio."""
    return sum(
        float(amplitude @ np.tensordot(level_weights(term, amplitude), term.gram[0], 1) @ amplitude)
        for term in terms
    )


def _in_stretches(prepared: Prepared) -> tuple[Prepared, dict[int, str]]:
    """Every recording as two: its odd and its even stretches, on the knots of the whole run."""
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
            stretch = np.arange(len(residual)) * STRETCHES // len(residual)
            for half in (0, 1):
                index, mine = 2 * recording + half, stretch % 2 == half
                matrices[index], white[index] = matrix[mine], noise.white_si[recording]
                run = noise.knots[recording]
                knots[index] = Knots(run.hats[mine], run.time_s, run.shapes)
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

    The gap before is what amplitudes of the part's own would gain, and what is left beside. What is missed,
    ‖W X (a − a₀)‖², is seen with the variance of a non-central chi square, 2k + 4 ‖·‖²; of the gain itself
    the noise is much larger, but common to what could be reached.
    """
    gain = np.array([fold.gain for fold in held.folds])
    best = np.array([fold.best_gain for fold in held.folds])
    rows = sum(fold.rows for fold in held.folds)
    left = max(unexplained, 0.0)

    rng = np.random.default_rng(0)
    count = len(held.folds)
    freedom = max(sum(held.freedom), 1)
    lost = best - gain
    pick = rng.integers(0, count, (BOOTSTRAPS, count))
    noise = rng.standard_normal((2, BOOTSTRAPS, count))
    reached = best[pick] + 2.0 * np.sqrt(np.maximum(best[pick], 0.0)) * noise[0]
    missed = lost[pick] + np.sqrt(2.0 * freedom + 4.0 * np.maximum(lost[pick], freedom)) * noise[1]
    missed = np.maximum(missed, 0.0).sum(axis=1)
    reachable = np.maximum(np.maximum(reached, 0.0).sum(axis=1), missed) + left
    found = 1.0 - (missed + left) / np.maximum(reachable, 1e-9)
    low, high = np.quantile(found, (0.025, 0.975))
    whole = float(np.sum(np.maximum(best, gain))) + left
    closed = float(np.sum(gain)) / max(whole, 1e-9)
    before, after = 1.0 + whole / rows, 1.0 + (whole - float(np.sum(gain))) / rows
    return Shrinkage(
        math.sqrt(max(before, 0.0)), math.sqrt(max(after, 0.0)), closed, (float(low), float(min(high, 1.0)))
    )

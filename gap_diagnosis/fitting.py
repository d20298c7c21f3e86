# pyright: strict
"""The parameters of a set of effects: shapes refined between grid points, amplitudes with covariance."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray
from dut_emulator.effects.parameters import scalars, with_values
from gap_diagnosis.candidates import Trial, is_curve, refined_trials
from gap_diagnosis.design import NUISANCES, Design
from gap_diagnosis.evidence import STEPS_OF_DATA, Terms, log_sum_exp, profile
from gap_diagnosis.observation import Channel, Observation
from gap_diagnosis.prepared import ChannelNoise, Prepared, prepare
from gap_diagnosis.search import Cause, beyond_belief
from gap_diagnosis.whitened import ChannelSystem

REFINING_FACTORS = (1.3, 1.3, 1.12, 1.12, 1.05, 1.02)
RELINEARISATIONS = 4
SMALLEST_STEP = 0.2
SETTLED = 1e-3


@dataclass(frozen=True)
class FittedScalar:
    """One parameter of one effect, in the effect's own unit."""

    name: str
    value: float
    standard_uncertainty: float
    unit: str


@dataclass(frozen=True)
class FittedEffect:
    """One effect of one triad with its parameters.

    Attributes:
        effect: with the fitted values, ready for a twin.
        name: in the catalogue.
        channels: that it changes.
        parameters: of the blocks that take part.
        signal: whitened signal-to-noise ratio d.
        rms_si: channel → rms of what it adds there, bias and matrix of the run taken off.
    """

    effect: CatalogueEffect
    name: str
    channels: tuple[Channel, ...]
    parameters: tuple[FittedScalar, ...]
    signal: float
    rms_si: Mapping[Channel, float]


@dataclass(frozen=True)
class JointFit:
    """A set of effects fitted together.

    Attributes:
        causes: with their blocks in `prepared.design`.
        prepared: columns of this set alone, at its refined shapes.
        amplitude: (k,) of the scaled columns.
        covariance: (k, k).
        places: of each scalar: (index of the cause, index of the block, number in the block).
        gain: Q of the whole set.
        effects: what it comes to.
    """

    causes: tuple[Cause, ...]
    prepared: Prepared
    amplitude: FloatArray
    covariance: FloatArray
    places: tuple[tuple[int, int, int], ...]
    gain: float
    effects: tuple[FittedEffect, ...]


def fit_set(
    observations: Sequence[Observation], prepared: Prepared, causes: Sequence[Cause]
) -> JointFit | None:
    """Refine the shapes in turn, then fit all amplitudes together. None: no effect with columns."""
    acting = [cause for cause in causes if cause.trial >= 0]
    if not acting:
        return None
    noisy = noisy_channels(causes)
    trials = [prepared.design.trials[cause.trial] for cause in acting]
    wanted = [frozenset(cause.channels) for cause in acting]
    current = _fitted(observations, trials, wanted, prepared.noise, noisy)
    for number in range(len(acting)):
        trials, current = _refined(observations, trials, wanted, prepared.noise, noisy, number, current)
    return current


def _refined(
    observations: Sequence[Observation],
    trials: list[Trial],
    wanted: Sequence[frozenset[Channel]],
    noise: Mapping[Channel, ChannelNoise],
    noisy: Mapping[Channel, tuple[int, ...]],
    number: int,
    current: JointFit,
) -> tuple[list[Trial], JointFit]:
    """One effect's held parameters by steps that shrink; or, where it is not linear, relinearised."""
    if is_curve(trials[number].effects[0]):
        for _ in range(RELINEARISATIONS):
            moved = _relinearised(trials[number], current)
            if moved is None:
                break
            trials = [*trials[:number], moved, *trials[number + 1 :]]
            before, current = current, _fitted(observations, trials, wanted, noise, noisy)
            if abs(current.gain - before.gain) < SETTLED * max(current.gain, 1.0):
                break
        return trials, current
    for factor in REFINING_FACTORS:
        for trial in refined_trials(trials[number], factor):
            tried = [*trials[:number], trial, *trials[number + 1 :]]
            fit = _fitted(observations, tried, wanted, noise, noisy)
            if fit.gain > current.gain:
                trials, current = tried, fit
    return trials, current


def _relinearised(trial: Trial, current: JointFit) -> Trial | None:
    """The trial at the value that the fit found, where that is inside its range."""
    effects: list[CatalogueEffect] = []
    for effect in trial.effects:
        found = [
            one.effect
            for one in current.effects
            if type(one.effect) is type(effect) and one.effect.sensor == effect.sensor
        ]
        if not found:
            effects.append(effect)
            continue
        (scalar,) = scalars(found[0], free_only=True)
        (before,) = scalars(effect, free_only=True)
        forward = scalar.value * before.value > (SMALLEST_STEP * before.value) ** 2
        value = scalar.value if forward else SMALLEST_STEP * before.value
        effects.append(with_values(effect, {scalar.name: value}))
    return Trial(trial.name, tuple(effects), trial.tied) if effects else None


def _fitted(
    observations: Sequence[Observation],
    trials: Sequence[Trial],
    wanted: Sequence[frozenset[Channel]],
    noise: Mapping[Channel, ChannelNoise],
    noisy: Mapping[Channel, tuple[int, ...]],
) -> JointFit:
    every = frozenset(channel for some in wanted for channel in some)
    prepared = prepare(
        observations, trials, 0, np.random.default_rng(0), cells=False, known_noise=noise, wanted=every
    )
    systems = systems_with(prepared, noisy)
    causes = [
        Cause(
            trial.name,
            number,
            tuple(
                i
                for i, block in enumerate(prepared.design.blocks)
                if block.trial == number and set(block.columns) <= wanted[number]
            ),
            tuple(sorted(wanted[number], key=lambda c: c.name)),
        )
        for number, trial in enumerate(trials)
    ]
    places, terms = joint_terms(systems, prepared.design, causes)
    gain, amplitude = profile(terms, STEPS_OF_DATA)
    covariance = np.asarray(
        np.linalg.pinv(_information(terms, amplitude[0, 0]), hermitian=True), dtype=np.float64
    )
    grams = grams_at(systems, prepared.design, causes, amplitude[0, 0])
    effects = _effects(prepared, grams, causes, places, amplitude[0, 0], covariance)
    return JointFit(
        tuple(causes), prepared, amplitude[0, 0], covariance, tuple(places), float(gain[0, 0]), effects
    )


def noisy_channels(causes: Sequence[Cause]) -> dict[Channel, tuple[int, ...]]:
    """Channels whose slow noise is a cause: channel → its shapes."""
    return {channel: cause.shapes for cause in causes if cause.trial < 0 for channel in cause.channels}


def systems_with(
    prepared: Prepared, noisy: Mapping[Channel, tuple[int, ...]], recordings: Sequence[int] | None = None
) -> dict[Channel, ChannelSystem]:
    """Systems in which the slow noise of some channels is beyond the belief."""
    return {
        channel: beyond_belief(system, noisy[channel]) if channel in noisy else system
        for channel, system in prepared.systems(recordings).items()
    }


def joint_terms(
    systems: Mapping[Channel, ChannelSystem], design: Design, causes: Sequence[Cause]
) -> tuple[list[tuple[int, int, int]], list[Terms]]:
    """All scalars of all causes side by side, as one block: where each comes from, one term a channel."""
    places = [
        (number, block, k)
        for number, cause in enumerate(causes)
        for block in cause.blocks
        for k in range(len(design.blocks[block].scalars))
    ]
    terms: list[Terms] = []
    for channel, system in systems.items():
        index = np.array(
            [
                int(columns[k]) if (columns := design.blocks[block].columns.get(channel)) is not None else -1
                for _, block, k in places
            ]
        )
        if not len(index) or (index < 0).all():
            continue
        use = slice(0, system.believed)
        place, there = np.where(index < 0, 0, index - NUISANCES), index >= 0
        gram = system.gram[use][:, place][:, :, place] * (there[:, np.newaxis] & there)
        cross = system.cross[use, :, 0:1][:, place] * there[:, np.newaxis]
        log_weighted = system.log_likelihood[use, 0:1] + system.log_weight[use, np.newaxis]
        terms.append(Terms(gram[np.newaxis], cross[np.newaxis], log_weighted))
    return places, terms


def _information(terms: Sequence[Terms], amplitude: FloatArray) -> FloatArray:
    total = np.zeros((len(amplitude), len(amplitude)))
    for term in terms:
        total = total + np.asarray(
            np.tensordot(level_weights(term, amplitude), term.gram[0], 1), dtype=np.float64
        )
    return total


def level_weights(term: Terms, amplitude: FloatArray) -> FloatArray:
    """(h,) probability of each level, given the amplitudes."""
    gained = term.cross[0, :, :, 0] @ amplitude - 0.5 * (term.gram[0] @ amplitude) @ amplitude
    score = term.log_weighted[:, 0] + gained
    weight = np.exp(score - score.max())
    return weight / weight.sum()


def grams_at(
    systems: Mapping[Channel, ChannelSystem], design: Design, causes: Sequence[Cause], amplitude: FloatArray
) -> dict[Channel, FloatArray]:
    """Channel → (p, p) XᵀC⁻¹X, the levels of its noise weighed as they are likely once the causes act.

    amplitude (k,): of the causes' scalars, in the order of `joint_terms`.
    """
    found: dict[Channel, FloatArray] = {}
    for channel, system in systems.items():
        use = slice(0, system.believed)
        terms = joint_terms({channel: system}, design, causes)[1]
        if terms:
            weight = level_weights(terms[0], amplitude)
        else:
            score = system.log_likelihood[use, 0] + system.log_weight[use]
            weight = np.exp(score - log_sum_exp(score, 0))
        found[channel] = np.asarray(np.tensordot(weight, system.gram[use], 1), dtype=np.float64)
    return found


def _effects(
    prepared: Prepared,
    grams: Mapping[Channel, FloatArray],
    causes: Sequence[Cause],
    places: Sequence[tuple[int, int, int]],
    amplitude: FloatArray,
    covariance: FloatArray,
) -> tuple[FittedEffect, ...]:
    """One for each triad that a cause acts on."""
    design = prepared.design
    found: list[FittedEffect] = []
    for number in range(len(causes)):
        for effect in design.trials[number].effects:
            mine = [
                i
                for i, (n, block, _) in enumerate(places)
                if n == number and effect in design.blocks[block].effects
            ]
            if not mine:
                continue
            found.append(_effect(prepared, grams, effect, mine, places, amplitude, covariance))
    return tuple(found)


def _effect(
    prepared: Prepared,
    grams: Mapping[Channel, FloatArray],
    effect: CatalogueEffect,
    mine: Sequence[int],
    places: Sequence[tuple[int, int, int]],
    amplitude: FloatArray,
    covariance: FloatArray,
) -> FittedEffect:
    design = prepared.design
    units = {scalar.name: scalar for scalar in scalars(effect)}
    parameters: list[FittedScalar] = []
    parts: dict[Channel, list[tuple[int, float]]] = {}
    for i in mine:
        _, block, k = places[i]
        name = design.blocks[block].scalars[k]
        for channel, columns in design.blocks[block].columns.items():
            if columns[k] >= 0 and channel.sensor == effect.sensor:
                parts.setdefault(channel, []).append((int(columns[k]), float(amplitude[i])))
        channel = next(c for c, columns in design.blocks[block].columns.items() if columns[k] >= 0)
        scale = design.channels[channel].scales[int(design.blocks[block].columns[channel][k])]
        value, u = (
            float(amplitude[i]) / float(scale),
            math.sqrt(max(float(covariance[i, i]), 0.0)) / float(scale),
        )
        parameters.append(FittedScalar(name, value, u, units[name].unit))
    kept = {one.name: min(max(one.value, units[one.name].low), units[one.name].high) for one in parameters}
    signal = 0.0
    rms: dict[Channel, float] = {}
    for channel, own in parts.items():
        index = np.array([column for column, _ in own])
        a = np.array([value for _, value in own])
        gram = grams[channel][np.ix_(index - NUISANCES, index - NUISANCES)]
        signal += float(a @ gram @ a)
        rms[channel] = rms_added(prepared, channel, index, a)
    name = design.trials[places[mine[0]][0]].name
    return FittedEffect(
        with_values(effect, kept), name, tuple(parts), tuple(parameters), math.sqrt(max(signal, 0.0)), rms
    )


def rms_added(prepared: Prepared, channel: Channel, index: NDArray[np.int64], amplitude: FloatArray) -> float:
    """Of what columns add to a channel over all recordings, bias and matrix of each taken off, SI."""
    square, count = 0.0, 0
    for matrix in prepared.design.channels[channel].matrices.values():
        added = matrix[:, index] @ amplitude
        nuisances = matrix[:, :NUISANCES]
        gram = nuisances.T @ nuisances
        gram[np.diag_indices_from(gram)] += 1e-9 * (1.0 + np.diag(gram))
        left = added - nuisances @ np.linalg.solve(gram, nuisances.T @ added)
        square += float(left @ left)
        count += len(left)
    return math.sqrt(square / max(count, 1))

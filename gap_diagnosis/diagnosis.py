# pyright: strict
"""The diagnosis: where the gap lies, which effect causes it, how far it shrinks once that is added.

observe      recordings to SI, timing first
prepare      columns of all trials, noise, statistics, simulated nulls
localise     is there a gap, and where
search       singles, pairs, triples
fit_set      shapes and amplitudes of the best set
hold_out     its gain on recordings that it was not fitted to
remainder    what it leaves: if that is not noise, the diagnosis abstains
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gap_diagnosis.attribution import Attribution, attribute
from gap_diagnosis.candidates import Trial, has_shape, trials_for
from gap_diagnosis.decimation import decimated
from gap_diagnosis.direct_findings import certain_findings, oddities_of
from gap_diagnosis.enough_rows import with_enough_rows
from gap_diagnosis.findings import Findings
from gap_diagnosis.fitting import JointFit, fit_set, noisy_channels
from gap_diagnosis.held_out import HeldOut, hold_out
from gap_diagnosis.jumps import Jump, jumps_of_noise
from gap_diagnosis.localisation import Localisation, localise
from gap_diagnosis.norm_trials import norm_trials, without_the_untold
from gap_diagnosis.observation import Channel, Observation
from gap_diagnosis.outcome import report_of
from gap_diagnosis.prepared import ChannelNoise, Prepared, prepare
from gap_diagnosis.proposal import with_next_test
from gap_diagnosis.reference_noise import claimable, delays_beside, reference_noted
from gap_diagnosis.report import GapReport
from gap_diagnosis.rivals import Rival, rivals_of_noise
from gap_diagnosis.search import Cause, Scan, Search, SlowExcess, beyond_belief, projected, scan, search
from gap_diagnosis.spectral_lines import lines_taken_off
from gap_diagnosis.switched_field import switched_trials
from gap_diagnosis.together import check_together
from gap_diagnosis.unknown_drift import drift_noted, without_drifts
from gap_diagnosis.unknown_heading import with_headings
from gap_diagnosis.unlisted import UNLISTED, unlisted_trials
from gap_diagnosis.visible import visible_only
from gap_diagnosis.whitened import ChannelSystem, NullNoise
from gap_diagnosis.without_stand import observed_together
from protocol.errors import Fault, TestloomError
from protocol.recordings import Recording

NULLS = 200
SEED = 20260101
"""Of the simulated nulls: the same recordings give the same report."""
NOISES = {
    "gyro.bias_instability": (0, 2),
    "gyro.rate_random_walk": (1,),
    "acc.bias_instability": (0, 1, 2),
    "mag.bias_instability": (0, 1, 2),
}
"""Slow noise of the catalogue → shapes of `noise_model.shapes_for` that it may have."""
SHARPENINGS = 2
SHARP_SIGNAL = 7.0
"""From this whitened signal-to-noise ratio on, a shape between two of the grid's is searched with."""
Progress = Callable[[str, float], None]


def _silent(_step: str, _share: float) -> None:
    return None


def diagnose(
    recordings: Sequence[Recording],
    *,
    without: frozenset[str] | set[str] = frozenset(),
    nulls: int = NULLS,
    progress: Progress = _silent,
) -> GapReport:
    """Diagnose recordings of one unit together.

    Args:
        recordings: of one unit; several profiles, runs and mounts are better than one.
        without: names of effects that are not to be offered.
        nulls: simulated; a p below 1 / (nulls + 1) is a fitted tail.
        progress: told the step and the share that is done.

    Raises:
        TestloomError: recordings that cannot carry a diagnosis.
    """
    if not recordings:
        raise TestloomError(
            "There is no recording to diagnose.",
            where="gap diagnosis",
            fault=Fault.OPERATOR,
            remedy="name at least one recording.",
        )
    check_together(recordings)
    observed, by_norm = observed_together(recordings, lambda share: progress("reading", 0.2 * share))
    observations = [with_enough_rows(decimated(one)) for one in lines_taken_off(observed)]
    observations = [reference_noted(drift_noted(one)) for one in observations]
    observations += [with_enough_rows(one) for one in by_norm]
    return diagnose_observations(observations, frozenset(without), nulls, progress)


def diagnose_observations(
    observations: Sequence[Observation],
    without: frozenset[str],
    nulls: int,
    progress: Progress = _silent,
) -> GapReport:
    """The same, from observations."""
    rng = np.random.Generator(np.random.PCG64(SEED))
    progress("columns", 0.2)
    trials, beside_reference = _offered(observations, without)
    prepared = visible_only(prepare(observations, trials, nulls, rng, keep_columns=False))
    if not prepared.moments:
        raise TestloomError(
            "No channel has samples beside a prediction.",
            where=", ".join(one.recording_id for one in observations),
            fault=Fault.DATA,
            remedy="record the stand's stream beside the unit's, or what the unit saw at rest.",
        )
    progress("where", 0.5)
    systems = prepared.systems()
    scanned = scan(systems, prepared.design, data_only=False)
    located = localise(prepared, systems, scanned)
    prepared.forget_nulls_and_cells()
    systems = prepared.systems()
    progress("which", 0.6)
    noises = [] if beside_reference else _noises(systems, without)
    searched, systems, found = _searched(observations, prepared, systems, noises, rng)
    best = next((one for one in found.sets if one.causes and UNLISTED not in one.names), None)
    fit = held = None
    left: Remainder | None = None
    if best is not None:
        progress("how large", 0.7)
        fit = fit_set(observations, searched, best.causes)
        noisy = noisy_channels(best.causes)
        if fit is not None:
            progress("held out", 0.8)
            held = hold_out(fit, noisy)
        if not beside_reference:  # else what is left is the reference's
            progress("what is left", 0.9)
            left = remainder(observations, prepared, fit, best.causes, nulls, rng)
    attribution = attribute(found, systems, searched.design, fit)
    timing = (*certain_findings(observations, without), *delays_beside(observations, without))
    progress("report", 0.95)
    findings = Findings(
        prepared,
        located,
        found,
        attribution,
        fit,
        held,
        left.located if left else None,
        timing,
        without,
        rivals=left.rivals if left else (),
        jumps=left.jumps if left else (),
        oddities=oddities_of(observations, without),
    )
    return with_next_test(report_of(findings), observations, searched, found, attribution)


def _offered(observations: Sequence[Observation], without: frozenset[str]) -> tuple[list[Trial], bool]:
    """What is searched among; whether the stand is a reference beside which little can be claimed."""
    listed = with_headings(trials_for(observations, without), observations)
    offered = [*listed, *switched_trials(observations, without)]
    offered = without_drifts(offered, observations)
    offered = [*without_the_untold(offered, observations), *norm_trials(observations, without)]
    trials = claimable(offered, observations)
    beside_reference = len(trials) < len(offered)
    if not beside_reference:  # else what it does not tell would look like something unlisted
        trials += unlisted_trials(observations)
    return trials, beside_reference


def _searched(
    observations: Sequence[Observation],
    prepared: Prepared,
    systems: dict[Channel, ChannelSystem],
    noises: Sequence[SlowExcess],
    rng: np.random.Generator,
) -> tuple[Prepared, dict[Channel, ChannelSystem], Search]:
    """The search, again with shapes between those of the grid where the best set has clear ones."""
    searched = prepared
    found = search(systems, prepared.design, noises)
    for _ in range(SHARPENINGS):
        sharper = _sharper_trials(observations, searched, found)
        if not sharper:
            break
        every = [*searched.design.trials, *sharper]
        searched = visible_only(
            prepare(observations, every, 0, rng, cells=False, known_noise=prepared.noise, keep_columns=False)
        )
        systems = searched.systems()
        found = search(systems, searched.design, noises)
    return searched, systems, found


def _sharper_trials(observations: Sequence[Observation], searched: Prepared, found: Search) -> list[Trial]:
    """The shapes of the best set where they lie between the grid's, for effects that are clear enough."""
    best = next(one for one in found.sets if UNLISTED not in one.names)
    shaped = [
        cause for cause in best.causes if cause.trial >= 0 and has_shape(searched.design.trials[cause.trial])
    ]
    if not shaped:
        return []
    fit = fit_set(observations, searched, best.causes)
    if fit is None:
        return []
    clear = {one.name for one in fit.effects if one.signal > SHARP_SIGNAL}
    known = set(searched.design.trials)
    return [
        trial
        for trial in fit.prepared.design.trials
        if trial.name in clear and has_shape(trial) and trial not in known
    ]


def _noises(systems: Mapping[Channel, ChannelSystem], without: frozenset[str]) -> list[SlowExcess]:
    """Slow noises of the catalogue on the triads that have a belief to go beyond."""
    found: list[SlowExcess] = []
    for name, shapes in NOISES.items():
        sensor = name.split(".")[0]
        channels = frozenset(
            c for c, one in systems.items() if c.sensor == sensor and one.believed < len(one.log_weight)
        )
        if channels and name not in without:
            found.append(SlowExcess(name, channels, shapes))
    return found


@dataclass(frozen=True)
class Remainder:
    """What the best set leaves: a localisation with the set's own columns taken out; rivals and jumps of what
    passes for slow noise."""

    located: Localisation
    rivals: tuple[Rival, ...]
    jumps: tuple[Jump, ...]


def remainder(
    observations: Sequence[Observation],
    prepared: Prepared,
    fit: JointFit | None,
    causes: Sequence[Cause],
    nulls: int,
    rng: np.random.Generator,
) -> Remainder:
    """Cells and noise again, data and nulls alike without the set's refined columns."""
    trials: list[Trial] = [] if fit is None else list(fit.prepared.design.trials)
    systems = prepared.systems()
    columns = {} if fit is None else {c: one.matrices for c, one in fit.prepared.design.channels.items()}
    jumps = jumps_of_noise(prepared, systems, causes, columns)
    noise = dict(prepared.noise)
    for channel, shapes in noisy_channels(causes).items():
        noise[channel] = _as_noisy(noise[channel], beyond_belief(systems[channel], shapes), rng)
    again = prepare(observations, trials, nulls, rng, known_noise=noise, keep_columns=False)
    systems = again.systems()
    for number, cause in enumerate(fit.causes if fit is not None else ()):
        blocks = tuple(
            i
            for i, block in enumerate(again.design.blocks)
            if block.trial == number and set(block.columns) <= set(cause.channels)
        )
        systems = projected(systems, again.design, dataclasses.replace(cause, trial=number, blocks=blocks))
    rivals = rivals_of_noise(systems, again.design, causes)
    for cause in causes:
        if cause.trial < 0:
            systems = projected(systems, again.design, cause)
    nothing = Scan({"": np.zeros(nulls + 1)}, np.zeros((0, nulls + 1)), {})
    return Remainder(localise(again, systems, nothing, white=False), tuple(rivals), tuple(jumps))


def _as_noisy(noise: ChannelNoise, beyond: ChannelSystem, rng: np.random.Generator) -> ChannelNoise:
    """The channel with nulls as noisy as the data are likely to be; `beyond`: levels above the belief."""
    score = beyond.log_likelihood[:, 0]
    shape = int(beyond.shape[int(np.argmax(score))])
    weight = np.where(beyond.shape == shape, np.exp(score - score.max()), 0.0)
    numbers = np.flatnonzero(np.arange(len(noise.levels)) >= noise.levels.believed)
    numbers = numbers[np.isin(noise.levels.shape[numbers], beyond.shape)]
    drawn = rng.choice(
        noise.levels.level_si[numbers], size=len(noise.nulls.level_si), p=weight / weight.sum()
    )
    return dataclasses.replace(noise, nulls=NullNoise(drawn, shape))


__all__ = ["Attribution", "Channel", "HeldOut", "Search", "diagnose", "diagnose_observations"]

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gap_diagnosis.attribution import Attribution, attribute
from gap_diagnosis.candidates import Trial, trials_for
from gap_diagnosis.decimation import decimated
from gap_diagnosis.fitting import JointFit, fit_set
from gap_diagnosis.held_out import HeldOut, hold_out
from gap_diagnosis.localisation import Localisation, localise
from gap_diagnosis.observation import Channel, Observation, TimingFinding
from gap_diagnosis.observing import observe
from gap_diagnosis.outcome import Findings, report_of
from gap_diagnosis.prepared import Prepared, prepare
from gap_diagnosis.report import GapReport
from gap_diagnosis.search import Cause, Scan, Search, SlowExcess, projected, scan, search
from protocol.errors import Fault, TestloomError
from protocol.recordings import Recording

NULLS = 200
SEED = 20260101
"""Of the simulated nulls: the same recordings give the same report."""
NOISE_NAMES = {"gyro": "gyro.bias_instability", "acc": "acc.bias_instability", "mag": "mag.bias_instability"}
CERTAIN_LOG_RATIO = 12.0
"""A timing finding counts from this log likelihood ratio on."""
SEEN_BY_TIMING = frozenset(
    {"link.timestamp_jitter", "link.frame_loss", "link.duplicate_frames", "link.counter_wrap"}
)

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
    observations: list[Observation] = []
    for number, recording in enumerate(recordings):
        progress("reading", 0.2 * number / len(recordings))
        observations.append(decimated(observe(recording)))
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
    trials = trials_for(observations, without)
    prepared = prepare(observations, trials, nulls, rng)
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
    progress("which", 0.6)
    noises = [
        SlowExcess(name, {channel: 0.0 for channel in systems if channel.sensor == sensor})
        for sensor, name in NOISE_NAMES.items()
        if name not in without and any(channel.sensor == sensor for channel in systems)
    ]
    found = search(systems, prepared.design, noises)
    best = next((one for one in found.sets if one.causes), None)
    fit = held = None
    left: Remainder | None = None
    if best is not None:
        progress("how large", 0.7)
        fit = fit_set(observations, prepared, best.causes)
        noisy = frozenset(c for cause in best.causes if cause.trial < 0 for c in cause.channels)
        if fit is not None:
            progress("held out", 0.8)
            held = hold_out(fit, noisy)
        progress("what is left", 0.9)
        left = remainder(observations, prepared, fit, best.causes, nulls, rng)
    attribution = attribute(found, systems, prepared.design, fit)
    timing = _certain(observations, without)
    progress("report", 0.95)
    return report_of(
        Findings(prepared, located, found, attribution, fit, held, left.located if left else None, timing)
    )


def _certain(observations: Sequence[Observation], without: frozenset[str]) -> tuple[TimingFinding, ...]:
    """The clearest finding of each kind among the recordings."""
    best: dict[str, TimingFinding] = {}
    for one in observations:
        for finding in one.timing:
            if finding.effect not in SEEN_BY_TIMING or finding.effect in without:
                continue
            known = best.get(finding.effect)
            if finding.log_likelihood_ratio > CERTAIN_LOG_RATIO and (
                known is None or finding.log_likelihood_ratio > known.log_likelihood_ratio
            ):
                best[finding.effect] = finding
    return tuple(best.values())


@dataclass(frozen=True)
class Remainder:
    """What the best set leaves: a localisation with the set's own columns taken out."""

    located: Localisation


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
    again = prepare(observations, trials, nulls, rng, known_noise=prepared.noise)
    systems = again.systems()
    for number, cause in enumerate(fit.causes if fit is not None else ()):
        blocks = tuple(
            i
            for i, block in enumerate(again.design.blocks)
            if block.trial == number and set(block.columns) <= set(cause.channels)
        )
        systems = projected(systems, again.design, dataclasses.replace(cause, trial=number, blocks=blocks))
    for cause in causes:
        if cause.trial < 0:
            systems = projected(systems, again.design, cause)
    nothing = Scan({"": np.zeros(nulls + 1)}, np.zeros((0, nulls + 1)), {})
    return Remainder(localise(again, systems, nothing))


__all__ = ["Attribution", "Channel", "HeldOut", "Search", "diagnose", "diagnose_observations"]

# pyright: strict
"""What the samples of several recordings show by themselves: which of it counts, and what has no name.

An effect that is not to be offered is still seen; it then is what the catalogue has not.
"""

import math
from collections.abc import Mapping, Sequence

from gap_diagnosis.line_search import LEAST_LOG_RATIO
from gap_diagnosis.observation import Observation, Oddity, TimingFinding

CERTAIN_LOG_RATIO = 12.0
SEEN_DIRECTLY: Mapping[str, float] = {
    "link.timestamp_jitter": CERTAIN_LOG_RATIO,
    "link.frame_loss": CERTAIN_LOG_RATIO,
    "link.duplicate_frames": CERTAIN_LOG_RATIO,
    "link.counter_wrap": CERTAIN_LOG_RATIO,
    "gyro.quantization": CERTAIN_LOG_RATIO,
    "acc.quantization": CERTAIN_LOG_RATIO,
    "mag.quantization": CERTAIN_LOG_RATIO,
    "gyro.saturation": CERTAIN_LOG_RATIO,
    "acc.saturation": CERTAIN_LOG_RATIO,
    "mag.saturation": CERTAIN_LOG_RATIO,
    "link.aliasing": LEAST_LOG_RATIO,  # family-wise already
    "mag.mains_interference": LEAST_LOG_RATIO,
}
"""What needs no search, with the log likelihood ratio from which on it counts."""


def certain_findings(
    observations: Sequence[Observation], without: frozenset[str]
) -> tuple[TimingFinding, ...]:
    """The clearest finding of each kind among the recordings."""
    best: dict[str, TimingFinding] = {}
    for one in observations:
        for finding in one.timing:
            if finding.effect in without or not _counts(finding):
                continue
            known = best.get(finding.effect)
            if known is None or finding.log_likelihood_ratio > known.log_likelihood_ratio:
                best[finding.effect] = finding
    return tuple(best.values())


def oddities_of(observations: Sequence[Observation], without: frozenset[str]) -> tuple[Oddity, ...]:
    """What the catalogue has not, or must not be offered: of each channel the clearest, in that order."""
    found = [oddity for one in observations for oddity in one.oddities]
    for one in observations:
        found += [
            _without_name(finding) for finding in one.timing if finding.effect in without and _counts(finding)
        ]
    by_channel: dict[tuple[str, bool], Oddity] = {}
    for one in sorted(found, key=lambda one: one.p):
        by_channel.setdefault((one.channel, one.is_certain), one)
    return tuple(by_channel.values())


def _counts(finding: TimingFinding) -> bool:
    return finding.log_likelihood_ratio > SEEN_DIRECTLY.get(finding.effect, math.inf)


def _without_name(finding: TimingFinding) -> Oddity:
    channel = finding.channels[0] if finding.channels else f"{(*finding.sensors, 'gyro')[0]}_x"
    p = math.exp(-min(finding.log_likelihood_ratio, 600.0))
    return Oddity(finding.description.rstrip("."), channel, p)

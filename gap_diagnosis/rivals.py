# pyright: strict
"""Rivals of the catalogue: a gap that simply follows a variable, whatever its curve.

Slow noise explains everything a little. Where the cells of one variable, common to all runs, explain a
channel better than more noise does, the cause is not noise but something that nobody has listed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gap_diagnosis.design import NUISANCES, CellGroup, Design
from gap_diagnosis.evidence import STEPS_OF_DATA, Terms, log_bayes_factor, profile
from gap_diagnosis.observation import Channel
from gap_diagnosis.search import Cause, excess_of
from gap_diagnosis.whitened import ChannelSystem

CLEARLY = 3.0
"""ln B by which a rival must be ahead."""


@dataclass(frozen=True)
class Rival:
    """A variable that a channel follows better than noise explains it."""

    channel: Channel
    variable: str
    log_bayes_factor: float
    of_noise: float


def rivals_of_noise(
    systems: Mapping[Channel, ChannelSystem], design: Design, causes: Sequence[Cause]
) -> list[Rival]:
    """Of each noise among the causes; `systems`: the others' columns taken out, noise as believed."""
    found: list[Rival] = []
    for cause in causes:
        for channel in cause.channels if cause.trial < 0 else ():
            system = systems[channel]
            of_noise = excess_of(system, cause.shapes)
            for group in design.cells:
                if group.channel == channel:
                    evidence = _log_bayes_factor(group, system)
                    if evidence > of_noise + CLEARLY:
                        found.append(Rival(channel, group.regime.variable, evidence, of_noise))
    return sorted(found, key=lambda rival: -rival.log_bayes_factor)


def _log_bayes_factor(group: CellGroup, system: ChannelSystem) -> float:
    use = slice(0, system.believed)
    place = group.columns[:-1] - NUISANCES
    terms = Terms(
        system.gram[use][:, place][:, :, place][np.newaxis],
        system.cross[use][:, place, :1][np.newaxis],
        system.log_likelihood[use, :1] + system.log_weight[use, np.newaxis],
    )
    gain, _ = profile([terms], STEPS_OF_DATA)
    return float(log_bayes_factor(gain[0], len(place))[0])

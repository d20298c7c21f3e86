# pyright: strict
"""Effects that follow the time since power-on alone, where nothing is believed of slow noise.

A bias of a MEMS gyro wanders by 0.02 °/s in ten minutes without any cause but noise. Whoever states no slow
noise has not said that there is none, and a record of one power-on cannot tell: temperature and time go
together, and in a test by hand so does the order of the poses. A drift then is left without a name.
"""

import dataclasses
from collections.abc import Sequence

from gap_diagnosis.candidates import Trial
from gap_diagnosis.observation import Observation, SetAside
from gap_diagnosis.reference_noise import is_reference

WORDS = ("warm_up",)
SAID = "nothing is believed of its slow noise, so a drift is not told from warm-up and none is claimed"


def without_drifts(trials: Sequence[Trial], observations: Sequence[Observation]) -> list[Trial]:
    """The trials without such effects on triads of which no slow noise is believed."""
    silent = {sensor for one in observations for sensor in wandering(one)}
    return [
        trial
        for trial in trials
        if trial.effects[0].word not in WORDS or not any(one.sensor in silent for one in trial.effects)
    ]


def drift_noted(observation: Observation) -> Observation:
    """The observation, with a word on that among what is not used."""
    if is_reference(observation):  # beside which nothing of that kind is claimed
        return observation
    notes = (SetAside(sensor, 0, SAID) for sensor in wandering(observation) if sensor in ("gyro", "acc"))
    return dataclasses.replace(observation, set_aside=(*observation.set_aside, *notes))


def wandering(one: Observation) -> list[str]:
    """Triads of which no slow noise is believed."""
    return [
        sensor
        for sensor, output in one.outputs.items()
        if output.noise.slow_deviation_si is None and output.noise.slow_coefficient_si is None
    ]

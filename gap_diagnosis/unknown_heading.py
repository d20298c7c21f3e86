# pyright: strict
# ruff: noqa: ARG002  one signature for every effect
"""The Earth's rate where nobody stated how the stand is headed: a candidate for each of some headings."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import EffectState, FloatArray, Stimulus
from dut_emulator.effects.stand_surroundings import EarthRate
from gap_diagnosis.candidates import Trial
from gap_diagnosis.observation import Observation

HEADINGS = 12


@dataclass(frozen=True)
class TurnedEarthRate(EarthRate):
    """The Earth's rate of a stand whose y axis points `heading_rad` further east of north than was taken."""

    heading_rad: float = 0.0

    def regressors(
        self, samples: FloatArray, stimulus: Stimulus, state: EffectState
    ) -> dict[str, FloatArray]:
        """See `LinearEffect.regressors`."""
        rate = stimulus.triad("earth_rate_rad_s")
        (sine_m, cosine_m), (sine_i, cosine_i) = stimulus.angle_waves(1), stimulus.angle_waves(2)
        up = np.stack([-sine_m, cosine_m * sine_i, cosine_m * cosine_i], axis=1)  # see `gimbal_geometry`
        upward = np.sum(rate * up, axis=1, keepdims=True) * up
        level = rate - upward
        turned = math.cos(self.heading_rad) * level + math.sin(self.heading_rad) * np.cross(up, level)
        return {"share": upward + turned}


def with_headings(trials: Sequence[Trial], observations: Sequence[Observation]) -> list[Trial]:
    """The trials; that of the Earth's rate for each heading where the site states none and a table turned."""
    stated = all("heading_deg" in one.site for one in observations)
    turned = all(
        one.stimulus.angles_rad is not None and one.stimulus.earth_rate_rad_s is not None
        for one in observations
    )
    if stated or not turned:
        return list(trials)
    found: list[Trial] = []
    for trial in trials:
        if trial.name != "stand.earth_rate":
            found.append(trial)
            continue
        for number in range(HEADINGS):
            heading = 2.0 * math.pi * number / HEADINGS
            found.append(dataclasses.replace(trial, effects=(TurnedEarthRate("gyro", heading_rad=heading),)))
    return found

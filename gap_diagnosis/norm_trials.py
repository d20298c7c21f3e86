# pyright: strict
"""The constants of a triad as effects that a norm can tell, and only those.

A norm is blind to a rotation, so a matrix has six elements to tell, on and below its diagonal; a common
factor goes with the unknown strength, so one element of the diagonal stays as believed. With a stand's
report these constants are recalibrated for at every mount and are no gap; without one nothing else
calibrates them.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dut_emulator.effects.catalogue_effect import CatalogueEffect, LinearEffect
from dut_emulator.effects.deterministic import Bias, Misalignment, ScaleFactorError
from dut_emulator.effects.effect import FloatArray, SensorName, Stimulus
from dut_emulator.effects.fields_and_tones import HardIron, SoftIron
from gap_diagnosis.candidates import Trial
from gap_diagnosis.observation import AXES, NormView, Observation


@dataclass(frozen=True)
class _Told(LinearEffect):
    """An effect with a basis of some of its scalars alone."""

    told: tuple[str, ...] = ()

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """Free scalar that a norm tells → (n, 3)."""
        return {name: column for name, column in super().basis(stimulus).items() if name in self.told}


@dataclass(frozen=True)
class ToldScaleFactor(_Told, ScaleFactorError):
    """Scale factor errors against that of one axis."""


@dataclass(frozen=True)
class ToldMisalignment(_Told, Misalignment):
    """Non-orthogonality, written as angles below the diagonal: the x axis, and y in the plane of x and y."""


@dataclass(frozen=True)
class ToldSoftIron(_Told, SoftIron):
    """Soft iron and scale factors against that of one axis; the lower triangle."""


def norm_trials(observations: Sequence[Observation], without: frozenset[str]) -> list[Trial]:
    """The constants of each triad that is seen by its norm."""
    found: list[Trial] = []
    for sensor, view in seen_by_norm(observations).items():
        free = [f"{AXES[i]}{AXES[j]}" for i, j in view.free]
        on = tuple(name for name in free if name[0] == name[1])
        off = tuple(name for name in free if name[0] != name[1])
        if sensor == "mag":
            effects: list[tuple[str, CatalogueEffect]] = [
                ("mag.hard_iron", HardIron("mag")),
                ("mag.soft_iron", ToldSoftIron("mag", told=tuple(f"matrix_{name}" for name in (*on, *off)))),
            ]
        else:
            scales = tuple(f"scale_factor_error_{name[0]}" for name in on)
            effects = [
                ("acc.bias", Bias("acc")),
                ("acc.scale_factor_error", ToldScaleFactor("acc", told=scales)),
            ]
            if off:
                angles = tuple(f"misalignment_rad_{name}" for name in off)
                effects.append(("acc.misalignment", ToldMisalignment("acc", told=angles)))
        found += [Trial(name, (effect,)) for name, effect in effects if name not in without]
    return found


def without_the_untold(trials: Sequence[Trial], observations: Sequence[Observation]) -> list[Trial]:
    """The trials without what they do to triads that are seen by their norm."""
    seen = seen_by_norm(observations)
    if not seen:
        return list(trials)
    left = [
        dataclasses.replace(trial, effects=tuple(one for one in trial.effects if one.sensor not in seen))
        for trial in trials
    ]
    return [trial for trial in left if trial.effects]


def seen_by_norm(observations: Sequence[Observation]) -> Mapping[SensorName, NormView]:
    """Triads that are seen by their norm alone."""
    return {
        sensor: output.norm
        for one in observations
        for sensor, output in one.outputs.items()
        if output.norm is not None
    }

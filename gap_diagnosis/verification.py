# pyright: strict
"""How much of the gap is left on recordings that were not used before, once the found effects are added."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect, LinearEffect
from dut_emulator.effects.effect import EffectChain, FloatArray, SensorName, Stage, Stimulus
from gap_diagnosis.candidates import Trial
from gap_diagnosis.evidence import STEPS_OF_DATA, profile
from gap_diagnosis.fitting import joint_terms, level_weights, rms_added
from gap_diagnosis.held_out import Fold, HeldOut, gain_at, shrinkage_of, signal_at
from gap_diagnosis.observation import Channel, Observation
from gap_diagnosis.prepared import Prepared, prepare
from gap_diagnosis.report_entries import shrinkage_entry
from gap_diagnosis.search import Cause
from protocol.errors import Fault, TestloomError

KNOWN = "known"


@dataclass(frozen=True)
class KnownChange(LinearEffect):
    """What effects with settled parameters add to a triad, as one column with the amplitude `share`, 1."""

    effects: tuple[CatalogueEffect, ...] = ()
    word: ClassVar[str] = KNOWN
    stage: ClassVar[Stage] = Stage.TRANSDUCER

    def basis(self, stimulus: Stimulus) -> dict[str, FloatArray]:
        """(n, 3) chain of all effects less the true input."""
        samples = stimulus.true_input(self.sensor)
        chain = EffectChain(self.effects)
        return {"share": chain.apply(samples, stimulus, chain.begin(np.random.SeedSequence(0))) - samples}


def verify(observations: Sequence[Observation], effects: Sequence[CatalogueEffect]) -> dict[str, Any]:
    """The gap before and after, as `shrinkage` of a report; each recording is held out by nature.

    Args:
        observations: not used by the diagnosis that found the effects.
        effects: with their parameters; noise effects change no prediction and are refused.

    Raises:
        TestloomError: no deterministic effect, or recordings on which they do nothing.
    """
    deterministic = [effect for effect in effects if not effect.stochastic]
    if not deterministic:
        raise TestloomError(
            "There is no effect whose change of the output can be predicted.",
            where="gap verification",
            fault=Fault.OPERATOR,
            remedy="noise is verified by a new diagnosis with the twin's noise as the belief.",
        )
    sensors: dict[SensorName, list[CatalogueEffect]] = {}
    for effect in deterministic:
        sensors.setdefault(effect.sensor, []).append(effect)
    trials = [Trial(KNOWN, (KnownChange(sensor, effects=tuple(mine)),)) for sensor, mine in sensors.items()]
    prepared = prepare(observations, trials, 0, np.random.default_rng(0), cells=False)
    if not prepared.design.blocks:
        raise TestloomError(
            "These recordings do not excite the effects: nothing of them can be seen.",
            where=", ".join(one.recording_id for one in observations),
            fault=Fault.DATA,
            remedy="record a profile that shows them; the report's next test names one.",
        )
    held, share = _folds(prepared)
    entry = shrinkage_entry(shrinkage_of(held, 0.0), held, _changes(prepared))
    return entry | {"share": share}


def _causes(prepared: Prepared) -> list[Cause]:
    return [
        Cause(KNOWN, block.trial, (number,), tuple(block.columns))
        for number, block in enumerate(prepared.design.blocks)
    ]


def _settled(prepared: Prepared, places: Sequence[tuple[int, int, int]]) -> FloatArray:
    """Amplitudes of the scaled columns at which every share is 1."""
    scales: list[float] = []
    for _, number, k in places:
        block = prepared.design.blocks[number]
        channel, columns = next(iter(block.columns.items()))
        scales.append(float(prepared.design.channels[channel].scales[int(columns[k])]))
    return np.array(scales)


def _folds(prepared: Prepared) -> tuple[HeldOut, dict[str, dict[str, float]]]:
    causes = _causes(prepared)
    folds: list[Fold] = []
    for index, one in enumerate(prepared.observations):
        systems = prepared.systems([index])
        places, terms = joint_terms(systems, prepared.design, causes)
        if not terms:
            continue
        settled = _settled(prepared, places)
        own, _ = profile(terms, STEPS_OF_DATA)
        gain = gain_at(terms, settled)
        signal = signal_at(terms, settled)
        rows = sum(by[index].rows for by in prepared.moments.values() if index in by)
        folds.append(
            Fold(
                one.recording_id,
                gain,
                signal,
                np.array([gain]),
                np.array([signal]),
                float(own[0, 0]) - len(settled),
                rows,
            )
        )
    places, terms = joint_terms(prepared.systems(), prepared.design, causes)
    settled = _settled(prepared, places)
    _, amplitude = profile(terms, STEPS_OF_DATA)
    information = sum(np.tensordot(level_weights(t, amplitude[0, 0]), t.gram[0], 1) for t in terms)
    uncertainty = np.sqrt(np.diag(np.linalg.pinv(np.asarray(information), hermitian=True)))
    share = {
        prepared.design.blocks[number].effects[0].sensor: {
            "value": float(amplitude[0, 0, i] / settled[i]),
            "standard_uncertainty": float(uncertainty[i] / settled[i]),
        }
        for i, (_, number, _) in enumerate(places)
    }
    return HeldOut(tuple(folds), within_run=False), share


def _changes(prepared: Prepared) -> Mapping[Channel, float]:
    """Channel → rms of what the effects change there."""
    changes: dict[Channel, float] = {}
    for block in prepared.design.blocks:
        for channel, columns in block.columns.items():
            scales = prepared.design.channels[channel].scales[columns]
            changes[channel] = rms_added(prepared, channel, columns, scales)
    return changes

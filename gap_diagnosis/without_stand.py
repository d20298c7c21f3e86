# pyright: strict
"""All recordings of a unit as observations, with and without a stand that tells how it moved.

A unit that a stand turns is recalibrated there: norms are asked only of recordings by hand or of rests.
"""

import dataclasses
from collections.abc import Callable, Sequence

from dut_emulator.effects.effect import SensorName
from gap_diagnosis.errors import NoReference
from gap_diagnosis.norms import norm_observations
from gap_diagnosis.observation import Observation, SetAside
from gap_diagnosis.observing import observe
from gap_diagnosis.rest import at_rest
from gap_diagnosis.stillness import stilled
from gap_diagnosis.unit_and_stand import UNPREDICTED, unit_side
from protocol.recordings import Recording


def observed_together(
    recordings: Sequence[Recording], progress: Callable[[float], None]
) -> tuple[list[Observation], list[Observation]]:
    """Those beside a stand's report or at rest, and those of triads that are seen by their norm.

    progress: told the share that is done.

    Raises:
        TestloomError: a recording that carries neither.
    """
    observed: list[Observation] = []
    refused: list[tuple[Recording, NoReference]] = []
    on_a_stand: set[str] = set()
    for number, recording in enumerate(recordings):
        progress(number / len(recordings))
        try:
            one = observe(recording)
            if not at_rest(one.outputs):
                on_a_stand.add(recording.recording_id)
            observed.append(stilled(one))
        except NoReference as error:
            refused.append((recording, error))
    by_hand = [recording for recording in recordings if recording.recording_id not in on_a_stand]
    unpredicted = any(note.why == UNPREDICTED for one in observed for note in one.set_aside)
    if not by_hand or (not refused and not unpredicted):
        return observed, []
    predicted: frozenset[SensorName] = frozenset(sensor for one in observed for sensor in one.outputs)
    by_norm = norm_observations(by_hand, [unit_side(one) for one in by_hand], predicted)
    if refused and not by_norm:
        raise refused[0][1]
    if by_norm:
        notes = [_unused(recording) for recording, _ in refused if recording.stream("dut").has("gyro_x")]
        by_norm[0] = dataclasses.replace(by_norm[0], set_aside=(*by_norm[0].set_aside, *notes))
    seen: set[str] = {sensor for one in by_norm for sensor in one.outputs}
    return [_without_notes(one, seen) for one in observed], by_norm


def _unused(recording: Recording) -> SetAside:
    why = f"in {recording.recording_id} it was turned and no stand tells how, so it is not used"
    return SetAside("gyro", len(recording.stream("dut")), why)


def _without_notes(one: Observation, seen: set[str]) -> Observation:
    """Without the word that nothing predicts a triad which is seen by its norm."""
    kept = tuple(note for note in one.set_aside if not (note.what in seen and note.why == UNPREDICTED))
    return dataclasses.replace(one, set_aside=kept)

"""Several recordings of one unit and profile: what lay between them, and their evaluations as one.

A unit was switched on at `test.started_at` + `test.power_on_s` (absent: 0). Recordings whose instants agree
are runs of one power-on; where all differ, each run has its own. Anything else, times that overlap or are
not stated, carries no repeatability, and why is said.
"""

# pyright: strict
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from calibration.algorithms.repeatability import Condition
from calibration.algorithms.screening import NotUsed
from calibration.evaluations.method_evaluation import MethodEvaluation, SensorResult
from protocol.errors import CalibrationError
from protocol.language import say
from protocol.recordings import Recording

SAME_POWER_ON_S = 2.0
"""Instants of switching on that are closer are one: `started_at` is often of whole seconds."""


@dataclass(frozen=True)
class BetweenRuns:
    """What lay between runs. `condition` None: not known or mixed; `words`: which, or why not."""

    condition: Condition | None
    words: str


def between_runs(recordings: Sequence[Recording]) -> BetweenRuns:
    """Whether the unit stayed on between the recordings, by what they say of their times."""
    spans: list[tuple[float, float]] = []
    switched_on: list[float] = []
    for recording in recordings:
        begin_s = started_s(recording)
        if begin_s is None:
            return BetweenRuns(None, say("the recordings do not state test.started_at"))
        time_s = recording.stream("dut").time_s()
        spans.append((begin_s + float(time_s[0]), begin_s + float(time_s[-1])))
        stated = recording.test.get("power_on_s", 0.0)
        switched_on.append(begin_s + (float(stated) if isinstance(stated, int | float) else 0.0))
    ordered = sorted(spans)
    pauses = [after[0] - before[1] for before, after in itertools.pairwise(ordered)]
    if pauses and min(pauses) < -1.0:
        return BetweenRuns(None, say("the recordings overlap in time by their test.started_at"))
    instants = sorted(switched_on)
    steps = [after - before for before, after in itertools.pairwise(instants)]
    pause = f"{max(min(pauses, default=0.0), 0.0) / 60.0:.3g}"
    if all(step <= SAME_POWER_ON_S for step in steps):
        words = say("runs of one power-on, at least {pause} min apart", pause=pause)
        return BetweenRuns("same_power_on", words)
    if all(step > SAME_POWER_ON_S for step in steps):
        return BetweenRuns("each_power_on", say("switched off and on between the runs"))
    return BetweenRuns(None, say("some runs are of one power-on and some are not"))


def mounts_words(recordings: Sequence[Recording]) -> str | None:
    """A sentence where the unit was mounted anew between runs: that is part of what they differ by."""
    mounts = {str(recording.test.get("mount", "")) for recording in recordings}
    if len(mounts) == 1:
        return None
    return say("mounted {count} times: how the unit sits is part of the repeatability", count=len(mounts))


def each_that_can(
    recordings: Sequence[Recording], evaluate: Callable[[Recording], MethodEvaluation]
) -> tuple[list[tuple[Recording, MethodEvaluation]], list[NotUsed]]:
    """Evaluations of the recordings that can be evaluated; of the others, why not.

    Raises:
        CalibrationError: none can; the first one's reason.
    """
    done: list[tuple[Recording, MethodEvaluation]] = []
    failed: list[tuple[Recording, CalibrationError]] = []
    for recording in recordings:
        try:
            done.append((recording, evaluate(recording)))
        except CalibrationError as error:
            failed.append((recording, error))
    if not done:
        raise failed[0][1]
    notes = [NotUsed(one.recording_id, len(one.stream("dut")), error.what) for one, error in failed]
    return done, notes


def merged(parts: Sequence[MethodEvaluation], not_used: Sequence[NotUsed] = ()) -> MethodEvaluation:
    """Evaluations of one unit as one; what several say alike is said once."""
    results: tuple[SensorResult, ...] = tuple(result for part in parts for result in part.results)
    sentences = dict.fromkeys(sentence for part in parts for sentence in part.assumptions)
    names = dict.fromkeys(name for part in parts for name in part.recording_ids)
    return MethodEvaluation(
        recording_ids=tuple(names),
        serial=parts[0].serial,
        product=parts[0].product,
        profile=parts[0].profile,
        results=results,
        assumptions=tuple(sentences),
        not_used=_summed([*(note for part in parts for note in part.not_used), *not_used]),
    )


def _summed(notes: Sequence[NotUsed]) -> tuple[NotUsed, ...]:
    """What is said of several recordings alike, once, with the sum of its samples."""
    counts: dict[tuple[str, str], int] = {}
    for note in notes:
        counts[note.what, note.why] = counts.get((note.what, note.why), 0) + note.count
    return tuple(NotUsed(what, count, why) for (what, why), count in counts.items())


def started_s(recording: Recording) -> float | None:
    """When it began, s since 1970; None where it does not say so."""
    try:
        return datetime.fromisoformat(str(recording.test.get("started_at", ""))).timestamp()
    except ValueError:
        return None

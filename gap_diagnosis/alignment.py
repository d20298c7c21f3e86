# pyright: strict
"""Whether two clocks belong together, and by how much the unit's is moved if they do not.

The unit's clock is moved onto the stand's where the two spans have nothing in common, where they were not
started by one edge (`test.triggered` false), or where the motion agrees only more than `MAX_DELAY_S` away.
After that nothing can be said of a delay: it is in the alignment.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName
from dut_emulator.effects.recursions import MAX_DELAY_S
from gap_diagnosis.delay_fit import DelayFit, Triad, fitted_delay
from gap_diagnosis.epochs import CoarseLag, Motion, coarse_lag
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.holes import piece_numbers
from gap_diagnosis.observation import Observation
from gap_diagnosis.stand_at_unit import StandReport, stand_at
from gap_diagnosis.unit_outputs import UnitTriad
from protocol.errors import Fault
from protocol.recordings import Recording, Stream

BETTER, MUCH_BETTER = 0.01, 0.2
"""By so much a correlation near by, or far away, must exceed that at the clocks' own times."""
MAX_ROWS = 60_000
_REPORTED: dict[SensorName, str] = {"gyro": "rate_rad_s", "acc": "specific_force_m_s2", "mag": "field_t"}


@dataclass(frozen=True)
class CoarseAlignment:
    """What the motion tells at first sight, to a few samples.

    Attributes:
        added_s: to be added to the unit's clock; None where the clocks belong together.
        about_s: the delay that is left then.
    """

    added_s: float | None = None
    about_s: float = 0.0


def coarse_alignment(
    recording: Recording, time_s: FloatArray, triads: dict[SensorName, UnitTriad]
) -> CoarseAlignment:
    """Whether the clocks belong together, and how far they are apart.

    Raises:
        DiagnosisError: no common time, and the motion does not tell where the one lies in the other.
    """
    stand = recording.streams.get("stand")
    if stand is None or len(stand) < 2:
        return CoarseAlignment()
    stand_s = stand.time_s()
    apart = stand_s[0] > time_s[-1] or stand_s[-1] < time_s[0]
    found = _best(stand, stand_s, time_s, triads)
    if apart and (found is None or not found.is_clear):
        raise DiagnosisError(
            f"Unit and stand have no time in common ({time_s[0]:.3f} to {time_s[-1]:.3f} s and "
            f"{stand_s[0]:.3f} to {stand_s[-1]:.3f} s), and their motion does not tell how the clocks belong "
            "together.",
            where=f"recording {recording.recording_id}, streams dut and stand",
            fault=Fault.DATA,
            remedy="give the stand's report of this run, or start both clocks by one edge.",
        )
    by_hand = recording.test.get("triggered") is False
    if found is None or not found.is_clear:
        return CoarseAlignment(added_s=0.0 if by_hand else None)
    own = -1.0 if apart else _at_own_times(stand, time_s, triads)
    is_far = abs(found.ahead_s) > MAX_DELAY_S and found.correlation > own + MUCH_BETTER
    if apart or is_far or by_hand:
        return CoarseAlignment(added_s=found.ahead_s)
    is_late = abs(found.ahead_s) <= MAX_DELAY_S and found.correlation > own + BETTER
    return CoarseAlignment(about_s=-found.ahead_s if is_late else 0.0)


def _best(
    stand: Stream, stand_s: FloatArray, time_s: FloatArray, triads: dict[SensorName, UnitTriad]
) -> CoarseLag | None:
    """The clearest and best of the triads, by their axes and by their norms."""
    report, best = stand_at(stand, stand_s), None
    for sensor, triad in triads.items():
        told = getattr(report, _REPORTED[sensor])
        if told is None or np.isnan(triad.values_si).all(axis=0).any():
            continue
        unit, other = Motion(time_s, triad.values_si), Motion(stand_s, told)
        for found in (coarse_lag(unit, other), coarse_lag(unit.norm, other.norm)):
            if found is not None and (best is None or _rank(found) > _rank(best)):
                best = found
    return best


def _rank(lag: CoarseLag) -> tuple[bool, float]:
    return lag.is_clear, lag.correlation


def _at_own_times(stand: Stream, time_s: FloatArray, triads: dict[SensorName, UnitTriad]) -> float:
    """The largest correlation of an axis or of the norms without any alignment.

    Of the axes too: a norm that a dead axis has no part in may fit another part of the test better.
    """
    report: StandReport = stand_at(stand, time_s)
    largest = 0.0
    for sensor, triad in triads.items():
        told = getattr(report, _REPORTED[sensor])
        if told is None:
            continue
        pairs = [(triad.values_si[:, axis], told[:, axis]) for axis in range(3)]
        for one, other in [(_length(triad.values_si), _length(told)), *pairs]:
            rows = np.isfinite(one) & np.isfinite(other)
            if rows.sum() > 16 and one[rows].std() > 0 and other[rows].std() > 0:
                largest = max(largest, float(np.corrcoef(one[rows], other[rows])[0, 1]))
    return largest


def _length(vectors: FloatArray) -> FloatArray:
    return np.sqrt((vectors**2).sum(axis=1))


def triad_of(observation: Observation, sensor: SensorName) -> Triad:
    """One triad's rows, as a fit of its delay wants them; at most `MAX_ROWS`, those that move most."""
    output, stimulus = observation.outputs[sensor], observation.stimulus
    rows = _telling_rows(output.predicted_si)
    return Triad(
        time_s=stimulus.time_s[rows],
        values=output.values_si[rows],
        predicted=output.predicted_si[rows],
        period_s=stimulus.sample_period_s,
        piece=piece_numbers(stimulus.time_s[rows], observation.usable[rows], stimulus.sample_period_s),
    )


def _telling_rows(predicted: FloatArray) -> slice | NDArray[np.bool_]:
    """All rows of a short recording; of a long one, the stretches that move most."""
    n = len(predicted)
    if n <= MAX_ROWS:
        return slice(0, n)
    size = 1000
    steps = np.nan_to_num(np.abs(np.diff(predicted, axis=0, prepend=predicted[:1])).sum(axis=1))
    motion = np.add.reduceat(steps**2, np.arange(0, n, size))
    best = np.sort(np.argsort(motion)[::-1][: MAX_ROWS // size])
    kept = np.zeros(n, dtype=bool)
    for block in best.tolist():
        kept[block * size : (block + 1) * size] = True
    return kept


def constant_delay(triad: Triad, about_s: float = 0.0) -> DelayFit | None:
    """The fit of one delay for the whole, begun at `about_s`."""
    return fitted_delay(triad, [np.ones(len(triad.time_s))], about_s=about_s)

# pyright: strict
"""Was the unit at rest? Asked where no stand tells its motion."""

from collections.abc import Mapping

import numpy as np

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.errors import DiagnosisError, NoReference
from gap_diagnosis.observation import SensorOutput
from gap_diagnosis.unit_outputs import UnitTriad
from protocol.errors import Fault
from protocol.recordings import Recording

AVERAGED_S = 0.5
LARGEST_CHANGE: dict[SensorName, float] = {"gyro": 0.03, "acc": 0.3, "mag": 2e-6}
"""SI, of means over `AVERAGED_S` about their median. Above the noise and the slow noise of MEMS; 0.03 rad/s
are 1.7 °/s, which any hand exceeds."""
STILL = 0.1
LEAST_SHARE = 0.01
"""Of the means: a knock at the bench is no motion."""


def refuse_unless_at_rest(
    recording: Recording, triads: Mapping[SensorName, UnitTriad], period_s: float
) -> None:
    """Take a unit that nothing is told of for one at rest only if its own samples say so.

    Raises:
        NoReference: the unit moved.
        DiagnosisError: it has no triad that could tell.
    """
    where = f"recording {recording.recording_id}"
    remedy = "record the stand's rates (stream 'stand', rate_x …), or leave this recording out."
    if not triads:
        raise DiagnosisError(
            "The unit sends no rate, specific force or field that could be read.",
            where=f"{where}, stream dut",
            fault=Fault.DATA,
            remedy="name the columns gyro_x …, acc_x …, mag_x … with their units.",
        )
    for sensor, triad in triads.items():
        largest = LARGEST_CHANGE[sensor]
        change = _changes(triad.values_si, period_s)
        share = float(np.mean(change > largest)) if len(change) else 0.0
        if share > LEAST_SHARE:
            raise NoReference(
                f"The unit moved ({sensor} changes by {float(np.quantile(change, 0.99)):.3g} in SI), "
                "but no stand reports how.",
                where=where,
                fault=Fault.DATA,
                remedy=remedy,
            )


def at_rest(outputs: Mapping[SensorName, SensorOutput]) -> bool:
    """True if no triad's prediction goes through more than `STILL` of what would be motion."""
    for sensor, largest in LARGEST_CHANGE.items():
        if sensor in outputs:
            predicted = outputs[sensor].predicted_si
            predicted = predicted[np.isfinite(predicted).all(axis=1)]
            if len(predicted) and float(np.ptp(predicted, axis=0).max()) > STILL * largest:
                return False
    return True


def _changes(values_si: FloatArray, period_s: float) -> FloatArray:
    """(blocks,) largest deviation of an axis' block mean from its median."""
    size = max(1, round(AVERAGED_S / period_s))
    there = ~np.isnan(values_si).all(axis=0)
    blocks = len(values_si) // size
    if not there.any() or not blocks:
        return np.empty(0)
    cut = values_si[: blocks * size, there].reshape(blocks, size, -1)
    known = np.isfinite(cut)
    means = np.where(known, cut, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    means[~known.any(axis=1)] = np.nan
    return np.nanmax(np.abs(means - np.nanmedian(means, axis=0)), axis=1)

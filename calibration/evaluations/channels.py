"""The unit's channels in rad/s and m/s^2, from whichever form it sends: numbers, counts, volts, pulses."""

# pyright: strict
import math
from collections.abc import Mapping
from typing import Any, Literal, cast

import numpy as np

from calibration.algorithms.coefficients import FloatArray
from calibration.evaluations.method_evaluation import (
    believed_number,
    believed_sensor,
    refused,
    sample_period_s,
    stream_with,
)
from calibration.sensor_knowledge import slow_noise
from protocol.language import say
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import factor_to_si

Kind = Literal["gyro", "acc"]
SI: Mapping[Kind, str] = {"gyro": "rad/s", "acc": "m/s^2"}


def channel_in_si(
    recording: Recording, dut: Stream, kind: Kind, letter: str, period_s: float
) -> FloatArray | None:
    """One channel, shape (n,); None: not there. Pulses become the mean over their sample period.

    Raises:
        CalibrationError: counts, volts or pulses of which the recording does not say what they stand for.
    """
    name = f"{kind}_{letter}"
    if name in dut.columns and dut.units[name] != "1":
        return dut.si(name)
    positive, negative = f"pulse_{name}_pos", f"pulse_{name}_neg"
    zero = 0.0
    if name in dut.columns:
        raw, per_unit = dut.si(name), _of_counts(recording, kind, "per_unit")
        zero = _of_counts(recording, kind, "at_zero") or 0.0
    elif dut.has(positive, negative):
        raw = (dut.si(positive) - dut.si(negative)) / period_s
        per_unit = believed_number(recording, kind, "pulses_per_unit_s")
    elif kind == "gyro" and f"volt_{letter}" in dut.columns:
        raw, per_unit = dut.si(f"volt_{letter}"), believed_number(recording, kind, "volts_per_unit")
    else:
        return None
    unit = believed_sensor(recording, kind).get("unit")
    if per_unit is None or per_unit <= 0.0 or not isinstance(unit, str):
        raise refused(
            recording,
            f"The recording does not say what a count, volt or pulse of the {kind} stands for.",
            f"write believed.{kind}.unit and its counts, volts_per_unit or pulses_per_unit_s",
        )
    return (raw - zero) / per_unit * factor_to_si(unit)


def channels_in_si(recording: Recording, kind: Kind) -> tuple[str, FloatArray]:
    """Letters of the channels that are there, 'xyz' or fewer, and their samples, shape (n, letters).

    Raises:
        CalibrationError: as `channel_in_si`; no stream, or samples without a period.
    """
    dut = stream_with(recording, "dut")
    period_s = sample_period_s(recording, dut)
    found = {letter: channel_in_si(recording, dut, kind, letter, period_s) for letter in "xyz"}
    there = {letter: samples for letter, samples in found.items() if samples is not None}
    values = np.stack(list(there.values()), axis=1) if there else np.zeros((len(dut), 0))
    return "".join(there), np.asarray(values, dtype=np.float64)


def stated_slow_terms(recording: Recording, kind: Kind) -> tuple[tuple[float, float], ...] | None:
    """(standard deviation, correlation time) of the slow noise that the recording states; None: nothing.

    What differs from one power-on to the next is left out: figures are of this power-on.
    """
    terms = tuple(
        (one.standard_deviation, one.correlation_time_s)
        for one in slow_noise(recording, kind)
        if math.isfinite(one.correlation_time_s)
    )
    return terms or None


def this_power_on() -> str:
    """Which bias it is that `stated_slow_terms` gives its uncertainty: a sentence for people."""
    return say("bias of this power-on, at the temperature that the unit had")


def _of_counts(recording: Recording, kind: str, key: str) -> float | None:
    counts = believed_sensor(recording, kind).get("counts")
    stated = cast(Mapping[str, Any], counts).get(key) if isinstance(counts, Mapping) else None
    return float(stated) if isinstance(stated, int | float) else None

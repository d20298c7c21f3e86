# pyright: strict
"""What the unit said, in SI: direct columns, counts, volts and pulses."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.belief import QUANTITY, TRIADS, TriadBelief
from gap_diagnosis.observation import AXES
from protocol.errors import Fault, RecordingError
from protocol.recordings import Recording, Stream
from protocol.units_of_measure import quantity_of


@dataclass(frozen=True)
class UnitTriad:
    """One triad's samples.

    Attributes:
        values_si: (m, 3); NaN for axes that the unit has not.
        are_means: pulses of a sample period: the mean over it, not the value at its end.
        quantum_si: one count of the column, if the belief does not say another.
    """

    values_si: FloatArray
    are_means: bool = False
    quantum_si: float = 0.0


def unit_triads(
    recording: Recording, beliefs: Mapping[SensorName, TriadBelief], period_s: float
) -> tuple[dict[SensorName, UnitTriad], list[str]]:
    """The triads that the unit sends, and sentences about columns that cannot be read.

    Raises:
        RecordingError: a column is in a unit of another quantity.
    """
    stream, found, unread = recording.stream("dut"), dict[SensorName, UnitTriad](), list[str]()
    for sensor in TRIADS:
        belief = beliefs[sensor]
        direct = [f"{sensor}_{axis}" for axis in AXES]
        pulses = [f"pulse_{sensor}_{axis}" for axis in AXES]
        if any(name in stream.columns for name in direct):
            triad = _direct(stream, direct, sensor, belief)
            if triad is None:
                unread.append(f"{sensor}: its columns are plain numbers, and no scale is believed.")
        elif belief.volts_per_si and any(f"volt_{axis}" in stream.columns for axis in AXES):
            volts = [_column(stream, f"volt_{axis}", "voltage") for axis in AXES]
            triad = UnitTriad(np.stack(volts, axis=1) / belief.volts_per_si)
        elif any(f"{name}_pos" in stream.columns for name in pulses):
            triad = _pulses(stream, pulses, belief, period_s)
            if triad is None:
                unread.append(f"{sensor}: it counts pulses, and no pulses_per_unit_s is believed.")
        else:
            continue
        if triad is not None:
            found[sensor] = triad
    return found, unread


def _direct(stream: Stream, names: list[str], sensor: SensorName, belief: TriadBelief) -> UnitTriad | None:
    units = {stream.units[name] for name in names if name in stream.columns}
    if {quantity_of(unit) for unit in units} == {"number"}:
        if belief.counts_per_si is None:
            return None
        counts = [_column(stream, name, "number") - belief.counts_at_zero for name in names]
        return UnitTriad(
            np.stack(counts, axis=1) / belief.counts_per_si, quantum_si=1.0 / belief.counts_per_si
        )
    return UnitTriad(np.stack([_column(stream, name, QUANTITY[sensor]) for name in names], axis=1))


def plain_numbers(recording: Recording, sensor: SensorName) -> FloatArray | None:
    """(m, 3) of a triad whose columns are plain numbers without a believed scale; None: it has none such."""
    stream, names = recording.stream("dut"), [f"{sensor}_{axis}" for axis in AXES]
    if not stream.has(*names) or {quantity_of(stream.units[name]) for name in names} != {"number"}:
        return None
    return np.stack([_column(stream, name, "number") for name in names], axis=1)


def _pulses(stream: Stream, names: list[str], belief: TriadBelief, period_s: float) -> UnitTriad | None:
    """Mean rate over the sample period that ends with the sample; the first one has no beginning."""
    if not belief.pulses_per_si_s:
        return None
    per_pulse = 1.0 / (belief.pulses_per_si_s * period_s)
    counted = [
        _column(stream, f"{name}_pos", "number") - _column(stream, f"{name}_neg", "number") for name in names
    ]
    values = np.stack(counted, axis=1) * per_pulse
    values[:1] = np.nan
    return UnitTriad(values, are_means=True, quantum_si=per_pulse)


def _column(stream: Stream, name: str, quantity: str) -> FloatArray:
    """In SI; NaN throughout where there is none."""
    if name not in stream.columns:
        return np.full(len(stream), np.nan)
    unit = stream.units[name]
    if quantity_of(unit) != quantity:
        raise RecordingError(
            f"The column '{name}' is in '{unit}', which measures {quantity_of(unit)}, not {quantity}.",
            where=f"stream {stream.name}, column {name}",
            fault=Fault.DATA,
            remedy="correct the column's unit in recording.json.",
        )
    return stream.si(name)


def unit_temperature_c(stream: Stream) -> FloatArray | None:
    """(m,) of 'temp', else the mean of what there is of 'temp_…'; None without any."""
    if "temp" in stream.columns:
        return _column(stream, "temp", "temperature")
    names = [name for name in stream.columns if name.startswith("temp_")]
    if not names:
        return None
    return np.mean([_column(stream, name, "temperature") for name in names], axis=0)


def unit_supply(stream: Stream) -> tuple[FloatArray | None, FloatArray | None]:
    """(m,) voltage and (m,) current at the supply pins, as far as recorded."""
    voltage = _column(stream, "supply", "voltage") if "supply" in stream.columns else None
    current = _column(stream, "supply_current", "current") if "supply_current" in stream.columns else None
    return voltage, current

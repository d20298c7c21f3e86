# pyright: strict
"""What `recording.json` believes of each triad, in SI: y = M u + b, filter, noise, quantum, range."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.errors import DiagnosisError
from gap_diagnosis.observation import NoiseBelief
from protocol.errors import Fault
from protocol.recordings import Recording
from protocol.units_of_measure import factor_to_si, is_known_unit, quantity_of

QUANTITY: dict[str, str] = {"gyro": "angular_rate", "acc": "acceleration", "mag": "magnetic_flux_density"}
TRIADS: tuple[SensorName, ...] = ("gyro", "acc", "mag")
_SI: dict[str, str] = {"gyro": "rad/s", "acc": "m/s^2", "mag": "T"}
_WHITE: dict[str, tuple[str, str]] = {
    "gyro": ("angle_random_walk", "angle_random_walk"),
    "acc": ("velocity_random_walk", "velocity_random_walk"),
    "mag": ("white_noise", "magnetic_noise_density"),
}
"""Key of the white noise of a triad, and the quantity of its unit."""


@dataclass(frozen=True)
class TriadBelief:
    """One triad's belief.

    Attributes:
        matrix, bias_si: of y = M u + b, (3, 3) and (3,).
        unit_si: factor of its unit.
        volts_per_si, counts_per_si, counts_at_zero, pulses_per_si_s: how columns in V, counts or pulses are
            to be read; None: they are not.
        is_stated: False where the recording says nothing of it and an ideal triad is assumed.
    """

    matrix: FloatArray
    bias_si: FloatArray
    unit_si: float
    noise: NoiseBelief
    quantum_si: float = 0.0
    range_si: float = math.inf
    bandwidth_hz: float | None = None
    volts_per_si: float | None = None
    counts_per_si: float | None = None
    counts_at_zero: float = 0.0
    pulses_per_si_s: float | None = None
    is_stated: bool = True


def triad_belief(recording: Recording, sensor: SensorName) -> TriadBelief:
    """What is believed of 'gyro', 'acc' or 'mag'; an ideal triad where nothing is.

    Raises:
        DiagnosisError: a belief that is no number, no unit, or of another quantity.
    """
    stated = recording.believed.get(sensor)
    if stated is None:
        return TriadBelief(np.eye(3), np.zeros(3), 1.0, NoiseBelief(), is_stated=False)
    where = f"recording {recording.recording_id}, believed.{sensor}"
    if not isinstance(stated, Mapping):
        raise _refused("The belief is no JSON object.", where)
    reader = _Reader(cast(Mapping[str, Any], stated), where)
    unit = reader.said.get("unit", _SI[sensor])
    scale = reader.factor(unit, QUANTITY[sensor], "unit") if unit != "1" else 1.0
    counts = reader.inner("counts")
    volts, pulses = reader.number("volts_per_unit"), reader.number("pulses_per_unit_s")
    per_count = counts.number("per_unit") if counts else None
    return TriadBelief(
        matrix=reader.array("matrix", (3, 3), np.eye(3)),
        bias_si=reader.array("bias", (3,), np.zeros(3)) * scale,
        unit_si=scale,
        noise=_noise(reader, sensor),
        quantum_si=(reader.number("quantum") or 0.0) * scale,
        range_si=(reader.number("range") or math.inf) * scale,
        bandwidth_hz=reader.number("bandwidth_hz"),
        volts_per_si=None if volts is None else volts / scale,
        counts_per_si=None if per_count is None else per_count / scale,
        counts_at_zero=(counts.number("at_zero") or 0.0) if counts else 0.0,
        pulses_per_si_s=None if pulses is None else pulses / scale,
    )


def _noise(reader: "_Reader", sensor: SensorName) -> NoiseBelief:
    key, quantity = _WHITE[sensor]
    white, slow = reader.inner(key), reader.inner("bias_instability")
    usual = NoiseBelief()
    level, slow_level = white and white.level(quantity), slow and slow.level(QUANTITY[sensor])
    correlation_s = slow.number("correlation_time_s") if slow else None
    return NoiseBelief(
        white_si_per_sqrt_hz=level or None,
        white_spread=_spread(white, usual.white_spread),
        slow_deviation_si=slow_level if correlation_s else None,
        slow_correlation_time_s=correlation_s,
        slow_coefficient_si=slow_level if slow and not correlation_s else None,
        slow_spread=_spread(slow, usual.slow_spread),
    )


def _spread(reader: "_Reader | None", usual: float) -> float:
    stated = reader.number("unit_spread") if reader else None
    return usual if stated is None else stated


@dataclass(frozen=True)
class _Reader:
    """An object of `believed`, read with what is wrong with it said."""

    said: Mapping[str, Any]
    where: str

    def inner(self, key: str) -> "_Reader | None":
        found = self.said.get(key)
        if found is None:
            return None
        if not isinstance(found, Mapping):
            raise _refused(f"'{key}' is no JSON object.", f"{self.where}.{key}")
        return _Reader(cast(Mapping[str, Any], found), f"{self.where}.{key}")

    def number(self, key: str) -> float | None:
        """None where it is not said, or null; every number of a belief is at least 0."""
        found = self.said.get(key)
        if found is None:
            return None
        number = float(found) if isinstance(found, int | float) else math.nan
        if not math.isfinite(number) or (number < 0 and key != "at_zero"):
            raise _refused(f"'{key}' is {found!r}, which is no finite number of at least 0.", self.where)
        return number

    def array(self, key: str, shape: tuple[int, ...], absent: FloatArray) -> FloatArray:
        found = self.said.get(key)
        if found is None:
            return absent
        try:
            array = np.asarray(found, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != shape or not np.isfinite(array).all():
            raise _refused(f"'{key}' is not {' × '.join(map(str, shape))} finite numbers.", self.where)
        return array

    def factor(self, unit: object, quantity: str, key: str) -> float:
        if not isinstance(unit, str) or not is_known_unit(unit) or quantity_of(unit) != quantity:
            raise _refused(
                f"The unit {unit!r} measures no {quantity.replace('_', ' ')}.", f"{self.where}.{key}"
            )
        return factor_to_si(unit)

    def level(self, quantity: str) -> float:
        value = self.number("value")
        if value is None:
            raise _refused("A level of noise has no 'value'.", self.where)
        return value * self.factor(self.said.get("unit"), quantity, "unit")


def _refused(what: str, where: str) -> DiagnosisError:
    return DiagnosisError(what, where=where, fault=Fault.DATA, remedy="correct recording.json.")

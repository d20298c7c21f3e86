# pyright: strict
"""Regimes: where in the test a sample was taken, in cells of what effects follow.

Cells ask for no effect: their means show where a gap lies, and all cells of one variable together are a rival
to every effect that follows it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray, SensorName
from gap_diagnosis.observation import AXES, Channel, Observation

CELLS = {
    "direction": 7,
    "temperature": 8,
    "rate": 9,
    "acceleration": 7,
    "time_since_power_on": 10,
    "table_angle": 8,
}
LEAST_SHARE = 0.005
"""A cell that holds a smaller share of the rows is joined to no statistic."""
LEAST_TURN_RAD = 0.5
LEAST_SPREAD = {"temperature": 2.0, "rate": 1e-3, "acceleration": 0.2, "time_since_power_on": 30.0}


@dataclass(frozen=True)
class Regime:
    """One variable's cells for one channel.

    Attributes:
        variable: 'temperature', 'rate_x', 'acceleration_z', 'time_since_power_on', 'table_angle_outer'.
        unit: of `edges`, as people read it.
        edges: (cells + 1,) increasing.
        values: recording → (n,) the variable on all rows, in `unit`; empty once the indicators are made.
    """

    variable: str
    unit: str
    edges: FloatArray
    values: tuple[FloatArray | None, ...]

    def indicators(self, recording: int, rows: NDArray[np.bool_]) -> FloatArray | None:
        """(rows used, cells) 1 where a row lies in a cell; `rows` (n,) says which are used."""
        values = self.values[recording]
        if values is None:
            return None
        cell = np.clip(np.searchsorted(self.edges, values[rows], side="right") - 1, 0, len(self.edges) - 2)
        return (cell[:, np.newaxis] == np.arange(len(self.edges) - 1)).astype(np.float64)


def regimes_of(observations: Sequence[Observation], channel: Channel) -> list[Regime]:
    """Every variable that the recordings move, for this channel."""
    found: list[Regime] = []
    stimuli = [one.stimulus for one in observations]
    here = [channel.sensor in one.outputs for one in observations]
    temperature = [
        s.temperature_c if one.has_temperature else None for one, s in zip(observations, stimuli, strict=True)
    ]
    found += _regime("temperature", "temperature", "degC", temperature)
    found += _regime(
        "time_since_power_on", "time_since_power_on", "s", [s.time_s - s.power_on_s for s in stimuli]
    )
    for axis, letter in enumerate(AXES):
        forces = [
            s.specific_force_m_s2[:, axis] if s.specific_force_m_s2 is not None and there else None
            for s, there in zip(stimuli, here, strict=True)
        ]
        rates = [None if s.rate_rad_s is None else np.degrees(s.rate_rad_s[:, axis]) for s in stimuli]
        found += _regime("acceleration", f"acceleration_{letter}", "m/s^2", forces)
        if axis == channel.axis or channel.sensor != "gyro":
            found += _regime("rate", f"rate_{letter}", "deg/s", rates)
        found += _regime("direction", f"direction_{letter}", "1", _directions(observations, channel, axis))
    for axis, name in enumerate(("outer", "middle", "inner")):
        turned = [s.angles_rad for s in stimuli if s.angles_rad is not None]
        if any(np.ptp(angles[:, axis]) > LEAST_TURN_RAD for angles in turned):
            angles = [
                None if s.angles_rad is None else np.degrees(s.angles_rad[:, axis]) % 360 for s in stimuli
            ]
            found += _regime("table_angle", f"table_angle_{name}", "deg", angles)
    return found


def _directions(observations: Sequence[Observation], channel: Channel, axis: int) -> list[FloatArray | None]:
    """Of recordings that see a field by its norm: (n,) cosine between field and axis."""
    found: list[FloatArray | None] = []
    for one in observations:
        output, field = one.outputs.get(channel.sensor), one.stimulus.field_t
        if output is None or output.norm is None or field is None:
            found.append(None)
        else:
            found.append(np.asarray(field[:, axis] / np.linalg.norm(field, axis=1), dtype=np.float64))
    return found


def _regime(kind: str, name: str, unit: str, values: Sequence[FloatArray | None]) -> list[Regime]:
    told = [v for v in values if v is not None]
    if not told:
        return []
    every = np.concatenate(told)
    low, high = float(every.min()), float(every.max())
    if high - low < LEAST_SPREAD.get(kind, 1e-9):
        return []
    edges = np.linspace(low, high, CELLS[kind] + 1)
    share = np.histogram(every, edges)[0] / len(every)
    kept = [
        edges[0],
        *(e for e, s in zip(edges[1:-1], share[:-1], strict=True) if s > LEAST_SHARE),
        edges[-1],
    ]
    if len(kept) < 3:
        return []
    return [Regime(name, unit, np.array(kept), tuple(values))]


def variable_of(effect_name: str) -> str:
    """The variable that an effect follows most: where its gap shows."""
    word = effect_name.split(".")[1]
    for part, variable in (
        ("temperature", "temperature"),
        ("thermal", "temperature"),
        ("chamber", "temperature"),
        ("warm_up", "time_since_power_on"),
        ("level_drift", "time_since_power_on"),
        ("clock_drift", "time_since_power_on"),
        ("g_sensitivity", "acceleration"),
        ("g2_", "acceleration"),
        ("quadratic", "acceleration"),
        ("cubic", "acceleration"),
        ("wobble", "table_angle"),
        ("ripple", "table_angle"),
        ("eccentricity", "table_angle"),
        ("motor_field", "table_angle"),
    ):
        if part in word:
            return variable
    return "acceleration" if effect_name.startswith("acc.") else "rate"


SENSOR_UNIT: dict[SensorName, str] = {
    "gyro": "deg/s",
    "acc": "m/s^2",
    "mag": "uT",
    "temperature": "degC",
    "gnss": "m",
}

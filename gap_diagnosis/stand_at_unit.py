# pyright: strict
"""The stand's report at the unit's instants: linear between rows, never across a hole.

A unit that counts pulses tells means over a sample period, so the stand's report is averaged over the same
period: the integral of the straight lines between its rows, exactly.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.holes import covered, hole_s
from gap_diagnosis.observation import AXES
from protocol.errors import Fault, RecordingError
from protocol.recordings import Stream
from protocol.units_of_measure import quantity_of

GIMBALS = ("angle_outer", "angle_middle", "angle_inner")
CRANK = "angle_crank"
ATTITUDE = ("roll", "pitch", "yaw")
_VECTORS: dict[str, tuple[tuple[str, ...], str]] = {
    "rate_rad_s": (tuple(f"rate_{axis}" for axis in AXES), "angular_rate"),
    "specific_force_m_s2": (tuple(f"acc_{axis}" for axis in AXES), "acceleration"),
    "field_t": (tuple(f"mag_{axis}" for axis in AXES), "magnetic_flux_density"),
    "attitude_rad": (ATTITUDE, "angle"),
    "position_m": (("position_east", "position_north", "position_up"), "length"),
}


@dataclass(frozen=True)
class StandReport:
    """What the stand says, (n, 3) or (n,) in SI, NaN where it says nothing; None: no such columns.

    Attributes:
        rate_rad_s: relative to the laboratory.
        angles_rad: gimbals outer, middle, inner, unwrapped; a crank's angle is the inner one.
        is_crank: the angle turns no unit.
        attitude_rad: roll, pitch, yaw of a vehicle.
    """

    rate_rad_s: FloatArray | None = None
    specific_force_m_s2: FloatArray | None = None
    field_t: FloatArray | None = None
    angles_rad: FloatArray | None = None
    is_crank: bool = False
    attitude_rad: FloatArray | None = None
    position_m: FloatArray | None = None
    temperature_c: FloatArray | None = None
    supply_v: FloatArray | None = None

    def arrays(self) -> list[FloatArray]:
        """All that there are."""
        values = (getattr(self, one.name) for one in fields(self))
        return [value for value in values if isinstance(value, np.ndarray)]


def stand_at(stream: Stream | None, instants_s: FloatArray, mean_over_s: float = 0.0) -> StandReport:
    """The report at instants on the stand's clock.

    Args:
        stream: the stand's; None: there is none.
        instants_s: (n,) never decreasing.
        mean_over_s: 0, or the period that ends with each instant and is averaged over.

    Raises:
        RecordingError: a column is in a unit of another quantity.
    """
    if stream is None or len(stream) == 0:
        return StandReport()
    reader = _Reader(stream, stream.time_s(), instants_s, mean_over_s)
    found: dict[str, FloatArray | None] = {
        name: reader.columns(names, quantity, unwrap=quantity == "angle")
        for name, (names, quantity) in _VECTORS.items()
        if stream.has(*names)
    }
    is_crank = stream.has(CRANK) and not any(name in stream.columns for name in GIMBALS)
    gimbals = ("", "", CRANK) if is_crank else GIMBALS
    if any(name in stream.columns for name in gimbals):
        found["angles_rad"] = reader.columns(gimbals, "angle", unwrap=True)
    for name, column, quantity in (
        ("temperature_c", "temp", "temperature"),
        ("supply_v", "supply", "voltage"),
    ):
        if column in stream.columns:
            found[name] = reader.columns((column,), quantity)[:, 0]
    return StandReport(is_crank=is_crank, **found)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class _Reader:
    stream: Stream
    known_s: FloatArray
    instants_s: FloatArray
    mean_over_s: float

    def columns(self, names: tuple[str, ...], quantity: str, unwrap: bool = False) -> FloatArray:
        """(n, k); a column that is not there is 0 (an axis that the stand does not have)."""
        out = np.zeros((len(self.instants_s), len(names)), order="F")
        covered_rows = np.ones(len(self.instants_s), dtype=bool)
        for index, name in enumerate(names):
            if name in self.stream.columns:
                values, known = self._known(name, quantity)
                covered_rows &= known
                out[:, index] = self._at(values, unwrap)
        out[~covered_rows] = np.nan
        return out

    def _known(self, name: str, quantity: str) -> tuple[tuple[FloatArray, FloatArray], NDArray[np.bool_]]:
        """(times, values) of the rows that have one, and which instants those cover."""
        unit = self.stream.units[name]
        if quantity_of(unit) != quantity:
            raise RecordingError(
                f"The column '{name}' is in '{unit}', which measures {quantity_of(unit)}, not {quantity}.",
                where=f"stream {self.stream.name}, column {name}",
                fault=Fault.DATA,
                remedy="correct the column's unit in recording.json.",
            )
        values, times = self.stream.si(name), self.known_s
        there = np.isfinite(values)
        if there.all():
            return (times, values), self._covered_by_all
        values, times = values[there], times[there]
        return (times, values), self._covered(times)

    @cached_property
    def _covered_by_all(self) -> NDArray[np.bool_]:
        return self._covered(self.known_s)

    def _covered(self, times: FloatArray) -> NDArray[np.bool_]:
        longest_s = hole_s(self.known_s)
        now = covered(self.instants_s, times, longest_s)
        if self.mean_over_s:
            now &= covered(self.instants_s - self.mean_over_s, times, longest_s)
        return now

    def _at(self, known: tuple[FloatArray, FloatArray], unwrap: bool) -> FloatArray:
        times, values = known
        if not len(times):
            return np.full(len(self.instants_s), np.nan)
        if unwrap:
            values = np.unwrap(values)
        if not self.mean_over_s:
            return np.interp(self.instants_s, times, values)
        ends = _integral(times, values, self.instants_s)
        return (ends - _integral(times, values, self.instants_s - self.mean_over_s)) / self.mean_over_s


def _integral(times: FloatArray, values: FloatArray, instants: FloatArray) -> FloatArray:
    """(n,) from the first row to each instant, of the straight lines between the rows."""
    steps = np.diff(times)
    up_to = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * steps)])
    row = np.clip(np.searchsorted(times, instants, side="right") - 1, 0, max(len(times) - 2, 0))
    past = instants - times[row]
    return up_to[row] + 0.5 * past * (values[row] + np.interp(instants, times, values))

# pyright: strict
"""The single-axis rate table of paper 4 (LX-10G): ± (5 to 1450) °/s, 0.01 %, and locked.

See `rate_table_model` for its physics and `rate_table_commands` for its command port.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.motion import rate_table_profile as profiles
from dut_emulator.motion.run import EventStream
from dut_emulator.stands.rate_table_commands import RateTablePort
from dut_emulator.stands.rate_table_model import (
    KIND,
    MAX_ACCELERATION_DEG_S2,
    MAX_RATE_DEG_S,
    MIN_RATE_DEG_S,
    RateTableModel,
    TablePlace,
    beyond_acceleration,
    beyond_rate,
    drawn_errors,
)
from dut_emulator.stands.recording_stand import LiveStand, StandIdentity, beyond_limit
from dut_emulator.stands.stand_draws import calibration_due
from protocol.bench_description import Site
from protocol.units_of_measure import factor_to_si

READING_RATE_HZ = 50.0

_READING = (("rate", "deg/s", "xyz"), ("acc", "g", "xyz"), ("angle", "deg", ("outer", "middle", "inner")))


class RateTableRun:
    """A schedule at a place. See `Run`.

    The event stream 'points' has a row for each reading of a point: when it begins, how long it lasts, the
    rate that was commanded, the body axis, the cycle, and the stroke (1 up, −1 down).
    """

    reading_rate_hz = READING_RATE_HZ
    reading_units: Mapping[str, str] = {
        **{f"{name}_{part}": unit for name, unit, parts in _READING for part in parts},
        "temp": "degC",
    }

    def __init__(self, schedule: profiles.TableSchedule, place: TablePlace) -> None:
        self._schedule = schedule
        self._place = place

    @property
    def duration_s(self) -> float:
        """From start to end."""
        return self._schedule.duration_s

    @property
    def trigger_times_s(self) -> FloatArray:
        """The start alone."""
        return np.zeros(1)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What truly acts on the unit; see `Run`."""
        return self._place.stimulus(times_s, *self._schedule.pose_rad(times_s))

    def reading(self, times_s: FloatArray) -> Mapping[str, NDArray[Any]]:
        """What the encoders say."""
        rate, force, angles, _ = self._place.reading(*self._schedule.pose_rad(times_s))
        columns: dict[str, NDArray[Any]] = {}
        for (name, unit, parts), values in zip(_READING, (rate, force, angles), strict=True):
            in_unit = values / factor_to_si(unit)
            columns |= {f"{name}_{part}": in_unit[:, index] for index, part in enumerate(parts)}
        return columns | {"temp": np.full(len(times_s), self._place.temperature_c)}

    def events(self) -> tuple[EventStream, ...]:
        """The readings of points, if there are any."""
        dwells = self._schedule.dwells
        if not dwells:
            return ()
        units = {"t": "s", "duration": "s", "rate": "deg/s", "axis": "1", "cycle": "1", "stroke": "1"}
        columns = {
            "t": np.array([dwell.begin_s for dwell in dwells]),
            "duration": np.array([dwell.duration_s for dwell in dwells]),
            "rate": np.array([dwell.rate_deg_s for dwell in dwells]),
            "axis": np.array([dwell.axis for dwell in dwells], dtype=np.int8),
            "cycle": np.array([dwell.cycle for dwell in dwells], dtype=np.int16),
            "stroke": np.array([dwell.stroke for dwell in dwells], dtype=np.int8),
        }
        return (EventStream("points", units, columns),)


class RateTable:
    """The table as a recording asks of it. See `RecordingStand`."""

    def __init__(self, seed: int, site: Site) -> None:
        self._place = TablePlace(site)
        self._effects = drawn_errors(seed)
        self._identity = StandIdentity(KIND, f"rt-{seed}", calibration_due(KIND, seed))

    @property
    def identity(self) -> StandIdentity:
        """Which table it is."""
        return self._identity

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """Its own errors."""
        return self._effects

    def run(self, profile: str, values: Mapping[str, float]) -> RateTableRun:
        """'eleven_point', or 'static' with the table locked. Raises as `RecordingStand`."""
        match profile:
            case "eleven_point":
                _check(values)
                schedule = profiles.eleven_point_schedule(values)
            case "static":
                schedule = profiles.locked_schedule(values["duration_s"])
            case _:
                raise beyond_limit(
                    KIND, f"A rate table cannot do '{profile}'.", "give 'eleven_point' or 'static'."
                )
        return RateTableRun(schedule, self._place)


def recording_stand(seed: int, site: Site) -> RateTable:
    """A table whose own errors are drawn by `seed`."""
    return RateTable(seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same table behind its command port."""
    table = RateTableModel(site, seed)
    port = RateTablePort(table, f"Testloom,RT1,{identity},1.0", calibration_due(KIND, seed))
    return LiveStand(port, table)


def _check(values: Mapping[str, float]) -> None:
    for name in ("axis", "cycles"):
        if values[name] % 1:
            raise beyond_limit(KIND, f"{name} cannot be {values[name]:g}.", "give a whole number.")
    for rate in profiles.point_rates_deg_s(values["full_scale_rate_deg_s"]):
        text = beyond_rate(rate)
        if text:
            least = MIN_RATE_DEG_S * (profiles.POINTS // 2)
            remedy = f"give a full_scale_rate_deg_s of {least:g} to {MAX_RATE_DEG_S:g} deg/s."
            raise beyond_limit(KIND, f"A point of {text}.", remedy)
    text = beyond_acceleration(values["acceleration_deg_s2"])
    if text:
        remedy = f"give up to {MAX_ACCELERATION_DEG_S2:g} deg/s2."
        raise beyond_limit(KIND, f"An {text}.", remedy)

# pyright: strict
"""A satellite simulator: it plays the signals that a receiver on a track would hear, to a unit at rest.

The unit lies level on the bench; only its receiver is told that it moves. The simulator's own errors: each
channel's power is off by some tenths of a dB, and its time by some ns against the true one; the reference
oscillator is disciplined, so that its rate is right. Its reading says what it plays, not what it should.

Live, a scenario is loaded, started and stopped; without one running there are no signals. Faults: 'no_signal'
(the RF output is dead), 'reference_unlocked' (its time runs away by 1e-7) and 'none'.

Out of scope: multipath and atmosphere in the scenario, interference, several receivers.
"""

import dataclasses
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.profile_catalogue import profile_named
from dut_emulator.motion.run import EventStream
from dut_emulator.motion.satellite_profiles import (
    MAX_SATELLITES,
    NOMINAL_POWER_DBM,
    OFF_DBM,
    SatelliteSignals,
    Track,
    dcm_local_from_body,
    lines_of_sight,
)
from dut_emulator.stands.level_board import LevelBoard
from dut_emulator.stands.recording_stand import StandIdentity, beyond_limit
from dut_emulator.stands.stand_draws import StandDraws, calibration_due
from protocol.bench_description import Site

FloatArray = NDArray[np.float64]

KIND = "satellite_simulator"
READING_RATE_HZ = 10.0
READING_UNITS = {
    **{f"position_{axis}": "m" for axis in ("east", "north", "up")},
    **{f"velocity_{axis}": "m/s" for axis in ("east", "north", "up")},
    "satellites": "1",
}
POWER_LIMITS_DBM = (-165.0, -115.0)
SPEED_LIMIT_M_S, ACCELERATION_LIMIT_M_S2 = 300.0, 50.0
UNLOCKED_RATE = 1e-7
"""By which the time runs away without its reference: a quartz's tolerance."""
_POWER_ERROR_DB, _PULSE_ERROR_S = 0.3, 2e-9
MAX_CHANGES = 4096
"""Of a live simulator, remembered; units ask about the last moments only."""


@dataclass(frozen=True)
class Errors:
    """Of one simulator: each channel's power (dB) and its time (s)."""

    power_db: FloatArray
    pulse_s: float

    @staticmethod
    def drawn(seed: int) -> "Errors":
        """By the simulator's seed."""
        draws = StandDraws(KIND, seed)
        power = [draws.normal(f"power {number}", _POWER_ERROR_DB) for number in range(MAX_SATELLITES)]
        return Errors(np.array(power), draws.normal("pulse", _PULSE_ERROR_S))


@dataclass(frozen=True)
class Scenario:
    """A track and its signals; `duration_s` from its start."""

    name: str
    track: Track
    duration_s: float
    satellites: int
    power_dbm: float


def scenario_of(profile: str, values: Mapping[str, float]) -> Scenario:
    """A profile with all its values as a scenario.

    Raises:
        TestloomError: beyond a limit.
    """
    if profile == "satellite_static":
        track, duration_s = Track(), values["duration_s"]
    elif profile == "satellite_trajectory":
        names = ("rest_s", "acceleration_m_s2", "speed_m_s", "straight_s", "radius_m", "turns")
        track = Track(**{name: values[name] for name in names})
        duration_s = track.duration_s
        _check_motion(track)
    else:
        remedy = "use satellite_static or satellite_trajectory."
        raise beyond_limit(KIND, f"A satellite simulator cannot play '{profile}'.", remedy)
    check_power(values["power_dbm"])
    return Scenario(profile, track, duration_s, round(values["satellites"]), values["power_dbm"])


class SatelliteSimulator:
    """See `RecordingStand`."""

    effects: tuple[CatalogueEffect, ...] = ()

    def __init__(self, seed: int, site: Site) -> None:
        self.identity = StandIdentity(KIND, f"gs-{seed}", calibration_due(KIND, seed))
        self._errors, self._site = Errors.drawn(seed), site

    def run(self, profile: str, values: Mapping[str, float]) -> "SatelliteRun":
        """See `RecordingStand.run`."""
        return SatelliteRun(scenario_of(profile, values), self._errors, LevelBoard(self._site))


@dataclass(frozen=True)
class SatelliteRun:
    """One scenario from its start. See `Run` and `SignalSource`."""

    scenario: Scenario
    errors: Errors
    board: LevelBoard
    reading_rate_hz: float = READING_RATE_HZ

    @property
    def duration_s(self) -> float:
        """Of the scenario."""
        return self.scenario.duration_s

    @property
    def reading_units(self) -> Mapping[str, str]:
        """What is played."""
        return READING_UNITS

    @property
    def trigger_times_s(self) -> FloatArray:
        """The pulses per second; the first is the start."""
        return np.arange(0.0, self.duration_s + 1e-9)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """The bench's, with the track for the receiver."""
        position, _, heading = self.scenario.track.at(times_s)
        acting = self.board.stimulus(times_s)
        dcm = dcm_local_from_body(heading)
        return dataclasses.replace(acting, position_m=position, dcm_local_from_body=dcm)

    def signals(self, times_s: FloatArray) -> SatelliteSignals:
        """Nothing before the start."""
        count = self.scenario.satellites
        power = self.scenario.power_dbm + self.errors.power_db[:count]
        played = np.where(times_s[:, np.newaxis] >= 0.0, power, OFF_DBM)
        return SatelliteSignals(played, lines_of_sight(count), np.full(len(times_s), self.errors.pulse_s))

    def reading(self, times_s: FloatArray) -> Mapping[str, NDArray[Any]]:
        """Position and velocity that are played, and how many satellites."""
        rows = track_rows(self.scenario.track, times_s)
        columns = {name: rows[:, index] for index, name in enumerate(list(READING_UNITS)[:6])}
        return columns | {"satellites": np.full(len(times_s), self.scenario.satellites, dtype=np.uint8)}

    def events(self) -> tuple[EventStream, ...]:
        """None: the pulses are on the trigger line."""
        return ()


@dataclass(frozen=True)
class _Playing:
    """From `from_s` on: power by channel, the scenario and its start, and since when the time runs away."""

    from_s: float
    power_dbm: FloatArray
    scenario: Scenario | None = None
    started_s: float = math.inf
    unlocked_s: float = math.inf


class LiveSatelliteSimulator:
    """A simulator that is operated. Surroundings of a unit, `SignalSource`, and `TriggerLine`: its pulses.

    Every change takes effect at its moment; what was before stays known for `MAX_CHANGES` changes.
    """

    effects: tuple[CatalogueEffect, ...] = ()

    def __init__(self, errors: Errors, site: Site) -> None:
        self._errors, self._board = errors, LevelBoard(site)
        self._dead = False
        self.power_dbm = np.full(MAX_SATELLITES, NOMINAL_POWER_DBM)
        self.count = 12
        self.scenario: Scenario | None = None
        self._started_s = self._unlocked_s = math.inf
        self._changes = deque([_Playing(-math.inf, np.full(MAX_SATELLITES, OFF_DBM))], MAX_CHANGES)

    @property
    def is_locked(self) -> bool:
        """To its reference."""
        return math.isinf(self._unlocked_s)

    @property
    def has_signal(self) -> bool:
        """The RF output works."""
        return not self._dead

    def elapsed_s(self, now_s: float) -> float | None:
        """Since the scenario's start; None when none is running or it is over."""
        passed = now_s - self._started_s
        running = self.scenario is not None and 0 <= passed < self.scenario.duration_s
        return passed if running else None

    def next_edge_s(self, after_s: float) -> float | None:
        """The next pulse per second, on the simulator's own time."""
        if self.scenario is None or math.isinf(self._started_s):
            return None
        late_s = self._errors.pulse_s + UNLOCKED_RATE * max(after_s - self._unlocked_s, 0.0)
        number = max(math.floor(after_s - late_s - self._started_s) + 1, 0)
        if number >= self.scenario.duration_s:
            return None
        edge_s = self._started_s + number + self._errors.pulse_s
        beyond_s = edge_s - self._unlocked_s  # where the time runs away, t − U (t − t_u) is the pulse's
        return edge_s if beyond_s <= 0.0 else self._unlocked_s + beyond_s / (1.0 - UNLOCKED_RATE)

    def load(self, profile: str, values: Mapping[str, float]) -> Scenario:
        """Load a scenario, with its satellites and power. Raises TestloomError: see `scenario_of`."""
        self.scenario = scenario_of(profile, profile_named(profile).values(values))
        self.count = self.scenario.satellites
        self.power_dbm = np.full(MAX_SATELLITES, self.scenario.power_dbm)
        return self.scenario

    def start(self, now_s: float) -> None:
        """Play from its beginning."""
        self._started_s = now_s
        self.changed(now_s)

    def stop(self, now_s: float) -> None:
        """No signals any more."""
        self._started_s = math.inf
        self.changed(now_s)

    def inject(self, fault: str, now_s: float) -> None:
        """Faults as named in the module."""
        self._dead = fault == "no_signal"
        self._unlocked_s = now_s if fault == "reference_unlocked" else math.inf
        self.changed(now_s)

    def changed(self, now_s: float) -> None:
        """What is played from now on is as it is now set."""
        on = np.arange(MAX_SATELLITES) < (0 if self._dead else self.count)
        power = np.where(on, self.power_dbm + self._errors.power_db, OFF_DBM)
        self._changes.append(_Playing(now_s, power, self.scenario, self._started_s, self._unlocked_s))

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """The bench's, with the track for the receiver: where the scenario begins while none is running."""
        position, dcm = np.zeros((len(times_s), 3)), np.zeros((len(times_s), 3, 3))
        for playing, rows in self._parts(times_s):
            track = playing.scenario.track if playing.scenario else Track()
            since_s = np.maximum(times_s[rows] - playing.started_s, 0.0)
            position[rows], _, heading = track.at(since_s)
            dcm[rows] = dcm_local_from_body(heading)
        acting = self._board.stimulus(times_s)
        return dataclasses.replace(acting, position_m=position, dcm_local_from_body=dcm)

    def signals(self, times_s: FloatArray) -> SatelliteSignals:
        """Of all channels; those that are off at −inf."""
        power = np.full((len(times_s), MAX_SATELLITES), OFF_DBM)
        error = np.full(len(times_s), self._errors.pulse_s)
        for playing, rows in self._parts(times_s):
            since_s = times_s[rows] - playing.started_s
            duration_s = playing.scenario.duration_s if playing.scenario else 0.0
            running = (since_s >= 0) & (since_s < duration_s)
            power[rows] = np.where(running[:, np.newaxis], playing.power_dbm, OFF_DBM)
            error[rows] += UNLOCKED_RATE * np.maximum(times_s[rows] - playing.unlocked_s, 0.0)
        return SatelliteSignals(power, lines_of_sight(MAX_SATELLITES), error)

    def _parts(self, times_s: FloatArray) -> list[tuple[_Playing, slice]]:
        """The stretches of these moments between changes."""
        begins = np.array([playing.from_s for playing in self._changes])
        which = np.maximum(np.searchsorted(begins, times_s, side="right") - 1, 0)
        cuts = np.flatnonzero(np.diff(which)) + 1
        edges = [0, *cuts.tolist(), len(times_s)]
        return [
            (self._changes[int(which[begin])], slice(begin, end))
            for begin, end in pairwise(edges)
            if end > begin
        ]


def track_rows(track: Track, times_s: FloatArray) -> FloatArray:
    """(n, 6): position and velocity, east, north, up."""
    position, velocity, _ = track.at(times_s)
    return np.concatenate([position, velocity], axis=1)


def check_power(power_dbm: float) -> None:
    """Raises TestloomError: the simulator has no such power."""
    low, high = POWER_LIMITS_DBM
    if not low <= power_dbm <= high:
        what = f"{power_dbm:g} dBm lies outside the simulator's {low:g} to {high:g} dBm."
        raise beyond_limit(KIND, what, f"give {low:g} to {high:g}.")


def _check_motion(track: Track) -> None:
    centripetal = track.speed_m_s**2 / track.radius_m if track.turns else 0.0
    least_radius_m = track.speed_m_s**2 / ACCELERATION_LIMIT_M_S2
    for name, value, limit, unit, remedy in (
        ("speed", track.speed_m_s, SPEED_LIMIT_M_S, "m/s", f"speed_m_s up to {SPEED_LIMIT_M_S:g}"),
        (
            *("acceleration", track.acceleration_m_s2, ACCELERATION_LIMIT_M_S2, "m/s^2"),
            f"acceleration_m_s2 up to {ACCELERATION_LIMIT_M_S2:g}",
        ),
        (
            *("acceleration on the circle", centripetal, ACCELERATION_LIMIT_M_S2, "m/s^2"),
            f"radius_m of {math.ceil(least_radius_m)} or more, or a lower speed_m_s",
        ),
    ):
        if value > limit:
            what = f"The {name} of {value:.1f} {unit} is above the simulator's limit of {limit:g} {unit}."
            raise beyond_limit(KIND, what, f"give {remedy}.")

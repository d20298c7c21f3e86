# pyright: strict
"""The impact rig of paper 3: a slider strikes a free table, a contact triggers the timer, frames are stamped.

`ImpactRig` runs profiles; `live_rig` has the same rig over bench time. Its own
errors: the strikes scatter, the trigger comes some nanoseconds after the hit and jitters, a programmed
impact misses its instant by some microseconds, the unit sits a little turned. The table has no encoder and
no motor: the rig reports the room's temperature and its triggers, nothing else. The table's axis is vertical
and the unit's body z lies along it; at the start its axes are the laboratory's.

Sources: P3 paper 3 · TL stated by this project where the paper is silent.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dut_emulator import gimbal_geometry as geometry
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.effects.stand import RemountMisalignment
from dut_emulator.motion.impact_profile import (
    Impacts,
    TableResponse,
    since_trigger_s,
)
from dut_emulator.motion.run import EventStream
from dut_emulator.stands.level_board import ROOM_TEMPERATURE_C
from dut_emulator.stands.recording_stand import StandIdentity, beyond_limit
from dut_emulator.stands.stand_draws import StandDraws, calibration_due, cut_normal
from protocol.bench_description import Site
from protocol.impact_rig import stamp_of

FloatArray = NDArray[np.float64]

KIND = "impact_rig"
PROFILE = "impact"

PEAK_RATE_DEG_S = (1.0, 100.0)
"""TL: what the slider's spring can give."""
STRIKE_SPREAD = 0.03
"""TL: relative standard deviation of the jump from strike to strike, cut at three."""
SETTLING_S = 0.05
"""TL: rest before a strike beyond the table's own stop."""
RELEASE_SCATTER_S = 10e-3
"""TL: the slider is released by hand or solenoid; many frames, so that phases are uniform."""
PROGRAMMED_ERROR_S = 2e-6
"""TL: standard deviation of a programmed instant, the paper's outlook, cut at three."""
TRIGGER_JITTER_S = 5e-9
TRIGGER_LATENCY_S = (20e-9, 60e-9)
"""TL: contact and comparator; the timer's count is 108.5 ns."""
REST_BEFORE_S = 0.1
"""TL: least rest that a recording has before a strike: 200 frames at 2 kHz tell σ to 5 %."""
MOUNTING_SPREAD_RAD = 3e-4
TEMPERATURE_RATE_HZ = 10.0


@dataclass(frozen=True)
class RigCharacter:
    """What makes this rig this rig."""

    response: TableResponse
    trigger_latency_s: float
    mounting_rad: tuple[float, float, float]


def draw_character(seed: int) -> RigCharacter:
    """The rig of this seed."""
    draws = StandDraws(KIND, seed)
    response = TableResponse(
        decay_s=0.2 * math.exp(draws.normal("decay", 0.1)),
        dry_rate_rad_s=math.radians(2.0 * math.exp(draws.normal("dry rate", 0.1))),
        ringing=0.15 * math.exp(draws.normal("ringing", 0.1)),
        ringing_rad_s=2 * math.pi * 180.0 * math.exp(draws.normal("ringing frequency", 0.05)),
    )
    latency_s = float(draws.generator("trigger latency").uniform(*TRIGGER_LATENCY_S))
    return RigCharacter(response, latency_s, draws.triple("remount", MOUNTING_SPREAD_RAD))


def strike(peak_rate_deg_s: float, shots: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Jumps (rad/s) and the contact's jitter (s) of so many strikes, each (shots,)."""
    jumps = math.radians(peak_rate_deg_s) * (1.0 + STRIKE_SPREAD * cut_normal(rng, shots))
    return jumps, TRIGGER_JITTER_S * cut_normal(rng, shots)


def scattered_release_s(shots: int, rng: np.random.Generator) -> FloatArray:
    """(shots,) how long after the release the slider strikes, when nothing is programmed."""
    return rng.uniform(0.0, RELEASE_SCATTER_S, shots)


def programmed_error_s(shots: int, rng: np.random.Generator) -> FloatArray:
    """(shots,) how far programmed impacts miss their instants."""
    return PROGRAMMED_ERROR_S * cut_normal(rng, shots)


def rig_effects(character: RigCharacter) -> tuple[CatalogueEffect, ...]:
    """The rig's errors as they act on the gyro it carries."""
    return (RemountMisalignment("gyro", character.mounting_rad),)


class TableSurroundings:
    """What acts on a unit on the rig's table, for any history of impacts."""

    def __init__(self, site: Site) -> None:
        self._earth_rate = geometry.earth_rate_lab_rad_s(site)
        self._gravity = geometry.specific_force_lab_m_s2(site)
        self._field = geometry.field_lab_t(site)

    def stimulus(self, impacts: Impacts, times_s: FloatArray) -> Stimulus:
        """Earth rate and the table's about the vertical; gravity; the field; room temperature."""
        rates, turned = impacts.motion(times_s)
        angles = np.zeros((len(times_s), 3))
        angles[:, 0] = turned
        earth_rate = geometry.into_body(self._earth_rate, angles)
        rate = earth_rate.copy()
        rate[:, 2] += rates
        return Stimulus(
            time_s=times_s,
            temperature_c=np.full(len(times_s), ROOM_TEMPERATURE_C),
            sample_period_s=math.nan,
            rate_rad_s=rate,
            specific_force_m_s2=np.tile(self._gravity, (len(times_s), 1)),
            field_t=geometry.into_body(self._field, angles),
            angles_rad=angles,
            earth_rate_rad_s=earth_rate,
        )


class ImpactRun:
    """K impacts, one in each slot of `spacing_s`; the timer is armed at the slot's start. See `Run`."""

    def __init__(
        self,
        table: TableSurroundings,
        impacts: Impacts,
        triggers_s: FloatArray,
        spacing_s: float,
        frame_rate_hz: float,
    ) -> None:
        self.frame_rate_hz = frame_rate_hz
        self._table, self._impacts, self._triggers_s = table, impacts, triggers_s
        # a frame that comes with the slot's start belongs to it, however the instants are rounded
        self._armed_s: FloatArray = np.arange(len(triggers_s), dtype=np.float64) * spacing_s - 1e-9
        self._duration_s = len(triggers_s) * spacing_s

    @property
    def duration_s(self) -> float:
        """All slots."""
        return self._duration_s

    @property
    def impact_times_s(self) -> FloatArray:
        """(k,) true instants of the hits."""
        return self._impacts.times_s

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """See `Run`."""
        return self._table.stimulus(self._impacts, times_s)

    @property
    def reading_units(self) -> Mapping[str, str]:
        """The room's temperature: a free table has no encoder."""
        return {"temp": "degC"}

    @property
    def reading_rate_hz(self) -> float:
        """Of the temperature."""
        return TEMPERATURE_RATE_HZ

    def reading(self, times_s: FloatArray) -> Mapping[str, FloatArray]:
        """To 0.1 °C."""
        return {"temp": np.full(len(times_s), round(ROOM_TEMPERATURE_C, 1))}

    def events(self) -> tuple[EventStream, ...]:
        """The triggers, with the number of the shot."""
        shots = np.arange(1, len(self._triggers_s) + 1, dtype=np.uint32)
        columns = {"t": self._triggers_s, "shot": shots}
        return (EventStream("trigger", {"t": "s", "shot": "1"}, columns),)

    @property
    def trigger_times_s(self) -> FloatArray:
        """(k,) edges of the contact's pulse."""
        return self._triggers_s

    def stamps(self, received_s: FloatArray) -> NDArray[np.uint16]:
        """See `StampsFrames`."""
        return stamp_of(since_trigger_s(received_s, self._armed_s, self._triggers_s))


class ImpactRig:
    """See `RecordingStand`."""

    def __init__(self, seed: int, site: Site) -> None:
        self._seed = seed
        self._character = draw_character(seed)
        self._table = TableSurroundings(site)

    @property
    def identity(self) -> StandIdentity:
        """Which rig it is."""
        return StandIdentity(KIND, f"IR-{self._seed:04d}", calibration_due(KIND, self._seed))

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """How the unit is mounted."""
        return rig_effects(self._character)

    def run(self, profile: str, values: Mapping[str, float]) -> ImpactRun:
        """Impacts with these values. Raises as `RecordingStand.run`."""
        shots = self._checked(profile, values)
        rng = run_generator(self._seed)
        spacing_s = values["spacing_s"]
        jumps, jitter_s = strike(values["peak_rate_deg_s"], shots, rng)
        slots_s = np.arange(shots) * spacing_s
        # the slot's first part is the last shot's way to rest, its end this shot's
        ready_s = slots_s + REST_BEFORE_S
        if values["next_frame_us"] < 0:
            times_s = ready_s + scattered_release_s(shots, rng)
        else:
            frame_s = 1.0 / values["frame_rate_hz"]
            ahead_s = (values["next_frame_us"] + values["step_us"] * np.arange(shots)) * 1e-6 % frame_s
            frames_s = (np.ceil(ready_s / frame_s - 1e-9) + 1.0) * frame_s
            times_s = frames_s - ahead_s + programmed_error_s(shots, rng)
        impacts = Impacts(times_s, jumps, self._character.response)
        triggers_s = times_s + self._character.trigger_latency_s + jitter_s
        return ImpactRun(self._table, impacts, triggers_s, spacing_s, values["frame_rate_hz"])

    def _checked(self, profile: str, values: Mapping[str, float]) -> int:
        name = self.identity.stand_id
        if profile != PROFILE:
            raise beyond_limit(name, f"The rig cannot do '{profile}'.", f"it can do: {PROFILE}.")
        shots, peak, spacing_s = values["shots"], values["peak_rate_deg_s"], values["spacing_s"]
        if shots != round(shots):
            raise beyond_limit(name, f"{shots:g} shots cannot be fired.", "give a whole number.")
        low, high = PEAK_RATE_DEG_S
        if not low <= peak <= high:
            what = f"The slider cannot strike for {peak:g} deg/s."
            raise beyond_limit(name, what, f"give {low:g} to {high:g} deg/s.")
        least_s = least_spacing_s(self._character.response, peak)
        if spacing_s < least_s:
            raise beyond_limit(
                name,
                f"After a strike of {peak:g} deg/s the table is not at rest for the next one {spacing_s:g} s "
                "later.",
                f"give a spacing of at least {math.ceil(least_s * 100) / 100:g} s, or strike more gently.",
            )
        return round(shots)


def least_spacing_s(response: TableResponse, peak_rate_deg_s: float) -> float:
    """From strike to strike with the hardest of this setting: its way to rest, settling, rest, scatter."""
    hardest = math.radians(peak_rate_deg_s) * (1 + 3 * STRIKE_SPREAD)
    return response.stop_s(hardest) + SETTLING_S + REST_BEFORE_S + RELEASE_SCATTER_S


def run_generator(seed: int) -> np.random.Generator:
    """What the rig of this seed draws its strikes from, in a recording and on a bench."""
    return StandDraws(KIND, seed).generator("run")

# pyright: strict
"""The impact rig over bench time, and the stream of its acquisition module."""

import math

import numpy as np
from numpy.typing import NDArray

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import Stimulus
from dut_emulator.motion.impact_profile import Impacts, since_trigger_s
from dut_emulator.stands.command_port import ERR_ARGUMENTS, Refused
from dut_emulator.stands.impact_rig import rig as rig_model
from protocol.bench_description import Site
from protocol.impact_rig import RECORD_DTYPE, make_records, stamp_of

FloatArray = NDArray[np.float64]

ERR_BUSY, ERR_NOT_ARMED, ERR_LIMIT, ERR_DOOR_OPEN = 10, 11, 12, 14

COCKING_S = 0.5
PROGRAMMED_AHEAD_S = (0.02, 10.0)
DEFAULT_PEAK_DEG_S = 40.0
SENDING_PERIOD_S = 0.05
"""Records leave the module at the latest so long after those before."""
MAX_KEPT = 256
"""Strikes, triggers and armings that are remembered: nobody asks about frames so long past."""


class RecordStream:
    """The acquisition module's records, one for each frame of the unit; they bring their own times.

    See `Stream`.
    """

    def __init__(self) -> None:
        self._from_s = math.inf
        self._sent_s = -math.inf
        self._pending: list[bytes] = []

    @property
    def sample_bytes(self) -> int:
        """See `Stream`."""
        return RECORD_DTYPE.itemsize

    def switch(self, arguments: list[str], now_s: float) -> None:
        """`ON` or `OFF`. Raises Refused."""
        order = ",".join(arguments).upper()
        if order not in ("ON", "OFF"):
            raise Refused(ERR_ARGUMENTS, "STRE takes ON or OFF")
        self._from_s = now_s if order == "ON" else math.inf
        self._sent_s = now_s

    def wants(self, received_s: FloatArray) -> NDArray[np.bool_]:
        """Whether frames that came at these times (n,) leave on the stream: (n,)."""
        return received_s >= self._from_s

    def add(self, records: bytes) -> None:
        """Records that are to leave."""
        self._pending.append(records)

    def sample_to(self, now_s: float) -> None:
        """Nothing: frames come by themselves."""

    def hand_over(self, to_s: float) -> bytes:
        """What has been stamped since the last call."""
        self._sent_s = to_s
        records = b"".join(self._pending)
        self._pending.clear()
        return records

    def next_event_s(self) -> float | None:
        """When the module sends what it has got."""
        return self._sent_s + SENDING_PERIOD_S if math.isfinite(self._from_s) else None


class LiveImpactRig:
    """The rig over bench time. See `Surroundings` and `TakesFrames`; commands get the bench time."""

    def __init__(self, seed: int, site: Site) -> None:
        self._character = rig_model.draw_character(seed)
        self._table = rig_model.TableSurroundings(site)
        self._rng = rig_model.run_generator(seed)
        self._impacts = Impacts(np.empty(0), np.empty(0), self._character.response)
        self._triggers_s = np.empty(0)
        self._armed_s = np.empty(0)
        self._forgotten_triggers = 0
        self._cocked_from_s = math.inf
        self._rest_from_s = -math.inf
        self.stream = RecordStream()
        self.peak_deg_s = DEFAULT_PEAK_DEG_S
        self.shots = 0
        self.fault = "none"

    @property
    def effects(self) -> tuple[CatalogueEffect, ...]:
        """How the unit is mounted."""
        return rig_model.rig_effects(self._character)

    def stimulus(self, times_s: FloatArray) -> Stimulus:
        """What acts on the unit."""
        return self._table.stimulus(self._impacts, times_s)

    def take_frames(self, frames: NDArray[np.uint8], received_s: FloatArray) -> None:
        """Stamp the unit's frames; they leave on the stream from when somebody has switched it on."""
        wanted = self.stream.wants(received_s)
        if wanted.any():
            since = since_trigger_s(received_s[wanted], self._armed_s, self._triggers_s)
            self.stream.add(make_records(frames[wanted], stamp_of(since), received_s[wanted]))

    def set_peak(self, peak_deg_s: float) -> None:
        """How hard the next strikes are."""
        low, high = rig_model.PEAK_RATE_DEG_S
        if not low <= peak_deg_s <= high:
            raise Refused(ERR_LIMIT, f"the slider gives {low:g} to {high:g} deg/s")
        self.peak_deg_s = peak_deg_s

    def arm(self, now_s: float) -> float:
        """Cock the slider, reset the timer: how long it takes."""
        self._check_free(now_s)
        self._cocked_from_s = now_s + COCKING_S
        self._armed_s = np.append(self._armed_s, now_s)[-MAX_KEPT:]
        return COCKING_S

    def safe(self, now_s: float) -> None:
        """Let the slider down."""
        self._check_free(now_s)
        self._cocked_from_s = math.inf

    def fire(self, at_s: float | None, now_s: float) -> float:
        """Strike at a programmed instant, or when the slider comes: time from now until the table rests."""
        self._check_free(now_s)
        if now_s < self._cocked_from_s:
            raise Refused(ERR_NOT_ARMED, "the slider is not cocked")
        if at_s is None:
            error_s = float(rig_model.scattered_release_s(1, self._rng)[0])
        else:
            low, high = PROGRAMMED_AHEAD_S
            if not low <= at_s - now_s <= high:
                raise Refused(ERR_LIMIT, f"give an instant {low:g} to {high:g} s ahead")
            error_s = float(rig_model.programmed_error_s(1, self._rng)[0])
        impact_s = (now_s if at_s is None else at_s) + error_s
        jumps, jitter_s = rig_model.strike(self.peak_deg_s, 1, self._rng)
        self._cocked_from_s = math.inf
        if self.fault == "slider_stuck":
            self._rest_from_s = impact_s
            return impact_s - now_s
        self.shots += 1
        self._impacts = self._impacts.with_impact(impact_s, float(jumps[0]), MAX_KEPT)
        if self.fault != "no_trigger":
            trigger_s = impact_s + self._character.trigger_latency_s + float(jitter_s[0])
            self._forgotten_triggers += len(self._triggers_s) == MAX_KEPT
            self._triggers_s = np.append(self._triggers_s, trigger_s)[-MAX_KEPT:]
        self._rest_from_s = impact_s + self._character.response.stop_s(float(jumps[0]))
        return self._rest_from_s - now_s

    def triggers(self, now_s: float) -> int:
        """How many the timer has seen."""
        return self._forgotten_triggers + int(np.searchsorted(self._triggers_s, now_s, side="right"))

    def least_spacing_s(self) -> float:
        """Between strikes at the present setting."""
        return rig_model.least_spacing_s(self._character.response, self.peak_deg_s)

    def status(self, now_s: float) -> str:
        """What `STAT?` says."""
        if self.fault == "door_open":
            state = "FAULT"
        elif now_s < self._rest_from_s:
            state = "MOVING"
        elif math.isinf(self._cocked_from_s):
            state = "SAFE"
        else:
            state = "ARMED" if now_s >= self._cocked_from_s else "COCKING"
        since = since_trigger_s(np.array([now_s]), self._armed_s, self._triggers_s)
        return f"{state},{self.shots},{int(not np.isnan(since[0]))}"

    def inject(self, fault: str) -> None:
        """An open door lets the slider down; what already moves, moves on."""
        self.fault = fault
        if fault == "door_open":
            self._cocked_from_s = math.inf

    def _check_free(self, now_s: float) -> None:
        if self.fault == "door_open":
            raise Refused(ERR_DOOR_OPEN, "the door is open")
        if now_s < self._rest_from_s:
            raise Refused(ERR_BUSY, "the table is not at rest, or a strike is due")

# pyright: strict
"""The thermal turntable of paper 2, section 4.2: one horizontal axis without stops inside a chamber.

Whichever body axis lies along the stand's, positions of the other two are reached; the third takes another
mount. Mounts in the names of `gimbal_geometry`: 1, body x along the axis, which is the inner one; 2, body y,
the middle one; 3, body z, the middle one with the inner at −90°. The probe is in the air; the unit is a
little nearer to room temperature and follows with a lag: the stand's 'chamber_gradient' and 'chamber_lag'.

The open door lets the room in: the air goes to room temperature at `DOOR_RAMP_C_PER_MIN`.
"""

import numpy as np

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import FloatArray
from dut_emulator.interfaces import StandRefusal
from dut_emulator.motion.chamber import ROOM_C, AirPath
from dut_emulator.motion.schedule import Drives
from dut_emulator.stands.recording_stand import LiveStand
from dut_emulator.stands.stand_draws import calibration_due
from dut_emulator.stands.turntable_commands import TurntablePort
from dut_emulator.stands.turntable_errors import (
    ARC_SECOND_RAD,
    TurntableSpec,
    drawn_effects,
)
from dut_emulator.stands.turntable_model import (
    ERR_ARGUMENT,
    ERR_DOOR_OPEN,
    ERR_LIMIT,
    EncoderErrors,
    TurntableModel,
)
from dut_emulator.stands.turntable_run import ChamberLimits, RecordingTurntable, TurntableKind
from protocol.bench_description import Site

DOOR_RAMP_C_PER_MIN = 20.0

DRIVES = Drives((0.0, 0.0, 400.0), (0.0, 0.0, 250.0))
CHAMBER = ChamberLimits()
SPEC = TurntableSpec(
    wobble_rad=5 * ARC_SECOND_RAD,
    eccentricity_rad=5 * ARC_SECOND_RAD,
    rate_ripple=1e-4,
    rate_scale_factor=5e-5,
    remount_misalignment_rad=1e-3,
    chamber_lag_s=180.0,
    chamber_gradient=0.03,
)
KIND = TurntableKind(
    "thermal_turntable",
    "ttc",
    DRIVES,
    SPEC,
    CHAMBER,
    mounts={
        2: Drives((0.0, 400.0, 0.0), (0.0, 250.0, 0.0)),
        3: Drives((0.0, 400.0, 0.0), (0.0, 250.0, 0.0), home_deg=(0.0, 0.0, -90.0)),
    },
)


class ThermalTurntableModel(TurntableModel):
    """The axis and the air around it, over bench time."""

    def __init__(
        self, site: Site, encoders: EncoderErrors, effects: tuple[CatalogueEffect, ...] = ()
    ) -> None:
        super().__init__(site, DRIVES, encoders, effects=effects)
        self._air = AirPath.steady(ROOM_C)
        self._target_c = ROOM_C

    def temperature_c(self, times_s: FloatArray) -> FloatArray:
        """(n,) of the air at the probe."""
        return self._air.at(times_s)

    def set_temperature(self, target_c: float, ramp_c_per_min: float, now_s: float) -> float | StandRefusal:
        """Begin a ramp of the air; the time that it takes in s."""
        if self.status(now_s).state == "FAULT":
            return StandRefusal(ERR_DOOR_OPEN, "door open")
        if not CHAMBER.low_c <= target_c <= CHAMBER.high_c:
            text = f"{target_c:g} degC outside {CHAMBER.low_c:g} to {CHAMBER.high_c:g} degC"
            return StandRefusal(ERR_LIMIT, text)
        if ramp_c_per_min <= 0:
            return StandRefusal(ERR_ARGUMENT, "the ramp must be above 0")
        if ramp_c_per_min > CHAMBER.ramp_c_per_min:
            text = f"ramp {ramp_c_per_min:g} degC/min above the limit of {CHAMBER.ramp_c_per_min:g} degC/min"
            return StandRefusal(ERR_LIMIT, text)
        return self._tell(target_c, ramp_c_per_min, now_s)

    def temperatures_c(self, now_s: float) -> tuple[float, float]:
        """Of the air at the probe, and the set point."""
        return float(self._air.at(np.array([now_s]))[0]), self._target_c

    def inject(self, fault: str, now_s: float) -> None:
        """As every turntable; the open door lets the room in, and the air stays where it is when it shuts."""
        was_open = self._fault == "door_open"
        super().inject(fault, now_s)
        if fault == "door_open":
            self._tell(ROOM_C, DOOR_RAMP_C_PER_MIN, now_s)
        elif was_open:
            self._tell(self.temperatures_c(now_s)[0], DOOR_RAMP_C_PER_MIN, now_s)

    def _tell(self, target_c: float, ramp_c_per_min: float, now_s: float) -> float:
        self._air = self._air.told(target_c, ramp_c_per_min, now_s)
        self._target_c = target_c
        return self._air.times_s[-1] - now_s


def recording_stand(seed: int, site: Site) -> RecordingTurntable:
    """The stand whose errors this seed draws, for recordings."""
    return RecordingTurntable(KIND, seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same stand behind its command port."""
    table = ThermalTurntableModel(
        site, EncoderErrors(seed=seed), drawn_effects(KIND.name, seed, SPEC, DRIVES)
    )
    identification = f"Testloom,TTC,{identity},1.0"
    return LiveStand(TurntablePort(table, identification, calibration_due(KIND.name, seed), table), table)

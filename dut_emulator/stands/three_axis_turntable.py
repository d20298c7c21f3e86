# pyright: strict
"""The three-axis turntable: outer and middle axis to 400 °/s, inner to 1000 °/s, all without stops."""

import dataclasses

from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.motion.schedule import Drives, Triple
from dut_emulator.stands.level_board import ROOM_TEMPERATURE_C
from dut_emulator.stands.recording_stand import LiveStand
from dut_emulator.stands.stand_draws import calibration_due
from dut_emulator.stands.turntable_commands import TurntablePort
from dut_emulator.stands.turntable_errors import TurntableSpec, drawn_effects
from dut_emulator.stands.turntable_model import (
    ERR_ARGUMENT,
    ERR_BUSY,
    ERR_DOOR_OPEN,
    ERR_LIMIT,
    ERR_NO_MARK,
    ERR_NO_REFERENCE,
    EncoderErrors,
    TurntableModel,
)
from dut_emulator.stands.turntable_run import RecordingTurntable, TurntableKind
from protocol.bench_description import Site

__all__ = [
    "ERR_ARGUMENT",
    "ERR_BUSY",
    "ERR_DOOR_OPEN",
    "ERR_LIMIT",
    "ERR_NO_MARK",
    "ERR_NO_REFERENCE",
    "ROOM_TEMPERATURE_C",
    "EncoderErrors",
    "ThreeAxisTurntableModel",
    "live_stand",
    "recording_stand",
]

DRIVES = Drives((400.0, 400.0, 1000.0), (250.0, 250.0, 500.0))
SPEC = TurntableSpec()
LIVE_SPEC = dataclasses.replace(SPEC, remount_misalignment_rad=5e-6)
"""On a bench the sockets stay on the table and are aligned by autocollimator once; for a recording a unit is
mounted by hand."""
KIND = TurntableKind("three_axis_turntable", "tt3", DRIVES, SPEC)


class ThreeAxisTurntableModel(TurntableModel):
    """A turntable with all three drives; without `effects` it does what it says."""

    def __init__(
        self,
        site: Site,
        limits: Drives | None = None,
        encoders: EncoderErrors | None = None,
        lever_arm_m: Triple = (0.0, 0.0, 0.0),
        temperature_c: float = ROOM_TEMPERATURE_C,
        effects: tuple[CatalogueEffect, ...] = (),
    ) -> None:
        super().__init__(site, limits or DRIVES, encoders, lever_arm_m, temperature_c, effects)


def recording_stand(seed: int, site: Site) -> RecordingTurntable:
    """The stand whose errors this seed draws, for recordings."""
    return RecordingTurntable(KIND, seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same stand behind its command port; its sockets are aligned better."""
    effects = drawn_effects(KIND.name, seed, LIVE_SPEC, DRIVES)
    table = ThreeAxisTurntableModel(site, encoders=EncoderErrors(seed=seed), effects=effects)
    return LiveStand(
        TurntablePort(table, f"Testloom,TT3,{identity},1.0", calibration_due(KIND.name, seed)), table
    )

# pyright: strict
"""The non-magnetic turntable of paper 1, section 5.4: one horizontal axis along north, to 15 rev/s.

The unit's z axis lies along it, so that x and y go through the vertical component of the field and the small
eastern one. In the names of `gimbal_geometry` it is the middle axis, with the inner one at −90° and the
outer one at the heading. The motor is far away and shielded: what of its field is left is the stand's
'motor_field'.
"""

from dut_emulator.motion.schedule import Drives
from dut_emulator.stands.recording_stand import LiveStand
from dut_emulator.stands.stand_draws import calibration_due
from dut_emulator.stands.turntable_commands import TurntablePort
from dut_emulator.stands.turntable_errors import (
    ARC_SECOND_RAD,
    TurntableSpec,
    drawn_effects,
)
from dut_emulator.stands.turntable_model import EncoderErrors, TurntableModel
from dut_emulator.stands.turntable_run import RecordingTurntable, TurntableKind
from protocol.bench_description import Site

NAME = "non_magnetic_turntable"
SPEC = TurntableSpec(
    wobble_rad=10 * ARC_SECOND_RAD,
    eccentricity_rad=10 * ARC_SECOND_RAD,
    rate_ripple=2e-4,
    rate_scale_factor=1e-4,
    remount_misalignment_rad=5e-4,
    motor_field_t=2e-8,
)


def _drives(site: Site) -> Drives:
    return Drives(
        (0.0, 5400.0, 0.0),
        (0.0, 1000.0, 0.0),
        positioning_acceleration_deg_s2=1000.0,
        home_deg=(site.heading_deg, 0.0, -90.0),
    )


def _kind(site: Site) -> TurntableKind:
    return TurntableKind(NAME, "ttn", _drives(site), SPEC, moving_rate_hz=1000.0)


def recording_stand(seed: int, site: Site) -> RecordingTurntable:
    """The stand whose errors this seed draws, for recordings."""
    return RecordingTurntable(_kind(site), seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same stand behind its command port."""
    drives = _drives(site)
    effects = drawn_effects(NAME, seed, SPEC, drives)
    table = TurntableModel(site, drives, EncoderErrors(seed=seed), effects=effects)
    return LiveStand(TurntablePort(table, f"Testloom,TTN,{identity},1.0", calibration_due(NAME, seed)), table)

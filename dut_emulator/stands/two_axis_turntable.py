# pyright: strict
"""The two-axis turntable of paper 2, section 4.2: both axes turn without stops, in a room.

One mount must reach all six positions, so the outer of its two axes is horizontal. In the names of
`gimbal_geometry` it is the middle one; what is called 'outer' there, the vertical axis, stays at 0.
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

DRIVES = Drives((0.0, 400.0, 600.0), (0.0, 250.0, 500.0))
SPEC = TurntableSpec(
    wobble_rad=3 * ARC_SECOND_RAD,
    eccentricity_rad=4 * ARC_SECOND_RAD,
    rate_ripple=5e-5,
    non_orthogonality_rad=3 * ARC_SECOND_RAD,
    rate_scale_factor=2e-5,
    remount_misalignment_rad=2e-4,
)
KIND = TurntableKind("two_axis_turntable", "tt2", DRIVES, SPEC)


def recording_stand(seed: int, site: Site) -> RecordingTurntable:
    """The stand whose errors this seed draws, for recordings."""
    return RecordingTurntable(KIND, seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same stand behind its command port."""
    effects = drawn_effects(KIND.name, seed, SPEC, DRIVES)
    table = TurntableModel(site, DRIVES, EncoderErrors(seed=seed), effects=effects)
    return LiveStand(
        TurntablePort(table, f"Testloom,TT2,{identity},1.0", calibration_due(KIND.name, seed)), table
    )

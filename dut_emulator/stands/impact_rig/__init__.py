# pyright: strict
"""The impact rig of paper 3: strikes at known instants, for recordings and on a bench."""

from dut_emulator.stands.impact_rig.live_rig import LiveImpactRig
from dut_emulator.stands.impact_rig.port import ImpactRigPort
from dut_emulator.stands.impact_rig.rig import KIND, ImpactRig
from dut_emulator.stands.recording_stand import LiveStand, RecordingStand
from dut_emulator.stands.stand_draws import calibration_due
from protocol.bench_description import Site


def recording_stand(seed: int, site: Site) -> RecordingStand:
    """The rig of this seed."""
    return ImpactRig(seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same rig behind its command port. `identity`: the stand's serial number."""
    rig = LiveImpactRig(seed, site)
    return LiveStand(ImpactRigPort(rig, identity, calibration_due(KIND, seed)), rig)

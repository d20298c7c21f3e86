# pyright: strict
"""The sinusoidal overload rig of paper 5: 1 to 12 g on a crank, for recordings and on a bench.

Crank and flywheel are in `dut_emulator.motion.crank`; here are its drive, its slide, its limits and its port.
"""

from dut_emulator.stands.recording_stand import LiveStand, RecordingStand
from dut_emulator.stands.sinusoidal_overload_rig.live_rig import LiveOverloadRig
from dut_emulator.stands.sinusoidal_overload_rig.port import OverloadPort
from dut_emulator.stands.sinusoidal_overload_rig.rig import KIND, RigErrors, SinusoidalOverloadRig
from dut_emulator.stands.stand_draws import calibration_due
from protocol.bench_description import Site


def recording_stand(seed: int, site: Site) -> RecordingStand:
    """A rig whose own errors are drawn by `seed`."""
    return _rig(seed, site, f"overload-rig-{seed}")


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same rig behind its command port."""
    rig = LiveOverloadRig(_rig(seed, site, identity))
    port = OverloadPort(rig, f"Testloom,SOR,{identity},1.0")
    return LiveStand(port, rig, trigger_line=port)


def _rig(seed: int, site: Site, stand_id: str) -> SinusoidalOverloadRig:
    due = calibration_due(KIND, seed)
    return SinusoidalOverloadRig(site, RigErrors.drawn(seed), stand_id=stand_id, calibration_due=due)

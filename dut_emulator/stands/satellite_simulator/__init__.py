# pyright: strict
"""The satellite simulator: scenarios on its outputs, for recordings and on a bench."""

from dut_emulator.stands.recording_stand import LiveStand, RecordingStand
from dut_emulator.stands.satellite_simulator.port import SatelliteSimulatorPort
from dut_emulator.stands.satellite_simulator.simulator import (
    KIND,
    Errors,
    LiveSatelliteSimulator,
    SatelliteSimulator,
)
from dut_emulator.stands.stand_draws import calibration_due
from protocol.bench_description import Site


def recording_stand(seed: int, site: Site) -> RecordingStand:
    """A simulator whose errors are drawn by `seed`."""
    return SatelliteSimulator(seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same behind its command port."""
    model = LiveSatelliteSimulator(Errors.drawn(seed), site)
    port = SatelliteSimulatorPort(model, f"Testloom,GS1,{identity},1.0", calibration_due(KIND, seed))
    return LiveStand(port, model, model)

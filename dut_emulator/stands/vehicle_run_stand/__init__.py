# pyright: strict
"""A vehicle with a reference on board: drives and flights, for recordings and on a bench."""

from dut_emulator.stands.recording_stand import LiveStand
from dut_emulator.stands.vehicle_run_stand.port import VehiclePort
from dut_emulator.stands.vehicle_run_stand.stand import VehicleRunStand
from protocol.bench_description import Site


def recording_stand(seed: int, site: Site) -> VehicleRunStand:
    """A vehicle with its reference; `seed` draws its errors."""
    return VehicleRunStand(seed, site)


def live_stand(seed: int, site: Site, identity: str) -> LiveStand:
    """The same behind its command port."""
    port = VehiclePort(VehicleRunStand(seed, site), site, identity)
    return LiveStand(port, port)

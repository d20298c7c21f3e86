# pyright: strict
"""Which benches there are: what stands on each, which products it takes, how they are wired.

A socket board has needles, CAN and instruments for one product; a stand wires a unit's power and its own
links through. Which profiles run where is the products' matter; a test holds this table to theirs.
"""

from dataclasses import dataclass
from typing import Literal

from dut_emulator.server.link_faults import Framing

SOCKET_BOARD = "socket_board"

Instrument = Literal["serial_multimeter", "pulse_counter"]


@dataclass(frozen=True)
class Wiring:
    """How a stand connects a product: links with their framing, or an instrument at its outputs.

    `supply_v`: the nominal supply voltage of the product.
    """

    supply_v: float
    links: tuple[tuple[str, Framing], ...] = ()
    instrument: Instrument | None = None


WIRING: dict[str, Wiring] = {
    "gnc_module": Wiring(5.0, (("rs422", Framing.RS422),)),
    "mems_ahrs": Wiring(5.0, (("rs422", Framing.RS422),)),
    "fog": Wiring(5.0, (("rs422", Framing.UNFRAMED),)),
    "rate_gyro_triad": Wiring(15.0, instrument="serial_multimeter"),
    "pulse_imu": Wiring(12.0, instrument="pulse_counter"),
}
"""Product → how a stand connects it."""


@dataclass(frozen=True)
class BenchKind:
    """A kind of bench. `products`: those it takes, the usual one first."""

    products: tuple[str, ...]
    sockets: int = 1


BENCH_KINDS: dict[str, BenchKind] = {
    SOCKET_BOARD: BenchKind(("gnc_module",), sockets=2),
    "three_axis_turntable": BenchKind(("gnc_module", "fog", "pulse_imu")),
    "two_axis_turntable": BenchKind(("mems_ahrs",)),
    "thermal_turntable": BenchKind(("mems_ahrs", "fog")),
    "non_magnetic_turntable": BenchKind(("gnc_module",)),
    "rate_table": BenchKind(("rate_gyro_triad",)),
    "impact_rig": BenchKind(("fog",)),
    "sinusoidal_overload_rig": BenchKind(("pulse_imu",)),
    "satellite_simulator": BenchKind(("gnc_module",)),
    "vehicle_run_stand": BenchKind(("mems_ahrs", "gnc_module")),
}

OPERATIONS: dict[tuple[str, str], tuple[str, ...]] = {
    (SOCKET_BOARD, "gnc_module"): ("functional",),
    ("three_axis_turntable", "gnc_module"): ("imu_calibration",),
}
"""Kind and product → the operations that a station has a plan for; on others it serves steps by hand."""

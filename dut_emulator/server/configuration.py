"""What a bench server is to be: checked before anything listens."""

import hashlib
import zlib
from dataclasses import dataclass
from pathlib import Path

from dut_emulator.server.bench_kinds import BENCH_KINDS, OPERATIONS, SOCKET_BOARD
from protocol.bench_description import Site
from protocol.errors import Fault, TestloomError

SERIAL_KINDS = ("socket", "pty")
MAX_SOCKETS = 16
MAX_PACE = 1000.0
PORTS_PER_SOCKET = 3
FIXED_PORTS = 7


@dataclass(frozen=True)
class BenchServerConfiguration:
    """One bench.

    Attributes:
        name: of the bench, as stations know it.
        kind: one of `BENCH_KINDS`.
        sockets: how many; None for the kind's usual number.
        seed: of the lot (which units exist) and of the instruments' calibration states.
        units_dir: where units keep their flash; shared by the benches of a line, closed to stations.
        description: the BenchDescription file that is written when everything listens.
        pace: 0 for lock-step, else bench seconds per second of the wall clock.
        serial: links of units as TCP ports or ptys.
        latitude_deg, gravity_m_s2, heading_deg: the site, as in BenchDescription.
        port_base: first of consecutive TCP ports; 0 for free ones.
        identity: the fixture's own serial number; empty: derived from name, kind and seed.
        product: of the units that are tested here; empty: the kind's usual one.
        twin: the twin file that every unit here is made of; None: each as the lot draws it.
    """

    name: str
    kind: str
    units_dir: Path
    description: Path
    sockets: int | None = None
    seed: int = 1
    pace: float = 0.0
    serial: str = "socket"
    latitude_deg: float = 39.96
    gravity_m_s2: float = 9.8013
    heading_deg: float = 0.0
    port_base: int = 0
    identity: str = ""
    product: str = ""
    twin: Path | None = None

    def __post_init__(self) -> None:
        """Raises TestloomError for what cannot be a bench."""
        products = BENCH_KINDS[self.kind].products if self.kind in BENCH_KINDS else ()
        last_port = self.port_base + FIXED_PORTS + PORTS_PER_SOCKET * self.socket_count
        plain = bool(self.name) and self.name.isprintable() and "/" not in self.name
        most = MAX_SOCKETS if self.kind == SOCKET_BOARD else 1
        ports_fit = self.port_base == 0 or (self.port_base >= 1024 and last_port <= 65_535)
        for option, given, good, expected in (
            ("name", self.name, plain, "a plain word"),
            ("kind", self.kind, self.kind in BENCH_KINDS, f"one of {', '.join(BENCH_KINDS)}"),
            ("product", self.product, self.unit_product in products, f"one of {', '.join(products)}"),
            ("serial", self.serial, self.serial in SERIAL_KINDS, f"one of {', '.join(SERIAL_KINDS)}"),
            ("sockets", self.socket_count, 1 <= self.socket_count <= most, f"1 to {most}"),
            ("seed", self.seed, 0 <= self.seed < 2**63, "a number from 0 to 2^63 - 1"),
            ("pace", self.pace, 0 <= self.pace <= MAX_PACE, f"0 (lock-step) to {MAX_PACE:g}"),
            ("latitude", self.latitude_deg, abs(self.latitude_deg) <= 90, "-90 to 90 degrees"),
            ("gravity", self.gravity_m_s2, 9.7 < self.gravity_m_s2 < 9.9, "9.7 to 9.9 m/s^2"),
            ("heading", self.heading_deg, abs(self.heading_deg) <= 360, "-360 to 360 degrees"),
            ("port-base", self.port_base, ports_fit, "0 (free ports), or 1024 to 65535 with room for all"),
            (
                "pace",
                self.pace,
                self.pace > 0 or self.serial != "pty",
                "more than 0 with a pty: it counts no bytes",
            ),
        ):
            if not good:
                raise TestloomError(
                    f"A bench cannot have the {option} '{given}'.",
                    where=f"bench '{self.name}', option --{option}",
                    fault=Fault.OPERATOR,
                    remedy=f"give {expected}.",
                )

    @property
    def socket_count(self) -> int:
        """How many sockets."""
        kind = BENCH_KINDS.get(self.kind)
        return self.sockets if self.sockets is not None else kind.sockets if kind else 1

    @property
    def unit_product(self) -> str:
        """The product of the units that are tested here."""
        kind = BENCH_KINDS.get(self.kind)
        return self.product or (kind.products[0] if kind else "")

    @property
    def operations(self) -> tuple[str, ...]:
        """What a station can do here by a plan."""
        return OPERATIONS.get((self.kind, self.unit_product), ())

    @property
    def site(self) -> Site:
        """Where the bench stands."""
        return Site(
            latitude_deg=self.latitude_deg, gravity_m_s2=self.gravity_m_s2, heading_deg=self.heading_deg
        )

    @property
    def instrument_seed(self) -> int:
        """Of the errors of this bench's own instruments and stand: other benches of the line have others."""
        return zlib.crc32(f"{self.bench_identity}|{self.seed}".encode())

    @property
    def bench_identity(self) -> str:
        """The fixture's serial number: the same after a restart, another for another bench."""
        if self.identity:
            return self.identity
        digest = hashlib.sha256(f"{self.name}|{self.kind}|{self.seed}".encode()).hexdigest()
        return f"TLB-{digest[:10].upper()}"

"""`testloom bench`: serve an emulated bench over real links, on its own clock."""

from pathlib import Path
from typing import Annotated, Any

import typer

from protocol.language import say


def _option(name: str, help_text: str) -> Any:
    return typer.Option(f"--{name}", help=help_text)


Name = Annotated[str, _option("name", say("Name of the bench."))]
UnitsDir = Annotated[
    Path, _option("units-dir", say("Where units keep their flash; shared by a line's benches."))
]
Description = Annotated[
    Path, _option("description", say("The file that tells a station what the bench offers."))
]
Kind = Annotated[str, _option("kind", say("socket_board, or the kind of stand."))]
Sockets = Annotated[
    int | None, _option("sockets", say("Number of sockets; the kind's usual one if left out."))
]
Seed = Annotated[int, _option("seed", say("Seed of the lot and of the instruments' errors."))]
Pace = Annotated[
    float, _option("pace", say("0: lock-step; else bench seconds per second of the wall clock."))
]
Serial = Annotated[
    str, _option("serial", say("Links of units as TCP ports (socket) or pseudo terminals (pty)."))
]
Latitude = Annotated[float, _option("latitude", say("Latitude of the site in degrees."))]
Gravity = Annotated[float, _option("gravity", say("Gravity at the site in m/s^2."))]
Heading = Annotated[
    float, _option("heading", say("Azimuth of the stand's y axis in degrees, east of north."))
]
PortBase = Annotated[int, _option("port-base", say("First of consecutive TCP ports; 0 for free ones."))]
Product = Annotated[
    str, _option("product", say("Product of the units tested here; the kind's usual one if left out."))
]
Twin = Annotated[
    Path | None, _option("twin", say("Twin file that every unit here is made of; drawn if left out."))
]
Identity = Annotated[str, _option("identity", say("The fixture's own serial number; derived if left out."))]


def bench(
    name: Name,
    units_dir: UnitsDir,
    description: Description,
    kind: Kind = "socket_board",
    sockets: Sockets = None,
    seed: Seed = 1,
    pace: Pace = 0.0,
    serial: Serial = "socket",
    latitude: Latitude = 39.96,
    gravity: Gravity = 9.8013,
    heading: Heading = 0.0,
    port_base: PortBase = 0,
    identity: Identity = "",
    product: Product = "",
    twin: Twin = None,
) -> None:
    from dut_emulator.server.assembly import run_bench
    from dut_emulator.server.configuration import BenchServerConfiguration

    configuration = BenchServerConfiguration(
        name=name,
        kind=kind,
        units_dir=units_dir,
        description=description,
        sockets=sockets,
        seed=seed,
        pace=pace,
        serial=serial,
        latitude_deg=latitude,
        gravity_m_s2=gravity,
        heading_deg=heading,
        port_base=port_base,
        identity=identity,
        product=product,
        twin=twin,
    )
    run_bench(configuration)


bench.__doc__ = say("Serve an emulated bench until it is stopped (SIGTERM, Ctrl-C).")

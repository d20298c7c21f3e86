"""`testloom bench`: serve an emulated bench over real links, on its own clock."""

from pathlib import Path
from typing import Annotated

import typer

from protocol.language import say


def bench(
    name: Annotated[str, typer.Option("--name", help=say("Name of the bench."))],
    units_dir: Annotated[
        Path,
        typer.Option("--units-dir", help=say("Where units keep their flash; shared by a line's benches.")),
    ],
    description: Annotated[
        Path, typer.Option("--description", help=say("The file that tells a station what the bench offers."))
    ],
    kind: Annotated[
        str, typer.Option("--kind", help=say("socket_board or three_axis_turntable."))
    ] = "socket_board",
    sockets: Annotated[
        int | None,
        typer.Option("--sockets", help=say("Number of sockets; the kind's usual one if left out.")),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", help=say("Seed of the lot and of the instruments' errors."))
    ] = 1,
    pace: Annotated[
        float,
        typer.Option("--pace", help=say("0: lock-step; else bench seconds per second of the wall clock.")),
    ] = 0.0,
    serial: Annotated[
        str,
        typer.Option("--serial", help=say("Links of units as TCP ports (socket) or pseudo terminals (pty).")),
    ] = "socket",
    latitude: Annotated[
        float, typer.Option("--latitude", help=say("Latitude of the site in degrees."))
    ] = 39.96,
    gravity: Annotated[float, typer.Option("--gravity", help=say("Gravity at the site in m/s^2."))] = 9.8013,
    heading: Annotated[
        float, typer.Option("--heading", help=say("Azimuth of the stand's y axis in degrees, east of north."))
    ] = 0.0,
    port_base: Annotated[
        int, typer.Option("--port-base", help=say("First of consecutive TCP ports; 0 for free ones."))
    ] = 0,
    identity: Annotated[
        str, typer.Option("--identity", help=say("The fixture's own serial number; derived if left out."))
    ] = "",
) -> None:
    """Serve an emulated bench until it is stopped (SIGTERM, Ctrl-C)."""
    from dut_emulator.server.assembly import run_bench
    from dut_emulator.server.configuration import BenchServerConfiguration

    run_bench(
        BenchServerConfiguration(
            name=name,
            kind=kind,  # type: ignore[arg-type]  # checked by the configuration, with an error for people
            units_dir=units_dir,
            description=description,
            sockets=sockets,
            seed=seed,
            pace=pace,
            serial=serial,  # type: ignore[arg-type]
            latitude_deg=latitude,
            gravity_m_s2=gravity,
            heading_deg=heading,
            port_base=port_base,
            identity=identity,
        )
    )

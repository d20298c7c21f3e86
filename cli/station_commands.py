"""`testloom station`: the agent of one bench."""

from pathlib import Path
from typing import Annotated

import typer

from protocol.addresses import DEFAULT_ROUTER
from protocol.language import say


def station(
    line: Annotated[str, typer.Option(help=say("Name of the line."))],
    name: Annotated[str, typer.Option(help=say("Name of the station on its line."))],
    bench: Annotated[Path, typer.Option(help=say("File that describes the bench."))],
    spool: Annotated[Path, typer.Option(help=say("File that keeps results until they are acknowledged."))],
    recordings: Annotated[Path, typer.Option(help=say("Folder for raw data."))],
    router: Annotated[str, typer.Option(help=say("Zenoh locator of the router."))] = DEFAULT_ROUTER,
    plans: Annotated[
        list[Path] | None,
        typer.Option(help=say("A plan, or a folder of plans, beside those that come along.")),
    ] = None,
) -> None:
    from stations.agent.core import EXIT_REFUSED
    from stations.agent.shell import AgentSettings, run_agent

    settings = AgentSettings(
        line=line,
        station=name,
        router=router,
        bench=bench,
        spool=spool,
        recordings=recordings,
        plans=tuple(plans or ()),
    )
    exit_code = run_agent(settings)
    if exit_code == EXIT_REFUSED:
        typer.echo(
            say("The coordinator has refused this station; its reason is in the last alarm."), err=True
        )
    raise typer.Exit(exit_code)


station.__doc__ = say("Run the agent of one station.")

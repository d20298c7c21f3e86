"""`testloom dashboard`: the line's web page, a process of its own."""

from typing import Annotated

import typer

from protocol.addresses import DASHBOARD_PORT, DEFAULT_LINE, DEFAULT_ROUTER, LOOPBACK
from protocol.language import say


def dashboard(
    line: Annotated[str, typer.Option(help=say("Name of the line."))] = DEFAULT_LINE,
    router: Annotated[str, typer.Option(help=say("Zenoh locator of the router."))] = DEFAULT_ROUTER,
    host: Annotated[
        str, typer.Option(help=say("Address to listen at; whoever reaches it can read everything."))
    ] = LOOPBACK,
    port: Annotated[int, typer.Option(min=0, max=65535, help=say("Port of the web page."))] = DASHBOARD_PORT,
) -> None:
    from dashboards.server import run_dashboard

    def announce(url: str) -> None:
        typer.echo(say("The dashboard of line '{line}' is at {url}", line=line, url=url))

    run_dashboard(line, router, host, port, on_listening=announce)


dashboard.__doc__ = say("Serve the web page of a line: its floor, its yield, its units.")

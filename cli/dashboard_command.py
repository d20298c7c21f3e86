"""`testloom dashboard`: the line's web page, a process of its own."""

from typing import Annotated

import typer

from protocol.language import say

DEFAULT_LINE = "demo"
DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8080


def dashboard(
    line: Annotated[str, typer.Option(help=say("Name of the line."))] = DEFAULT_LINE,
    router: Annotated[str, typer.Option(help=say("Zenoh locator of the router."))] = DEFAULT_ROUTER,
    host: Annotated[
        str, typer.Option(help=say("Address to listen at; whoever reaches it can read everything."))
    ] = DEFAULT_HOST,
    port: Annotated[int, typer.Option(min=0, max=65535, help=say("Port of the web page."))] = DEFAULT_PORT,
) -> None:
    from dashboards.server import run_dashboard

    def announce(url: str) -> None:
        typer.echo(say("The dashboard of line '{line}' is at {url}", line=line, url=url))

    run_dashboard(line, router, host, port, on_listening=announce)


dashboard.__doc__ = say("Serve the web page of a line: its floor, its yield, its units.")

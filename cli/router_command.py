"""`testloom router`: the fabric's router, a process of its own so that all else restarts alone."""

import signal
import threading
from typing import Annotated

import typer

from protocol.addresses import DEFAULT_ROUTER
from protocol.language import say


def router(
    listen: Annotated[str, typer.Option(help=say("Zenoh locator to listen at."))] = DEFAULT_ROUTER,
) -> None:
    from protocol.adapters.zenoh_link import open_router

    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    with open_router(listen):
        typer.echo(say("The router listens at {endpoint}.", endpoint=listen))
        stop.wait()


router.__doc__ = say("Run the Zenoh router of a line.")

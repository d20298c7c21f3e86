"""Putting the unit into the socket and taking it out."""

from protocol.errors import Fault, LinkError
from stations.sequencing.context import StepContext
from stations.sequencing.step_registry import step


@step("insert_unit")
def insert_unit(context: StepContext) -> None:
    """Load the leased unit into a dead socket, and see that the presence contact closes.

    Raises:
        LinkError: the contact stays open; the fixture's fault, since the unit says nothing about it.
    """
    context.power.switch(False)
    if context.board is not None:
        context.board.open_all()
    context.handler.insert(context.lease.unit.serial)
    if context.board is not None and not context.board.unit_present():
        raise LinkError(
            f"Unit {context.lease.unit.serial} was inserted and the presence contact is open.",
            where=f"socket {context.lease.socket}",
            fault=Fault.FIXTURE,
            remedy="reseat the unit; clean or replace the socket's contact.",
        )


@step("remove_unit")
def remove_unit(context: StepContext) -> None:
    """Empty the socket."""
    context.handler.remove()

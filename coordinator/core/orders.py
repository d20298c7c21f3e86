"""Which orders the line takes."""

# pyright: strict

from collections.abc import Iterable

from coordinator.core.line_state import Line
from protocol.errors import Fault
from protocol.line_views import OrderAccepted, OrderUnits
from protocol.outcomes import Disposition
from protocol.routes import Route
from protocol.station_messages import RequestRejected

FINAL_DISPOSITIONS = (Disposition.REWORK, Disposition.QUARANTINE, Disposition.SCRAP)
"""What a unit that does not pass may become."""


def decide(line: Line, order: OrderUnits) -> tuple[OrderAccepted | RequestRejected, bool]:
    """The answer to an order, and whether it is new to the line."""
    receipt = line.orders.get(order.order_id)
    if receipt is not None:
        return _accepted(order, receipt.accepted, receipt.already_known), False
    problem = _problem(line, order)
    if problem:
        return (
            RequestRejected(
                what=problem, fault=Fault.OPERATOR.value, remedy="correct the order and send it again."
            ),
            False,
        )
    known = tuple(identity.serial for identity in order.units if identity.serial in line.units)
    return _accepted(order, len(order.units) - len(known), known), True


def _accepted(order: OrderUnits, accepted: int, already_known: tuple[str, ...]) -> OrderAccepted:
    return OrderAccepted(order_id=order.order_id, accepted=accepted, already_known=already_known)


def _problem(line: Line, order: OrderUnits) -> str:
    route = order.route
    twice = _first_twice(identity.serial for identity in order.units)
    if twice:
        return f"The serial {twice} stands twice in order {order.order_id}."
    for identity in order.units:
        if identity.product != route.product:
            return f"{identity.serial} is a {identity.product}, route {route.name} is for {route.product}."
    known = line.routes.get(route.name)
    if known is not None and known != route:
        return f"The line knows another route by the name of {route.name}: give the new one its own name."
    return _problem_of_route(route)


def _problem_of_route(route: Route) -> str:
    twice = _first_twice(operation.name for operation in route.operations)
    if twice:
        return f"The operation {twice} stands twice in route {route.name}."
    for operation in route.operations:
        for disposition in (operation.on_confirmed_failure, operation.on_unjudgeable):
            if disposition not in FINAL_DISPOSITIONS:
                return (
                    f"Operation {operation.name} of route {route.name} would end a unit that does not pass "
                    f"as {disposition.value}."
                )
    return ""


def _first_twice(names: Iterable[str]) -> str:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return ""

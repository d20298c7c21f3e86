"""What people ask the coordinator, answered from the core's state. Pure: nothing is changed."""

# pyright: strict

from coordinator.core.floor import Floor
from coordinator.core.line_state import Line, Socket, Station, Unit
from coordinator.core.yield_statistics import final_yield
from protocol.errors import Fault, TestloomError
from protocol.line_views import (
    AttemptView,
    LineStatus,
    SocketStatus,
    StationStatus,
    UnitHistory,
    UnitStatus,
    YieldReport,
)
from protocol.outcomes import Disposition, Outcome

MAX_UNITS_IN_STATUS = 2_000
"""A status shows the units in process and the last finished ones, up to this many."""


def line_status(floor: Floor, line_name: str, at_s: float) -> LineStatus:
    """The whole line at one moment."""
    line, presence = floor.line, floor.presence
    queues = floor.dispatcher.queues
    return LineStatus(
        line=line_name,
        at_s=at_s,
        stations=tuple(_station(floor, station) for station in line.stations.values()),
        units=_units(floor),
        queue_lengths={
            operation: len(queues[operation].waiting) if operation in queues else 0
            for operation in operations_of(line)
        },
        yield_report=yield_report(line),
        alarms=tuple(presence.alarms),
        attempts_recorded=line.attempts_recorded,
        records_set_aside=line.records_set_aside,
        duplicates_ignored=presence.duplicates_ignored,
        finished=bool(line.units) and line.unfinished == 0,
        expected_remaining_s=expected_remaining_s(floor),
    )


def yield_report(line: Line) -> YieldReport:
    """Yield by operation and by station; RTY over the operations of all routes on the line."""
    operations = operations_of(line)
    statistics = line.yields
    rty, rty_unit = statistics.rolled(operations)
    dispositions = {disposition.value: count for disposition, count in line.dispositions.items()}
    if line.unfinished:
        in_process = Disposition.IN_PROCESS.value
        dispositions[in_process] = line.unfinished
    return YieldReport(
        operations=tuple(
            statistics.operations[operation].view(operation, None)
            for operation in operations
            if operation in statistics.operations
        ),
        stations=tuple(
            tally.view(operation, station)
            for (operation, station), tally in sorted(statistics.stations.items())
        ),
        rty=rty,
        rty_unit=rty_unit,
        final=final_yield(line.dispositions),
        dispositions=dispositions,
    )


def unit_history(floor: Floor, serial: str, attempts: tuple[AttemptView, ...]) -> UnitHistory:
    """A unit, with its attempts as the store kept them.

    Raises:
        TestloomError: the serial is not known on this line.
    """
    unit = floor.line.units.get(serial)
    if unit is None:
        raise unknown_serial(serial)
    outcomes: dict[str, Outcome] = {
        attempt.operation: attempt.outcome for attempt in unit.attempts if attempt.outcome is not None
    }
    status = _unit(floor, unit, _queue_positions(floor).get(serial))
    return UnitHistory(status=status, attempts=attempts, outcomes=outcomes)


def unknown_serial(serial: str) -> TestloomError:
    """Nobody ever ordered this unit here."""
    return TestloomError(
        f"The serial '{serial}' is not known on this line.",
        fault=Fault.OPERATOR,
        remedy="look at `testloom status` for the units of the line, or order it.",
    )


def operations_of(line: Line) -> tuple[str, ...]:
    """The operations of all routes on the line, each once, in the order of the routes."""
    return tuple(
        dict.fromkeys(operation.name for route in line.routes.values() for operation in route.operations)
    )


def expected_remaining_s(floor: Floor) -> float | None:
    """How long the units in process will take: the work of the busiest operation over its sockets.

    A first-order estimate: mean cycle times so far, no retests, sockets in service now. None when
    an operation that units still need has not passed any, or has no socket in service.
    """
    line = floor.line
    visits: dict[str, int] = {}
    longest_unit_s = 0.0
    for unit in line.units.values():
        if unit.state == "FINISHED":
            continue
        unit_s = 0.0
        for operation in unit.route.operations[unit.operation_index :]:
            visits[operation.name] = visits.get(operation.name, 0) + 1
            unit_s += line.mean_cycle_s.get(operation.name, 0.0)
        longest_unit_s = max(longest_unit_s, unit_s)
    remaining_s = longest_unit_s
    for operation, count in visits.items():
        queue = floor.dispatcher.queues.get(operation)
        mean_s = line.mean_cycle_s.get(operation)
        if mean_s is None or queue is None or not queue.in_service:
            return None
        remaining_s = max(remaining_s, count * mean_s / len(queue.in_service))
    return remaining_s


def _station(floor: Floor, station: Station) -> StationStatus:
    presence = floor.presence
    return StationStatus(
        station=station.station,
        state="silent" if station.station in presence.silent else "ready",
        incarnation=station.incarnation,
        sockets=tuple(_socket(floor.line, socket) for socket in station.sockets.values()),
        last_heard_s=presence.heard_at_s.get(station.station, station.registered_at_s),
    )


def _socket(line: Line, socket: Socket) -> SocketStatus:
    lease = line.leases.get(socket.fence)
    return SocketStatus(
        socket=socket.socket,
        operations=tuple(socket.plans),
        serial=lease.serial if lease else None,
        operation=lease.operation if lease else None,
        fence=lease.fence if lease else None,
        leased_since_s=lease.granted_at_s if lease else None,
    )


def _units(floor: Floor) -> tuple[UnitStatus, ...]:
    units = list(floor.line.units.values())
    if len(units) > MAX_UNITS_IN_STATUS:
        # In process first, then the newest; shown in the order of arrival.
        units.sort(key=lambda unit: (unit.state == "FINISHED", -unit.arrival))
        units = sorted(units[:MAX_UNITS_IN_STATUS], key=lambda unit: unit.arrival)
    positions = _queue_positions(floor)
    return tuple(_unit(floor, unit, positions.get(unit.serial)) for unit in units)


def _queue_positions(floor: Floor) -> dict[str, int]:
    positions: dict[str, int] = {}
    for queue in floor.dispatcher.queues.values():
        for place, (_, _, serial) in enumerate(sorted(queue.waiting.values()), start=1):
            positions[serial] = place
    return positions


def _unit(floor: Floor, unit: Unit, queue_position: int | None) -> UnitStatus:
    lease = floor.line.leases.get(unit.fence)
    template, values = _waits_for(floor, unit) if unit.state == "WAITING" else ("", {})
    return UnitStatus(
        unit=floor.identity(unit),
        disposition=unit.disposition,
        operation=None if unit.state == "FINISHED" else unit.operation.name,
        station=lease.station if lease else None,
        socket=lease.socket if lease else None,
        attempts=len(unit.attempts),
        queue_position=queue_position,
        waits_for=template.format(**values),
        waits_for_template=template,
        waits_for_values=values,
    )


def _waits_for(floor: Floor, unit: Unit) -> tuple[str, dict[str, str]]:
    operation = unit.operation.name
    queue = floor.dispatcher.queues[operation]
    if not queue.in_service:
        return "no socket in service can run {operation}", {"operation": operation}
    if unit.failed_sockets and queue.in_service - set(unit.failed_sockets):
        return (
            "another socket for {operation} than {sockets}",
            {"operation": operation, "sockets": ", ".join(dict.fromkeys(unit.failed_sockets))},
        )
    return "a free socket for {operation}", {"operation": operation}

# pyright: strict
"""From the coordinator's read models to what the floor page shows. Pure."""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from dashboards.intervals import CountedFraction, counted_fraction
from dashboards.socket_states import LiveSocket, SocketAddress, SocketView, socket_view
from protocol.line_views import (
    Alarm,
    LineStatus,
    OperationYield,
    StationStatus,
    UnitStatus,
    YieldReport,
)
from protocol.outcomes import Disposition

Density = Literal["huge", "large", "medium", "compact"]

MAX_QUEUE_ENTRIES_SHOWN = 8
MAX_ALARMS_SHOWN = 6
MAX_FALLEN_UNITS_SHOWN = 12
MAX_SOCKETS_HUGE = 12
MAX_SOCKETS_LARGE = 24
MAX_SOCKETS_MEDIUM = 48

STILL_ON_LINE = (Disposition.IN_PROCESS, Disposition.RETEST)
FALLEN = (Disposition.SCRAP, Disposition.QUARANTINE, Disposition.REWORK)


@dataclass(frozen=True)
class Sentence:
    """What the coordinator says: in English, and as a template for other languages."""

    text: str
    template: str
    values: Mapping[str, str]


@dataclass(frozen=True)
class StationView:
    """One station with its sockets and its own first-pass yield (all its operations together)."""

    station: str
    state: Literal["ready", "silent", "refused"]
    silent_for_s: float
    sockets: tuple[SocketView, ...]
    first_pass: CountedFraction


@dataclass(frozen=True)
class StationGroup:
    """The stations that do the same operations."""

    operations: tuple[str, ...]
    stations: tuple[StationView, ...]
    sockets: int
    sockets_at_work: int


@dataclass(frozen=True)
class QueueEntry:
    """A unit that waits, its place (1 = next) and what for."""

    serial: str
    position: int | None
    attempts: int
    is_retest: bool
    waits_for: Sentence


@dataclass(frozen=True)
class OperationQueue:
    """Who waits for an operation; `not_shown` more wait behind those listed."""

    operation: str
    length: int
    entries: tuple[QueueEntry, ...]
    not_shown: int


@dataclass(frozen=True)
class YieldRow:
    """First-pass yield of an operation in both conventions.

    `first_pass`: every first attempt that is not a PASS counts against it.
    `first_pass_units`: only faults of the unit count, at the first attempt that judged the unit.
    """

    operation: str
    first_pass: CountedFraction
    first_pass_units: CountedFraction
    attempts: int


@dataclass(frozen=True)
class YieldView:
    """Yield of the line. `final`: shipped out of finished."""

    operations: tuple[YieldRow, ...]
    rty: float | None
    rty_unit: float | None
    final: CountedFraction


@dataclass(frozen=True)
class OrderView:
    """How far the order is. The five parts add up to `units`."""

    units: int
    shipped: int
    fallen: int
    at_stations: int
    waiting: int
    finished: bool
    remaining_s: float | None

    @property
    def done(self) -> int:
        """Units that have left the line, whichever way."""
        return self.shipped + self.fallen


@dataclass(frozen=True)
class FallenUnit:
    """A unit that left the line without being shipped."""

    serial: str
    disposition: Disposition
    attempts: int


@dataclass(frozen=True)
class AlarmView:
    """An alarm and its age by the coordinator's clock."""

    alarm: str
    subject: str
    sentence: Sentence
    age_s: float


@dataclass(frozen=True)
class FloorView:
    """All that the floor page shows of a line at one moment."""

    line: str
    order: OrderView
    groups: tuple[StationGroup, ...]
    density: Density
    queues: tuple[OperationQueue, ...]
    yields: YieldView
    alarms: tuple[AlarmView, ...]
    alarms_not_shown: int
    fallen: tuple[FallenUnit, ...]
    fallen_not_shown: int
    attempts_recorded: int
    records_set_aside: int
    duplicates_ignored: int


def floor_view(status: LineStatus, live: Mapping[SocketAddress, LiveSocket]) -> FloorView:
    """What to show of this line status, with the live views by (station, socket)."""
    first_pass_by_station = _first_pass_by_station(status.yield_report)
    stations = [
        _station_view(station, live, first_pass_by_station, status.at_s) for station in status.stations
    ]
    alarms = sorted(status.alarms, key=lambda alarm: -alarm.raised_at_s)
    fallen = [unit for unit in status.units if unit.disposition in FALLEN]
    return FloorView(
        line=status.line,
        order=_order_view(status),
        groups=_groups(status, stations),
        density=_density(sum(len(station.sockets) for station in stations)),
        queues=_queues(status),
        yields=yield_view(status.yield_report),
        alarms=tuple(_alarm_view(alarm, status.at_s) for alarm in alarms[:MAX_ALARMS_SHOWN]),
        alarms_not_shown=max(0, len(alarms) - MAX_ALARMS_SHOWN),
        fallen=tuple(
            FallenUnit(unit.unit.serial, unit.disposition, unit.attempts)
            for unit in sorted(fallen, key=lambda unit: natural_key(unit.unit.serial))[
                :MAX_FALLEN_UNITS_SHOWN
            ]
        ),
        fallen_not_shown=max(0, len(fallen) - MAX_FALLEN_UNITS_SHOWN),
        attempts_recorded=status.attempts_recorded,
        records_set_aside=status.records_set_aside,
        duplicates_ignored=status.duplicates_ignored,
    )


def yield_view(report: YieldReport) -> YieldView:
    """Yields with Wilson 95 % intervals, from the counts of the report."""
    left = {Disposition(name): count for name, count in report.dispositions.items()}
    finished = sum(count for disposition, count in left.items() if disposition not in STILL_ON_LINE)
    return YieldView(
        operations=tuple(_yield_row(row) for row in report.operations),
        rty=report.rty,
        rty_unit=report.rty_unit,
        final=counted_fraction(left.get(Disposition.SHIP, 0), finished),
    )


def natural_key(name: str) -> tuple[tuple[bool, int, str], ...]:
    """Sorts 'fct-2' before 'fct-10'."""
    return tuple(
        (not part.isdecimal(), int(part) if part.isdecimal() else 0, part)
        for part in re.findall(r"[0-9]+|[^0-9]+", name)
    )


def _station_view(
    station: StationStatus,
    live: Mapping[SocketAddress, LiveSocket],
    first_pass_by_station: Mapping[str, CountedFraction],
    at_s: float,
) -> StationView:
    return StationView(
        station=station.station,
        state=station.state,
        silent_for_s=max(0.0, at_s - station.last_heard_s),
        sockets=tuple(
            socket_view(station.state, socket, live.get((station.station, socket.socket)), at_s)
            for socket in sorted(station.sockets, key=lambda socket: natural_key(socket.socket))
        ),
        first_pass=first_pass_by_station.get(station.station, counted_fraction(0, 0)),
    )


def _groups(status: LineStatus, stations: list[StationView]) -> tuple[StationGroup, ...]:
    """Stations by what they do, in the order in which the line's yield lists the operations."""
    order_of_operations = {row.operation: place for place, row in enumerate(status.yield_report.operations)}
    by_operations: dict[tuple[str, ...], list[StationView]] = {}
    for described, shown in zip(status.stations, stations, strict=True):
        operations = {operation for socket in described.sockets for operation in socket.operations}
        ordered = sorted(
            operations, key=lambda name: (order_of_operations.get(name, len(order_of_operations)), name)
        )
        by_operations.setdefault(tuple(ordered), []).append(shown)
    at_work = ("testing", "recording")
    groups = [
        StationGroup(
            operations=operations,
            stations=tuple(sorted(members, key=lambda station: natural_key(station.station))),
            sockets=sum(len(station.sockets) for station in members),
            sockets_at_work=sum(socket.state in at_work for station in members for socket in station.sockets),
        )
        for operations, members in by_operations.items()
    ]
    unknown = len(order_of_operations)
    return tuple(
        sorted(
            groups,
            key=lambda group: (
                [order_of_operations.get(name, unknown) for name in group.operations],
                group.operations,
            ),
        )
    )


def _queues(status: LineStatus) -> tuple[OperationQueue, ...]:
    waiting: dict[str, list[UnitStatus]] = {row.operation: [] for row in status.yield_report.operations}
    for operation in status.queue_lengths:
        waiting.setdefault(operation, [])
    for unit in status.units:
        if _waits(unit) and unit.operation is not None:
            waiting.setdefault(unit.operation, []).append(unit)
    return tuple(_queue(operation, units, status.queue_lengths) for operation, units in waiting.items())


def _queue(operation: str, units: list[UnitStatus], lengths: Mapping[str, int]) -> OperationQueue:
    in_order = sorted(
        units,
        key=lambda unit: (
            unit.queue_position is None,
            unit.queue_position or 0,
            natural_key(unit.unit.serial),
        ),
    )
    entries = tuple(
        QueueEntry(
            serial=unit.unit.serial,
            position=unit.queue_position,
            attempts=unit.attempts,
            is_retest=unit.disposition is Disposition.RETEST,
            waits_for=Sentence(unit.waits_for, unit.waits_for_template, unit.waits_for_values),
        )
        for unit in in_order[:MAX_QUEUE_ENTRIES_SHOWN]
    )
    length = lengths.get(operation, len(units))
    return OperationQueue(operation, length, entries, max(0, length - len(entries)))


def _waits(unit: UnitStatus) -> bool:
    return unit.disposition in STILL_ON_LINE and unit.operation is not None and unit.station is None


def _order_view(status: LineStatus) -> OrderView:
    counts = Counter(unit.disposition for unit in status.units)
    still_on_line = [unit for unit in status.units if unit.disposition in STILL_ON_LINE]
    at_stations = sum(unit.station is not None for unit in still_on_line)
    return OrderView(
        units=len(status.units),
        shipped=counts[Disposition.SHIP],
        fallen=sum(counts[disposition] for disposition in FALLEN),
        at_stations=at_stations,
        waiting=len(still_on_line) - at_stations,
        finished=status.finished,
        remaining_s=status.expected_remaining_s,
    )


def _yield_row(row: OperationYield) -> YieldRow:
    return YieldRow(
        operation=row.operation,
        first_pass=counted_fraction(row.first_passes, row.first_attempts),
        first_pass_units=counted_fraction(row.first_judged - row.first_unit_faults, row.first_judged),
        attempts=row.attempts,
    )


def _first_pass_by_station(report: YieldReport) -> dict[str, CountedFraction]:
    passes: Counter[str] = Counter()
    attempts: Counter[str] = Counter()
    for row in report.stations:
        if row.station is not None:
            passes[row.station] += row.first_passes
            attempts[row.station] += row.first_attempts
    return {station: counted_fraction(passes[station], attempts[station]) for station in attempts}


def _alarm_view(alarm: Alarm, at_s: float) -> AlarmView:
    sentence = Sentence(alarm.text, alarm.template, alarm.values)
    return AlarmView(alarm.alarm, alarm.subject, sentence, max(0.0, at_s - alarm.raised_at_s))


def _density(sockets: int) -> Density:
    if sockets <= MAX_SOCKETS_HUGE:
        return "huge"
    if sockets <= MAX_SOCKETS_LARGE:
        return "large"
    return "medium" if sockets <= MAX_SOCKETS_MEDIUM else "compact"

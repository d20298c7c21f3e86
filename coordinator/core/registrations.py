"""What a station's registration does to the line: process, sockets, spool. Part of the facts.

The numbers of a station's records have no gap. Where the next one to come is not the one after the last
that came, records were lost, or the spool was replaced: both are alarms, never silence.
"""

# pyright: strict

from coordinator.core.floor import Floor
from coordinator.core.line_state import Socket, Station, socket_key
from protocol.coordinator_events import StationRegistered
from protocol.station_messages import RegisterStation


def station_registered(floor: Floor, fact: StationRegistered) -> None:
    """Take a station in, or what has changed about it: its process, its sockets, its spool."""
    line, registration, at_s = floor.line, fact.registration, fact.at_s
    station = line.stations.get(registration.station)
    fresh_process = station is None or registration.incarnation > station.incarnation
    if station is None:
        station = line.stations[registration.station] = Station(
            registration.station, registration.bench_identity, registration.incarnation, at_s
        )
    if fresh_process:
        station.incarnation, station.registered_at_s = registration.incarnation, at_s
        _compare_spool(floor, station, registration, at_s)
    _describe_sockets(floor, station, registration)
    held = {lease.fence for lease in registration.held}
    line.last_fence = max(line.last_fence, registration.newest_fence, *held)  # stale below, to this station
    for fence in sorted(held):
        lease = line.leases.get(fence)
        if lease is not None and lease.station == station.station and lease.state == "OFFERED":
            lease.state = line.story.lease_step(fence, lease.state, "accepted", at_s)
    for socket in station.sockets.values():
        if floor.presence.lingering.get(socket.key) not in held:
            floor.presence.lingering.pop(socket.key, None)
        if fresh_process:
            floor.presence.resting_until_s.pop(socket.key, None)
            floor.presence.trouble.pop(socket.key, None)
        floor.refresh(socket)


def _compare_spool(floor: Floor, station: Station, registration: RegisterStation, at_s: float) -> None:
    """The first unacknowledged record must be the one after the last that came."""
    oldest = registration.spool_first or registration.spool_next
    if station.highest_sequence is None:
        station.highest_sequence = oldest - 1
        return
    check_gap(floor, station, oldest, at_s)
    if registration.spool_next <= station.highest_sequence:
        floor.alarm(
            at_s,
            "spool_replaced",
            station.station,
            "Station {station} counts its records anew from {next}; {highest} had come: "
            "its spool was replaced.",
            station=station.station,
            next=str(registration.spool_next),
            highest=str(station.highest_sequence),
        )
        station.highest_sequence = oldest - 1


def check_gap(floor: Floor, station: Station, sequence_number: int, at_s: float) -> None:
    """Records are numbered without a gap: one that skips numbers says which never came."""
    expected = (station.highest_sequence or 0) + 1
    if sequence_number > expected:
        floor.alarm(
            at_s,
            "spool_gap",
            station.station,
            "Records {first} to {last} of station {station} never came.",
            station=station.station,
            first=str(expected),
            last=str(sequence_number - 1),
        )
        station.highest_sequence = sequence_number - 1


def _describe_sockets(floor: Floor, station: Station, registration: RegisterStation) -> None:
    plans = {plan.operation: plan for plan in registration.plans}
    described = {
        description.socket: {op: plans[op] for op in description.operations if op in plans}
        for description in registration.sockets
    }
    for name in [*described, *(name for name in station.sockets if name not in described)]:
        socket = station.sockets.get(name)
        if socket is None:
            key = socket_key(station.station, name)
            socket = Socket(key, station.station, name, {})
            station.sockets[name] = floor.line.sockets[key] = socket
        floor.dispatcher.remove(socket)
        socket.plans = described.get(name, {})  # a socket no longer described can run nothing

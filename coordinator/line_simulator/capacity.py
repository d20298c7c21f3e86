"""What a line can do: the real core and model stations without any fault, at simulated speed."""

# pyright: strict

from dataclasses import dataclass

from coordinator.line_simulator.coordinator_model import CoordinatorModel
from coordinator.line_simulator.links import SimulatedLinks
from coordinator.line_simulator.station_model import StationModel
from coordinator.line_simulator.world import NetworkFaults, World
from protocol.attempts import Lease, UnitIdentity
from protocol.coordinator_events import LineSettings, RecordSummary, UnitsOrdered
from protocol.errors import Fault
from protocol.line_views import OrderUnits
from protocol.outcomes import Disposition, Outcome
from protocol.routes import Operation, Route

LIMIT_S = 30 * 86_400.0
ORDERED_AT_S = 1.0
SETTINGS = LineSettings(lease_duration_s=36_000.0, renewal_period_s=3_600.0)
"""Nothing fails here: a rare renewal keeps the agenda short."""


@dataclass(frozen=True)
class StationGroup:
    """Equal stations for one operation. A service time is drawn from mean ± half-width."""

    operation: str
    stations: int
    sockets: int
    service_s: float
    service_half_width_s: float
    pass_fraction: float


@dataclass(frozen=True)
class CapacityReport:
    """`utilisation`: by operation, busy socket time over available socket time until the last unit."""

    units: int
    makespan_s: float
    units_per_hour: float
    mean_flow_s: float
    utilisation: dict[str, float]
    bottleneck: str
    shipped: int


DEMONSTRATION_LINE = (
    StationGroup("functional", 4, 2, 9.0, 1.0, 0.95),
    StationGroup("imu_calibration", 2, 1, 30.0, 2.0, 0.98),
)
"""Four functional stations of two sockets, two turntables."""


class _CapacityLine(SimulatedLinks):
    def __init__(self, groups: tuple[StationGroup, ...], seed: int) -> None:
        self.world = World(seed, NetworkFaults())
        self.groups = {group.operation: group for group in groups}
        self.busy_s = dict.fromkeys(self.groups, 0.0)
        self.coordinator = CoordinatorModel(self.world, self._to_station, SETTINGS, False)
        self.made: list[RecordSummary] = []
        self.stations = {
            name: StationModel(
                world=self.world,
                station=name,
                sockets=tuple(f"S{socket + 1}" for socket in range(group.sockets)),
                operation=group.operation,
                attempted=self._attempted,
                ask=self._to_coordinator,
                made=self.made.append,
                renews_until_acknowledged=True,
                renewal_period_s=SETTINGS.renewal_period_s,
            )
            for group in groups
            for name in (f"{group.operation}-{number + 1:03d}" for number in range(group.stations))
        }

    def _attempted(self, lease: Lease) -> tuple[float, Outcome, Fault]:
        group, chance = self.groups[lease.operation], self.world.random
        width_s = group.service_half_width_s
        duration_s = group.service_s + chance.uniform(-width_s, width_s)
        self.busy_s[lease.operation] += duration_s
        if chance.random() < group.pass_fraction:
            return duration_s, Outcome.PASS, Fault.NONE
        return duration_s, Outcome.FAIL, Fault.UNIT


def simulate(groups: tuple[StationGroup, ...], units: int, seed: int) -> CapacityReport:
    """Order all units at once and let the line finish them."""
    line = _CapacityLine(groups, seed)
    world = line.world
    line.coordinator.start()
    for station in line.stations.values():
        station.start()
    route = Route(
        name="capacity", product="capacity", operations=tuple(Operation(name=op) for op in line.groups)
    )
    identities = tuple(UnitIdentity(serial=f"U{n:05d}", product="capacity", lot="L") for n in range(units))
    order = OrderUnits(order_id="all", route=route, units=identities)
    world.at(
        ORDERED_AT_S, lambda: line.coordinator.receive(UnitsOrdered(at_s=world.now_s, order=order), None)
    )
    finished_at_s = line.coordinator.disk.finished_at_s
    world.run(lambda: len(finished_at_s) == units, LIMIT_S)
    return _report(line, units)


def _report(line: _CapacityLine, units: int) -> CapacityReport:
    core = line.coordinator.core
    assert core is not None
    flows_s = [at_s - ORDERED_AT_S for at_s in line.coordinator.disk.finished_at_s.values()]
    makespan_s = max(flows_s)
    utilisation = {
        operation: line.busy_s[operation] / (group.stations * group.sockets * makespan_s)
        for operation, group in line.groups.items()
    }
    return CapacityReport(
        units=units,
        makespan_s=makespan_s,
        units_per_hour=units / makespan_s * 3600,
        mean_flow_s=sum(flows_s) / units,
        utilisation=utilisation,
        bottleneck=max(utilisation, key=lambda operation: utilisation[operation]),
        shipped=core.line.dispositions.get(Disposition.SHIP, 0),
    )

"""One seeded line under faults: what is built, what goes wrong, and when it must be finished.

Chaos lasts `CHAOS_S`: messages are lost, doubled and held back, stations are cut off and killed,
the coordinator is killed in the middle of batches, a second bench takes an id that is in use.
Then everything is sound, and the line must finish and empty its spools by `FINISH_S`.
"""

# pyright: strict

from dataclasses import dataclass

from coordinator.line_simulator.coordinator_model import CoordinatorModel
from coordinator.line_simulator.links import SimulatedLinks
from coordinator.line_simulator.station_model import NEVER_S, StationModel
from coordinator.line_simulator.world import NetworkFaults, World
from protocol.attempts import Lease, UnitIdentity
from protocol.coordinator_events import (
    LineSettings,
    RecordSummary,
    StationRegistered,
    StationTokenVanished,
    UnitsOrdered,
)
from protocol.errors import Fault
from protocol.line_views import OrderAccepted, OrderUnits
from protocol.outcomes import Outcome
from protocol.routes import Operation, Route
from protocol.station_messages import (
    RegisterStation,
    StationAccepted,
)

CHAOS_S = 70.0
FINISH_S = 700.0
OPERATIONS = ("functional", "imu_calibration")
SETTINGS = LineSettings(abort_patience_s=8.0, rest_limit_s=10.0)
ROUTE = Route(
    name="simulated",
    product="simulated",
    operations=tuple(Operation(name=operation, deadline_s=25.0) for operation in OPERATIONS),
)


@dataclass(frozen=True)
class Troubles:
    """Of stations, per attempt or offer; and of one socket that is always at fault."""

    disturbed: float
    hangs: float
    blamed_on_unit: float
    refuses: float
    red_socket: str


class Scenario(SimulatedLinks):
    """The line of one seed."""

    def __init__(self, seed: int, *, check_invariants: bool = True) -> None:
        self.seed = seed
        self.world = World(seed, NetworkFaults())
        chance = self.world.random
        self.world.faults = NetworkFaults(
            loss=chance.choice((0.0, 0.02, 0.1, 0.25)),
            duplication=chance.choice((0.0, 0.05, 0.2)),
            held_back=chance.choice((0.0, 0.02, 0.08)),
        )
        self.made: list[RecordSummary] = []
        self.intruder_accepted = False
        self.ordered = False
        self.settings = SETTINGS
        self.coordinator = CoordinatorModel(self.world, self._to_station, SETTINGS, check_invariants)
        self.stations = self._build_stations()
        self.units = self._build_units()
        sockets = [f"{s.station}/{name}" for s in self.stations.values() for name in s.sockets]
        self.troubles = Troubles(
            disturbed=chance.choice((0.0, 0.05, 0.2)),
            hangs=chance.choice((0.0, 0.03, 0.1)),
            blamed_on_unit=chance.choice((0.0, 0.3)),
            refuses=chance.choice((0.0, 0.05)),
            red_socket=chance.choice(sockets) if chance.random() < 0.3 else "",
        )

    def _build_stations(self) -> dict[str, StationModel]:
        chance = self.world.random
        counts = {"functional": chance.randint(1, 3), "imu_calibration": chance.randint(1, 2)}
        stations: dict[str, StationModel] = {}
        for operation, count in counts.items():
            for number in range(count):
                name = f"{operation[:3]}-{number + 1}"
                stations[name] = StationModel(
                    world=self.world,
                    station=name,
                    sockets=("A", "B")[: chance.randint(1, 2)],
                    operation=operation,
                    attempted=self._attempted,
                    ask=self._to_coordinator,
                    made=self.made.append,
                    renews_until_acknowledged=chance.random() < 0.7,
                    refuses=lambda: chance.random() < self.troubles.refuses,
                )
        return stations

    def _build_units(self) -> dict[str, str]:
        """Serial → the operation that finds its defect; empty when it is healthy."""
        chance = self.world.random
        return {
            f"U{number:02d}": chance.choice(OPERATIONS) if chance.random() < 0.3 else ""
            for number in range(1, chance.randint(3, 10) + 1)
        }

    def _attempted(self, lease: Lease) -> tuple[float, Outcome, Fault]:
        chance, troubles = self.world.random, self.troubles
        duration_s = chance.uniform(1.0, 6.0)
        if f"{lease.station}/{lease.socket}" == troubles.red_socket:
            return 0.5, Outcome.ERROR, Fault.FIXTURE
        if chance.random() < troubles.hangs:
            return NEVER_S, Outcome.ERROR, Fault.STATION
        if chance.random() < troubles.disturbed:
            outcome = chance.choice((Outcome.ERROR, Outcome.TIMEOUT, Outcome.ABORTED, Outcome.FAIL))
            return duration_s, outcome, chance.choice((Fault.STATION, Fault.FIXTURE, Fault.STAND))
        if self.units[lease.unit.serial] == lease.operation:
            blamed = chance.random() < troubles.blamed_on_unit
            outcome = chance.choice((Outcome.ERROR, Outcome.TIMEOUT)) if blamed else Outcome.FAIL
            return duration_s, outcome, Fault.UNIT
        return duration_s, Outcome.PASS, Fault.NONE

    # --- the run -----------------------------------------------------------------------------------

    def run(self) -> bool:
        """Run to the end; False if the line did not finish in time."""
        world = self.world
        self.coordinator.start()
        for station in self.stations.values():
            world.after(world.random.random(), station.start)
        serials = tuple(self.units)
        half = world.random.randint(1, len(serials))
        self._order("order-1", serials[:half], 0.5)
        if serials[half:]:
            self._order("order-2", serials[half:], 15.0)
        self._plan_chaos()
        world.at(CHAOS_S, self._calm)
        return world.run(self._finished, FINISH_S)

    def _order(self, order_id: str, serials: tuple[str, ...], at_s: float) -> None:
        units = tuple(UnitIdentity(serial=s, product=ROUTE.product, lot="L1") for s in serials)
        order = OrderUnits(order_id=order_id, route=ROUTE, units=units)

        def ask() -> None:
            event = UnitsOrdered(at_s=self.world.now_s, order=order)
            self._to_coordinator("client", event, answered, ask)

        def answered(reply: object) -> None:
            assert isinstance(reply, OrderAccepted), reply

        self.world.at(at_s, ask)

    def _plan_chaos(self) -> None:
        world, chance = self.world, self.world.random
        for _ in range(chance.choice((0, 1, 3, 8))):
            world.at(chance.uniform(1.0, CHAOS_S), self._kill_coordinator)
        for _ in range(chance.choice((0, 1, 3, 6))):
            world.at(chance.uniform(1.0, CHAOS_S), self._kill_station)
        for _ in range(chance.choice((0, 1, 3, 6))):
            world.at(chance.uniform(1.0, CHAOS_S), self._cut_off_station)
        if chance.random() < 0.4:
            world.at(chance.uniform(10.0, CHAOS_S), self._second_bench)

    def _kill_coordinator(self) -> None:
        if self.coordinator.core is not None:
            self.coordinator.crash()
            self.world.after(self.world.random.choice((0.2, 3.0, 15.0)), self.coordinator.start)

    def _kill_station(self) -> None:
        station = self._any_station()
        if not station.up:
            return
        incarnation = station.incarnation
        station.crash()
        if self.world.random.random() < 0.8:  # else the token's end is noticed late, or never

            def vanished() -> None:
                self.coordinator.receive(
                    StationTokenVanished(
                        at_s=self.world.now_s, station=station.station, incarnation=incarnation
                    ),
                    None,
                )

            self.world.after(self.world.random.random(), vanished)
        self.world.after(self.world.random.choice((0.3, 2.0, 20.0)), station.start)

    def _cut_off_station(self) -> None:
        name = self._any_station().station
        self.world.partitioned.add(name)
        duration_s = self.world.random.choice((1.0, 5.0, 14.0, 30.0))
        self.world.after(duration_s, lambda: self.world.partitioned.discard(name))

    def _second_bench(self) -> None:
        """Another bench by the id of a registered one: it must never be accepted."""
        core = self.coordinator.core
        known = core.line.stations if core is not None else {}
        if not known:
            return
        name = self.world.random.choice(sorted(known))
        registration = RegisterStation(
            station=name,
            incarnation=int(self.world.now_s * 1e9) + 2,
            bench_identity="another-bench",
            sockets=(),
            plans=(),
        )

        def answered(reply: object) -> None:
            self.intruder_accepted |= isinstance(reply, StationAccepted)

        def ask() -> None:
            event = StationRegistered(at_s=self.world.now_s, registration=registration)
            self._to_coordinator(name, event, answered, lambda: None)
            if self.world.now_s < CHAOS_S:
                self.world.after(3.0, ask)

        ask()

    def _any_station(self) -> StationModel:
        return self.world.random.choice(list(self.stations.values()))

    def _calm(self) -> None:
        self.world.heal()

    def _finished(self) -> bool:
        core = self.coordinator.core
        return (
            core is not None
            and self.coordinator.at_rest
            and len(core.line.units) == len(self.units)
            and core.line.unfinished == 0
            and self.world.now_s > CHAOS_S
            and not any(station.spool or station.active for station in self.stations.values())
        )

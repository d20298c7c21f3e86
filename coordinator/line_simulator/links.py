# pyright: strict
"""The simulated network between one coordinator and its stations, for every kind of run."""

from collections.abc import Callable

from coordinator.line_simulator.coordinator_model import CoordinatorModel
from coordinator.line_simulator.station_model import StationModel
from coordinator.line_simulator.world import World
from protocol.coordinator_events import Event
from protocol.station_messages import StartSequence, StationCommand

Answered = Callable[[object], None]
Unanswered = Callable[[], None]


class SimulatedLinks:
    """What a run inherits so that its coordinator and stations can ask each other over its world."""

    world: World
    coordinator: CoordinatorModel
    stations: dict[str, StationModel]

    def _to_coordinator(self, station: str, event: Event, answered: Answered, unanswered: Unanswered) -> None:
        self.world.ask(station, lambda reply: self.coordinator.receive(event, reply), answered, unanswered)

    def _to_station(self, command: StationCommand, answered: Answered, unanswered: Unanswered) -> None:
        name = command.lease.station if isinstance(command, StartSequence) else command.station
        self.world.ask(name, lambda reply: self.stations[name].command(command, reply), answered, unanswered)

"""Which processes make up a line on one machine, and how they find each other. Pure."""

from dataclasses import dataclass
from pathlib import Path

from cli.process_group import ProcessSpecification

# The coordinator outlives the stations, so that their last records are acknowledged; the router all.
STOP_RANK = {"station": 0, "dashboard": 0, "bench": 1, "coordinator": 2, "router": 3}


@dataclass(frozen=True)
class LineLayout:
    """A line on one machine.

    `seed` makes the units; only benches get it. `pace`: 0 as fast as possible, 1 real time.
    """

    line: str
    directory: Path
    seed: int
    functional_stations: int
    sockets_per_station: int
    turntables: int
    router_endpoint: str
    dashboard_port: int | None
    database_url: str
    pace: float = 0.0
    language: str = "en"

    def stations(self) -> dict[str, str]:
        """Station name → kind of its bench."""
        names = {f"functional-{k}": "socket_board" for k in range(1, self.functional_stations + 1)}
        names |= {f"turntable-{k}": "three_axis_turntable" for k in range(1, self.turntables + 1)}
        return names

    def processes(self) -> list[ProcessSpecification]:
        """All processes, in the order in which they are started."""
        return [
            self._process("router", "router", ("router", "--listen", self.router_endpoint)),
            self._process("coordinator", "coordinator", self._coordinator_arguments()),
            *(self._bench(station, kind) for station, kind in self.stations().items()),
            *(self._station(station) for station in self.stations()),
            *self._dashboards(),
        ]

    def spool(self, station: str) -> Path:
        """The spool of a station."""
        return self.directory / "spools" / f"{station}.sqlite"

    def description(self, station: str) -> Path:
        """The file by which a bench tells its station where its links are."""
        return self.directory / "benches" / f"{station}.json"

    @property
    def recordings(self) -> Path:
        """Where the stations keep their raw data."""
        return self.directory / "recordings"

    @property
    def sealed(self) -> Path:
        """What only benches may see: the units' own memories, and with them the truth."""
        return self.directory / "sealed"

    def _coordinator_arguments(self) -> tuple[str, ...]:
        return (
            "coordinator",
            *("--line", self.line, "--router", self.router_endpoint, "--database", self.database_url),
        )

    def _bench(self, station: str, kind: str) -> ProcessSpecification:
        sockets = self.sockets_per_station if kind == "socket_board" else 1
        arguments = (
            *("bench", "--name", f"bench-{station}", "--kind", kind, "--sockets", str(sockets)),
            *("--seed", str(self.seed), "--units-dir", str(self.sealed / "units")),
            *("--description", str(self.description(station)), "--pace", str(self.pace)),
        )
        return self._process(
            "bench", f"bench-{station}", arguments, {"description": str(self.description(station))}
        )

    def _station(self, station: str) -> ProcessSpecification:
        arguments = (
            *("station", "--line", self.line, "--name", station, "--router", self.router_endpoint),
            *("--bench", str(self.description(station)), "--spool", str(self.spool(station))),
            *("--recordings", str(self.recordings)),
        )
        return self._process("station", f"station-{station}", arguments)

    def _dashboards(self) -> list[ProcessSpecification]:
        if self.dashboard_port is None:
            return []
        arguments = (
            *("dashboard", "--line", self.line, "--router", self.router_endpoint),
            *("--port", str(self.dashboard_port)),
        )
        return [
            self._process(
                "dashboard", "dashboard", arguments, {"http": f"http://127.0.0.1:{self.dashboard_port}"}
            )
        ]

    def _process(
        self, role: str, name: str, arguments: tuple[str, ...], addresses: dict[str, str] | None = None
    ) -> ProcessSpecification:
        where = {"router": self.router_endpoint} | (addresses or {})
        return ProcessSpecification(
            role=role,
            name=name,
            arguments=("--lang", self.language, *arguments),
            addresses=where,
            stop_rank=STOP_RANK[role],
        )

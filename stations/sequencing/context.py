"""What a step function sees of the world: its unit, its instruments, its time, and where results go."""

import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from protocol.attempts import Lease, RecordingReference
from protocol.bench_description import Site
from protocol.errors import Fault
from protocol.instruments import Multimeter, Oscilloscope, SocketBoard, ThreeAxisTurntable
from protocol.measurements import Measurement, MeasurementSpecification, Value
from protocol.outcomes import MeasurementOutcome
from protocol.plans import ParameterValue, Step
from protocol.units_of_measure import factor_to_si
from stations.interruptions import StepError

if TYPE_CHECKING:
    from stations.drivers.can_link import CanLink
    from stations.drivers.clock import BranchClock
    from stations.drivers.handler import UnitHandler
    from stations.drivers.power_supply import SocketSupply
    from stations.drivers.socket_bench import SocketBench
    from stations.drivers.unit_link import GncModuleLink


@dataclass(frozen=True)
class Attempt:
    """What the steps of one attempt share. `values` carries arrays and readings from step to step."""

    lease: Lease
    recordings_dir: Path
    values: dict[str, object] = field(default_factory=dict)
    recordings: list[RecordingReference] = field(default_factory=list)


class StepContext:
    """One step's view of the bench. Steps of parallel branches have a context and a clock of their own.

    Times are bench time in s; every value given to `measure` is SI (the plan's unit is converted to).
    """

    def __init__(self, step: Step, attempt: Attempt, bench: "SocketBench", clock: "BranchClock") -> None:
        self._step = step
        self._attempt = attempt
        self._bench = bench
        self._clock = clock
        self._specifications: Mapping[str, MeasurementSpecification] = {
            specification.name: specification for specification in step.measurements
        }
        self._taken: dict[str, Measurement] = {}
        self.message = ""
        """Words for the record beside the measurements; a step may set it."""

    @property
    def lease(self) -> Lease:
        return self._attempt.lease

    @property
    def parameters(self) -> dict[str, ParameterValue]:
        return self._step.parameters

    @property
    def values(self) -> dict[str, object]:
        """Values carried between the steps of this attempt."""
        return self._attempt.values

    @property
    def recordings_dir(self) -> Path:
        return self._attempt.recordings_dir

    @property
    def clock(self) -> "BranchClock":
        """Bench time. Every wait raises SequenceAborted or StepTimeout when it is time to leave."""
        return self._clock

    @property
    def site(self) -> Site:
        return self._bench.description.site

    @property
    def unit(self) -> "GncModuleLink":
        """The unit on its RS-422 link."""
        return self._bench.unit_link(self._clock)

    @property
    def can(self) -> "CanLink | None":
        """The unit's CAN bus; None if the socket has none."""
        return self._bench.can_link(self._clock)

    @property
    def power(self) -> "SocketSupply":
        """The supply's channel of this socket."""
        return self._bench.supply(self._clock)

    @property
    def board(self) -> SocketBoard | None:
        """The board under the socket; None on a stand."""
        return self._bench.board(self._clock)

    @property
    def stand(self) -> ThreeAxisTurntable | None:
        """The motion stand; None on a socket-board bench."""
        return self._bench.stand(self._clock)

    @property
    def handler(self) -> "UnitHandler":
        """The hand that puts the unit into the socket and takes it out."""
        return self._bench.handler(self._clock)

    def multimeter(self) -> AbstractContextManager[Multimeter]:
        """The shared multimeter, for this socket alone inside the `with`; its relays open at the end.

        Raises on entry:
            StepError: the bench has none.
            LinkError: it did not become free within the arbitration's bound.
        """
        return self._bench.multimeter(self._clock)

    def oscilloscope(self) -> AbstractContextManager[Oscilloscope]:
        """The shared oscilloscope; as `multimeter`."""
        return self._bench.oscilloscope(self._clock)

    def measure(self, name: str, value: Value | None) -> None:
        """Take a measurement and judge it by the plan's limits.

        Args:
            name: as declared by this step in the plan.
            value: in SI; a number is converted into the plan's unit. None stays UNSET.

        Raises:
            StepError: this step of the plan does not declare the measurement.
        """
        specification = self._specifications.get(name)
        if specification is None:
            raise StepError(
                f"The step '{self._step.step}' took a measurement '{name}' that the plan does not declare.",
                where=f"step {self._step.step}",
                remedy="declare it in the plan, with its unit and limits.",
            )
        self._taken[name] = _judged(specification, value)

    def number(self, parameter: str) -> float:
        """A parameter of the plan that has to be a number.

        Raises:
            StepError: it is missing or no number.
        """
        value = self._step.parameters.get(parameter)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._wrong_parameter(parameter, "a number")
        return float(value)

    def word(self, parameter: str, allowed: Iterable[str]) -> str:
        """A parameter of the plan that has to be one of these words.

        Raises:
            StepError: it is missing or another.
        """
        value = self._step.parameters.get(parameter)
        choices = tuple(allowed)
        if not isinstance(value, str) or value not in choices:
            raise self._wrong_parameter(parameter, f"one of {', '.join(choices)}")
        return value

    def needed_board(self) -> SocketBoard:
        """The board under the socket.

        Raises:
            StepError: the bench has none.
        """
        board = self.board
        if board is None:
            raise StepError(
                f"The step '{self._step.step}' needs a socket board, and this bench has none.",
                where=f"step {self._step.step}",
                fault=Fault.PLAN,
                remedy="run this plan on a socket-board bench.",
            )
        return board

    def declares(self, name: str) -> bool:
        """True if the plan wants this measurement from this step."""
        return name in self._specifications

    def keep_recording(self, reference: RecordingReference) -> None:
        """Name raw data of this attempt in its record."""
        self._attempt.recordings.append(reference)

    def measurements(self) -> tuple[Measurement, ...]:
        """All that the plan declares for this step, in its order; what was not taken is UNSET."""
        return tuple(
            self._taken.get(name, Measurement(specification=specification))
            for name, specification in self._specifications.items()
        )

    def _wrong_parameter(self, parameter: str, wanted: str) -> StepError:
        return StepError(
            f"The parameter '{parameter}' of step '{self._step.step}' has to be {wanted}.",
            where=f"step {self._step.step}",
            fault=Fault.PLAN,
            remedy="correct the plan.",
        )


def _judged(specification: MeasurementSpecification, value: Value | None) -> Measurement:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if not math.isfinite(value):
            return Measurement(
                specification=specification,
                outcome=MeasurementOutcome.ERROR,
                message=f"the value {value} is not finite",
            )
        factor = factor_to_si(specification.unit)
        if factor != 1.0:
            value = value / factor
    return Measurement(specification=specification, value=value, outcome=specification.judge(value))

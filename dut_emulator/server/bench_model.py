# pyright: strict
"""What stands on a bench, without ports: sockets with units, instruments, perhaps a stand. Pure.

Bench time comes in with every call and never goes back. `receive` takes a station's bytes on a link,
`advance` gives what left the bench on each link since the call before. Shell and clock are elsewhere, so
that a whole bench can be run in a test without a port.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from dut_emulator.instruments.multimeter import Multimeter
from dut_emulator.instruments.oscilloscope import Oscilloscope
from dut_emulator.instruments.power_supply import PowerSupply
from dut_emulator.instruments.pulse_counter import PulseCounter, PulseSource
from dut_emulator.instruments.serial_multimeter import AveragedOutputs, SerialMultimeter
from dut_emulator.instruments.socket_board import SocketBoard
from dut_emulator.instruments.wiring import SharedInputs
from dut_emulator.interfaces import BenchModelError, EmulatedUnit, LinkOutput, StandModel, Surroundings
from dut_emulator.server.slcan import SlcanAdapter
from protocol.gnc_module import CONTINUITY_PAIRS, IMPEDANCE_PAIRS, INSULATION_PAIRS, TIMER_TEST_POINT

TEST_POINTS = frozenset(
    point
    for pair in (*CONTINUITY_PAIRS, *INSULATION_PAIRS, *IMPEDANCE_PAIRS)
    for point in (pair.high, pair.low)
) | {TIMER_TEST_POINT}
RS422, CAN = "rs422", "can"
STAND = "stand"
STAND_STREAM_LINK = f"{STAND}.stream"
METER = "multimeter"
METER_LINK = f"{METER}.rs232"


@dataclass
class SocketModel:
    """One socket: a load of the supply, test points for the board, a CAN adapter, a place for a unit."""

    name: str
    surroundings: Surroundings
    unit: EmulatedUnit | None = None
    serial: str = ""
    supply_v: float = 0.0
    ad_source: tuple[str, float] | None = None
    adapter: SlcanAdapter = field(default_factory=SlcanAdapter)

    @property
    def links(self) -> tuple[str, str]:
        """Names of its links: RS-422, CAN."""
        return f"{self.name}.{RS422}", f"{self.name}.{CAN}"

    def receive_rs422(self, data: bytes, now_s: float) -> bytes:
        """Bytes from the station; without a unit they go nowhere."""
        if self.unit is not None:
            self.unit.receive(RS422, data, now_s)
        return b""

    def receive_can(self, data: bytes, now_s: float) -> bytes:
        """Bytes from the station to the CAN adapter; the adapter's answers."""
        answers, frames = self.adapter.feed(data)
        for frame in frames:
            if self.unit is not None:
                self.unit.receive(CAN, frame.data, now_s, frame.identifier)
        return answers

    def advance(self, to_s: float) -> list[tuple[str, bytes]]:
        """What left the unit on each link."""
        if self.unit is None:
            return []
        return [
            (f"{self.name}.{output.link}", data)
            for output in self.unit.advance(to_s)
            if (data := self._on_the_wire(output))
        ]

    def _on_the_wire(self, output: LinkOutput) -> bytes:
        if output.link != CAN:
            return output.data
        if not self.adapter.hears_bus:
            return b""
        frames = [(frame.can_id, frame.data) for frame in output.frames()]
        return b"".join(
            self.adapter.frame_line(number, data) for number, data in frames if number is not None
        )

    def insert(self, unit: EmulatedUnit, serial: str, now_s: float) -> None:
        """Put a unit in.

        Raises:
            BenchModelError: the socket is taken or under power.
        """
        if self.unit is not None:
            raise BenchModelError(f"socket {self.name} holds unit {self.serial}")
        if self.supply_v > 0:
            raise BenchModelError(f"socket {self.name} is under power")
        unit.insert(self.surroundings, now_s)
        self.unit, self.serial = unit, serial
        if self.ad_source is not None:
            unit.set_ad_source(*self.ad_source)

    def remove(self, now_s: float) -> tuple[EmulatedUnit, str] | None:
        """Take the unit out, if there is one: unit and serial."""
        unit, serial = self.unit, self.serial
        self.unit, self.serial = None, ""
        if unit is None:
            return None
        unit.set_supply(0.0, now_s)
        return unit, serial

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """Voltage of the supply's channel."""
        self.supply_v = voltage_v
        if self.unit is not None:
            self.unit.set_supply(voltage_v, now_s)

    def supply_current_a(self, now_s: float) -> float:
        """What the socket draws."""
        return self.unit.supply_current_a(now_s) if self.unit is not None else 0.0

    def resistance_ohm(self, high: str, low: str) -> float:
        """True resistance; nothing to measure without a unit or under power."""
        if self.unit is None or self.supply_v > 0:
            return float("inf")
        return self.unit.resistance_ohm(high, low)

    def voltage_v(self, high: str, low: str, now_s: float) -> float:
        """True DC voltage of one point against another."""
        if self.unit is None:
            return 0.0
        return self.unit.point_voltage_v(high, now_s) - self.unit.point_voltage_v(low, now_s)

    def ripple_v(self, point: str, now_s: float) -> float:
        """True peak-to-peak AC voltage of a point."""
        return self.unit.point_ripple_v(point, now_s) if self.unit is not None else 0.0

    def period_s(self, point: str, now_s: float) -> float | None:
        """True period of a point's square wave."""
        return self.unit.point_period_s(point, now_s) if self.unit is not None else None

    def mean_voltage_v(self, point: str, begin_s: float, end_s: float) -> float:
        """True mean of an analogue output over an aperture; an empty socket's is 0 V."""
        return cast(AveragedOutputs, self.unit).mean_voltage_v(point, begin_s, end_s) if self.unit else 0.0

    def pulse_totals(self, now_s: float) -> NDArray[np.int64]:
        """Running totals of the pulse outputs, (6, 2); an empty socket has counted nothing."""
        if self.unit is None:
            return np.zeros((6, 2), dtype=np.int64)
        return cast(PulseSource, self.unit).pulse_totals(now_s)

    def knows_point(self, point: str) -> bool:
        """Whether the board has a needle there."""
        return point in TEST_POINTS

    def present(self) -> bool:
        """The presence contact."""
        return self.unit is not None

    def set_ad_source(self, source: str, voltage_v: float) -> None:
        """The AD switch; a unit inserted later finds it so."""
        self.ad_source = (source, voltage_v)
        if self.unit is not None:
            self.unit.set_ad_source(source, voltage_v)


@dataclass
class Instruments:
    """The instruments of a bench; a stand has a supply, and what reads a unit without a link of its own."""

    supply: PowerSupply
    multimeter: Multimeter | None = None
    oscilloscope: Oscilloscope | None = None
    boards: dict[str, SocketBoard] = field(default_factory=lambda: dict[str, SocketBoard]())
    serial_multimeter: SerialMultimeter | None = None
    pulse_counter: PulseCounter | None = None

    def next_event_s(self) -> float | None:
        """The end of the nearest window, or the arrival of an answer."""
        measuring = (self.multimeter, self.oscilloscope, self.serial_multimeter, self.pulse_counter)
        moments = [instrument.next_event_s() for instrument in measuring if instrument is not None]
        return min((moment for moment in moments if moment is not None), default=None)

    def advance(self, to_s: float) -> list[tuple[str, bytes]]:
        """Windows that end until then; what an instrument sends by itself, with its link."""
        for instrument in (self.multimeter, self.oscilloscope, self.pulse_counter):
            if instrument is not None:
                instrument.advance(to_s)
        if self.serial_multimeter is None:
            return []
        return [(METER_LINK, output.data) for output in self.serial_multimeter.advance(to_s)]


class BenchModel:
    """Sockets and instruments in step.

    Args:
        sockets: in the order of the supply's channels.
        seed: of the instruments' calibration states and noise.
        serial: of the bench, part of the instruments' serial numbers.
        with_board: a socket board bench, with multimeter, oscilloscope and boards.
        stand: the motion stand that carries the socket, if there is one.
    """

    def __init__(
        self,
        sockets: Iterable[SocketModel],
        seed: int,
        serial: str,
        *,
        with_board: bool,
        stand: StandModel | None = None,
    ) -> None:
        self.stand = stand
        self.sockets = {socket.name: socket for socket in sockets}
        loads = list(self.sockets.values())
        self.instruments = Instruments(PowerSupply(loads, seed, f"{serial}-PS"))
        if with_board:
            inputs = SharedInputs()
            self.instruments.multimeter = Multimeter(inputs, seed, f"{serial}-DMM")
            self.instruments.oscilloscope = Oscilloscope(inputs, seed, f"{serial}-OSC")
            self.instruments.boards = {
                socket.name: SocketBoard(
                    socket.name, socket, inputs, seed + index, f"{serial}-SB{socket.name}"
                )
                for index, socket in enumerate(loads)
            }
            for board in self.instruments.boards.values():
                board.apply_ad_source(0.0)

    def next_event_s(self, watched_links: Iterable[str]) -> float | None:
        """The next moment at which time has to stop on its way.

        The ends of the instruments' windows always; what units and the stand do only where somebody
        watches their links, because the others' bytes may as well be handed over later.
        """
        moments = [self.instruments.next_event_s()]
        for name in {link.partition(".")[0] for link in watched_links} - {METER}:
            emitter = self.stand if name == STAND else self.sockets[name].unit
            moments.append(emitter.next_event_s() if emitter is not None else None)
        return min((moment for moment in moments if moment is not None), default=None)

    def advance(self, to_s: float) -> list[tuple[str, bytes]]:
        """What left the bench on each link since the last call; then the instruments at that moment."""
        outputs = [piece for socket in self.sockets.values() for piece in socket.advance(to_s)]
        if self.stand is not None:
            samples = self.stand.advance(to_s)
            if samples:
                outputs.append((STAND_STREAM_LINK, samples))
        return outputs + self.instruments.advance(to_s)

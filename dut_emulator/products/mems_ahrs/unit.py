# pyright: strict
"""A MEMS attitude unit on its RS-422 link: power, commands, stream. Times are the bench's.

How commands are answered is in `products.command_link`. A correction that is written while a stream runs
takes effect with the next sample, its gates with the next stream.

The housing keeps its heat over a loss of power. Out of scope: the crystal's error (a twin may have
'link.clock_drift'), the time that bytes take on the line.
"""

import heapq
from collections.abc import Callable
from itertools import chain, count
from typing import Any

import numpy as np

from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.interfaces import EmulatedUnit, LinkOutput, Surroundings
from dut_emulator.lot import LotDraw
from dut_emulator.products.command_link import (
    FLASH_WRITE_S,
    REPLY_LATENCY_S,
    RESET_DELAY_S,
    CommandLink,
    identity,
    reply,
)
from dut_emulator.products.mems_ahrs import cooling
from dut_emulator.products.mems_ahrs.compensation import Flash, Node, TriadCompensation
from dut_emulator.products.mems_ahrs.sampling import SENSORS, Ahrs, Housing, check_twin
from dut_emulator.products.mems_ahrs.stream import Stream
from dut_emulator.products.mems_ahrs.unit_effects import draw_twin
from dut_emulator.products.product import chain_effects
from dut_emulator.products.stand_unit import StandUnit
from dut_emulator.twin import Twin
from protocol import mems_ahrs as rs422
from protocol.frames import Frame
from protocol.mems_ahrs import FrameType, ReplyStatus, Sensor

FIRMWARE_VERSION, HARDWARE_REVISION = "2.1.0", "B"
HEAT_STEP_S = 1.0
"""Between samples the ambient is looked at so often."""
MAX_SAMPLES_PER_OUTPUT = 4096
_SENSOR_NOISE = 1


def make_unit(
    seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
) -> EmulatedUnit:
    """The unit of this serial number in the lot of this seed, with what its flash kept (None: new).

    Raises:
        TestloomError: a twin or a flash that is no mems_ahrs's.
    """
    return MemsAhrsUnit(seed, serial, flash, twin)


class MemsAhrsUnit(StandUnit):
    """See `EmulatedUnit`."""

    def __init__(
        self, seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
    ) -> None:
        super().__init__(serial)
        self._draw = LotDraw(seed, serial)
        self._twin = twin or draw_twin(seed, serial)
        check_twin(self._twin)
        self._flash = Flash.from_image(flash) if flash is not None else Flash()
        self._housing: Housing | None = None
        self._ahrs: Ahrs | None = None
        self._stream: Stream | None = None
        self._power_on_s = self._ready_s = 0.0
        self._resets_s: float | None = None
        self._outbox: list[tuple[float, int, LinkOutput]] = []
        self._order = count()
        self._link = CommandLink(0.0)
        self._last_flags = 0
        self._last_attitude_deg = (np.nan, np.nan, np.nan)

    def insert(self, surroundings: Surroundings, now_s: float) -> None:
        """The unit is put into a socket, unpowered, with the temperature that is there."""
        super().insert(surroundings, now_s)
        warmth = chain_effects(self._twin, surroundings.effects, "temperature")
        self._housing = Housing(cooling.AS_MEASURED, cooling.Cooling.PASTE, warmth)
        self._housing.settle(self._acting(np.array([now_s])), now_s)

    def set_supply(self, voltage_v: float, now_s: float) -> None:
        """The voltage at the supply pins; the linear regulators turn what is too much into heat."""
        if self._powered:
            self._advance_to(now_s)
            self._send_samples(now_s, whole_blocks=False)
        super().set_supply(voltage_v, now_s)
        if self._ahrs is not None:
            self._ahrs.supply_v = voltage_v
        self._heat(now_s)

    def flash_image(self) -> dict[str, Any]:
        """What the unit keeps without power, JSON-able."""
        return self._flash.as_image()

    # --- power

    def _power_on(self, surroundings: Surroundings, now_s: float) -> None:
        assert self._housing is not None
        self._flash = self._flash.after_power_on()
        self._power_on_s = now_s
        seed = self._draw.seed_for(_SENSOR_NOISE, self._flash.power_cycles, round(now_s * 1e6))
        triads = [chain_effects(self._twin, surroundings.effects, sensor) for sensor in SENSORS]
        self._ahrs = Ahrs(chain.from_iterable(triads), self._housing, self._flash, seed, now_s)
        self._boot(now_s)

    def _power_off(self, now_s: float) -> None:
        del now_s
        self._stream = self._ahrs = self._resets_s = None
        self._outbox.clear()

    def _boot(self, now_s: float) -> None:
        self._ready_s = now_s + rs422.BOOT_DURATION_S
        self._stream = self._resets_s = None
        self._link = CommandLink(now_s)
        self._last_flags, self._last_attitude_deg = 0, (np.nan, np.nan, np.nan)

    def _heat(self, now_s: float) -> None:
        """Let the housing come to now as it was; from here on it is heated by what runs now."""
        if self._housing is None:
            return
        steps = int((now_s - self._housing.last_s) / HEAT_STEP_S)
        ticks = self._housing.last_s + HEAT_STEP_S * np.arange(1, steps + 1, dtype=np.float64)
        if steps:
            self._housing.advance(self._acting(ticks), HEAT_STEP_S)
        rest_s = now_s - self._housing.last_s
        if rest_s > 0:
            self._housing.advance(self._acting(np.array([now_s])), rest_s)
        rate_hz = self._stream.rate_hz if self._stream is not None else 0.0
        self._housing.heat_w = cooling.heat_w(self._supply_v if self._powered else 0.0, rate_hz)

    def _running_current_a(self) -> float:
        return cooling.supply_current_a(self._stream.rate_hz if self._stream is not None else 0.0)

    # --- time

    def _run_to(self, now_s: float) -> list[LinkOutput]:
        if self._resets_s is not None and now_s >= self._resets_s:
            reset_s = self._resets_s
            self._send_samples(reset_s, whole_blocks=False)
            self._boot(reset_s)
            self._heat(reset_s)
        self._send_samples(now_s, whole_blocks=True)
        left: list[LinkOutput] = []
        while self._outbox and self._outbox[0][0] <= now_s:
            left.append(heapq.heappop(self._outbox)[2])
        return left

    def _next_event_s(self) -> float | None:
        times = [
            *([self._outbox[0][0]] if self._outbox else []),
            *([self._stream.next_block_s()] if self._stream is not None else []),
            *([self._resets_s] if self._resets_s is not None else []),
        ]
        return min(times, default=None)

    def _send_samples(self, now_s: float, *, whole_blocks: bool) -> None:
        stream, ahrs = self._stream, self._ahrs
        if stream is None or ahrs is None:
            return
        due = stream.due(now_s, whole_blocks=whole_blocks)
        while due > 0:
            number = min(due, MAX_SAMPLES_PER_OUTPUT)
            due -= number
            times_s = np.minimum(stream.instants_s(number), now_s)
            samples = ahrs.sample(self._acting, times_s, stream.period_s, compensated=stream.compensated)
            self._last_flags = int(samples.flags[-1])
            roll, pitch, yaw = np.degrees(samples.attitude_rad[-1])
            self._last_attitude_deg = (float(roll), float(pitch), float(yaw))
            data = stream.encode(samples, (times_s - self._power_on_s) * 1e6)
            self._send(data, float(times_s[-1]))

    def _acting(self, times_s: FloatArray) -> Stimulus:
        assert self._surroundings is not None
        return self._surroundings.stimulus(times_s)

    # --- commands

    def _received(self, link: str, data: bytes, now_s: float, can_id: int | None) -> None:
        del can_id
        if link != "rs422" or now_s < self._ready_s:
            return
        for frame in self._link.commands(data, now_s):
            self._handle(frame, now_s)

    def _handle(self, frame: Frame, now_s: float) -> None:
        handlers: dict[int, Callable[[Frame, float], None]] = {
            FrameType.IDENTIFY: self._identify,
            FrameType.START_STREAM: self._start_stream,
            FrameType.STOP_STREAM: self._stop_stream,
            FrameType.WRITE_COEFFICIENTS: self._write_coefficients,
            FrameType.READ_COEFFICIENTS: self._read_coefficients,
            FrameType.WRITE_NODE: self._write_node,
            FrameType.READ_NODE: self._read_node,
            FrameType.ERASE_NODES: self._erase_nodes,
            FrameType.STATUS: self._status,
            FrameType.RESET: self._reset,
            FrameType.ECHO: self._echo,
        }
        handler = handlers.get(frame.type)
        if handler is None:
            self._answer(frame, ReplyStatus.UNKNOWN, now_s)
        else:
            handler(frame, now_s)

    def _identify(self, frame: Frame, now_s: float) -> None:
        texts = identity(self._serial, FIRMWARE_VERSION, HARDWARE_REVISION)
        self._answer(frame, ReplyStatus.DONE, now_s, texts)

    def _echo(self, frame: Frame, now_s: float) -> None:
        self._answer(frame, ReplyStatus.DONE, now_s, frame.payload)

    def _reset(self, frame: Frame, now_s: float) -> None:
        self._answer(frame, ReplyStatus.DONE, now_s)
        self._resets_s = now_s + RESET_DELAY_S

    def _start_stream(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != rs422.START_STREAM_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        rate_hz, flags = rs422.START_STREAM_LAYOUT.unpack(frame.payload)
        if rate_hz not in rs422.STREAM_RATES_HZ or flags > 1:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        assert self._ahrs is not None
        self._send_samples(now_s, whole_blocks=False)
        self._stream = Stream(rate_hz, bool(flags & 1), now_s + REPLY_LATENCY_S)
        self._ahrs.begin_stream(self._stream.period_s)
        self._heat(now_s)
        self._answer(frame, ReplyStatus.DONE, now_s)

    def _stop_stream(self, frame: Frame, now_s: float) -> None:
        self._send_samples(now_s, whole_blocks=False)
        self._stream = None
        self._last_attitude_deg = (np.nan, np.nan, np.nan)
        self._heat(now_s)
        self._answer(frame, ReplyStatus.DONE, now_s)

    def _status(self, frame: Frame, now_s: float) -> None:
        assert self._housing is not None
        self._send_samples(now_s, whole_blocks=False)
        self._heat(now_s)
        now_c = self._housing.temperatures_c
        values = rs422.STATUS_LAYOUT.pack(
            ReplyStatus.DONE,
            self._last_flags,
            self._housing.components_too_hot(),
            round((now_s - self._power_on_s) * 1e6),
            *cooling.infrared_points_c(now_c[np.newaxis, :])[0],
            now_c[cooling.CASE],
            *self._last_attitude_deg,
        )
        self._answer(frame, ReplyStatus.DONE, now_s, values[1:])

    def _write_coefficients(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != rs422.COEFFICIENTS_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor, *numbers = rs422.COEFFICIENTS_LAYOUT.unpack(frame.payload)
        if sensor not in tuple(Sensor):
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        nodes = self._flash.triads[Sensor(sensor)].nodes
        triad = TriadCompensation(tuple(numbers[:9]), tuple(numbers[9:]), nodes)
        return self._keep(frame, Sensor(sensor), triad, now_s)

    def _read_coefficients(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != 1 or frame.payload[0] not in tuple(Sensor):
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor = Sensor(frame.payload[0])
        triad = self._flash.triads[sensor]
        packed = rs422.COEFFICIENTS_LAYOUT.pack(sensor, *triad.matrix, *triad.bias)
        return self._answer(frame, ReplyStatus.DONE, now_s, packed)

    def _write_node(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != rs422.NODE_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor, index, temperature_c, *numbers = rs422.NODE_LAYOUT.unpack(frame.payload)
        if sensor not in tuple(Sensor) or index > len(self._flash.triads[Sensor(sensor)].nodes):
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        triad = self._flash.triads[Sensor(sensor)].with_node(index, Node(temperature_c, tuple(numbers)))
        return self._keep(frame, Sensor(sensor), triad, now_s)

    def _read_node(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != rs422.NODE_ADDRESS_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor, index = frame.payload
        if sensor not in tuple(Sensor) or index >= len(self._flash.triads[Sensor(sensor)].nodes):
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        node = self._flash.triads[Sensor(sensor)].nodes[index]
        packed = rs422.NODE_LAYOUT.pack(sensor, index, node.temperature_c, *node.coefficients)
        return self._answer(frame, ReplyStatus.DONE, now_s, packed)

    def _erase_nodes(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != 1 or frame.payload[0] not in tuple(Sensor):
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor = Sensor(frame.payload[0])
        old = self._flash.triads[sensor]
        return self._keep(frame, sensor, TriadCompensation(old.matrix, old.bias), now_s)

    def _keep(self, frame: Frame, sensor: Sensor, triad: TriadCompensation, now_s: float) -> None:
        """Into the flash, from the samples after now on; refused if it is not sound."""
        if not triad.is_acceptable:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        assert self._ahrs is not None
        self._send_samples(now_s, whole_blocks=False)
        self._ahrs.flash = self._flash = self._flash.with_triad(sensor, triad)
        return self._answer(frame, ReplyStatus.DONE, now_s + FLASH_WRITE_S)

    def _answer(self, frame: Frame, status: ReplyStatus, now_s: float, rest: bytes = b"") -> None:
        self._send(reply(frame, bytes((status,)) + rest), now_s + REPLY_LATENCY_S)

    def _send(self, data: bytes, time_s: float) -> None:
        heapq.heappush(self._outbox, (time_s, next(self._order), LinkOutput(time_s, "rs422", data)))

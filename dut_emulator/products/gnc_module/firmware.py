# pyright: strict
"""The firmware from boot to reset or brown-out: what RAM holds, commands, self-tests, stream, heartbeat.

Time passes by `run_to`, which does everything due until then in order; commands arrive between two such
calls. What leaves the unit carries its own bench time and waits in the outbox until that has come. The
firmware counts in its crystal's time: every duration it keeps is true time × (1 + crystal_error).

How commands are answered is in `products.command_link`.
While it streams, rate and specific force go out on CAN too. Out of scope: the time that bytes take on a line.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count
from operator import attrgetter

import numpy as np

from dut_emulator.interfaces import LinkOutput
from dut_emulator.products.command_link import (
    FLASH_WRITE_S,
    REPLY_LATENCY_S,
    RESET_DELAY_S,
    CommandLink,
    identity,
    reply,
)
from dut_emulator.products.gnc_module import self_tests
from dut_emulator.products.gnc_module.can_output import can_bursts
from dut_emulator.products.gnc_module.flash import Coefficients
from dut_emulator.products.gnc_module.gnss_forwarding import GnssForwarding, gnss_self_test
from dut_emulator.products.gnc_module.hardware import Hardware
from dut_emulator.products.gnc_module.heartbeat import status_frame
from dut_emulator.products.gnc_module.inertial_sensors import SensorSamples
from dut_emulator.products.gnc_module.stream import MAX_SAMPLES_PER_OUTPUT, SampleStream
from protocol import gnc_module as product
from protocol.can_database import (
    GNC_STATUS,
    GNC_TEST_ECHO,
    GNC_TEST_REQUEST,
    PATTERN_MASK,
    CanFrame,
    EchoStatus,
    UnitState,
    decode_can,
    encode_can,
    message_period_s,
)
from protocol.errors import LinkError
from protocol.frames import Frame
from protocol.gnc_module import FrameType, ReplyStatus, SelfTest, Sensor

ECHO_LATENCY_S = 1e-3
HEARTBEATS_PER_TEMPERATURE = 8
"""The heartbeat's temperature is read anew with every so many; 256 is a multiple of it."""
FIRMWARE_VERSION, HARDWARE_REVISION = "1.4.2", "C"

_MEMORY_TESTS = (SelfTest.INTERNAL_RAM, SelfTest.SDRAM, SelfTest.SPI_FLASH, SelfTest.INTERNAL_FLASH)


@dataclass(frozen=True)
class RunningTest:
    """A self-test that occupies its resource."""

    test: SelfTest
    argument: int
    sequence: int
    started_s: float


class Firmware:
    """What runs on the processor from one boot to the next.

    `on_booted` is called when it begins to listen, `on_reset` (with the time) when it has ended itself.
    """

    def __init__(
        self,
        hardware: Hardware,
        now_s: float,
        on_booted: Callable[[], None],
        on_reset: Callable[[float], None],
    ) -> None:
        self.hardware = hardware
        self._on_booted, self._on_reset = on_booted, on_reset
        self._ready = False
        self._order = count()
        self._agenda: list[tuple[float, int, Callable[[float], None]]] = []
        self._outbox: list[tuple[float, int, LinkOutput]] = []
        self._on_can: list[LinkOutput] = []  # of the stream, in their order: too many for the outbox
        self._link = CommandLink(now_s)
        self._running: dict[str, RunningTest] = {}
        self._stream: SampleStream | None = None
        self._forwarding: GnssForwarding | None = None
        self._frames_echoed = 0
        self._heartbeat_counter = 0
        self._temperature_c = 0.0
        self._error_flags: set[str] = set()
        self._at(now_s + product.BOOT_DURATION_S * hardware.second_s, self._boot_done)
        self._heartbeat_period_s = (message_period_s(GNC_STATUS) or 0.1) * hardware.second_s
        self._at(now_s + self._heartbeat_period_s, self._heartbeat)

    @property
    def timer_period_s(self) -> float | None:
        """True period of the square wave at TIMER_OUT; None when there is none."""
        running = self._running.get(product.RESOURCE_OF_TEST[SelfTest.TIMER])
        if running is None or running.test is not SelfTest.TIMER:
            return None
        return running.argument * 1e-6 * self.hardware.second_s

    def next_event_s(self) -> float | None:
        """When something will happen or leave by itself."""
        times = [entry[0] for entry in (*self._agenda[:1], *self._outbox[:1])]
        times += [output.time_s for output in self._on_can[:1]]
        if self._stream is not None:
            times.append(self._stream.next_block_s())
        return min(times, default=None)

    def run_to(self, to_s: float) -> list[LinkOutput]:
        """Do what is due; everything that has left the unit, in order of time."""
        while self._agenda and self._agenda[0][0] <= to_s:  # a restart empties the agenda
            time_s, _, action = heapq.heappop(self._agenda)
            action(time_s)
        if self._stream is not None:
            self._send_samples(self._stream, to_s, whole_blocks=True)
        left: list[LinkOutput] = []
        while self._outbox and self._outbox[0][0] <= to_s:
            left.append(heapq.heappop(self._outbox)[2])
        if self._on_can:
            left = sorted(left + self._on_can, key=attrgetter("time_s"))
            self._on_can = []
        return left

    # --- what arrives

    def receive_rs422(self, data: bytes, now_s: float) -> None:
        """Bytes on RS-422. While booting nobody listens."""
        if not self._ready:
            return
        for frame in self._link.commands(data, now_s):
            self._handle(frame, now_s)

    def receive_can(self, identifier: int, data: bytes, now_s: float) -> None:
        """A CAN frame. Anything but a well-formed request is not for us."""
        if not self._ready or self.hardware.truth.digital.can_silent:
            return
        try:
            message = decode_can(identifier, data)
        except LinkError:
            return
        if message.name != GNC_TEST_REQUEST:
            return
        armed = product.RESOURCE_OF_TEST[SelfTest.CAN] in self._running
        self._frames_echoed += armed
        echo = {
            "inverted_pattern": int(message.signals["pattern"]) ^ PATTERN_MASK,
            "counter": message.signals["counter"],
            "status": int(EchoStatus.OK if armed else EchoStatus.NOT_READY),
        }
        self._send_can(encode_can(GNC_TEST_ECHO, echo), now_s + ECHO_LATENCY_S)

    # --- commands

    def _handle(self, frame: Frame, now_s: float) -> None:
        handlers: dict[int, Callable[[Frame, float], None]] = {
            FrameType.IDENTIFY: self._identify,
            FrameType.SELF_TEST: self._self_test,
            FrameType.START_STREAM: self._start_stream,
            FrameType.STOP_STREAM: self._stop_stream,
            FrameType.WRITE_COEFFICIENTS: self._write_coefficients,
            FrameType.READ_COEFFICIENTS: self._read_coefficients,
            FrameType.RESET: self._reset,
            FrameType.ECHO: self._echo,
            FrameType.FORWARD_GNSS: self._forward_gnss,
        }
        handler = handlers.get(frame.type)
        if handler is None:
            self._answer(frame, ReplyStatus.UNKNOWN, now_s)
        else:
            handler(frame, now_s)

    def _identify(self, frame: Frame, now_s: float) -> None:
        texts = identity(self.hardware.truth.serial, FIRMWARE_VERSION, HARDWARE_REVISION)
        self._answer(frame, ReplyStatus.DONE, now_s, texts)

    def _echo(self, frame: Frame, now_s: float) -> None:
        self._answer(frame, ReplyStatus.DONE, now_s, frame.payload)

    def _reset(self, frame: Frame, now_s: float) -> None:
        self._answer(frame, ReplyStatus.DONE, now_s)
        self._at(now_s + RESET_DELAY_S, self._restart)

    def _restart(self, now_s: float) -> None:
        """The end of this firmware's RAM: what has left has left, what was to leave later never will."""
        if self._stream is not None:
            self._send_samples(self._stream, now_s, whole_blocks=True)
        self._stream = None
        self._agenda.clear()
        self._outbox = [entry for entry in self._outbox if entry[0] <= now_s]
        heapq.heapify(self._outbox)
        self._on_reset(now_s)

    def _start_stream(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != product.START_STREAM_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        rate_hz, flags = product.START_STREAM_LAYOUT.unpack(frame.payload)
        if rate_hz not in product.STREAM_RATES_HZ or flags > 1:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        if self._imu_is_busy():
            return self._answer(frame, ReplyStatus.BUSY, now_s)
        period_s = self.hardware.second_s / rate_hz
        self._stream = SampleStream(rate_hz, bool(flags & 1), now_s + REPLY_LATENCY_S, period_s)
        self._answer(frame, ReplyStatus.DONE, now_s)

    def _stop_stream(self, frame: Frame, now_s: float) -> None:
        if self._stream is not None:
            self._send_samples(self._stream, now_s, whole_blocks=False)
            self._stream = None
        self._answer(frame, ReplyStatus.DONE, now_s)

    def _forward_gnss(self, frame: Frame, now_s: float) -> None:
        order = GnssForwarding.ordered(frame.payload)
        if order is None:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        rate_hz, protocols = order
        self._forwarding = None
        if rate_hz:
            self._forwarding = GnssForwarding(self.hardware, rate_hz, protocols, now_s)
            self._at(self._forwarding.next_epoch_s, partial(self._gnss_epoch, self._forwarding))
        self._answer(frame, ReplyStatus.DONE, now_s)

    def _gnss_epoch(self, forwarding: GnssForwarding, now_s: float) -> None:
        if forwarding is not self._forwarding:
            return  # another order has come since
        self._send(LinkOutput(now_s, "rs422", forwarding.epoch()))
        self._at(forwarding.next_epoch_s, partial(self._gnss_epoch, forwarding))

    def _write_coefficients(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != product.COEFFICIENTS_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor, *numbers = product.COEFFICIENTS_LAYOUT.unpack(frame.payload)
        coefficients = Coefficients(tuple(numbers[:9]), tuple(numbers[9:]))
        if sensor not in tuple(Sensor) or not coefficients.is_acceptable:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        self.hardware.flash = self.hardware.flash.with_coefficients(Sensor(sensor), coefficients)
        self._answer(frame, ReplyStatus.DONE, now_s + FLASH_WRITE_S)

    def _read_coefficients(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != 1 or frame.payload[0] not in tuple(Sensor):
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        sensor = Sensor(frame.payload[0])
        entry = self.hardware.flash.coefficients[sensor]
        packed = product.COEFFICIENTS_LAYOUT.pack(sensor, *entry.matrix, *entry.bias)
        self._answer(frame, ReplyStatus.DONE, now_s, packed)

    # --- self-tests

    def _self_test(self, frame: Frame, now_s: float) -> None:
        if len(frame.payload) != product.SELF_TEST_LAYOUT.size:
            return self._answer(frame, ReplyStatus.INVALID, now_s)
        number, argument = product.SELF_TEST_LAYOUT.unpack(frame.payload)
        echoed = product.SELF_TEST_LAYOUT.pack(number, argument)
        if number not in tuple(SelfTest):
            return self._answer(frame, ReplyStatus.UNKNOWN, now_s, echoed)
        test = SelfTest(number)
        if not self_tests.is_valid_argument(test, argument):
            return self._answer(frame, ReplyStatus.INVALID, now_s, echoed)
        resource = product.RESOURCE_OF_TEST[test]
        if resource in self._running or (test is SelfTest.IMU and self._imu_is_busy()):
            return self._answer(frame, ReplyStatus.BUSY, now_s, echoed)
        self._running[resource] = RunningTest(test, argument, frame.sequence, now_s)
        if test is SelfTest.CAN:
            self._frames_echoed = 0
        self._answer(frame, ReplyStatus.ACCEPTED, now_s, echoed)
        duration_s = product.TEST_DURATION_S[test] * self.hardware.second_s
        self._at(now_s + duration_s, lambda end_s: self._self_test_done(resource, end_s))

    def _self_test_done(self, resource: str, now_s: float) -> None:
        running = self._running.pop(resource)
        head = product.SELF_TEST_REPLY_HEAD.pack(ReplyStatus.DONE, running.test, running.argument)
        values = self._values(running, now_s)
        self._error_flags |= self_tests.error_flags(running.test, values)
        self._send_frame(Frame(FrameType.SELF_TEST, running.sequence, b""), head + values, now_s)

    def _values(self, running: RunningTest, now_s: float) -> bytes:
        hardware, truth = self.hardware, self.hardware.truth
        match running.test:
            case SelfTest.CPU:
                return self_tests.cpu_values()
            case SelfTest.TIMER:
                return self_tests.timer_values(product.TEST_DURATION_S[SelfTest.TIMER], running.argument)
            case SelfTest.IMU:
                return self_tests.imu_values(self._sample_while(running, now_s))
            case SelfTest.GNSS:
                return gnss_self_test(hardware, self._forwarding, now_s)
            case SelfTest.AD:
                acting = hardware.acting_at(now_s)
                field_t = hardware.sensors.field_t(acting.true_input("mag"), acting)[0]
                return self_tests.ad_values(truth, field_t, hardware.routed_v, hardware.rng)
            case SelfTest.IO:
                return self_tests.io_values(truth, running.argument & 0xFF, running.argument >> 8)
            case SelfTest.SPI:
                return self_tests.spi_values(truth)
            case SelfTest.CAN:
                return product.CAN_VALUES.pack(self._frames_echoed)
            case memory:
                assert memory in _MEMORY_TESTS
                return self_tests.memory_values(truth, memory)

    def _sample_while(self, running: RunningTest, now_s: float) -> SensorSamples:
        period_s = self.hardware.second_s / self_tests.IMU_TEST_RATE_HZ
        number = round((now_s - running.started_s) / period_s)
        times_s = np.minimum(running.started_s + period_s * np.arange(1, number + 1), now_s)
        return self.hardware.sensors.sample(times_s, period_s, self.hardware.surroundings.stimulus(times_s))

    def _imu_is_busy(self) -> bool:
        return self._stream is not None or product.RESOURCE_OF_TEST[SelfTest.IMU] in self._running

    # --- what leaves by itself

    def _boot_done(self, _now_s: float) -> None:
        self._ready = True
        self._on_booted()

    def _heartbeat(self, now_s: float) -> None:
        self._at(now_s + self._heartbeat_period_s, self._heartbeat)
        if self._heartbeat_counter % HEARTBEATS_PER_TEMPERATURE == 0:
            self._temperature_c = self._read_temperature_c(now_s)
        flags = frozenset(self._error_flags | ({"link"} if self._link.crc_errors else set()))
        supply_v = round(self.hardware.supply_v, 3)
        identifier, data = status_frame(self._unit_state(), flags, supply_v, self._temperature_c)
        data = data[:1] + bytes((self._heartbeat_counter,)) + data[2:]
        self._heartbeat_counter = (self._heartbeat_counter + 1) % 256
        self._send_can(CanFrame(identifier, data), now_s)

    def _read_temperature_c(self, now_s: float) -> float:
        hardware = self.hardware
        warmth = hardware.sensors.temperature_c(hardware.acting_at(now_s).temperature_c, np.array([now_s]))
        return round(float(warmth[0]) + hardware.truth.temperature_error_c, 2)

    def _unit_state(self) -> UnitState:
        if not self._ready:
            return UnitState.STARTING
        if self._running:
            return UnitState.SELF_TEST
        return UnitState.STREAMING if self._stream is not None else UnitState.IDLE

    def _send_samples(self, stream: SampleStream, now_s: float, *, whole_blocks: bool) -> None:
        due = stream.due(now_s, whole_blocks=whole_blocks)
        while due > 0:
            number = min(due, MAX_SAMPLES_PER_OUTPUT)
            due -= number
            times_s = np.minimum(stream.instants_s(number), now_s)
            acting = self.hardware.surroundings.stimulus(times_s)
            raw = self.hardware.sensors.sample(times_s, stream.period_s, acting)
            coefficients, latest_s = self.hardware.flash.coefficients, float(times_s[-1])
            if not self.hardware.truth.digital.can_silent:
                self._on_can += can_bursts(raw, coefficients, stream, latest_s)
            chosen = raw
            if stream.compensated:
                chosen = raw.compensated(coefficients[Sensor.GYRO], coefficients[Sensor.ACC])
            data = stream.encode(chosen, self.hardware.unit_time_us(times_s))
            self._send(LinkOutput(latest_s, "rs422", data))

    # --- plumbing

    def _at(self, time_s: float, action: Callable[[float], None]) -> None:
        heapq.heappush(self._agenda, (time_s, next(self._order), action))

    def _answer(self, frame: Frame, status: ReplyStatus, now_s: float, rest: bytes = b"") -> None:
        self._send_frame(frame, bytes((status,)) + rest, now_s + REPLY_LATENCY_S)

    def _send_frame(self, command: Frame, payload: bytes, time_s: float) -> None:
        self._send(LinkOutput(time_s, "rs422", reply(command, payload)))

    def _send_can(self, frame: CanFrame, time_s: float) -> None:
        if not self.hardware.truth.digital.can_silent:
            self._send(LinkOutput(time_s, "can", frame.data, frame.identifier))

    def _send(self, output: LinkOutput) -> None:
        if output.link == "rs422" and self.hardware.truth.digital.rs422_silent:
            return
        heapq.heappush(self._outbox, (output.time_s, next(self._order), output))

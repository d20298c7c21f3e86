# pyright: strict
"""A gyro on a bench: supply, RS-422, broadcast and query.

Powered, it boots for 0.5 s and then broadcasts one frame each period: the last byte of frame k comes k
periods after the end of the boot. A command takes effect with its last byte: `BROADCAST` starts a new
row of frames one period later, `QUERY` is answered with the newest data, whose last byte comes 60 µs of
processing and the frame's time on the line after it. A second query during an answer is not heard.
In both modes a frame shows the motion a pure lag before its last byte. The loop runs at the frame rate last
set, also in query mode: the answers' noise is that of its frames.
"""

import math
from typing import Any

import numpy as np

from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.interfaces import EmulatedUnit, LinkOutput, Surroundings
from dut_emulator.lot import LotDraw
from dut_emulator.motion.impact_profile import TakesFrames
from dut_emulator.products.fog.population import draw_twin
from dut_emulator.products.fog.sensor import SUPPLY_A, FogSensor, check_effects
from dut_emulator.products.stand_unit import StandUnit
from dut_emulator.twin import Twin
from protocol.fog import (
    DEFAULT_FRAME_RATE_HZ,
    FRAME_BYTES,
    FRAME_RATES_HZ,
    FRAME_TRANSMISSION_S,
    Command,
    FogCommandParser,
    FrameStatus,
    make_frames,
)

LINK = "rs422"
BOOT_S = 0.5
QUERY_PROCESSING_S = 60e-6
ANSWER_S = QUERY_PROCESSING_S + FRAME_TRANSMISSION_S
BLOCK_S = 0.05
"""Of broadcast frames, when nobody stops time earlier; each still has its own instant."""
MAX_FRAMES_PER_OUTPUT = 8192
_INSTANT_TOLERANCE_S = 1e-9
_POWER_ON = 7_001
"""Purpose of `LotDraw.seed_for`."""


def make_unit(
    seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
) -> EmulatedUnit:
    """The gyro of this serial number in the lot of this seed. It keeps nothing without power."""
    del flash
    return FogUnit(seed, serial, twin or draw_twin(seed, serial))


class FogUnit(StandUnit):
    """See `EmulatedUnit`. Noise depends on unit and power-on time only: the same day, the same bytes."""

    def __init__(self, seed: int, serial: str, twin: Twin) -> None:
        super().__init__(serial)
        check_effects(twin)
        self._draw = LotDraw(seed, serial)
        self._twin = twin
        self._sensor: FogSensor | None = None
        self._commands = FogCommandParser()
        self._rate_hz = float(DEFAULT_FRAME_RATE_HZ)
        self._booted_s = self._first_s = math.inf
        self._sent_of_row = 0
        self._answer_s = math.inf
        self._counter = 0
        self._status = FrameStatus(0)

    def _power_on(self, surroundings: Surroundings, now_s: float) -> None:
        seed = self._draw.seed_for(_POWER_ON, max(round(now_s * 1e6), 0))
        self._sensor = FogSensor(self._twin, surroundings.effects, seed, now_s)
        self._commands = FogCommandParser()
        self._rate_hz, self._counter, self._status = float(DEFAULT_FRAME_RATE_HZ), 0, FrameStatus(0)
        self._booted_s = now_s + BOOT_S
        self._begin_row(self._booted_s)

    def _power_off(self, now_s: float) -> None:
        del now_s
        self._sensor = None

    def _begin_row(self, first_s: float) -> None:
        self._first_s, self._sent_of_row, self._answer_s = first_s, 0, math.inf

    def _run_to(self, now_s: float) -> list[LinkOutput]:
        passed_s = now_s - self._first_s + _INSTANT_TOLERANCE_S
        ripe = math.floor(passed_s * self._rate_hz) + 1 if passed_s >= 0 else 0
        left: list[LinkOutput] = []
        while ripe > self._sent_of_row:
            numbers = np.arange(self._sent_of_row, min(ripe, self._sent_of_row + MAX_FRAMES_PER_OUTPUT))
            self._sent_of_row += len(numbers)
            left += self._frames(self._first_s + numbers / self._rate_hz)
        if now_s + _INSTANT_TOLERANCE_S >= self._answer_s:
            answer_s, self._answer_s = self._answer_s, math.inf
            left += self._frames(np.array([answer_s]))
        return left

    def _frames(self, received_s: FloatArray) -> list[LinkOutput]:
        """Frames with these last bytes, as one block."""
        surroundings = self._surroundings
        assert self._sensor is not None
        assert surroundings is not None
        self._sensor.supply_v = self._supply_v
        samples = self._sensor.sample(received_s, self._rate_hz, self._acting)
        counters = (self._counter + np.arange(len(received_s))).astype(np.uint8)
        self._counter += len(received_s)
        statuses = samples.status | np.uint8(self._status)
        frames = make_frames(counters, statuses, samples.rate, samples.temperature)[~samples.lost]
        if len(frames) == 0:
            return []
        if isinstance(surroundings, TakesFrames):
            rows = frames.view(np.uint8).reshape(-1, FRAME_BYTES)
            surroundings.take_frames(rows, received_s[~samples.lost])
        return [LinkOutput(float(received_s[-1]), LINK, frames.tobytes())]

    def _acting(self, times_s: FloatArray) -> Stimulus:
        assert self._surroundings is not None
        return self._surroundings.stimulus(times_s)

    def _received(self, link: str, data: bytes, now_s: float, can_id: int | None) -> None:
        del can_id
        if link != LINK or now_s < self._booted_s:
            return
        for frame in self._commands.feed(data):
            self._obey(frame.command, frame.argument, now_s)

    def _obey(self, command: int, argument: int, now_s: float) -> None:
        low, high = FRAME_RATES_HZ
        match command:
            case Command.BROADCAST if low <= argument <= high:
                self._rate_hz, self._status = float(argument), FrameStatus(0)
                self._begin_row(now_s + 1.0 / self._rate_hz)
            case Command.QUERY_MODE:
                self._status = FrameStatus.QUERY_MODE
                self._begin_row(math.inf)
            case Command.QUERY if self._status & FrameStatus.QUERY_MODE:
                self._answer_s = min(self._answer_s, now_s + ANSWER_S)
            case _:
                self._status |= FrameStatus.COMMAND_REFUSED

    def _next_event_s(self) -> float | None:
        block = max(round(BLOCK_S * self._rate_hz), 1)
        due_s = min(self._first_s + (self._sent_of_row + block - 1) / self._rate_hz, self._answer_s)
        return due_s if math.isfinite(due_s) else None

    def _running_current_a(self) -> float:
        return SUPPLY_A
